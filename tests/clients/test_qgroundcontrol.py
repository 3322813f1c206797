"""Replay of QGroundControl's first minute: its requests to a newly found vehicle, in order.

QGroundControl has no version without windows. Its requests, and the fields of the answers that it uses, are
from its sources (Vehicle/InitialConnectStateMachine, ComponentInformation, MissionManager/PlanManager).
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from autopilot.mavlink import dialect
from foundation.geometry.geodesy import ned_to_geodetic
from harness.launch.swarm import Swarm

pytestmark = [pytest.mark.clients, pytest.mark.timeout(200)]

LIMIT_S = 5.0
DEG_M = 1.0 / 111_319.5
"""Degrees of latitude per metre."""
HASH_INDEX = 65_535
PX4_MODES = {
    "Hold": (4, 3), "Mission": (4, 4), "Return": (4, 5), "Land": (4, 6), "Takeoff": (4, 2),
    "Position": (3, 0), "Altitude": (2, 0), "Stabilized": (7, 0), "Offboard": (6, 0),
}  # fmt: skip
"""Main and sub mode of those that a PX4 multicopter offers."""


class Station:
    """A ground station on the vehicle's port, as system 255."""

    def __init__(self, swarm: Swarm) -> None:
        self.swarm = swarm
        self.link = swarm.mavlink(0)
        self.received: list[Any] = []

    def ask(self, send: Callable[[Any], None], kinds: str, count: int = 1, *, times: int = 3) -> list[Any]:
        """Send a request and fly until ``count`` answers of ``kinds`` have arrived; repeat after LIMIT_S."""
        answers: list[Any] = []
        for _ in range(times):
            send(self.link.mav)
            limit_s = self.swarm.truth.t_s + LIMIT_S
            while self.swarm.truth.t_s < limit_s:
                self.swarm.run_for(0.1)
                while (message := self.link.recv_msg()) is not None:
                    self.received.append(message)
                    if message.get_type() in kinds.split() and message.get_srcComponent() == 1:
                        answers.append(message)
                if len(answers) >= count:
                    return answers
        raise AssertionError(f"{len(answers)} of {count} {kinds}")

    def request(self, message: int, kind: str, count: int = 1, *, index: float = 0.0) -> list[Any]:
        """Request a message by MAV_CMD_REQUEST_MESSAGE."""
        params = (float(message), index, 0.0, 0.0, 0.0, 0.0, 0.0)
        return self.ask(
            lambda mav: mav.command_long_send(1, 1, common.MAV_CMD_REQUEST_MESSAGE, 0, *params), kind, count
        )


@pytest.fixture
def station() -> Any:
    with Swarm("scenarios/article.toml", agents=1, overrides=["onboard.hold=true"], speed=4.0) as swarm:
        swarm.run_for(10.0)  # until the estimate is valid
        yield Station(swarm)


def test_the_requests_of_its_first_minute(station: Station) -> None:
    _check_heartbeat_and_status(station)
    _check_version(station)
    _check_modes(station)
    names = _load_parameters(station)
    assert {"SYS_AUTOSTART", "COM_RC_IN_MODE", "MIS_TAKEOFF_ALT", "RTL_RETURN_ALT"} <= names
    _load_plans(station)
    _request_home(station)


def _check_heartbeat_and_status(station: Station) -> None:
    (beat,) = station.ask(lambda _: None, "HEARTBEAT")[:1]
    assert (beat.type, beat.autopilot, beat.base_mode & 1) == (2, 12, 1)
    (status,) = station.ask(lambda _: None, "SYS_STATUS")[:1]
    # every sensor in use is healthy and arming would be accepted: QGroundControl shows "Ready to fly"
    present, enabled, health = (
        status.onboard_control_sensors_present,
        status.onboard_control_sensors_enabled,
        status.onboard_control_sensors_health,
    )
    assert present & enabled & ~health == 0
    assert health & common.MAV_SYS_STATUS_PREARM_CHECK
    assert not enabled & common.MAV_SYS_STATUS_GEOFENCE or present & common.MAV_SYS_STATUS_GEOFENCE


def _check_version(station: Station) -> None:
    (version,) = station.request(common.MAVLINK_MSG_ID_AUTOPILOT_VERSION, "AUTOPILOT_VERSION")[:1]
    needs = (
        common.MAV_PROTOCOL_CAPABILITY_MISSION_INT,
        common.MAV_PROTOCOL_CAPABILITY_COMMAND_INT,
        common.MAV_PROTOCOL_CAPABILITY_MAVLINK2,
        common.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE,
        common.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY,
        common.MAV_PROTOCOL_CAPABILITY_FTP,
    )
    assert all(version.capabilities & need for need in needs)
    assert version.flight_sw_version >> 16 == 0x0111  # 1.17: features are disabled for older versions
    assert version.uid or any(version.uid2)


def _check_modes(station: Station) -> None:
    modes = station.request(dialect.AvailableModes.id, "AVAILABLE_MODES", 9)
    number = modes[0].number_modes
    assert sorted(mode.mode_index for mode in modes) == list(range(1, number + 1))
    custom = {mode.custom_mode for mode in modes}
    assert {main << 16 | sub << 24 for main, sub in PX4_MODES.values()} <= custom


def _load_parameters(station: Station) -> set[str]:
    (first,) = station.ask(lambda mav: mav.param_request_list_send(1, 1), "PARAM_VALUE")[:1]
    assert (first.param_id, first.param_index) == ("_HASH_CHECK", HASH_INDEX)
    values: dict[int, Any] = {}
    limit_s = station.swarm.truth.t_s + 4 * LIMIT_S
    while len(values) < first.param_count and station.swarm.truth.t_s < limit_s:
        station.swarm.run_for(0.1)
        received: list[Any] = []
        while (message := station.link.recv_msg()) is not None:
            received.append(message)
        for message in [*station.received, *received]:
            if message.get_type() == "PARAM_VALUE" and message.param_index != HASH_INDEX:
                values[message.param_index] = message
    assert sorted(values) == list(range(first.param_count))
    names = [values[index].param_id for index in range(first.param_count)]
    assert names == sorted(names)
    assert first.param_type == common.MAV_PARAM_TYPE_UINT32
    return set(names)


def _load_plans(station: Station) -> None:
    for kind in (
        common.MAV_MISSION_TYPE_MISSION, common.MAV_MISSION_TYPE_FENCE, common.MAV_MISSION_TYPE_RALLY,
    ):  # fmt: skip
        (count,) = station.ask(
            lambda mav, kind=kind: mav.mission_request_list_send(1, 1, kind), "MISSION_COUNT"
        )[:1]
        assert (count.count, count.mission_type) == (0, kind)
        assert (count.target_system, count.target_component) == (255, 190)
        station.link.mav.mission_ack_send(1, 1, common.MAV_MISSION_ACCEPTED, kind)


def _request_home(station: Station) -> None:
    answers = station.request(common.MAVLINK_MSG_ID_HOME_POSITION, "COMMAND_ACK HOME_POSITION", 2)
    answer = {message.get_type(): message for message in answers}
    ack, home = answer["COMMAND_ACK"], answer["HOME_POSITION"]
    assert (ack.command, ack.result) == (common.MAV_CMD_REQUEST_MESSAGE, common.MAV_RESULT_ACCEPTED)
    site = station.swarm.scenario.site
    place = ned_to_geodetic(
        np.array(station.swarm.truth.vehicles[0].pos_ned_m),
        origin_lat_deg=site.latitude_deg,
        origin_lon_deg=site.longitude_deg,
        origin_alt_m=site.altitude_m,
    )
    # the GPS position of the vehicle: within metres, and twice as much in height
    assert (1e-7 * home.latitude, 1e-7 * home.longitude) == pytest.approx(place[:2], abs=6.0 * DEG_M)
    assert 1e-3 * home.altitude == pytest.approx(place[2], abs=12.0)
