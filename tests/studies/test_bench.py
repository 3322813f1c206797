"""Tests of the benchmark: floors' frames, medians and shares of given costs, tables, command line errors."""

import json
import socket
import struct

import msgspec
import psutil
import pytest
from pymavlink.dialects.v20 import common as mavlink
from typer.testing import CliRunner

from autopilot.mavlink.hil import HilActuatorControls, HilParser, HilSensor
from foundation.exit_status import FAILED, INTERRUPTED
from foundation.profiling.profiler import KindProfile
from harness.launch.profiling import VEHICLES
from studies.bench import bench, floor
from studies.bench.bench import BenchPlan, FlightBench, HostMachine, summarise, to_json
from studies.bench.cli import bench_app
from studies.bench.flight_job import LAUNCHER, FlightCost, Span
from studies.bench.floor_job import FloorCost, FloorJob, FloorSpeed
from studies.bench.tables import markdown, sheets, terminal_table

SENSOR = (4_000, *range(13), 0x1FFF)


def sensor_frame(sequence=7):
    return floor.frame(floor._SENSOR, 107, 108, sequence, *SENSOR)


def test_floor_frames_are_valid_mavlink():
    (sensed,) = HilParser(HilSensor).push(sensor_frame())
    assert (sensed.time_usec, sensed.temperature, sensed.fields_updated) == (4_000, 12.0, 0x1FFF)
    (response,) = HilParser(HilActuatorControls).push(floor.reply(sensor_frame(), 3))
    assert (response.time_usec, list(response.controls[:5]), response.flags) == (
        4_000,
        pytest.approx([0.7, 0.7, 0.7, 0.7, 0.0]),
        1,
    )
    # independent parser
    parsed = mavlink.MAVLink(None).parse_buffer(bytearray(sensor_frame()))
    assert [message.get_type() for message in parsed] == ["HIL_SENSOR"]


@pytest.mark.parametrize("at", [0, 7, 12, 70, 75])
def test_corrupted_frame_is_rejected(at):
    wrong = bytearray(sensor_frame())
    wrong[at] ^= 0x10
    assert floor.fields_of(bytes(wrong), floor._SENSOR, 107, 108) is None
    with pytest.raises(floor.LostError):
        floor.reply(bytes(wrong), 0)


def test_floors_have_the_requested_processes_and_positive_costs():
    cost = floor.measure(FloorJob(agents=3, wall_s=0.2))
    assert cost.agents == 3
    for speed in (cost.lockstep, cost.echo):
        assert speed.real_time_factor > 0.1
        assert speed.server_cpu_s_per_simulated_s > 0.0
        assert speed.vehicles_cpu_s_per_simulated_s > 0.0


def test_end_of_a_bare_process_is_detected():
    def close_link(link: socket.socket) -> None:
        link.recv(4_096)

    with floor.bare_processes(2, close_link) as bare, pytest.raises((floor.LostError, ConnectionError)):
        next(floor._echo_steps(bare.links))


def span(factor, scale=1.0):
    return Span(
        simulated_s=10.0,
        wall_s=10.0 / factor,
        cpu_s_per_simulated_s={
            "physics": 0.1 * scale, "radio": 0.05 * scale, VEHICLES: 0.2 * scale, LAUNCHER: 0.0,
        },
        other_processors=0.1 * scale,
    )  # fmt: skip


def flight(factor, scale=1.0, profile=None):
    return FlightCost(
        startup_s=3.0 * scale,
        formed_s=15.0,
        whole=span(factor * 1.1, scale),
        steady=span(factor, scale),
        uss_mb={"physics": 100.0, "radio": 25.0, VEHICLES: 40.0 * scale, LAUNCHER: 60.0},
        pss_mb=700.0 * scale,
        profile=profile or {},
    )


def profiled():
    def kind(**parts):
        return KindProfile(
            processes=1,
            cpu_s_per_simulated_s=sum(parts.values()),
            parts_cpu_s_per_simulated_s=parts,
            waiting_fraction=0.5,
            queueing_fraction=0.1,
            samples=1_000,
        )

    # the profiled flight takes longer; only its shares are used
    return flight(
        1.0,
        profile={"physics": kind(sensors=0.2, physics=0.2), VEHICLES: kind(control=0.3, link=0.1, log=1e-4)},
    )


def floor_cost(factor):
    speed = FloorSpeed(
        real_time_factor=factor, server_cpu_s_per_simulated_s=0.02, vehicles_cpu_s_per_simulated_s=0.03
    )
    return FloorCost(agents=8, lockstep=speed, echo=speed)


@pytest.fixture
def run():
    return summarise(
        8,
        "article.toml",
        floors=[floor_cost(20.0), floor_cost(30.0), floor_cost(10.0)],
        flights=[flight(7.0), flight(1.0, scale=5.0), flight(8.0)],  # the second is disturbed
        profiled=profiled(),
    )


def test_summary_has_medians_and_parts_that_add_up(run):
    assert run.real_time_factor == pytest.approx(7.0)
    assert run.whole_real_time_factor == pytest.approx(7.7)
    assert run.floor_real_time_factor == 20.0
    assert run.startup_s == 3.0
    assert run.uss_mb_per_uav == 40.0
    assert run.other_processors == pytest.approx(0.5)  # a noisy repeat must be reported
    assert run.cpu_s_per_simulated_s[VEHICLES] == pytest.approx(0.2)
    assert run.parts_cpu_s_per_simulated_s["physics"] == {
        "sensors": pytest.approx(0.05),
        "physics": pytest.approx(0.05),
    }
    for kind, parts in run.parts_cpu_s_per_simulated_s.items():
        assert sum(parts.values()) == pytest.approx(run.cpu_s_per_simulated_s[kind])


def found(*runs):
    machine = HostMachine(processors=2, model="any", memory_gb=8.0, system="Linux", python="3.11", load=0.1)
    return FlightBench(machine=machine, duration_s=10.0, repeats=3, runs=runs)


def test_tables_have_a_column_for_each_number_of_uavs(run):
    for sheet in sheets(found(run, run)):
        assert sheet.heading == ("UAVs", "8", "8")
        assert all(len(row) == 3 for row in sheet.rows), sheet.title
        assert terminal_table(sheet).row_count == len(sheet.rows)
    cells = {row[0]: row[1] for sheet in sheets(found(run)) for row in sheet.rows}
    assert cells["in formation"] == "7.00"
    assert cells["slowest to fastest"] == "1.00 to 8.00"
    assert cells["  control"] == "150"
    assert cells["  log"] == "0.0"  # below the limit for a row, but the only such part


def test_markdown_contains_machine_and_tables(run):
    text = markdown(found(run))
    assert text.startswith("any, 2 processors, 8 GB; Linux, Python 3.11; load 0.1 before the start.\n")
    assert "| in formation | 7.00 |\n" in text
    assert "| &nbsp;&nbsp;control | 150 |\n" in text


def test_json_has_the_documented_fields(run):
    (result,) = json.loads(to_json(found(run)))["runs"]
    assert {"agents", "real_time_factor", "floor_real_time_factor", "uss_mb_per_uav", "startup_s"} <= set(
        result
    )
    assert set(result["cpu_s_per_simulated_s"]) == {"physics", "radio", VEHICLES, LAUNCHER}
    assert len(result["flights"]) == len(result["floors"]) == 3


def test_default_scenario_depends_on_the_number_of_uavs():
    plan = BenchPlan(agents=(8, 9), duration_s=1.0, repeats=1, floor_wall_s=0.1)
    assert [plan.scenario_for(number).name for number in plan.agents] == ["article.toml", "swarm64.toml"]


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--agents", "1,two"], "bench: --agents 1,two: expected numbers of UAVs: 1,8,16"),
        (["--agents", "0"], "bench: --agents 0: expected numbers of UAVs: 1,8,16"),
        (["--agents", "1", "--scenario", "nowhere.toml"], "bench: nowhere.toml"),
        (["--agents", "1,1000"], "bench: "),
    ],
)
def test_bad_input_is_one_line_before_the_first_flight(arguments, line):
    result = CliRunner().invoke(bench_app, arguments)
    assert result.exit_code == 2
    assert result.stderr.startswith(line)
    assert result.stderr.count("\n") == 1
    assert result.stdout == ""


@pytest.fixture
def measure(monkeypatch, run):
    """Run the command line for 1, 8 and 64 UAVs; the run with 64 ends with the given exception."""

    def invoke(reason, *options, agents="1,8,64"):
        def one(_plan, agents, note):
            note(f"{agents} UAVs are measured")
            if agents == 64:
                raise reason
            return msgspec.structs.replace(run, agents=agents)

        monkeypatch.setattr(bench, "_run", one)
        monkeypatch.setattr(bench.kernel_cache, "prepare", lambda _: None)
        return CliRunner().invoke(bench_app, ["--agents", agents, *options])

    return invoke


@pytest.mark.parametrize(
    ("reason", "status", "line"),
    [
        (bench.BenchError("uav 3 was lost"), FAILED, "bench: 64 UAVs: uav 3 was lost"),
        (KeyboardInterrupt(), INTERRUPTED, "bench: 64 UAVs: interrupted"),
    ],
)
def test_results_before_a_failure_are_reported(measure, reason, status, line):
    result = measure(reason)
    assert result.exit_code == status
    assert result.stderr.splitlines()[-1] == line
    assert "in formation" in result.stdout
    document = json.loads(measure(reason, "--json").stdout)
    assert [each["agents"] for each in document["runs"]] == [1, 8]
    assert f"bench: {document['failure']}" == line
    assert document["broken_off"] is (status == INTERRUPTED)


@pytest.mark.parametrize(
    ("reason", "status", "line"),
    [
        (bench.BenchError("uav 3 was lost"), FAILED, "bench: uav 3 was lost"),
        (KeyboardInterrupt(), INTERRUPTED, "bench: interrupted"),
    ],
)
def test_without_results_only_the_reason_is_printed(measure, reason, status, line):
    result = measure(reason, agents="64,8")
    assert (result.exit_code, result.stdout) == (status, "")
    assert result.stderr.splitlines()[-1] == line


def test_failed_measurement_is_reported_with_its_last_line(tmp_path):
    plan = BenchPlan(
        agents=(1,), duration_s=1.0, repeats=1, floor_wall_s=0.1, scenario=tmp_path / "nowhere.toml"
    )
    with pytest.raises(bench.BenchError, match=r"nowhere\.toml"):
        bench._flight(plan, 1)


def test_measurement_over_its_time_limit_is_interrupted(monkeypatch):
    monkeypatch.setattr(bench, "WALL_LIMIT_S", 1.0)
    others = psutil.Process().children()  # started by earlier tests
    with pytest.raises(bench.BenchError, match=r"^studies\.bench\.floor: not done within 1 s$"):
        bench._floor(1, 60.0)
    assert set(psutil.Process().children()) <= set(others)


def test_frame_lengths_are_those_of_a_flight():
    assert floor._SENSOR.size == struct.calcsize("<Q13fI") == 64
    assert floor._REPLY.size == 81
