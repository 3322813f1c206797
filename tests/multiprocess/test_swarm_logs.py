"""ULog and tlog of many processes with a ground station, of which one vehicle is killed. About 6 s."""

import struct

import numpy as np
import pytest
from paths import SCENARIOS
from pymavlink import mavutil  # noqa: TID251  reads the log
from pymavlink.dialects.v20 import common
from pyulog import ULog

from harness.launch.swarm import Swarm

pytestmark = pytest.mark.multiprocess

SECRET = bytes(range(32))
EPOCH_UNIX_US = 1_767_225_600_000_000
"""`run.epoch_utc`, 2026-01-01."""
STAMP = struct.Struct(">Q")


def receive(link, frames):
    """Add the frames that have arrived at a station to a list."""
    while (message := link.recv_msg()) is not None:
        frames.append(bytes(message.get_msgbuf()))


def frames_of(path):
    """Return time and frame of each entry of a tlog, by its layout; pymavlink's reader skips other bytes."""
    data, at, found = path.read_bytes(), 0, []
    while at < len(data):
        (time_us,) = STAMP.unpack_from(data, at)
        assert data[at + 8] == 0xFD
        length = 12 + data[at + 9] + (13 if data[at + 10] & 1 else 0)
        found.append((time_us, data[at + 8 : at + 8 + length]))
        at += 8 + length
    assert at == len(data)
    return found


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Return folder, summary, and the frames that a station of vehicle 0 has received."""
    folder, received = tmp_path_factory.mktemp("logs") / "run", []
    overrides = ["formation.rows=1", "formation.columns=2", "onboard.hold=true"]
    overrides += ["logging.ulog=true", "logging.tlog=true"]
    swarm = Swarm(SCENARIOS / "article.toml", agents=2, overrides=overrides, out=folder, wall_limit_s=120.0)
    with swarm:
        swarm.run(until_s=2.0)
        link = swarm.mavlink(0)
        swarm.run(until_s=3.0)
        link.mav.setup_signing_send(1, 1, SECRET, 0)
        link.mav.param_set_send(1, 1, b"MPC_XY_P", 1.25, common.MAV_PARAM_TYPE_REAL32)
        swarm.run(until_s=4.0)
        swarm.kill(1)
        swarm.run(until_s=5.0)
        receive(link, received)
        summary = swarm.summary(draw=False)  # closes the link
    return folder, summary, received


def test_the_tlog_has_what_the_station_received_and_sent(flown):
    folder, _, received = flown
    entries = frames_of(folder / "ground-0.tlog")
    times_us = [time_us - EPOCH_UNIX_US for time_us, _ in entries]
    assert times_us == sorted(times_us)
    assert times_us[0] >= 0
    assert times_us[-1] <= 5_000_000
    of_vehicle = [frame for _, frame in entries if frame[5] == 1]
    assert len(received) > 50
    first = of_vehicle.index(received[0])
    assert of_vehicle[first : first + len(received)] == received
    of_station = {frame[7] for _, frame in entries if frame[5] == 255}
    assert {common.MAVLINK_MSG_ID_HEARTBEAT, common.MAVLINK_MSG_ID_PARAM_SET} <= of_station


def test_the_tlog_has_no_signing_key_and_is_private(flown):
    folder, *_ = flown
    path = folder / "ground-0.tlog"
    assert SECRET[:31] not in path.read_bytes()  # MAVLink 2 leaves zeros at the end out
    assert path.stat().st_mode & 0o777 == 0o600


def test_pymavlink_reads_the_tlog(flown):
    folder, *_ = flown
    path = folder / "ground-0.tlog"
    log, read = mavutil.mavlink_connection(str(path), dialect="common"), []
    while (message := log.recv_msg()) is not None:
        read.append((round(message._timestamp * 1e6), bytes(message.get_msgbuf())))
    log.close()
    expected = frames_of(path)
    assert [frame for _, frame in read] == [frame for _, frame in expected]
    np.testing.assert_allclose([at for at, _ in read], [at for at, _ in expected], atol=1)


def test_a_change_by_the_station_is_in_the_ulog(flown):
    folder, *_ = flown
    log = ULog(str(folder / "uav-0.ulg"))
    ((time_us, name, value),) = log.changed_parameters
    assert (name, value) == ("MPC_XY_P", 1.25)
    assert 3_000_000 <= time_us <= 4_000_000
    gyro_us = log.get_dataset("sensor_combined").data["timestamp"]
    assert np.array_equal(gyro_us, np.arange(4_000, 5_000_000, 4_000))


def test_the_log_of_the_killed_vehicle_is_readable_and_has_the_truth(flown):
    folder, summary, _ = flown
    assert [vehicle["lost"] is None for vehicle in summary["vehicles"]] == [True, False]
    log = ULog(str(folder / "uav-1.ulg"))
    assert not log.file_corruption
    last_us = log.get_dataset("sensor_combined").data["timestamp"][-1]
    assert 4_000_000 - 2_000_000 < last_us <= 4_000_000
    true_us = log.get_dataset("vehicle_local_position_groundtruth").data["timestamp"]
    assert (true_us[0], true_us[-1]) == (40_000, 4_960_000)
