"""Serial modems in real processes: logs equal to those of one process, and dialogues of a ground station."""

import json

import pytest
from paths import SCENARIOS
from pymavlink.dialects.v20 import common

from harness.launch.one_process import OneProcessSwarm
from harness.launch.swarm import Swarm

pytestmark = pytest.mark.multiprocess

ARTICLE = SCENARIOS / "article.toml"
SERIAL = ["links.telemetry=serial-radio", "stations=[{name='ground', pos_ned_m=[9.0, 0.0, 0.0]}]"]
ITEMS = 4
LIMIT_S = 60.0
"""Simulated time limit of a dialogue."""
REPEAT_S = 3.0
"""Simulated time after which a request is repeated."""


def test_without_a_program_a_run_is_a_function_of_scenario_and_seed(tmp_path):
    found = []
    for kind in (OneProcessSwarm, Swarm):
        out = tmp_path / kind.__name__
        with kind(ARTICLE, agents=2, overrides=["formation.columns=2", *SERIAL], out=out) as swarm:
            swarm.run(until_s=5.0)
            summary = swarm.summary(draw=False)
        processes = {
            each["name"]: each["details"]
            for each in json.loads((out / "manifest.json").read_text())["processes"]
        }
        found.append((summary, processes))
    (one, _), (many, processes) = found
    assert one["log_sha256"] == many["log_sha256"]
    assert one["deterministic"] and many["deterministic"]  # noqa: PT018
    assert one["telemetry_serial"] == many["telemetry_serial"]
    counts = many["telemetry_serial"]["ground"]
    # two vehicles at half of PX4's data rate or more, and a report after each heartbeat
    assert counts["sent_bytes"] > 2 * 600 * 4
    assert counts["radio_status"] >= 2 * 3
    assert one["frames"]["sent"] == many["frames"]["sent"] > 0
    modems = processes["radio"]["counters"]["serial_radio"]
    assert modems["ground_station"]["packets_received"] == modems["vehicles"]["packets_sent"] > 0
    received = processes["ground station ground"]["serial"]
    assert {each["radio_status"] for each in received.values()} == {0}  # the station sends no heartbeats


class Dialogue:
    """A program of the ground station, which repeats its requests."""

    def __init__(self, swarm):
        self._swarm = swarm
        self.link = swarm.mavlink(0)

    def ask(self, request, *kinds):
        """Send a request until a message of these kinds arrives; return it, or None after the limit."""
        end_s, repeat_s = self._swarm.truth.t_s + LIMIT_S, 0.0
        while self._swarm.truth.t_s < end_s:
            if request is not None and self._swarm.truth.t_s >= repeat_s:
                repeat_s = self._swarm.truth.t_s + REPEAT_S
                request()
            self._swarm.run_for(0.02)
            while (message := self.link.recv_msg()) is not None:
                if message.get_type() in kinds:
                    return message
        return None


def test_a_station_reads_a_parameter_and_uploads_a_mission(swarm, tmp_path):
    overrides = ["onboard.enabled=false", "formation.columns=1", *SERIAL]
    flight = swarm(
        ARTICLE, agents=1, overrides=overrides, out=tmp_path / "run", processes="many", speed="max"
    )
    dialogue = Dialogue(flight)
    mav = dialogue.link.mav
    assert dialogue.ask(None, "HEARTBEAT").get_srcSystem() == 1
    beat = (common.MAV_TYPE_GCS, common.MAV_AUTOPILOT_INVALID, 0, 0, common.MAV_STATE_ACTIVE)
    status = dialogue.ask(lambda: mav.heartbeat_send(*beat), "RADIO_STATUS")
    assert (status.get_srcSystem(), status.get_srcComponent()) == (ord("3"), ord("D"))
    assert status.txbuf > 50
    value = dialogue.ask(lambda: mav.param_request_read_send(1, 1, b"MAV_RADIO_TOUT", -1), "PARAM_VALUE")
    assert value.param_id == "MAV_RADIO_TOUT"

    kinds = "MISSION_REQUEST_INT", "MISSION_ACK"
    answer = dialogue.ask(
        lambda: mav.mission_count_send(1, 1, ITEMS, common.MAV_MISSION_TYPE_MISSION), *kinds
    )
    while answer.get_type() != "MISSION_ACK":
        seq = answer.seq
        answer = dialogue.ask(
            lambda seq=seq: mav.mission_item_int_send(
                1, 1, seq, common.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, common.MAV_CMD_NAV_WAYPOINT, 0, 1,
                0, 0, 0, 0, 473_977_420 + 100 * seq, 85_455_940, 10.0, common.MAV_MISSION_TYPE_MISSION,
            ),
            *kinds,
        )  # fmt: skip
    assert answer.type == common.MAV_MISSION_ACCEPTED
    assert seq == ITEMS - 1
    summary = flight.summary(draw=False)
    assert (summary["status"], summary["deterministic"]) == ("completed", False)
    assert summary["telemetry_serial"]["ground"]["received_bytes"] > ITEMS * 40
