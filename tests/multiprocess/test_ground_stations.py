"""Ground stations on the radio in real processes: equal logs, a lossy link, a pause, a stop, a death."""

import json
import math
import os
import re
import signal
import time
from pathlib import Path

import pytest
from paths import SCENARIOS
from pymavlink.dialects.v20 import common

from harness.ground_station.send_window import MOST_UNREPORTED, MOST_WAITING
from harness.launch.one_process import OneProcessSwarm
from harness.launch.run_messages import ProcessNotice
from harness.launch.supervisor import Exited
from harness.launch.swarm import Swarm, SwarmError

pytestmark = pytest.mark.multiprocess

ARTICLE = SCENARIOS / "article.toml"
STATIONS = "stations=[{name='north', pos_ned_m=[9.0, 0.0, 0.0]}, {name='south', pos_ned_m=[-9.0, 0.0, 0.0]}]"
RADIO = ["links.telemetry=radio", STATIONS]
ITEMS = 12
LIMIT_S = 60.0
"""Simulated time limit of a dialogue."""


def test_without_a_program_a_run_is_a_function_of_scenario_and_seed(tmp_path):
    found = []
    for kind in (OneProcessSwarm, Swarm):
        out = tmp_path / kind.__name__
        with kind(ARTICLE, agents=2, overrides=["formation.columns=2", *RADIO], out=out) as swarm:
            swarm.run(until_s=5.0)
            found.append(swarm.summary(draw=False))
    one, many = found
    assert one["log_sha256"] == many["log_sha256"]
    assert one["deterministic"] and many["deterministic"]  # noqa: PT018
    assert one["telemetry_frames"] == many["telemetry_frames"]
    for counts in one["telemetry_frames"].values():
        # two vehicles, ten datagrams a second or more
        assert counts["sent"] > 2 * 10 * 4
        assert counts["acknowledged"] >= counts["sent"] - 4
        assert counts["lost"] == 0


class Client:
    """The ground station's side of the mission protocol."""

    def __init__(self, swarm, station):
        self._swarm = swarm
        self._link = swarm.mavlink(0, station)
        self.repeated = 0
        """Requests for an item that had been sent already."""

    def await_any(self, *kinds, wait_s=1.0):
        """Return the next message of these kinds within ``wait_s`` of simulated time, or None."""
        end_s = self._swarm.truth.t_s + wait_s
        while self._swarm.truth.t_s < end_s:
            self._swarm.run_for(0.02)
            while (message := self._link.recv_msg()) is not None:
                if message.get_type() in kinds:
                    return message
        return None

    def upload(self):
        """Upload a mission of `ITEMS` waypoints; return the vehicle's verdict."""
        end_s, sent = self._swarm.truth.t_s + LIMIT_S, set()
        while self._swarm.truth.t_s < end_s:
            if not sent:
                self._link.mav.mission_count_send(1, 1, ITEMS, common.MAV_MISSION_TYPE_MISSION)
            match self.await_any("MISSION_REQUEST_INT", "MISSION_REQUEST", "MISSION_ACK"):
                case None:
                    continue  # the vehicle asks again
                case message if message.get_type() == "MISSION_ACK":
                    return message.type
                case request:
                    self.repeated += request.seq in sent
                    sent.add(request.seq)
                    self._link.mav.mission_item_int_send(
                        1, 1, request.seq, common.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
                        common.MAV_CMD_NAV_WAYPOINT, 0, 1, 0, 0, 0, 0, 473_977_420 + 100 * request.seq,
                        85_455_940, 10.0, common.MAV_MISSION_TYPE_MISSION,
                    )  # fmt: skip
        return None

    def count(self):
        """Return the number of items that the vehicle reports."""
        end_s = self._swarm.truth.t_s + LIMIT_S
        while self._swarm.truth.t_s < end_s:
            self._link.mav.mission_request_list_send(1, 1, common.MAV_MISSION_TYPE_MISSION)
            if (message := self.await_any("MISSION_COUNT")) is not None:
                return message.count
        return None


def test_a_mission_is_uploaded_over_a_link_that_loses_every_fifth_datagram(swarm, tmp_path):
    overrides = ["onboard.enabled=false", "formation.columns=1", "radio.drop_fraction=0.2", *RADIO]
    flight = swarm(
        ARTICLE, agents=1, overrides=overrides, out=tmp_path / "run", processes="many", speed="max"
    )
    assert "uav 0, system 1: ground station north by radio, UDP " in flight.addresses[0]
    with pytest.raises(SwarmError, match=r"there is no ground station east on the radio; .*: north, south"):
        flight.mavlink(0, "east")
    client = Client(flight, "south")
    assert client.upload() == common.MAV_MISSION_ACCEPTED
    assert client.count() == ITEMS

    os.kill(flight.pids["ground station north"], signal.SIGKILL)
    while not any(isinstance(event, Exited) for event in flight.events):
        flight.run_for(0.1)
    assert client.count() == ITEMS  # the other one is not affected
    summary = flight.summary(draw=False)
    assert not flight.forced
    assert (summary["status"], summary["deterministic"]) == ("completed", False)
    manifest = json.loads((flight.path / "manifest.json").read_text())
    lines = "\n".join(manifest["nondeterminism"])
    killed = r"^ground station north \(pid \d+\) was killed by SIGKILL at \d+\.\d{3} s, and the flight goes"
    assert re.search(killed, lines, re.MULTILINE)
    assert "ground station south received messages from a program over UDP" in lines
    processes = {each["name"]: each["details"] for each in manifest["processes"]}
    up = processes["ground station south"]["frames"]["uav 0"]
    down = processes["uav 0"]["links"]["ground_station"]["frames"]["south"]
    # each frame is acknowledged before the host loses it
    assert up["acknowledged"] == up["sent"] > ITEMS
    assert 0.5 * up["sent"] < down["received"] < up["sent"]
    assert down["received"] == processes["uav 0"]["ground_messages"]
    # four standard deviations of a share of independent losses
    arrived = down["acknowledged"]
    assert up["received"] / arrived == pytest.approx(0.8, abs=4.0 * math.sqrt(0.2 * 0.8 / arrived))


def unread_bytes(port):
    """Return what waits in the socket at a port of this machine."""
    for line in Path("/proc/net/udp").read_text().splitlines()[1:]:
        fields = line.split()
        if int(fields[1].partition(":")[2], 16) == port:
            return int(fields[4].partition(":")[2], 16)
    return 0


def test_after_a_pause_the_newest_datagrams_count_and_a_stopped_station_is_named(swarm, tmp_path):
    notes = []
    overrides = ["onboard.enabled=false", "formation.columns=1", *RADIO]
    flight = swarm(
        ARTICLE, agents=1, overrides=overrides, out=tmp_path / "run", processes="many", speed="max",
        on_message=lambda message: notes.append(message.text) if isinstance(message, ProcessNotice) else None,
    )  # fmt: skip
    title = Path(f"/proc/{flight.pids['ground station north']}/comm").read_text()
    assert title == "ground north\n"
    link = flight.mavlink(0, "north")
    flight.run_for(2.0)

    def set_cruise(speed_m_s):
        link.mav.param_set_send(1, 1, b"MPC_XY_CRUISE", speed_m_s, common.MAV_PARAM_TYPE_REAL32)

    # simulated time rests; each number is exact in binary
    speeds_m_s = [3.0 + number / 64 for number in range(150)]
    for speed_m_s in speeds_m_s:
        set_cruise(speed_m_s)
    port, end_s = link.destination_addr[1], time.monotonic() + 20.0
    while unread_bytes(port) and time.monotonic() < end_s:
        time.sleep(0.01)
    reported = []
    end_s = flight.truth.t_s + LIMIT_S
    while speeds_m_s[-1] not in reported:
        assert flight.truth.t_s < end_s
        flight.run_for(0.1)
        while (message := link.recv_match(type="PARAM_VALUE")) is not None:
            reported.append(message.param_value)
    assert reported == sorted(reported)

    pid = flight.pids["ground station south"]
    os.kill(pid, signal.SIGSTOP)
    while not any(isinstance(event, Exited) for event in flight.events):
        flight.run_for(0.1)
    line = rf"ground station south \(pid {pid}\) is stopped \(SIGSTOP\) at \d+\.\d{{3}} s"
    end = ": it is killed, and the flight goes on without its programs"
    assert [note for note in notes if re.fullmatch(line + end, note)]
    flight.run_for(1.0)
    summary = flight.summary(draw=False)
    assert not flight.forced
    assert (summary["status"], summary["deterministic"]) == ("completed", False)
    manifest = json.loads((flight.path / "manifest.json").read_text())
    assert any(re.match(line, cause) for cause in manifest["nondeterminism"])
    (details,) = [each["details"] for each in manifest["processes"] if each["name"] == "ground station north"]
    frames = details["frames"]["uav 0"]
    # the connection's heartbeat, too
    assert frames["sent"] + details["datagrams_overtaken"] == 1 + len(speeds_m_s)
    assert details["datagrams_overtaken"] <= len(speeds_m_s) - MOST_UNREPORTED - MOST_WAITING
    assert (frames["acknowledged"], frames["lost"]) == (frames["sent"], 0)
    assert (details["datagrams_over_budget"], details["datagrams_over_buffer"]) == (0, 0)
