"""Swarms with stand-ins for ArduPilot: flights, losses, errors at the start, strangers, end with the run."""

import contextlib
import itertools
import json
import random
import socket
import struct
import threading
import time

import psutil
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from ardupilot_swarms import make_swarm
from external_swarms import free_base
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder
from harness.launch.one_process import OneProcessSwarm
from harness.launch.process_commands import PREFORK, application, uav
from harness.launch.swarm import SetupError, SwarmError
from harness.records.run_folder import RunFolder
from harness.simulator.messages import ApplicationLost, VehicleLost

pytestmark = pytest.mark.multiprocess


@pytest.fixture
def swarm(tmp_path):
    """Return a factory of swarms of stand-ins; ``**how`` are fields of `ardupilot_stand_in.Deviations`."""

    def make(agents, *overrides, **how):
        return make_swarm(tmp_path, agents, *overrides, **how)

    return make


def program_of(flown, instance):
    """Return the process of a program itself, not that of `harness.launch.external_process`."""
    return psutil.Process(flown._processes.ready[uav(instance)].pid)


def lost(flown):
    return [(event.instance, event.reason) for event in flown.events if isinstance(event, VehicleLost)]


def test_a_swarm_localised_by_ranges_flies_the_formation_and_nothing_is_left(swarm):
    flown = swarm(
        3,
        "onboard.localisation=ftm",
        "formation.columns=2",
        flies=True,
        late={"700": 0.3},
        lost=[900],
        silence_s=0.6,
    )
    with flown:
        programs = [program_of(flown, i) for i in range(3)]
        ports = [port for each in programs for port in bound_ports(each)]
        flown.run_until_formed(timeout_s=90.0)
        flown.run_until(lambda truth: truth.error_m.max() < 0.7, timeout_s=10.0)
        truth = flown.run_for(1.0)
        assert lost(flown) == []
        assert all(vehicle.alive and vehicle.armed for vehicle in truth.vehicles)
        assert {vehicle.mode for vehicle in truth.vehicles} == {"Guided"}
        assert {vehicle.phase for vehicle in truth.vehicles} == {"on station"}
        summary = flown.summary(draw=False)
    assert flown.forced == ()
    assert flown.leftovers() == []
    assert not any(each.is_running() for each in programs)
    for port in ports:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", port))
    assert summary["status"] == "completed"
    assert not summary["deterministic"]
    manifest = json.loads((flown.path / "manifest.json").read_text())
    assert [line for line in manifest["nondeterminism"] if "flown by" in line] == [
        f"uav {i} is flown by an ArduPilot, whose threads depend on the machine" for i in range(3)
    ]
    details = {process["name"]: process["details"] for process in manifest["processes"]}
    for i in range(3):
        assert details[application(i)]["malformed_bytes"] == 0
        assert details[application(i)]["bad_beacons"] == 0
        assert details[application(i)]["commands_refused"] == 0
        assert "ArduCopter" in (flown.path / "logs" / f"uav-{i}.log").read_text()
        assert (flown.path / "ardupilot" / f"uav-{i}" / "coflight.parm").is_file()
    assert summary["frames"]["delivered"] > 100
    assert summary["ftm"]["completed"] > 10


def bound_ports(process):
    return [connection.laddr.port for connection in process.net_connections("udp4")]


def test_ardupilot_and_own_autopilot_fly_in_one_formation(swarm):
    flown = swarm(2, "autopilot.ardupilot_vehicles=[1]", flies=True, silence_s=0.1)
    with flown:
        flown.run_for(1.0)
        time.sleep(0.5)  # the program repeats its packet meanwhile
        flown.run_until_formed(timeout_s=90.0)
        truth = flown.run_until(lambda truth: truth.error_m.max() < 0.7, timeout_s=10.0)
        assert [vehicle.mode for vehicle in truth.vehicles] == ["Offboard", "Guided"]
    assert set(flown.pids) == {"radio", "physics", PREFORK, uav(0), uav(1), application(1)}
    assert flown.leftovers() == []


def test_a_killed_ardupilot_is_named_and_the_others_continue(swarm):
    flown = swarm(3, "autopilot.params.NO_SUCH=1", "onboard.enabled=false")
    with flown:
        flown.run_for(1.5)
        program_of(flown, 0).kill()
        truth = flown.run_for(8.0)
        assert [vehicle.alive for vehicle in truth.vehicles] == [False, True, True]
        assert lost(flown) == [(0, "its connection closed")]
        # the parameter is reported of those that could answer
        warned = [event.name for event in flown.events if "NO_SUCH" in getattr(event, "text", "")]
        assert sorted(warned) == [uav(1), uav(2)]
        flown.kill(1)
        flown.kill(2)
        with pytest.raises(SwarmError, match="no vehicle is left"):
            flown.run_for(1.0)
    assert flown.leftovers() == []


def test_an_ardupilot_that_hangs_in_flight_is_named_and_the_others_continue(swarm):
    flown = swarm(2, "onboard.enabled=false", "run.silence_limit_s=1.0", mute_from=150, only=[1])
    with flown:
        truth = flown.run_for(1.5)
        assert [vehicle.alive for vehicle in truth.vehicles] == [True, False]
        ((instance, reason),) = lost(flown)
        assert instance == 1
        assert "has not answered" in reason
    assert flown.leftovers() == []


def test_an_ardupilot_that_ends_in_flight_is_named(swarm):
    flown = swarm(1, "onboard.enabled=false", ends_after=200)
    with flown, pytest.raises(SwarmError, match="no vehicle is left"):
        flown.run_for(20.0)
    assert lost(flown) == [(0, "its connection closed")]
    assert flown.leftovers() == []


def test_an_ardupilot_continues_after_the_end_of_its_application(swarm):
    flown = swarm(2, flies=True)
    with flown:
        flown.run_until(
            lambda truth: min(vehicle.pos_ned_m[2] for vehicle in truth.vehicles) < -1.0, timeout_s=60.0
        )
        psutil.Process(flown.pids[application(0)]).kill()
        truth = flown.run_for(3.0)
        assert [vehicle.alive for vehicle in truth.vehicles] == [True, True]
        assert truth.vehicles[0].armed
        assert truth.vehicles[0].phase == ""
        assert truth.vehicles[1].phase in {"joining", "on station"}
    assert lost(flown) == []
    assert [event.instance for event in flown.events if isinstance(event, ApplicationLost)] == [0]


# ---- errors at the start


def test_an_ardupilot_that_ends_at_once_is_reported_with_its_output(swarm):
    flown = swarm(2, ends_at_start=3)
    expected = r"^uav \d .* ended with status 3: PANIC: no such frame[^\n]*$"
    with pytest.raises(SwarmError, match=expected), flown:
        flown.run_for(1.0)
    assert flown.leftovers() == []


@pytest.mark.parametrize("how", [{"never_sends": True}, {"magic": 18_459}])
def test_one_without_a_servo_packet_is_named_after_a_time_limit(swarm, monkeypatch, how):
    write = RunFolder.write_physics_config

    def write_short(*args, **kwargs):
        path = write(*args, **kwargs)
        config = json.loads(path.read_text("utf-8"))
        path.write_text(json.dumps(config | {"connect_timeout_s": 2.0}), "utf-8")
        return path

    monkeypatch.setattr(RunFolder, "write_physics_config", write_short)
    flown = swarm(1, "onboard.enabled=false", **how)
    with pytest.raises(SwarmError, match=r"^physics [^\n]*no connection from uav 0 within 2 s[^\n]*$"), flown:
        flown.run_for(1.0)
    assert flown.leftovers() == []


def test_a_missing_program_is_an_error_before_anything_starts(swarm, tmp_path):
    program = tmp_path / "arducopter"
    for spoil in (lambda: program.chmod(0o644), program.unlink):
        flown = swarm(1)
        spoil()
        with pytest.raises(
            SetupError,
            match=rf"^autopilot\.ardupilot_program: there is no program {program}; expected [^\n]*$",
        ):
            flown.start()
        assert flown.pids == {}
        assert not flown.path.exists()


def test_one_process_refuses_an_ardupilot(swarm, tmp_path):
    with pytest.raises(SetupError, match="an ArduPilot is a process of its own, so one process cannot"):
        OneProcessSwarm(swarm(1).scenario, out=tmp_path / "one").start()


# ---- strangers


FLOOD_BYTES = 1_000_000
ROUNDS_PER_CONNECTION = 20
BEAT = common.MAVLink_heartbeat_message(2, 3, 0x81, 4, 4, 3)


class Flood:
    """A thread that sends datagrams and TCP data, invalid and valid, to a vehicle's ports."""

    def __init__(self, port):
        self._address = ("127.0.0.1", port)
        self._random = random.Random(port)  # noqa: S311
        self.sent_bytes = 0
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stopped.set()
        self._thread.join()

    def datagrams(self):
        pulses_us = [self._random.randrange(1_000, 2_001) for _ in range(16)]
        packet = bytearray(struct.pack("<HHI16H", 18_458, 1_200, self._random.randrange(5_000), *pulses_us))
        yield self._random.randbytes(self._random.randrange(2_000))
        yield bytes(packet[: self._random.randrange(40)])
        yield bytes([packet[0] ^ 1, *packet[1:]])
        packet[self._random.randrange(2, 40)] = self._random.randrange(256)
        yield bytes(packet)

    def _run(self):
        foreign = Encoder(system=77, component=1)
        with contextlib.ExitStack() as stack:
            sock = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            for number in itertools.count():
                if self._stopped.is_set():
                    return
                for data in self.datagrams():
                    sock.sendto(data, self._address)
                    self.sent_bytes += len(data)
                time.sleep(0.0005)
                if number % ROUNDS_PER_CONNECTION:
                    continue
                with contextlib.suppress(OSError), socket.create_connection(self._address, 0.2) as stranger:
                    stranger.sendall(self._random.choice((b"", b"GET /", self._random.randbytes(3_000))))
                    stranger.sendall(foreign.encode(BEAT))


def test_strangers_at_the_ports_do_not_change_the_flight(swarm):
    """What they send, also before the vehicle's first packet, may be right but for its sender."""
    results = []
    for name in ("undisturbed", "disturbed"):
        base = free_base(2)
        settings = ("onboard.enabled=false", f"ports.simulator_tcp={base}")
        flown = swarm(1, *settings, name=name, silence_s=0.3, armed_from=50)
        with contextlib.ExitStack() as stack:
            flood = stack.enter_context(Flood(base)) if name == "disturbed" else None
            with flown:
                flown.run_for(0.1)
                flown.run_for(4.0)
                while flood is not None and flood.sent_bytes < FLOOD_BYTES:
                    flown.run_for(0.5)
                assert lost(flown) == []
                flown.summary(draw=False)
        results.append(pq.read_table(flown.path / "flight.parquet").filter(pc.field("time_us") < 4_000_000))
    undisturbed, disturbed = results
    assert len(undisturbed) > 90
    assert pc.max(undisturbed["rotor_speed_rad_s.0"]).as_py() > 500.0
    for name in ("time_us", "armed", "pos_ned_m.d", "q_ned_frd.w", "rotor_speed_rad_s.3"):
        assert undisturbed[name].equals(disturbed[name]), name
