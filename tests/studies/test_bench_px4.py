"""The comparison with PX4s: the bare simulator's vehicles and companion, the table, errors of the command."""

import contextlib
import socket

import numpy as np
import pytest
from typer.testing import CliRunner

from autopilot.mavlink.codec import Parser
from foundation.exit_status import BAD_INPUT
from harness.scenario.scenario_file import load
from studies.bench.bench import SCENARIOS, HostMachine
from studies.bench.px4_bare import GRAVITY_M_S2, HOVER_CONTROL, STEP_US, BareCompanion, BareVehicles
from studies.bench.px4_bench import (
    BARE_FLIES,
    BARE_RESTS,
    MEASUREMENTS,
    SEATS,
    Px4Bench,
    Px4Cost,
    Px4Plan,
    sheet,
)
from studies.bench.px4_cli import px4_bench_app


def scenario(*settings, agents=3):
    return load(SCENARIOS / "article.toml", [f"agents={agents}", "formation.columns=1", *settings])


def vehicles():
    return BareVehicles(scenario(), np.random.default_rng(1))


def sensed(frames):
    """Messages to each vehicle, by name."""
    return [{message.get_type(): message for message in Parser().push_datagram(frame)} for frame in frames]


def fly(bare, control, seconds):
    for _ in range(round(seconds / (STEP_US * 1e-6))):
        bare.advance(np.full((3, 4), control))


def test_a_vehicle_stands_until_its_motors_carry_it_and_hovers_at_their_share():
    bare = vehicles()
    fly(bare, 0.9 * HOVER_CONTROL, 2.0)
    assert bare.height_m.tolist() == [0.0] * 3
    fly(bare, 1.1 * HOVER_CONTROL, 1.0)
    assert bare.height_m == pytest.approx(0.05 * GRAVITY_M_S2, rel=0.01)  # a t^2 / 2
    fly(bare, 0.9 * HOVER_CONTROL, 1.0)
    at_top_m = bare.height_m.copy()
    assert at_top_m == pytest.approx(0.1 * GRAVITY_M_S2, rel=0.02)
    fly(bare, HOVER_CONTROL, 1.0)
    assert bare.height_m == pytest.approx(at_top_m, abs=0.01)
    fly(bare, 0.0, 2.0)
    assert bare.height_m.tolist() == [0.0] * 3


def test_sensors_are_those_of_a_level_vehicle_at_its_height():
    bare = vehicles()
    (ground, *_) = sensed(bare.frames(50))
    fly(bare, 1.1 * HOVER_CONTROL, 3.0)
    (climbing, *_) = sensed(bare.frames(800))
    assert ground["HIL_SENSOR"].time_usec == 50 * STEP_US
    for messages, force_m_s2 in ((ground, GRAVITY_M_S2), (climbing, 1.1 * GRAVITY_M_S2)):
        sensor = messages["HIL_SENSOR"]
        assert sensor.zacc == pytest.approx(-force_m_s2, abs=0.6)
        assert (sensor.xacc, sensor.yacc, sensor.xgyro) == pytest.approx((0.0, 0.0, 0.0), abs=0.6)
    risen_m = bare.height_m[0]
    fall_hpa = ground["HIL_SENSOR"].abs_pressure - climbing["HIL_SENSOR"].abs_pressure
    assert fall_hpa == pytest.approx(0.115 * risen_m, abs=0.1)
    assert climbing["HIL_GPS"].alt - ground["HIL_GPS"].alt == pytest.approx(1e3 * risen_m, abs=1.0)
    assert climbing["HIL_GPS"].vd < 0 == ground["HIL_GPS"].vd


def test_sensors_change_in_every_step_and_slow_ones_are_marked_at_their_rates():
    frames = [sensed(vehicles().frames(step))[0] for step in range(1, 251)]
    sensors = [messages["HIL_SENSOR"] for messages in frames]
    assert len({(sensor.xacc, sensor.zgyro) for sensor in sensors}) == 250
    assert sum(sensor.fields_updated != 0x3F for sensor in sensors) == 50
    assert sum("HIL_GPS" in messages for messages in frames) == 5


def test_the_companion_sends_setpoints_and_commands_until_its_px4_has_armed():
    with contextlib.ExitStack() as stack:
        px4 = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        px4.bind(("127.0.0.1", 0))
        px4.settimeout(5.0)
        base = px4.getsockname()[1]
        ports = scenario(f"ports.companion_local_udp={base}", "ports.companion_remote_udp=0", agents=1)
        companion = stack.enter_context(contextlib.closing(BareCompanion(ports, 0)))
        names = []
        for step, armed in ((250, False), (260, False), (500, True)):
            companion.send(step, armed=armed)
            names.append([message.get_type() for message in Parser().push_datagram(px4.recv(2_048))])
    setpoint = "SET_POSITION_TARGET_LOCAL_NED"
    assert names == [[setpoint, "COMMAND_LONG", "COMMAND_LONG"], [setpoint], [setpoint]]


def cost(factor, *, whole=None, **cpu_s):
    return Px4Cost(
        real_time_factor=factor, whole_real_time_factor=whole, cpu_s_per_simulated_s=cpu_s,
        other_processors=None,
    )  # fmt: skip


def test_the_table_has_medians_and_the_share_of_each_bare_rate():
    machine = HostMachine(processors=2, model="x", memory_gb=1.0, system="x", python="x", load=0.0)
    found = {name: [cost(4.0, vehicles=0.4, physics=0.05)] * 3 for name in MEASUREMENTS}
    found[SEATS] = [cost(factor, whole=factor - 0.5, vehicles=0.5) for factor in (2.0, 3.0, 9.0)]
    found[BARE_RESTS] = [cost(5.0)]
    rows = {name: cells for name, *cells in sheet(
        Px4Bench(machine=machine, agents=8, duration_s=20.0, measurements=found)
    ).rows}  # fmt: skip
    assert rows[SEATS][:4] == ["3.00", "2.00 to 9.00", "2.50", "500"]
    assert rows[BARE_FLIES][2:6] == ["-", "400", "-", "50"]
    assert rows[BARE_FLIES][-1] == "450"
    assert rows[f"{SEATS}, of: {BARE_FLIES}"][0] == "75%"
    assert rows[f"{SEATS}, of: {BARE_RESTS}"][0] == "60%"


def test_the_scenario_of_the_px4s_has_their_build_user_and_settings():
    plan = Px4Plan(build="x", user="pilot", settings=("autopilot.params.SDLOG_MODE=-1",))
    autopilot = scenario(*plan.px4_settings()).autopilot
    assert autopilot.kind == "px4"
    assert autopilot.px4_command[:2] == ("setpriv", "--reuid=pilot")
    assert autopilot.params["SDLOG_MODE"] == -1


@pytest.mark.parametrize("settings", [[], ["--set", "autopilot.px4_nothing=1"]])
def test_a_build_or_setting_that_does_not_exist_is_reported_before_a_flight(tmp_path, settings):
    result = CliRunner().invoke(px4_bench_app, ["--build", str(tmp_path), "--user", "x", *settings])
    assert result.exit_code == BAD_INPUT
    assert "px4" in result.stderr
