"""The display of a run: lines, live view, and the table at the end."""

import errno
import io
import re

import pytest
from application_phases import standing
from msgspec import structs
from rich.console import Console

from foundation.processes.child_protocol import Ready
from harness.cli import progress as progress_display
from harness.cli.progress import (
    LineDisplay,
    LiveDisplay,
    Pace,
    Stage,
    describe,
    fleet,
    headline,
    summary_table,
)
from harness.launch.kernel_cache import CompileProgress
from harness.launch.run_messages import Compiling, Message
from harness.launch.supervisor import Exited
from harness.simulator.messages import Collision, Formed, Progress, VehicleLost, VehicleSilent, VehicleTruth


def vehicle(
    *,
    alive: bool = True,
    armed: bool = True,
    mode: str = "offboard",
    phase: str = "on station",
    error_m: float = 0.25,
) -> VehicleTruth:
    return VehicleTruth(
        alive=alive,
        armed=armed,
        mode=mode,
        **standing(phase),
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
    vehicles = [
        vehicle(),
        vehicle(error_m=0.5),
        vehicle(phase="take off"),
        vehicle(alive=False, error_m=99.0),
    ]
    assert fleet(vehicles) == "2 on station, 1 take off, 1 lost, largest error 0.50 m"


def test_the_fleet_has_no_error_where_no_application_flies_to_a_place() -> None:
    elsewhere = [
        vehicle(phase="held", error_m=80.0),
        vehicle(phase="held", armed=False),
        vehicle(phase="yielded", mode="Return", error_m=50.0),
        vehicle(phase="", mode="Mission", error_m=70.0),
        vehicle(phase="", mode="Hold", armed=False),
        vehicle(phase="", mode="", armed=False),
    ]
    assert fleet(elsewhere) == "1 disarmed, 1 held, 1 in Mission, 1 in Return, 1 in offboard, 1 starting"
    assert fleet([*elsewhere, vehicle(error_m=0.3)]).endswith("largest error 0.30 m")


def test_headline() -> None:
    assert headline(progress(12_340_000, 0.0), 4.26) == "t = 12.34 s, 4.3 x real time, channel 12.3% busy"
    assert "- x real time" in headline(progress(0, 0.0), None)
    late = structs.replace(progress(12_340_000, 0.0), lag_s=0.34)
    assert headline(late, 1.0) == "t = 12.34 s, 1.0 x real time (0.3 s behind), channel 12.3% busy"
    standing = structs.replace(progress(12_340_000, 0.0), paused=True)
    assert headline(standing, 0.5) == "t = 12.34 s, paused, channel 12.3% busy"
    stage = Stage("in formation", end_s=35.4)
    assert headline(progress(12_340_000, 0.0), 2.0, stage, 70.0) == (
        "t = 12.34 of 35.40 s, in formation, 2.0 x real time, 1 min 10 s left, channel 12.3% busy"
    )
    assert headline(standing, 2.0, stage, 70.0) == (
        "t = 12.34 of 35.40 s, in formation, paused, channel 12.3% busy"
    )
    assert headline(progress(12_340_000, 0.0), 1.0, Stage("holding until Ctrl-C")) == (
        "t = 12.34 s, holding until Ctrl-C, 1.0 x real time, channel 12.3% busy"
    )


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


def test_plain_lines_have_the_total_the_remaining_time_and_the_vehicles_in_trouble() -> None:
    console = Console(record=True, width=40, force_terminal=False, quiet=False)
    display = LineDisplay(console)
    display.begin(Stage("in formation", end_s=100.0))
    far = [vehicle(error_m=9.0)] * 5
    for wall_s in range(5):
        display.on_message(progress(wall_s * 4_000_000, wall_s, *far, vehicle()))
    lines = console.export_text().splitlines()
    assert lines[1] == (
        "t = 12.00 of 100.00 s, in formation, 4.0 x real time, 22 s left, channel 12.3% busy, "
        "6 on station, largest error 9.00 m, in trouble: uav 0 (9.0 m from its place), "
        "uav 1 (9.0 m from its place), uav 2 (9.0 m from its place), 2 more"
    )


def test_the_remaining_time_does_not_count_a_pause() -> None:
    console = Console(record=True, width=40, force_terminal=False, quiet=False)
    display = LineDisplay(console)
    display.begin(Stage("in formation", end_s=100.0))
    for wall_s in (0.0, 1.0):
        display.on_message(progress(round(wall_s * 4e6), wall_s, vehicle()))
    for wall_s in (2.0, 50.0):
        display.on_message(structs.replace(progress(4_000_000, wall_s, vehicle()), paused=True))
    for wall_s in (50.2, 53.2):
        display.on_message(progress(4_000_000 + round((wall_s - 50.2) * 4e6), wall_s, vehicle()))
    lines = console.export_text().splitlines()
    assert "paused, channel" in lines[1]
    assert "t = 16.00 of 100.00 s, in formation, 4.0 x real time, 21 s left" in lines[2]


def shown_live(display_stage: Stage | None, *messages: Message, width: int = 80) -> list[str]:
    """Return the lines of the live view after the messages."""
    screen = io.StringIO()
    display = LiveDisplay(Console(file=screen, force_terminal=True, width=width, height=24))
    if display_stage is not None:
        display.begin(display_stage)
    for message in messages:
        display.on_message(message)
    before = len(screen.getvalue())
    display._live.refresh()
    last = screen.getvalue()[before:]
    display.close()
    display.close()
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", last).replace("\r", "")
    return [line.rstrip() for line in plain.split("\n") if line.strip()]


def test_a_healthy_fleet_of_any_size_takes_three_lines() -> None:
    for vehicles in (2, 64):
        lines = shown_live(
            Stage("in formation", end_s=35.4), progress(17_700_000, 1.0, *[vehicle()] * vehicles)
        )
        assert len(lines) == 3
        assert lines[0].startswith("in formation ━")
        assert lines[0].endswith("t = 17.70 of 35.40 s")
        assert lines[1] == "- x real time, ? left, channel 12.3% busy"
        assert lines[2] == f"{vehicles} on station, largest error 0.25 m"


def test_the_live_view_has_a_line_per_vehicle_in_trouble_and_fits_a_terminal() -> None:
    lost = VehicleLost(time_us=900_000, instance=1, reason="gone")
    lines = shown_live(None, lost, progress(1_000_000, 1.0, vehicle(), vehicle(alive=False)))
    assert lines[-2:] == ["1 on station, 1 lost, largest error 0.25 m", "uav 1: lost: gone"]
    fleet_lost = progress(1_000_000, 1.0, *[vehicle(alive=False)] * 60, *[vehicle()] * 4)
    lines = shown_live(Stage("in formation", end_s=35.4), fleet_lost)
    assert len(lines) <= 14
    assert lines[-1] == "and 50 more in trouble"
    narrow = shown_live(Stage("in formation", end_s=35.4), lost, fleet_lost, width=50)
    assert len(narrow) <= 15


def test_before_the_formation_the_bar_shows_the_vehicles_on_station() -> None:
    def filled(on_station: int) -> int:
        fleet_now = [vehicle()] * on_station + [vehicle(phase="joining")] * (4 - on_station)
        first, *_ = shown_live(Stage("forming", forming=True), progress(17_700_000, 1.0, *fleet_now))
        assert first.startswith("forming ")
        assert first.endswith("t = 17.70 s")
        return first.split("╺")[0].count("━") if on_station < 4 else first.count("━")

    assert filled(2) == pytest.approx(progress_display.BAR_WIDTH / 2, abs=1)
    assert filled(4) == progress_display.BAR_WIDTH


def test_events_stay_above_the_live_view(capsys: pytest.CaptureFixture[str]) -> None:
    display = LiveDisplay(Console(force_terminal=True, width=100))
    display.on_message(progress(1_000_000, 1.0, vehicle(), vehicle(alive=False)))
    display.on_message(VehicleLost(time_us=900_000, instance=1, reason="gone"))
    display.close()
    assert "t = 0.90 s: uav 1 lost: gone" in capsys.readouterr().out


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
    assert "packets of programs" not in text
    assert re.search(r"lost +│ uav 1 \(its connection broke, t = 1\.00 s\)", text)
    assert "article, seed 7: not_formed" in text
    assert "- absolute, 0.123 m shape" in text
    assert "- mean, 13.26 dBi ideal, - std" in text
    assert "10 sent, 1 collided, 2 lost to noise" in text
    assert "4 of 5 completed" in text
    assert "5.0%" in text


def test_a_hold_has_no_formation_in_the_table() -> None:
    packets = {"sent": 9, "received": 50, "late": 3, "mean_late_ms": 1.34, "largest_late_ms": 61.2}
    nothing = dict.fromkeys(("absolute", "shape", "mean", "std", "ideal"))
    summary = {
        "scenario": "article", "seed": 1, "status": "held", "simulated_s": 12.0, "wall_s": 12.0,
        "real_time_factor": 1.0, "formed_s": None, "formation_rms_m": nothing, "max_gain_dbi": nothing,
        "frames": {"sent": 0, "collided": 0, "lost_to_noise": 0}, "vehicles": [],
        "ftm": {"requested": 0, "completed": 0, "error_mean_m": None, "error_std_m": None},
        "channel_busy_fraction": 0.0, "collisions": 0, "deterministic": False, "log_sha256": "f" * 64,
        "program_packets": packets,
        "telemetry_frames": {"north": {"sent": 90, "acknowledged": 80, "lost": 10, "received": 7}},
        "telemetry_serial": {"pair": {"sent_bytes": 900, "received_bytes": 70, "radio_status": 3}},
    }  # fmt: skip
    console = Console(record=True, width=100, quiet=False)
    console.print(summary_table(summary))
    text = console.export_text()
    assert "50 received, 3 more than 20 ms late; 1.3 ms mean, 61 ms at most" in text
    assert "article, seed 1: held" in text
    assert re.search(r"telemetry, north +│ 90 sent, 80 acknowledged, 10 lost, 7 received", text)
    assert re.search(r"telemetry, pair +│ 900 B sent, 70 B received, 3 radio status", text)
    for row in ("formation error, rms", "maximum gain", "FTM error"):
        assert re.search(rf"{row} +│ - +│", text)


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
