"""Real swarms of the `swarm` fixture: a killed vehicle, ground stations with and without signing."""

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from harness.launch.supervisor import Exited
from harness.launch.swarm import Swarm
from harness.simulator.messages import VehicleLost

pytestmark = pytest.mark.multiprocess

Factory = Callable[..., Swarm]


def test_killed_vehicle_falls_and_the_others_continue(swarm: Factory) -> None:
    overrides = ["wind.mean_n=1", "onboard.localisation=gps"]
    flight = swarm("scenarios/article.toml", agents=3, overrides=overrides)
    flight.run_until(lambda truth: bool(truth.height_m.min() > 4.0), timeout_s=30.0)
    began_us, wall_began_s = flight.truth.time_us, time.monotonic()
    flight.kill(1)
    exited = [event for event in flight.events if isinstance(event, Exited)]
    assert time.monotonic() - wall_began_s < 1.0
    assert [event.describe() for event in exited] == [f"uav 1 (pid {exited[0].pid}) was killed by SIGKILL"]
    # with stopped rotors it falls from 4 m in about a second; its collision box is some 0.1 m high
    truth = flight.run_until(lambda truth: bool(truth.height_m[1] < 0.3), timeout_s=3.0)
    assert truth.alive.tolist() == [True, False, True]
    assert truth.height_m[[0, 2]].min() > 3.5
    lost = [event for event in flight.events if isinstance(event, VehicleLost)]
    assert [(event.instance, event.time_us) for event in lost] == [(1, began_us)]
    flight.stop()
    assert flight.forced == ()


def test_ground_station_receives_telemetry_of_its_vehicle(swarm: Factory) -> None:
    flight = swarm("scenarios/article.toml", agents=2)
    links = [flight.mavlink(i) for i in range(2)]
    flight.run_for(3.0)
    for i, link in enumerate(links):
        kinds = set()
        while (message := link.recv_match(blocking=False)) is not None:
            assert message.get_srcSystem() == i + 1
            kinds.add(message.get_type())
        assert kinds >= {"HEARTBEAT", "ATTITUDE", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT"}
    assert flight.summary(draw=False)["deterministic"] is False


def test_ground_station_signs_with_the_key_of_the_swarm(swarm: Factory, tmp_path: Path) -> None:
    key = tmp_path / "key"
    key.write_text("correct horse\n")
    overrides = [f"links.signing_key_file={key}", "onboard.hold=true"]
    flight = swarm("scenarios/article.toml", agents=1, overrides=overrides)
    links = [flight.mavlink(0) for _ in range(2)]  # each with its own sequence of time stamps
    flight.run_for(1.0)
    for link in reversed(links):
        while link.recv_match(blocking=False) is not None:
            pass
        link.mav.param_request_read_send(1, 1, b"MPC_XY_VEL_MAX", -1)
    flight.run_for(0.5)
    for link in links:
        value = link.recv_match(type="PARAM_VALUE", blocking=False)
        assert value.param_id == "MPC_XY_VEL_MAX"
        assert value.get_signed()
