"""A wrong command line is one line on stderr and status 2; the display of a run is correct."""

import errno
import io
import re
from pathlib import Path

import pytest
from msgspec import structs
from rich.console import Console

from foundation.processes.child_protocol import Ready
from harness.cli import progress as progress_display
from harness.cli.fly import BAD_INPUT, FINE, main
from harness.cli.progress import LineDisplay, LiveDisplay, Pace, describe, fleet, headline, summary_table
from harness.launch.kernel_cache import CompileProgress
from harness.launch.processes import Compiling
from harness.launch.supervisor import Exited
from harness.simulator.messages import Collision, Formed, Progress, VehicleLost, VehicleSilent, VehicleTruth


@pytest.fixture
def scenario_file(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text("agents = 2\n[wind]\nmean_n = 1.0\n")
    return path


def error_line(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> str:
    """Run an invalid command line; returns its only line on stderr."""
    assert main(arguments) == BAD_INPUT
    streams = capsys.readouterr()
    assert streams.out == ""
    lines = streams.err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("coflight: ")
    return lines[0].removeprefix("coflight: ")


def test_missing_file_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    line = error_line(capsys, ["no/such.toml"])
    assert line.startswith("no/such.toml: no such scenario file; scenarios by name: article, ")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--set", "wind.men_n=2"], ["wind", "men_n"]),
        (["--set", "wind.mean_n=strong"], ["wind.mean_n"]),
        (["--set", "wind"], ["--set wind", "PATH=VALUE"]),
        (["--agents", "0"], ["agents"]),
        (["--agents", "many"], ["--agents"]),
        (["--duration", "-1"], ["run.duration_s"]),
        (["--seed", "-1"], ["run.seed"]),
        (["--speed", "fast"], ["'fast'", "'max'"]),
        (["--speed", "0"], ["'0'", "'max'"]),
        (["--speed", "inf"], ["'inf'", "'max'"]),
        (["--port-offset", "61000"], ["simulator_tcp", "61000"]),
        (["--port-offset", "-1"], ["offset of -1", "0 or more"]),
        (["--port-offset", "many"], ["'many'", "'auto'"]),
        (["--out", ""], ["--out", "empty"]),
        (["--hold", "--one-process"], ["--hold", "one process"]),
        (["--profile", "--one-process"], ["--profile", "one process"]),
        (["--no-such-option"], ["--no-such-option"]),
    ],
)
def test_bad_input_is_one_line_that_names_it(
    capsys: pytest.CaptureFixture[str], scenario_file: Path, arguments: list[str], words: list[str]
) -> None:
    line = error_line(capsys, [str(scenario_file), *arguments])
    for word in words:
        assert word in line


def test_debug_shows_the_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["no/such.toml", "--debug"]) == BAD_INPUT
    assert "Traceback" in capsys.readouterr().err


def test_help_is_no_failure(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == FINE
    assert "--port-offset" in capsys.readouterr().out


def vehicle(*, alive: bool = True, phase: str = "on station", error_m: float = 0.25) -> VehicleTruth:
    return VehicleTruth(
        alive=alive,
        armed=True,
        mode="offboard",
        phase=phase,
        pos_ned_m=(1.0, 2.0, -10.5),
        vel_ned_m_s=(0.0, 0.0, 0.0),
        q_ned_frd=(1.0, 0.0, 0.0, 0.0),
        error_m=error_m,
    )


def progress(time_us: int, wall_s: float, *vehicles: VehicleTruth) -> Progress:
    return Progress(time_us=time_us, wall_s=wall_s, channel_busy_fraction=0.1234, vehicles=vehicles)


def test_speed_is_that_of_the_last_two_seconds() -> None:
    pace = Pace()
    assert pace.update(0, 100.0) is None
    assert pace.update(4_000_000, 101.0) == pytest.approx(4.0)
    # the first second, four times as fast, leaves the window
    assert pace.update(5_000_000, 102.0) == pytest.approx(2.5)
    assert pace.update(6_000_000, 103.0) == pytest.approx(1.0)
    assert pace.update(7_000_000, 104.0) == pytest.approx(1.0)


def test_fleet_counts_phases_without_the_lost() -> None:
    vehicles = [vehicle(), vehicle(error_m=0.5), vehicle(phase="climb"), vehicle(alive=False, error_m=99.0)]
    assert fleet(vehicles) == "1 climb, 2 on station, 1 lost, largest error 0.50 m"


def test_headline() -> None:
    assert headline(progress(12_340_000, 0.0), 4.26) == "t = 12.34 s, 4.3 x real time, channel 12.3% busy"
    assert "- x real time" in headline(progress(0, 0.0), None)
    late = structs.replace(progress(12_340_000, 0.0), lag_s=0.34)
    assert headline(late, 1.0) == "t = 12.34 s, 1.0 x real time (0.3 s behind), channel 12.3% busy"
    standing = structs.replace(progress(12_340_000, 0.0), paused=True)
    assert headline(standing, 0.5) == "t = 12.34 s, paused, channel 12.3% busy"


def test_events_are_described_in_words() -> None:
    where = (0.0, 0.0, -10.0)
    assert describe(Formed(time_us=31_200_000)) == "t = 31.20 s: formation reached"
    assert describe(VehicleLost(time_us=4_000, instance=3, reason="gone")) == "t = 0.00 s: uav 3 lost: gone"
    silent = VehicleSilent(time_us=0, instance=2, wall_silence_s=0.52)
    assert describe(silent) == "t = 0.00 s: uav 2 has not answered for 0.5 s of wall time"
    collision = Collision(time_us=1_000_000, first=1, second=2, pos_ned_m=where)
    assert describe(collision) == "t = 1.00 s: uav 1 and uav 2 touched"
    killed = Exited(name="uav 3", pid=12, returncode=-9, log_tail="flying\na library", last_words="flying")
    assert describe(killed) == "uav 3 (pid 12) was killed by SIGKILL: flying"
    assert describe(Exited(name="uav 3", pid=12, returncode=0, log_tail="")) is None
    assert describe(Ready(name="uav 3", pid=12)) is None


def test_plain_lines_are_printed_every_three_seconds_and_events_at_once() -> None:
    console = Console(record=True, width=40, force_terminal=False, quiet=False)
    display = LineDisplay(console)
    for tenth in range(70):
        display.on_message(progress(tenth * 400_000, tenth / 10, vehicle()))
        if tenth == 15:
            display.on_message(Formed(time_us=6_000_000))
    display.close()
    lines = console.export_text().splitlines()
    assert [line.split(",")[0] for line in lines] == [
        "t = 0.00 s",
        "t = 6.00 s: formation reached",
        "t = 12.00 s",
        "t = 24.00 s",
    ]
    assert lines[2].endswith("4.0 x real time, channel 12.3% busy, 1 on station, largest error 0.25 m")


def test_live_table_shows_every_vehicle_and_keeps_the_events(capsys: pytest.CaptureFixture[str]) -> None:
    display = LiveDisplay(Console(force_terminal=True, width=100))
    display.on_message(progress(1_000_000, 1.0, vehicle(), vehicle(alive=False)))
    display.on_message(VehicleLost(time_us=900_000, instance=1, reason="gone"))
    display.close()
    display.close()
    shown = capsys.readouterr().out
    assert "uav 1 lost: gone" in shown
    for words in ("offboard", "on station", "10.50", "0.25", "channel 12.3% busy"):
        assert words in shown


def test_a_closed_terminal_does_not_fail_the_run() -> None:
    class Closed(io.StringIO):
        def write(self, _: str) -> int:
            raise OSError(errno.EIO, "Input/output error")

    console = Console(file=Closed(), force_terminal=False)
    LineDisplay(console).note("formation reached")
    with pytest.raises(OSError, match="Input"):
        console.print("formation reached")


def test_summary_table_shows_values_and_dashes_for_missing_ones() -> None:
    summary = {
        "scenario": "article", "seed": 7, "status": "not_formed", "simulated_s": 12.0, "wall_s": 4.0,
        "real_time_factor": 3.0, "formed_s": None, "formation_rms_m": {"absolute": None, "shape": 0.1234},
        "frames": {"sent": 10, "delivered": 60, "collided": 1, "lost_to_noise": 2},
        "channel_busy_fraction": 0.05, "collisions": 0, "deterministic": True, "log_sha256": "f" * 64,
        "ftm": {"requested": 5, "completed": 4, "failed": 1, "error_mean_m": 0.01, "error_std_m": 0.06},
        "max_gain_dbi": {"ideal": 13.26, "mean": None, "std": None},
        "vehicles": [{"uav": 0, "lost": None}, {"uav": 1, "lost": "its connection broke, t = 1.00 s"}],
    }  # fmt: skip
    console = Console(record=True, width=100, quiet=False)
    console.print(summary_table(summary))
    text = console.export_text()
    assert re.search(r"lost +│ uav 1 \(its connection broke, t = 1\.00 s\)", text)
    assert "article, seed 7: not_formed" in text
    assert "- absolute, 0.123 m shape" in text
    assert "- mean, 13.26 dBi ideal, - std" in text
    assert "10 sent, 1 collided, 2 lost to noise" in text
    assert "4 of 5 completed" in text
    assert "5.0%" in text


def test_plain_lines_report_compiling_every_ten_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    wall_s = 100.0
    monkeypatch.setattr(progress_display.time, "monotonic", lambda: wall_s)
    screen = io.StringIO()
    display = LineDisplay(Console(file=screen))
    for done in (3, 4, 5):
        packages = {"vehicles": CompileProgress(done, 10), "radio": CompileProgress(0, 0)}
        display.on_message(Compiling(packages=packages))
        wall_s += progress_display.COMPILING_LINE_PERIOD_S / 2.0
    assert screen.getvalue().splitlines() == [
        "compiled kernels: vehicles 3 of 10, radio loading",
        "compiled kernels: vehicles 5 of 10, radio loading",
    ]
