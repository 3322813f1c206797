"""The Python API with real processes: stand-ins that follow the protocol and fail on request."""

import os
import re
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from paths import SUPPORT
from supervisor_stand_ins import FAILS_AT_LAST_M, FORMED_US, SEED_RADIO_DIES, STEP_US

import harness.launch.processes
from harness.launch.resources import bind
from harness.launch.supervisor import Exited
from harness.launch.swarm import SetupError, Swarm, SwarmError, SwarmTimeoutError
from harness.scenario.autopilot_settings import AutopilotConfig
from harness.scenario.scenario import PortsConfig, RunConfig, Scenario
from harness.simulator.messages import Formed, VehicleLost

pytestmark = pytest.mark.multiprocess

STAND_INS = SUPPORT / "supervisor_stand_ins.py"
Launch = Callable[..., Swarm]


@pytest.fixture(autouse=True)
def _stand_ins(monkeypatch: pytest.MonkeyPatch) -> None:
    def command(module: str, *arguments: str) -> list[str]:
        return [sys.executable, str(STAND_INS), module, *arguments]

    monkeypatch.setattr(harness.launch.processes, "bound_module", command)


@pytest.fixture
def launch() -> Iterator[Launch]:
    """Yield a factory of swarms of three vehicles; checks at the end that no process or port is left."""
    launched: list[Swarm] = []

    def make(name: str = "fine", *, agents: int = 3, run: RunConfig | None = None, **options: Any) -> Swarm:
        scenario = Scenario(name=name, agents=agents, run=run or RunConfig())
        swarm = Swarm(scenario, **{"wall_limit_s": 30.0} | options)
        launched.append(swarm)
        return swarm

    yield make
    for swarm in launched:
        swarm.stop()
        assert swarm.leftovers() == []


def test_run_methods_stop_at_exact_times(launch: Launch) -> None:
    with launch() as swarm:
        assert set(swarm.pids) == {"radio", "physics", "prefork", "uav 0", "uav 1", "uav 2"}
        assert swarm.truth.time_us == 0
        assert swarm.run(until_s=1.0).time_us == 1_000_000
        assert swarm.run_for(0.5).t_s == pytest.approx(1.5)
        # 1 m/s from the ground: 2.03 m are first exceeded on the grid of 20 ms at 2.04 s
        truth = swarm.run_until(lambda truth: bool((truth.height_m > 2.03).all()), timeout_s=10.0)
        assert truth.time_us == 2_040_000
        assert truth.pos_ned_m.shape == (3, 3)
        assert truth.error_m.tolist() == [0.25, 0.25, 0.25]
        assert swarm.run_until_formed(timeout_s=10.0).time_us == FORMED_US
    assert swarm.forced == ()
    exits = [event for event in swarm.events if isinstance(event, Exited)]
    assert {event.name: event.returncode for event in exits} == dict.fromkeys(swarm.pids, 0)
    assert Formed(time_us=FORMED_US) in swarm.events


def test_run_until_returns_at_once_or_at_the_timeout(launch: Launch) -> None:
    with launch() as swarm:
        assert swarm.run_until(lambda _: True, timeout_s=1.0).time_us == 0
        with pytest.raises(SwarmTimeoutError, match=r"not met within 0\.05 s"):
            swarm.run_until(lambda _: False, timeout_s=0.05)
        assert swarm.truth.time_us == 52_000  # the step that reaches the deadline
        with pytest.raises(ValueError, match="multiple of the step, 4000 us"):
            swarm.run_until(lambda _: True, timeout_s=1.0, every_s=0.005)
        assert swarm.scenario.run.step_us == STEP_US
        swarm.run_for(1.0)  # the run continues after an unmet condition


def test_kill_returns_after_the_end_of_the_vehicle_and_others_continue(launch: Launch) -> None:
    with launch() as swarm:
        swarm.run(until_s=1.0)
        pid = swarm.pids["uav 1"]
        swarm.kill(1)
        assert not psutil.pid_exists(pid)
        exited = [event for event in swarm.events if isinstance(event, Exited)]
        assert [event.describe() for event in exited] == [f"uav 1 (pid {pid}) was killed by SIGKILL"]
        assert swarm.run(until_s=2.0).alive.tolist() == [True, False, True]
        lost = [event for event in swarm.events if isinstance(event, VehicleLost)]
        assert [(event.instance, event.time_us) for event in lost] == [(1, 1_000_000)]
        swarm.kill(0)
        swarm.kill(2)
        ending = (
            rf"^no vehicle is left at 2\.000 s; uav 2 \(pid {swarm.pids['uav 2']}\) was killed by SIGKILL "
            r"at 2\.000 s \(log: .*/uav-2\.log\)$"
        )
        with pytest.raises(SwarmError, match=ending):
            swarm.run_for(1.0)


@pytest.mark.parametrize(
    ("name", "seed", "ending"),
    [
        ("physics-dies-at-last", 1, r"physics \(pid \d+\) was killed by SIGKILL"),
        ("fine", SEED_RADIO_DIES, r"radio \(pid \d+\) was killed by SIGKILL"),
        ("fine", SEED_RADIO_DIES + 1, r"radio \(pid \d+\) ended with status 0, but did not finish"),
    ],
)
def test_process_without_complete_records_fails_the_run(
    launch: Launch, name: str, seed: int, ending: str
) -> None:
    with launch(name, run=RunConfig(seed=seed)) as swarm:
        swarm.run(until_s=1.0)
        assert swarm.records_lost is None
    assert swarm.records_lost is not None
    assert re.match(ending, swarm.records_lost)
    assert swarm._processes.failure == swarm.records_lost
    assert swarm._processes.nondeterminism() == [swarm.records_lost]


def test_vehicle_killed_at_its_end_is_reported_unless_planned() -> None:
    params = AutopilotConfig(params={"MIS_TAKEOFF_ALT": FAILS_AT_LAST_M + 1})
    swarm = Swarm(Scenario(name="fine", agents=3, autopilot=params), wall_limit_s=30.0)
    with swarm:
        swarm.run(until_s=1.0)
        swarm.kill(2)
        swarm.run(until_s=2.0)
    assert swarm.records_lost is None
    (died,) = swarm._processes.nondeterminism({2})
    assert died.startswith(
        f"uav 1 (pid {swarm.pids['uav 1']}) was killed by SIGKILL while the run was being stopped (log: "
    )
    lost = "uav 2 was lost for no simulated reason: its connection broke"
    assert swarm._processes.nondeterminism() == [lost, died]  # reported once


def test_on_vehicle_loss_end_ends_the_run(launch: Launch) -> None:
    with launch(run=RunConfig(on_vehicle_loss="end")) as swarm:
        swarm.kill(2)
        with pytest.raises(SwarmError, match=r"^uav 2 was lost: its connection broke; run\.on_"):
            swarm.run_for(1.0)
        with pytest.raises(SwarmError, match=r"^uav 2 was lost"):  # the run does not continue
            swarm.run_for(1.0)


def test_channel_commands_are_received_in_order(launch: Launch) -> None:
    with launch() as swarm:
        swarm.cut_channel()
        swarm.degrade_channel(20.0)
        swarm.restore_channel()
        swarm.run_for(0.1)
        log = swarm.log_tails(10)["physics"].splitlines()
    attenuations = [
        line.partition("attenuation_db=")[2].rstrip(")") for line in log if "SetAttenuation" in line
    ]
    assert attenuations == ["200.0", "20.0", "0.0"]


def test_failed_physics_ends_the_run_with_its_message(launch: Launch) -> None:
    complaint = r"^physics \(pid \d+\) ended with status 2: physics: the world has ended \(log: .*\)$"
    with launch("physics-fails") as swarm, pytest.raises(SwarmError, match=complaint):
        swarm.run(until_s=5.0)


def test_killed_radio_ends_the_run(launch: Launch) -> None:
    with launch() as swarm:
        pid = swarm.pids["radio"]
        os.kill(pid, signal.SIGKILL)
        with pytest.raises(
            SwarmError, match=rf"^radio \(pid {pid}\) was killed by SIGKILL at .* s \(log: .*\)$"
        ):
            swarm.run_until(lambda _: False, timeout_s=1e6)


def test_killed_prefork_server_ends_the_run_and_the_vehicles(launch: Launch) -> None:
    with launch() as swarm:
        pid = swarm.pids["prefork"]
        os.kill(pid, signal.SIGKILL)
        with pytest.raises(
            SwarmError, match=rf"^prefork \(pid {pid}\) was killed by SIGKILL at .* s \(log: "
        ):
            swarm.run_until(lambda _: False, timeout_s=1e6)
    assert swarm.forced == ()
    endings = {event.name: event.returncode for event in swarm.events if isinstance(event, Exited)}
    # the prefork server would have reported the status of the vehicles
    assert endings == {"prefork": -9, "physics": 0, "radio": 0} | {f"uav {i}": None for i in range(3)}


def test_hanging_physics_is_ended_at_the_wall_time_limit(
    launch: Launch, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(harness.launch.processes, "STOP_LIMIT_S", 3.0)  # enough on a busy machine
    swarm = launch("physics-hangs", agents=2, wall_limit_s=2.0)
    with swarm, pytest.raises(SwarmTimeoutError, match="the wall time of 2 s is over"):
        swarm.run(until_s=5.0)
    # physics ended with its stdin, and the vehicles with their connections
    assert swarm.forced == (f"physics (pid {swarm.pids['physics']}) did not stop when asked",)


def test_unreached_formation_raises_a_timeout(launch: Launch) -> None:
    with (
        launch("never-formed") as swarm,
        pytest.raises(SwarmTimeoutError, match="formation was not reached within 5 s"),
    ):
        swarm.run_until_formed(timeout_s=5.0)


def test_vehicle_that_fails_at_the_start_is_reported_with_its_reason() -> None:
    scenario = Scenario(name="fine", agents=3)
    params = type(scenario.autopilot)(params={"MIS_TAKEOFF_ALT": 1.0})
    swarm = Swarm(Scenario(name="fine", agents=3, autopilot=params))
    with pytest.raises(
        SwarmError, match=r"^uav 1 \(pid \d+\) ended with status 2: uav 1: no such airframe \(log"
    ):
        swarm.start()
    assert swarm.leftovers() == []
    with pytest.raises(SwarmError, match="a swarm is started once"):
        swarm.start()


def test_port_in_use_is_reported_before_the_start() -> None:
    with bind(socket.SOCK_STREAM, "127.0.0.1", 0) as taken:
        port = taken.getsockname()[1]
        ports = PortsConfig(
            simulator_tcp=port,
            simulator_link="tcp",
            gcs_local_udp=0,
            gcs_remote_udp=0,
            companion_local_udp=0,
            companion_remote_udp=0,
            radio_tcp=0,
        )
        swarm = Swarm(Scenario(name="fine", agents=1, ports=ports), ports="scenario")
        with pytest.raises(SetupError, match=rf"^TCP port {port} on 127\.0\.0\.1: Address already in use; "):
            swarm.start()
        assert swarm.pids == {}


def test_folder_of_another_run_is_not_overwritten(launch: Launch, tmp_path: Path) -> None:
    with launch(agents=1, out=tmp_path / "run"):
        pass
    with pytest.raises(SetupError, match="holds a run already"):
        launch(agents=1, out=tmp_path / "run").start()


def test_two_swarms_in_two_threads_are_independent(launch: Launch) -> None:
    ends: dict[str, float] = {}

    def fly(swarm: Swarm, until_s: float) -> None:
        with swarm:
            ends[swarm.scenario.name] = swarm.run(until_s=until_s).t_s

    flights = [
        threading.Thread(target=fly, args=(launch(name, agents=2), until_s))
        for name, until_s in (("one", 2.0), ("two", 4.0))
    ]
    for flight in flights:
        flight.start()
    for flight in flights:
        flight.join()
    assert ends == {"one": pytest.approx(2.0), "two": pytest.approx(4.0)}


def test_ctrl_c_in_flight_leaves_no_process(launch: Launch) -> None:
    swarm = launch("interrupted")
    with pytest.raises(KeyboardInterrupt), swarm:
        swarm.run_until(lambda _: False, timeout_s=60.0)
    assert not any(psutil.pid_exists(pid) for pid in swarm.pids.values())


def test_run_after_stop_raises(launch: Launch) -> None:
    with launch(agents=1) as swarm:
        swarm.run_for(0.1)
    with pytest.raises(SwarmError, match="not running"):
        swarm.run_for(0.1)
    swarm.stop()


def test_temporary_folder_is_deleted_with_its_swarm() -> None:
    swarm = Swarm(Scenario(name="fine", agents=1))
    path = swarm.path
    assert path.is_dir()
    del swarm
    assert not path.exists()
