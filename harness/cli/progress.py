"""Progress display of a run: live on a terminal, periodic plain lines elsewhere, and a table at the end.

Input are the messages of the processes (`harness.launch.processes.Message`), which include wall times.
"""

import contextlib
import time
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from foundation.processes.child_protocol import Warned
from harness.launch.kernel_cache import CompileProgress
from harness.launch.processes import Compiling, Message, ProcessNotice, uav
from harness.launch.supervisor import Exited
from harness.simulator.messages import (
    Collision,
    FaultChanged,
    FormationMoves,
    Formed,
    Progress,
    VehicleLost,
    VehicleSilent,
    VehicleTruth,
)

LINE_PERIOD_S, COMPILING_LINE_PERIOD_S = 3.0, 10.0
"""Wall time between two plain lines, in flight and while kernels compile."""
PACE_WINDOW_S = 2.0
"""Wall time over which the present speed is measured."""
_IGNORE_CLOSED_TERMINAL = contextlib.suppress(OSError)
"""Writing to a closed terminal does not fail a run: SIGHUP ends the run in order."""


def compiled(packages: Mapping[str, CompileProgress]) -> str:
    """Return the numbers of compiled and loaded kernels by package."""
    counts = (
        f"{name} {each.done} of {each.total}" if each.total else f"{name} loading"
        for name, each in packages.items()
    )
    return ", ".join(counts)


def _compile_bars(packages: Mapping[str, CompileProgress]) -> Table:
    table = Table.grid(padding=(0, 1))
    for name, each in packages.items():
        bar = ProgressBar(total=each.total or 1, completed=each.done, width=40)
        table.add_row(f"{name} kernels", bar, f"{each.done} of {each.total}" if each.total else "loading")
    return table


def describe(message: Message) -> str | None:
    """Return one line for a message of interest to the user; None for others."""
    match message:
        case Formed():
            return f"{_at(message.time_us)}: formation reached"
        case FormationMoves():
            return f"{_at(message.time_us)}: formation moves at {message.start_us * 1e-6:.3f} s"
        case VehicleLost():
            return f"{_at(message.time_us)}: {uav(message.instance)} lost: {message.reason}"
        case VehicleSilent():
            silence = f"has not answered for {message.wall_silence_s:.1f} s of wall time"
            return f"{_at(message.time_us)}: {uav(message.instance)} {silence}"
        case Collision():
            return f"{_at(message.time_us)}: {uav(message.first)} and {uav(message.second)} touched"
        case FaultChanged():
            vehicles = "every uav" if message.instance is None else uav(message.instance)
            what = message.what if message.motor is None else f"{message.what} {message.motor}"
            return f"{_at(message.time_us)}: fault {message.number} ({what}) of {vehicles} {message.change}"
        case Warned():
            return f"{_at(message.time_us)}: {message.name}: {message.text}"
        case ProcessNotice():
            return message.text
        case Exited() if message.returncode:
            return message.describe() + (f": {message.last_words}" if message.last_words else "")
        case _:
            return None


class Pace:
    """Simulated over wall time during the last seconds."""

    def __init__(self) -> None:
        self._marks: deque[tuple[int, float]] = deque()

    def update(self, time_us: int, wall_s: float) -> float | None:
        """Add a pair of times; returns the factor, None before there are two."""
        self._marks.append((time_us, wall_s))
        while len(self._marks) > 2 and wall_s - self._marks[0][1] > PACE_WINDOW_S:
            self._marks.popleft()
        first_us, first_wall_s = self._marks[0]
        return (time_us - first_us) * 1e-6 / (wall_s - first_wall_s) if wall_s > first_wall_s else None


class LineDisplay:
    """Prints a line every few seconds of wall time."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._pace = Pace()
        self._wall_next_s = 0.0
        self._wall_compiling_s = 0.0

    def on_message(self, message: Message) -> None:
        """Print notable events, and periodically the state of the run."""
        if (line := describe(message)) is not None:
            self.note(line)
        if isinstance(message, Compiling):
            if (wall_s := time.monotonic()) >= self._wall_compiling_s:
                self._wall_compiling_s = wall_s + COMPILING_LINE_PERIOD_S
                self.note(f"compiled kernels: {compiled(message.packages)}")
            return
        if not isinstance(message, Progress):
            return
        factor = self._pace.update(message.time_us, message.wall_s)
        if message.wall_s >= self._wall_next_s:
            self._wall_next_s = message.wall_s + LINE_PERIOD_S
            self.note(f"{headline(message, factor)}, {fleet(message.vehicles)}")

    def note(self, line: str) -> None:
        """Print a line of any length without wrapping."""
        with _IGNORE_CLOSED_TERMINAL:
            self._console.print(Text(line), soft_wrap=True)

    def close(self) -> None:
        """Do nothing."""


class LiveDisplay:
    """A table that is redrawn in place, below permanent lines."""

    def __init__(self, console: Console) -> None:
        self._pace = Pace()
        self._live = Live(Text("starting"), console=console, refresh_per_second=5, transient=True)
        self._live.start()

    def on_message(self, message: Message) -> None:
        """Redraw the table, and print notable events above it."""
        if (line := describe(message)) is not None:
            self.note(line)
        if isinstance(message, Compiling):
            self._live.update(_compile_bars(message.packages))
        if isinstance(message, Progress):
            factor = self._pace.update(message.time_us, message.wall_s)
            self._live.update(Group(Text(headline(message, factor)), _vehicle_table(message.vehicles)))

    def note(self, line: str) -> None:
        """Print a line above the table."""
        with _IGNORE_CLOSED_TERMINAL:
            self._live.console.print(Text(line), soft_wrap=True)

    def close(self) -> None:
        """Remove the table; harmless when repeated."""
        with _IGNORE_CLOSED_TERMINAL:
            self._live.stop()


FlightDisplay = LineDisplay | LiveDisplay


def display_for(console: Console) -> FlightDisplay:
    """Return a live display on a terminal, plain lines elsewhere."""
    return LiveDisplay(console) if console.is_terminal else LineDisplay(console)


def headline(progress: Progress, factor: float | None) -> str:
    """Return time, speed, lag behind the requested speed, and channel occupancy of a run."""
    speed = "-" if factor is None else f"{factor:.1f}"
    pace = "paused" if progress.paused else f"{speed} x real time"
    lag = f" ({progress.lag_s:.1f} s behind)" if progress.lag_s > 0.0 else ""
    busy = f"{progress.channel_busy_fraction:.1%}"
    return f"{_at(progress.time_us)}, {pace}{lag}, channel {busy} busy"


def fleet(vehicles: Sequence[VehicleTruth]) -> str:
    """Return the number of vehicles in each phase, and the largest error of living vehicles, as text."""
    alive = [vehicle for vehicle in vehicles if vehicle.alive]
    phases = Counter(vehicle.phase or vehicle.mode or "starting" for vehicle in alive)
    parts = [f"{count} {phase}" for phase, count in sorted(phases.items())]
    if len(alive) < len(vehicles):
        parts.append(f"{len(vehicles) - len(alive)} lost")
    if alive:
        parts.append(f"largest error {max(vehicle.error_m for vehicle in alive):.2f} m")
    return ", ".join(parts)


def _vehicle_table(vehicles: Sequence[VehicleTruth]) -> Table:
    table = Table("uav", "mode", "phase", box=None, pad_edge=False)
    table.add_column("height m", justify="right")
    table.add_column("error m", justify="right")
    for i, vehicle in enumerate(vehicles):
        height, error = f"{-vehicle.pos_ned_m[2]:.2f}", f"{vehicle.error_m:.2f}"
        if vehicle.alive:
            mode = vehicle.mode if vehicle.armed else f"{vehicle.mode} (disarmed)"
            table.add_row(str(i), mode, vehicle.phase, height, error)
        else:
            table.add_row(str(i), "lost", "", height, error, style="red")
    return table


def summary_table(summary: Mapping[str, Any]) -> Table:
    """Return a table of the main results in ``summary.json``."""
    formation, frames, ftm = summary["formation_rms_m"], summary["frames"], summary["ftm"]
    gain = summary["max_gain_dbi"]
    lost = [
        f"{uav(vehicle['uav'])} ({vehicle['lost']})" for vehicle in summary["vehicles"] if vehicle["lost"]
    ]
    title = f"{summary['scenario']}, seed {summary['seed']}: {summary['status']}"
    formation_rms = [f"{_number(formation[kind], '.3f', 'm')} {kind}" for kind in ("absolute", "shape")]
    frame_counts = [
        f"{frames[kind]} {kind.replace('_', ' ')}" for kind in ("sent", "collided", "lost_to_noise")
    ]
    ftm_error = [f"{_number(ftm[f'error_{kind}_m'], '.3f', 'm')} {kind}" for kind in ("mean", "std")]
    gains = [f"{_number(gain[kind], '.2f', 'dBi')} {kind}" for kind in ("mean", "ideal")]
    rows = {
        "simulated": _number(summary["simulated_s"], ".1f", "s"),
        "wall time": _number(summary["wall_s"], ".1f", "s"),
        "real-time factor": _number(summary["real_time_factor"], ".2f"),
        "formation reached at": _number(summary["formed_s"], ".1f", "s"),
        "formation error, rms": ", ".join(formation_rms),
        "frames": ", ".join(frame_counts),
        "channel busy": _number(summary["channel_busy_fraction"], ".1%"),
        "FTM sessions": f"{ftm['completed']} of {ftm['requested']} completed",
        "FTM error": ", ".join(ftm_error),
        "maximum gain": f"{', '.join(gains)}, {_number(gain['std'], '.2f', 'dB')} std",
        "computed by": ": ".join(filter(None, (gain.get("backend"), gain.get("accuracy")))) or "-",
        "collisions": str(summary["collisions"]),
        **({"lost": "; ".join(lost)} if lost else {}),
        "deterministic": "yes" if summary["deterministic"] else "no",
        "log sha256": str(summary["log_sha256"])[:16],
    }
    table = Table(title=title, show_header=False)
    for name, value in rows.items():
        table.add_row(name, value)
    return table


def _at(time_us: int) -> str:
    return f"t = {time_us * 1e-6:.2f} s"


def _number(value: float | None, form: str, unit: str = "") -> str:
    return "-" if value is None else f"{value:{form}} {unit}".rstrip()
