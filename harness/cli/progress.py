"""Progress display of a run: live on a terminal, periodic plain lines elsewhere, and a table at the end.

Input are the messages of the processes (`harness.launch.run_messages.Message`), which include wall times.
"""

import contextlib
import time
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from foundation.durations import duration_text
from foundation.processes.child_protocol import Warned
from harness.cli.troubles import Lag, Trouble, Troubles, error_m
from harness.launch.death_report import ending
from harness.launch.kernel_cache import CompileProgress
from harness.launch.process_commands import application, uav
from harness.launch.run_messages import Compiling, Message, ProcessNotice
from harness.launch.supervisor import Exited
from harness.simulator.messages import (
    ApplicationLost,
    ApplicationSilent,
    ApplicationText,
    Collision,
    FaultChanged,
    FormationMoves,
    Formed,
    Progress,
    VehicleLost,
    VehicleSilent,
    VehicleTruth,
)
from netsim.network.messages import ProgramEnded
from netsim.transport.packet_pace import LATE_MS

LINE_PERIOD_S, COMPILING_LINE_PERIOD_S = 3.0, 10.0
"""Wall time between two plain lines, in flight and while kernels compile."""
PACE_WINDOW_S, STEADY_WINDOW_S = 2.0, 10.0
"""Wall time over which the present speed is measured, as shown and for estimates."""
BAR_WIDTH = 30
MOST_TROUBLES, MOST_TROUBLES_IN_A_LINE = 10, 3
"""Vehicles in trouble that are shown: with them the live view has 14 lines, of a terminal's usual 24."""
MOST_NUMBERS = 4
"""Numbers of the applications' statuses that are shown; all are recorded."""
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
        case ApplicationText():
            return f"{_at(message.time_us)}: {uav(message.instance)}: {message.text}"
        case VehicleLost():
            return f"{_at(message.time_us)}: {uav(message.instance)} lost: {message.reason}"
        case ApplicationLost():
            without = f"{uav(message.instance)} flies on without it"
            return (
                f"{_at(message.time_us)}: {application(message.instance)} lost: {message.reason}; {without}"
            )
        case ApplicationSilent():
            silence = f"has not answered for {message.wall_silence_s:.1f} s of wall time"
            return f"{_at(message.time_us)}: {application(message.instance)} {silence}"
        case VehicleSilent():
            silence = f"has not answered for {message.wall_silence_s:.1f} s of wall time"
            return f"{_at(message.time_us)}: {uav(message.instance)} {silence}"
        case Collision():
            return f"{_at(message.time_us)}: {uav(message.first)} and {uav(message.second)} touched"
        case FaultChanged():
            vehicles = "every uav" if message.instance is None else uav(message.instance)
            what = message.what if message.motor is None else f"{message.what} {message.motor}"
            return f"{_at(message.time_us)}: fault {message.number} ({what}) of {vehicles} {message.change}"
        case ProgramEnded() if message.returncode and not message.was_stopped:
            how = f"{uav(message.station)}: program {message.name} {ending(message.returncode)}"
            again = message.restart_in_s
            return how if again is None else f"{how}; it is started again in {again:g} s"
        case Warned():
            return f"{_at(message.time_us)}: {message.name}: {message.text}"
        case ProcessNotice():
            return message.text
        case Exited() if message.returncode:
            how = f"{message.describe()} {message.sequel}".rstrip()
            return f"{how}: {message.last_words}" if message.last_words else how
        case _:
            return None


class Stage(NamedTuple):
    """Part of a run, as shown."""

    name: str
    end_s: float | None = None
    """Simulated time at which the run ends; None: unknown."""
    forming: bool = False
    """The formation is awaited: progress is the number of vehicles on station."""


class Pace:
    """Simulated over wall time during the last ``window_s`` of wall time."""

    def __init__(self, window_s: float = PACE_WINDOW_S) -> None:
        self._window_s = window_s
        self._marks: deque[tuple[int, float]] = deque()
        self.factor: float | None = None
        """Newest result of `update`."""

    def update(self, time_us: int, wall_s: float) -> float | None:
        """Add a pair of times; returns the factor, None before there are two."""
        self._marks.append((time_us, wall_s))
        while len(self._marks) > 2 and wall_s - self._marks[0][1] > self._window_s:
            self._marks.popleft()
        first_us, first_wall_s = self._marks[0]
        self.factor = (time_us - first_us) * 1e-6 / (wall_s - first_wall_s) if wall_s > first_wall_s else None
        return self.factor

    def restart(self) -> None:
        """Forget all times, because simulated time stands still."""
        self._marks.clear()
        self.factor = None


class _Flight:
    """State of a run, from its messages. ``forms``: see `Troubles`."""

    def __init__(self, *, forms: bool) -> None:
        self.stage: Stage | None = None
        self.progress: Progress | None = None
        self.pace, self._steady_pace = Pace(), Pace(STEADY_WINDOW_S)
        self._troubles, self._lag = Troubles(forms=forms), Lag()

    def update(self, message: Message) -> list[str]:
        """Note a message; returns the permanent lines that it causes."""
        lines = [describe(message)]
        self._troubles.update(message)
        if isinstance(message, Progress):
            self.progress = message
            for pace in (self.pace, self._steady_pace):
                if message.paused:
                    pace.restart()
                else:
                    pace.update(message.time_us, message.wall_s)
            lines.append(self._lag.update(message, self._steady_pace.factor))
        return [line for line in lines if line is not None]

    def troubles(self) -> list[Trouble]:
        """Return the vehicles in trouble, the most urgent first."""
        return [] if self.progress is None else self._troubles.found(self.progress)

    def left_s(self) -> float | None:
        """Return the remaining wall time at the speed of the last seconds; None: unknown."""
        if self.stage is None or self.stage.end_s is None or self.progress is None:
            return None
        factor = self._steady_pace.factor
        return max(0.0, self.stage.end_s - self.progress.time_us * 1e-6) / factor if factor else None


class LineDisplay:
    """Prints a line every few seconds of wall time."""

    def __init__(self, console: Console, *, forms: bool = True) -> None:
        self._console = console
        self._flight = _Flight(forms=forms)
        self._wall_next_s = 0.0
        self._wall_compiling_s = 0.0

    def begin(self, stage: Stage) -> None:
        """Show this part of the run from now on."""
        self._flight.stage = stage

    def on_message(self, message: Message) -> None:
        """Print notable events, and periodically the state of the run."""
        for line in self._flight.update(message):
            self.note(line)
        if isinstance(message, Compiling):
            if (wall_s := time.monotonic()) >= self._wall_compiling_s:
                self._wall_compiling_s = wall_s + COMPILING_LINE_PERIOD_S
                self.note(f"compiled kernels: {compiled(message.packages)}")
            return
        if isinstance(message, Progress) and message.wall_s >= self._wall_next_s:
            self._wall_next_s = message.wall_s + LINE_PERIOD_S
            flight = self._flight
            parts = [headline(message, flight.pace.factor, flight.stage, flight.left_s())]
            parts += filter(None, [fleet(message.vehicles), _in_a_line(flight.troubles())])
            self.note(", ".join(parts))

    def note(self, line: str) -> None:
        """Print a line of any length without wrapping."""
        with _IGNORE_CLOSED_TERMINAL:
            self._console.print(Text(line), soft_wrap=True)

    def close(self) -> None:
        """Do nothing."""


class LiveDisplay:
    """A few lines that are redrawn in place, below permanent lines."""

    def __init__(self, console: Console, *, forms: bool = True) -> None:
        self._flight = _Flight(forms=forms)
        self._live = Live(Text("starting"), console=console, refresh_per_second=5, transient=True)
        self._live.start()

    def begin(self, stage: Stage) -> None:
        """Show this part of the run from now on."""
        self._flight.stage = stage

    def on_message(self, message: Message) -> None:
        """Redraw the view, and print notable events above it."""
        for line in self._flight.update(message):
            self.note(line)
        if isinstance(message, Compiling):
            self._live.update(_compile_bars(message.packages))
        elif isinstance(message, Progress | VehicleSilent) and self._flight.progress is not None:
            self._live.update(_view(self._flight, self._flight.progress))

    def note(self, line: str) -> None:
        """Print a line above the view."""
        with _IGNORE_CLOSED_TERMINAL:
            self._live.console.print(Text(line), soft_wrap=True)

    def close(self) -> None:
        """Remove the view; harmless when repeated."""
        with _IGNORE_CLOSED_TERMINAL:
            self._live.stop()


FlightDisplay = LineDisplay | LiveDisplay


def display_for(console: Console, *, forms: bool) -> FlightDisplay:
    """Return a live display on a terminal, plain lines elsewhere; ``forms``: see `Troubles`."""
    return LiveDisplay(console, forms=forms) if console.is_terminal else LineDisplay(console, forms=forms)


def headline(
    progress: Progress, factor: float | None, stage: Stage | None = None, left_s: float | None = None
) -> str:
    """Return time, stage, speed, remaining wall time and channel occupancy of a run."""
    name = "" if stage is None else f", {stage.name}"
    return f"{_time(progress, stage)}{name}, {_pace(progress, factor, stage, left_s)}"


def _time(progress: Progress, stage: Stage | None) -> str:
    if stage is None or stage.end_s is None:
        return _at(progress.time_us)
    return f"t = {progress.time_us * 1e-6:.2f} of {stage.end_s:.2f} s"


def _pace(progress: Progress, factor: float | None, stage: Stage | None, left_s: float | None) -> str:
    """Return speed, lag behind the requested speed, remaining wall time and channel occupancy."""
    parts = ["paused" if progress.paused else f"{_number(factor, '.1f')} x real time"]
    if progress.lag_s > 0.0:
        parts[0] += f" ({progress.lag_s:.1f} s behind)"
    if stage is not None and stage.end_s is not None and not progress.paused:
        parts.append(f"{duration_text(left_s)} left")
    return ", ".join([*parts, f"channel {progress.channel_busy_fraction:.1%} busy"])


def fleet(vehicles: Sequence[VehicleTruth]) -> str:
    """Return the number of vehicles in each phase, and the largest error from a place, as text."""
    alive = [vehicle for vehicle in vehicles if vehicle.alive]
    parts = [f"{count} {what}" for what, count in sorted(Counter(map(_activity, alive)).items())]
    if len(alive) < len(vehicles):
        parts.append(f"{len(vehicles) - len(alive)} lost")
    errors_m = [error for error in map(error_m, vehicles) if error is not None]
    if errors_m:
        parts.append(f"largest error {max(errors_m):.2f} m")
    parts += _ranges(alive)
    return ", ".join(parts)


def _ranges(vehicles: Sequence[VehicleTruth]) -> list[str]:
    """Return the least and the greatest of each number that the applications report, as text."""
    parts = []
    names = list(dict.fromkeys(name for vehicle in vehicles for name in vehicle.values))
    for name in names[:MOST_NUMBERS]:
        values = [vehicle.values[name] for vehicle in vehicles if name in vehicle.values]
        least, greatest = f"{min(values):.4g}", f"{max(values):.4g}"
        parts.append(f"{name} {least}" + (f" to {greatest}" if greatest != least else ""))
    return parts


def _activity(vehicle: VehicleTruth) -> str:
    """Return the phase of a vehicle, or the mode in which a ground station flies it."""
    if (not vehicle.phase or vehicle.aim == "dropped") and vehicle.mode:
        return f"in {vehicle.mode}" if vehicle.armed else vehicle.phase or "disarmed"
    return vehicle.phase or ("armed" if vehicle.armed else "starting")


def _view(flight: _Flight, progress: Progress) -> Group:
    """Return the live view: a bar with the time, the pace, the fleet, and a line per vehicle in trouble."""
    stage, troubles = flight.stage, flight.troubles()
    first = Table.grid(padding=(0, 1))
    bar: list[ProgressBar | str] = []
    if stage is not None and stage.end_s is not None:
        bar = [ProgressBar(total=stage.end_s, completed=progress.time_us * 1e-6, width=BAR_WIDTH)]
    elif stage is not None and stage.forming:
        aims = [vehicle.aim for vehicle in progress.vehicles if vehicle.alive]
        bar = [ProgressBar(total=len(aims) or 1, completed=aims.count("reached"), width=BAR_WIDTH)]
    first.add_row(*([stage.name] if stage is not None else []), *bar, _time(progress, stage))
    lines = [_pace(progress, flight.pace.factor, stage, flight.left_s()), fleet(progress.vehicles)]
    shown = [f"{uav(each.instance)}: {each.text}" for each in troubles[:MOST_TROUBLES]]
    if len(troubles) > len(shown):
        shown.append(f"and {len(troubles) - len(shown)} more in trouble")
    return Group(
        first,
        *(Text(line, no_wrap=True, overflow="ellipsis") for line in lines),
        *(Text(line, style="red", no_wrap=True, overflow="ellipsis") for line in shown),
    )


def _in_a_line(troubles: Sequence[Trouble]) -> str:
    shown = [f"{uav(each.instance)} ({each.text})" for each in troubles[:MOST_TROUBLES_IN_A_LINE]]
    if len(troubles) > len(shown):
        shown.append(f"{len(troubles) - len(shown)} more")
    return f"in trouble: {', '.join(shown)}" if shown else ""


def summary_table(summary: Mapping[str, Any]) -> Table:
    """Return a table of the main results in ``summary.json``."""
    formation, frames, ftm = summary["formation_rms_m"], summary["frames"], summary["ftm"]
    gain = summary["max_gain_dbi"]
    losses = {
        title: [
            f"{uav(vehicle['uav'])} ({vehicle[key]})" for vehicle in summary["vehicles"] if vehicle.get(key)
        ]
        for title, key in (("lost", "lost"), ("applications lost", "application_lost"))
    }
    title = f"{summary['scenario']}, seed {summary['seed']}: {summary['status']}"
    formation_rms = _numbers({kind: (formation[kind], ".3f", "m") for kind in ("absolute", "shape")})
    frame_counts = [
        f"{frames[kind]} {kind.replace('_', ' ')}" for kind in ("sent", "collided", "lost_to_noise")
    ]
    ftm_format = f" ({ftm['format']})" if ftm.get("format") else ""
    ftm_error = _numbers({kind: (ftm[f"error_{kind}_m"], ".3f", "m") for kind in ("mean", "std")})
    units = {"mean": "dBi", "ideal": "dBi", "std": "dB"}
    gains = _numbers({kind: (gain[kind], ".2f", unit) for kind, unit in units.items()})
    rows = {
        **({"reason": summary["reason"]} if summary.get("reason") else {}),
        "simulated": _number(summary["simulated_s"], ".1f", "s"),
        "wall time": _number(summary["wall_s"], ".1f", "s"),
        "real-time factor": _number(summary["real_time_factor"], ".2f"),
        "formation reached at": _number(summary["formed_s"], ".1f", "s"),
        "formation error, rms": formation_rms,
        "frames": ", ".join(frame_counts),
        "channel busy": _number(summary["channel_busy_fraction"], ".1%"),
        "FTM sessions": f"{ftm['completed']} of {ftm['requested']} completed{ftm_format}",
        "FTM error": ftm_error,
        "maximum gain": gains,
        "computed by": ": ".join(filter(None, (gain.get("backend"), gain.get("accuracy")))) or "-",
        "collisions": str(summary["collisions"]),
        **{title: "; ".join(lost) for title, lost in losses.items() if lost},
        **_packets_row(summary.get("program_packets")),
        **_telemetry_rows(summary),
        "deterministic": "yes" if summary["deterministic"] else "no",
        "log sha256": str(summary["log_sha256"])[:16],
    }
    table = Table(title=title, show_header=False)
    for name, value in rows.items():
        table.add_row(name, value)
    return table


def _packets_row(packets: Mapping[str, Any] | None) -> dict[str, str]:
    if not packets:
        return {}
    late = f"{packets['late']} more than {LATE_MS:g} ms late"
    mean_ms, largest_ms = packets["mean_late_ms"], packets["largest_late_ms"]
    received = f"{packets['received']} received"
    return {"packets of programs": f"{received}, {late}; {mean_ms:.1f} ms mean, {largest_ms:.0f} ms at most"}


def _telemetry_rows(summary: Mapping[str, Any]) -> dict[str, str]:
    """Return a row for each ground station: counts at the vehicles' ends of its links."""
    rows = {}
    for kind in ("telemetry_frames", "telemetry_serial"):
        for station, counts in summary.get(kind, {}).items():
            shown = [
                f"{count} B {name.removesuffix('_bytes')}" if name.endswith("_bytes") else f"{count} {name}"
                for name, count in counts.items()
            ]
            rows[f"telemetry, {station}"] = ", ".join(shown).replace("_", " ")
    return rows


def _at(time_us: int) -> str:
    return f"t = {time_us * 1e-6:.2f} s"


def _number(value: float | None, form: str, unit: str = "") -> str:
    return "-" if value is None else f"{value:{form}} {unit}".rstrip()


def _numbers(values: Mapping[str, tuple[float | None, str, str]]) -> str:
    """Return numbers with their names; a single dash if all are missing."""
    if all(value is None for value, _, _ in values.values()):
        return "-"
    return ", ".join(f"{_number(*value)} {name}" for name, value in values.items())
