"""The ULog of a vehicle, read by pyulog: a recorded flight is played to a host with fast steps. 5 s."""

import contextlib
import errno
import io
import os
from pathlib import Path

import msgspec
import numpy as np
import pytest
from host_players import Player
from paths import ROOT
from pymavlink.dialects.v20 import common
from pyulog import ULog

from autopilot.logs.ulog_messages import SampleEncoder
from autopilot.logs.ulog_rows import OF_ROWS
from autopilot.logs.ulog_status import NAV_STATES
from autopilot.logs.ulog_topics import NUMBER_OF, TOPICS, TRUTH_TOPICS
from autopilot.mavlink.codec import Encoder
from autopilot.mavlink.modes import FlightMode
from autopilot.parameters.config import LoggingConfig, VehicleConfig
from autopilot.parameters.onboard_config import OnboardConfig
from autopilot.parameters.table import ROWS
from autopilot.services.service import GROUND_STATION, Addressed, Partner
from studies.vehicle.bench import record_flight

GUIDE = ROOT / "docs" / "how-to" / "ulog.md"
STEP_US = 4_000
FLIGHT_S = 12.0
CHANGED_US = 10_000_000
CONFIG = VehicleConfig(
    run_id="bench", instance=0, seed=7, onboard=OnboardConfig(localisation="gps"),
    places_ned_m=((0.0, 0.0, -5.0),), epoch_unix_us=1_700_000_000_000_000,
)  # fmt: skip
SIZES = {
    "uint64_t": 8, "double": 8, "float": 4, "uint32_t": 4, "int32_t": 4, "uint16_t": 2, "uint8_t": 1,
    "bool": 1,
}  # fmt: skip
WITHOUT_CHANGE = {"manual_control_setpoint", "home_position"}
"""Topics without samples, or with few, in a flight without sticks."""
READ_BY_FLIGHT_REVIEW = {
    "vehicle_local_position": "x y z vx vy vz xy_valid z_valid v_xy_valid v_z_valid ref_timestamp ref_lat "
    "ref_lon dist_bottom dist_bottom_valid",
    "vehicle_local_position_setpoint": "x y z vx vy vz",
    "vehicle_local_position_groundtruth": "x y z vx vy vz",
    "vehicle_gps_position": "latitude_deg longitude_deg altitude_msl_m fix_type time_utc_usec eph epv hdop "
    "vdop s_variance_m_s satellites_used noise_per_ms jamming_indicator vel_m_s",
    "vehicle_air_data": "baro_alt_meter",
    "vehicle_global_position": "alt",
    "vehicle_attitude": "q[0] q[3]",
    "vehicle_attitude_setpoint": "q_d[0] q_d[3] yaw_sp_move_rate",
    "vehicle_attitude_groundtruth": "q[0] q[3]",
    "vehicle_angular_velocity": "xyz[0] xyz[1] xyz[2]",
    "vehicle_angular_velocity_groundtruth": "xyz[0] xyz[1] xyz[2]",
    "vehicle_rates_setpoint": "roll pitch yaw",
    "rate_ctrl_status": "rollspeed_integ pitchspeed_integ yawspeed_integ",
    "manual_control_setpoint": "roll pitch yaw throttle aux1 aux2",
    "vehicle_torque_setpoint": "xyz[0] xyz[1] xyz[2]",
    "vehicle_thrust_setpoint": "xyz[0] xyz[1] xyz[2]",
    "actuator_motors": "control[0] control[11]",
    "actuator_outputs": "noutputs output[0] output[15]",
    "sensor_combined": "accelerometer_m_s2[0] accelerometer_m_s2[2] gyro_rad[0] gyro_rad[2]",
    "vehicle_imu_status": "accel_vibration_metric",
    "vehicle_magnetometer": "magnetometer_ga[0] magnetometer_ga[1] magnetometer_ga[2]",
    "battery_status": "voltage_v current_a discharged_mah remaining ocv_estimate "
    "internal_resistance_estimate temperature",
    "sensor_baro": "temperature",
    "estimator_status": "health_flags timeout_flags time_slip",
    "vehicle_status": "nav_state arming_state failsafe failsafe_and_user_took_over is_vtol vehicle_type "
    "in_transition_mode",
    "failsafe_flags": "auto_mission_missing offboard_control_signal_lost mode_req_attitude",
}
"""Topics and fields that Flight Review's plots of a multicopter read (configured_plots.py, June 2026)."""


def player_into(folder, *, compiled=True, ulog=True):
    """Return a host that receives a recorded flight and writes into a folder."""
    path = str(folder / "uav-0.params")
    config = msgspec.structs.replace(CONFIG, params_path=path, logging=LoggingConfig(ulog=ulog))
    return Player(config, compiled=compiled)


@pytest.fixture(scope="module")
def stream():
    """Return the bytes of each step of a flight to a position."""
    return record_flight(FLIGHT_S).stream


@pytest.fixture(scope="module")
def flown(stream, tmp_path_factory):
    """Return the log of the flight, states at its full steps, replies, and the player."""
    folder = tmp_path_factory.mktemp("flown")
    player, states, replies = player_into(folder), {}, []
    with contextlib.closing(player.host):
        for data in stream:
            before = player.inertial
            vehicle = player.host.vehicle
            replies.append(player.play(data))
            now_us = vehicle.flight.now_us
            if player.inertial == before:
                states[now_us] = (
                    vehicle.flight.state.pos_ned_m.copy(), vehicle.flight.state.q_ned_frd.copy(),
                    vehicle.commander.armed, vehicle.commander.mode,
                )  # fmt: skip
            if now_us == CHANGED_US:
                vehicle.parameters.set("MPC_XY_P", 1.25)
    return ULog(str(folder / "uav-0.ulg")), states, replies, player


def columns(log, topic):
    return log.get_dataset(topic).data


def test_the_log_has_every_topic_and_no_fault(flown):
    log, *_ = flown
    assert not log.file_corruption
    assert not log.dropouts
    assert {each.name for each in log.data_list} == {topic.name for topic in TOPICS} - {
        "manual_control_setpoint"
    }
    assert {topic.name for topic in TOPICS + TRUTH_TOPICS} == set(log.message_formats)
    assert log.msg_info_dict["ver_data_format"] == 2
    assert log.get_version_info_str() == "v1.17.0"


def test_formats_need_no_padding():
    """UORB sorts the fields by size, so that each is aligned."""
    for topic in TOPICS + TRUTH_TOPICS:
        sizes = [SIZES[field.kind] for field in topic.fields]
        assert sizes == sorted(sizes, reverse=True), topic.name
        assert topic.dtype.itemsize == topic.layout.size == topic.size + 3


@pytest.mark.parametrize("topic", READ_BY_FLIGHT_REVIEW)
def test_the_fields_that_flight_review_plots_are_defined(topic):
    (definition,) = [each for each in TOPICS + TRUTH_TOPICS if each.name == topic]
    names = {field.name for field in definition.fields}
    names |= {f"{field.name}[{k}]" for field in definition.fields for k in range(field.elements)}
    assert set(READ_BY_FLIGHT_REVIEW[topic].split()) <= names


def test_topics_of_the_inertial_sensor_are_sampled_in_fast_steps_too(flown, stream):
    log, _, _, player = flown
    assert player.inertial > 0.25 * len(stream)
    times_us = columns(log, "sensor_combined")["timestamp"]
    assert np.array_equal(np.diff(times_us), np.full(len(stream) - 1, STEP_US))
    for name in set(OF_ROWS) - {"sensor_combined", "vehicle_imu_status"}:
        period_us = TOPICS[NUMBER_OF[name]].period_us
        sampled_us = columns(log, name)["timestamp"]
        every_us = times_us[times_us >= sampled_us[0]]
        firsts = every_us[np.flatnonzero(np.diff(every_us // period_us, prepend=-1))]
        assert np.array_equal(sampled_us, firsts), name


def test_other_topics_keep_their_periods(flown):
    log, states, *_ = flown
    for topic in TOPICS:
        if topic.name in WITHOUT_CHANGE or topic.name in OF_ROWS:
            continue
        sampled_us = columns(log, topic.name)["timestamp"].astype(np.int64)
        assert len(np.unique(sampled_us)) == len(sampled_us), topic.name
        assert set(sampled_us.tolist()) <= set(states), topic.name
        gaps_us = np.diff(sampled_us)
        least_us = 200_000 if topic.name == "vehicle_gps_position" else 40_000  # fixes; full steps
        assert np.max(gaps_us) <= max(topic.period_us, least_us) + 200_000, topic.name
        assert np.mean(gaps_us) == pytest.approx(max(topic.period_us, least_us), rel=0.25), topic.name


def test_samples_are_the_estimates(flown):
    log, states, *_ = flown
    position = columns(log, "vehicle_local_position")
    for i, time_us in enumerate(position["timestamp"].tolist()):
        expected = states[time_us][0].astype(np.float32)
        assert [position[axis][i] for axis in "xyz"] == expected.tolist()
    attitude = columns(log, "vehicle_attitude")
    for i, time_us in enumerate(attitude["timestamp"].tolist()):
        if time_us in states:
            expected = states[time_us][1].astype(np.float32)
            assert [attitude[f"q[{k}]"][i] for k in range(4)] == expected.tolist()
    site, last = CONFIG.site, {name: values[-1] for name, values in columns(log, "sensor_gps").items()}
    assert abs(last["latitude_deg"] - site.latitude_deg) < 1e-4
    assert abs(last["altitude_msl_m"] - site.altitude_m) < 30.0
    assert last["time_utc_usec"] == CONFIG.epoch_unix_us + last["timestamp"]


def test_the_angular_acceleration_is_that_of_the_rates(flown):
    log, *_ = flown
    rates = columns(log, "vehicle_angular_velocity")
    gyro = columns(log, "sensor_combined")
    at = np.searchsorted(gyro["timestamp"], rates["timestamp"])[5:]
    # a correction of the bias between two samples is below 0.4 mrad/s
    expected = (gyro["gyro_rad[0]"][at] - gyro["gyro_rad[0]"][at - 1]) / (STEP_US * 1e-6)
    np.testing.assert_allclose(rates["xyz_derivative[0]"][5:], expected, atol=0.1)


def test_motors_are_the_controls_that_the_simulator_receives(flown):
    log, states, *_ = flown
    motors = columns(log, "actuator_motors")
    armed = np.array([states[time_us][2] for time_us in motors["timestamp"].tolist()])
    assert armed.any()
    assert np.array_equal(~np.isnan(motors["control[3]"]), armed)
    assert np.isnan(motors["control[4]"]).all()
    widths_us = columns(log, "actuator_outputs")["output[0]"]
    np.testing.assert_allclose(widths_us[armed], 1000.0 + 1000.0 * motors["control[0]"][armed], rtol=1e-6)


def test_arming_and_modes_have_px4s_numbers(flown):
    log, states, *_ = flown
    status = columns(log, "vehicle_status")
    times_us = status["timestamp"].tolist()
    assert [value == 2 for value in status["arming_state"]] == [states[time_us][2] for time_us in times_us]
    assert status["nav_state"].tolist() == [NAV_STATES[states[time_us][3]] for time_us in times_us]
    assert set(NAV_STATES) >= set(FlightMode) - {FlightMode.__members__.get("ORBIT")}
    began_us = next(time_us for time_us, state in states.items() if state[2])
    assert began_us in times_us  # a change is logged at once


def test_the_log_has_all_parameters_their_defaults_and_the_change_in_flight(flown):
    log, _, _, player = flown
    parameters = player.host.vehicle.parameters
    assert set(log.initial_parameters) == {row.name for row in ROWS}
    for row in ROWS:
        if row.name != "MPC_XY_P":
            assert log.initial_parameters[row.name] == pytest.approx(parameters.get(row.name), rel=1e-6)
    ((time_us, name, value),) = log.changed_parameters
    assert (name, value) == ("MPC_XY_P", 1.25)
    assert CHANGED_US < time_us <= CHANGED_US + 40_000


def test_the_texts_of_the_flight_are_in_the_log(flown):
    log, *_ = flown
    texts = [(each.log_level_str(), each.message) for each in log.logged_messages]
    assert ("INFO", "Takeoff detected") in texts


def test_the_log_changes_no_reply_and_is_the_same_without_compiled_steps(flown, stream, tmp_path):
    log, _, replies, _ = flown
    (tmp_path / "without").mkdir()
    (tmp_path / "plain").mkdir()
    without = player_into(tmp_path / "without", ulog=False)
    plain = player_into(tmp_path / "plain", compiled=False)
    with contextlib.closing(without.host), contextlib.closing(plain.host):
        for data, reply in zip(stream, replies, strict=True):
            assert without.play(data) == reply
            assert plain.play(data) == reply
            for player in (without, plain):
                if player.host.vehicle.flight.now_us == CHANGED_US:
                    player.host.vehicle.parameters.set("MPC_XY_P", 1.25)
    assert plain.inertial == 0
    assert list((tmp_path / "without").iterdir()) == []
    other = ULog(str(tmp_path / "plain" / "uav-0.ulg"))
    for name in set(OF_ROWS) - {"vehicle_imu_status", "vehicle_acceleration"}:  # these have values of a block
        for field, values in columns(log, name).items():
            np.testing.assert_array_equal(values, columns(other, name)[field], err_msg=f"{name}.{field}")


def test_a_value_beyond_its_type_drops_the_sample():
    encoder = SampleEncoder(3, TOPICS[NUMBER_OF["rate_ctrl_status"]])
    assert encoder.encode(1, {"rollspeed_integ": 1e39}) == b""
    assert len(encoder.encode(1, {"rollspeed_integ": 1.0})) == TOPICS[NUMBER_OF["rate_ctrl_status"]].size + 3


def test_the_table_of_the_guide_has_all_topics_with_their_periods():
    """Rows ``| topic, topic | period in ms or words | contents |``."""
    rows = [
        line.split("|")[1:3]
        for line in GUIDE.read_text(encoding="utf-8").splitlines()
        if line.startswith("| `")
    ]
    listed = {name.strip(" `"): period.strip() for names, period in rows for name in names.split(",")}
    expected = {
        topic.name: f"{topic.period_us / 1000:g} ms" if topic.period_us else listed.get(topic.name)
        for topic in TOPICS + TRUTH_TOPICS
    }
    assert {name: period for name, period in listed.items() if not name.startswith("logging.")} == expected
    assert (listed["sensor_combined"], listed["home_position"]) == ("each sample", "each change")


# ---- the file


SIMULATOR = Encoder(system=0, component=1)
LIST = common.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF)


def sensor(time_us):
    at_rest = (0.0, 0.0, -9.81, 0.0, 0.0, 0.0, 0.2, 0.0, 0.4, 1013.25, 0.0, 0.0, 15.0)
    return SIMULATOR.encode(common.MAVLink_hil_sensor_message(time_us, *at_rest, 0x1FFF, 0))


def run(host, begin_us, end_us, *station_messages, active=(True, False)):
    out = []
    for now_us in range(begin_us, end_us, STEP_US):
        for messages in host.push(host.put(sensor(now_us))):
            links = [Addressed(Partner(GROUND_STATION, 0), message) for message in station_messages]
            station_messages = ()
            out += host.step(messages, link_messages=links, link_active=active)[1]
    return [message for _, message in out]


@pytest.fixture
def host(tmp_path):
    with contextlib.closing(player_into(tmp_path, ulog=False).host) as made:
        yield made


def test_without_a_station_there_is_no_log(host, tmp_path):
    run(host, 4_000, 400_000)
    host.close()
    assert list(tmp_path.iterdir()) == []


def test_a_message_from_a_station_starts_a_log_that_can_be_read_while_written(host, tmp_path):
    refused = common.MAVLink_command_long_message(
        1, 1, common.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1.0, *[0.0] * 6
    )
    run(host, 4_000, 200_000)
    texts = run(host, 200_000, 2_000_000, common.MAVLink_system_time_message(0, 0), refused)
    (entry,) = [m for m in run(host, 2_000_000, 2_004_000, LIST) if m.get_type() == "LOG_ENTRY"]
    assert entry.num_logs == 1
    ask = common.MAVLink_log_request_data_message(1, 1, 0, 0, entry.size)
    pieces = [m for m in run(host, 2_004_000, 4_000_000, ask) if m.get_type() == "LOG_DATA"]
    downloaded = b"".join(bytes(piece.data[: piece.count]) for piece in pieces)
    file = host.vehicle.messaging.files.open("/fs/microsd/log/uav-0.ulg")
    assert file.read(0, entry.size) == downloaded
    host.close()
    whole = (tmp_path / "uav-0.ulg").read_bytes()
    assert whole[: entry.size] == downloaded
    log = ULog(io.BytesIO(whole))
    assert log.start_timestamp == 200_000
    sent = [
        m.text if isinstance(m.text, str) else m.text.decode() for m in texts if m.get_type() == "STATUSTEXT"
    ]
    logged = [each.message for each in log.logged_messages]
    assert logged == list(dict.fromkeys(sent))  # the texts are sent on both links
    assert any("denied" in text.lower() for text in sent)
    assert columns(log, "sensor_combined")["timestamp"].tolist() == list(range(200_000, 4_000_000, STEP_US))


def test_others_cannot_read_the_log(tmp_path):
    with contextlib.closing(player_into(tmp_path).host) as host:
        run(host, 4_000, 100_000)
    assert (tmp_path / "uav-0.ulg").stat().st_mode & 0o777 == 0o600


def test_of_a_killed_vehicle_all_but_the_last_second_is_readable(tmp_path):
    with contextlib.closing(player_into(tmp_path).host) as host:
        run(host, 4_000, 5_000_000)
        left = (tmp_path / "uav-0.ulg").read_bytes()  # what a kill leaves
    times_us = columns(ULog(io.BytesIO(left)), "sensor_combined")["timestamp"]
    assert times_us[0] == 4_000
    assert times_us[-1] > 5_000_000 - 2_000_000


def test_a_log_of_a_station_that_cannot_be_opened_is_one_line(host, tmp_path, capsys):
    (tmp_path / "uav-0.ulg").mkdir()
    answers = run(host, 4_000, 100_000, LIST)
    assert [m.num_logs for m in answers if m.get_type() == "LOG_ENTRY"] == [0]
    assert capsys.readouterr().err.startswith("uav 0: no log: ")


class FullDisk(io.RawIOBase):
    """A file on a full disk."""

    def write(self, _data):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("ulog", [True, False])
def test_a_full_disk_ends_a_vehicle_whose_log_is_required_and_names_the_file(tmp_path, capsys, ulog):
    player = player_into(tmp_path, ulog=ulog)
    run(player.host, 4_000, 200_000, LIST)
    player.host._flight_log._file.close()
    player.host._flight_log._file = FullDisk()
    if ulog:
        with pytest.raises(OSError, match="No space left") as raised:
            run(player.host, 200_000, 3_000_000)
        assert Path(raised.value.filename) == tmp_path / "uav-0.ulg"
    else:
        run(player.host, 200_000, 3_000_000)
        assert capsys.readouterr().err.count("log ended: [Errno 28] No space left on device") == 1
        assert player.host.vehicle.shared.samples.count == 0
