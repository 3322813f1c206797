"""Report of a run: converts raw logs to tables, computes results and figures, and writes the manifest.

Uses the run folder only, so a run that was interrupted is reported like any other.
"""

import errno
import hashlib
import shutil
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pyarrow.parquet as pq
from matplotlib.figure import Figure
from numpy.typing import NDArray

from antenna.analysis.gain_figures import gain_density_figure, patterns_figure
from antenna.analysis.patterns import Pattern
from foundation.records.record_log import count, read, read_blocks, read_rows
from foundation.records.whole_file import sha256_of, write_whole
from harness.launch.interrupts import interrupts_deferred
from harness.records.flight import Flight
from harness.records.freed_memory import return_freed_memory
from harness.records.manifest import make_manifest, manifest_text, read_outcome
from harness.records.outcome import RunOutcome
from harness.records.run_folder import NotARun, RunFolder, read_raw_scenario
from harness.records.tables import flight_in, read_flight, write_tables
from harness.report import antenna_report, figures
from harness.report.antenna_report import Aperture
from harness.report.flown_array import figure_patterns
from harness.report.formation_error import FormationError, formation_error
from harness.report.page.flight_plots import ErrorEnvelopes
from harness.report.page.run_page import Computed, write_page
from harness.report.program_packets import program_packets
from harness.report.telemetry import telemetry_frames, telemetry_serial
from harness.report.ulog_truth import add_truth
from harness.scenario.scenario import Scenario
from harness.simulator.messages import Formed
from harness.simulator.motion_start import flown_start_us, since_start_s
from harness.simulator.truth_record import AIR_RECORD, truth_record
from netsim.emulator.log_layout import FRAME_LOG, SESSION_LOG
from netsim.ftm.stamps import format_name

LOGS = ("events.jsonl", "flight.parquet", "radio.parquet", "ftm.parquet", "air.parquet")
"""Files that a seed determines byte for byte, in their order in ``log_sha256``."""

_IN_USE = frozenset({errno.ENOENT, errno.EBUSY, errno.ENOTEMPTY, errno.EEXIST})
"""Errors of NFS, which renames files that are in use, at their deletion and that of their folder."""


class Drawn(NamedTuple):
    """What the figures of a run show."""

    whole: Flight
    error: tuple[NDArray[np.int64], FormationError] | None
    """Times in us from when the formation was reached, and the errors then; of a long flight some"""
    antenna: Aperture
    occupancy: tuple[NDArray[np.int64], NDArray[np.float64]]
    """Times in us, and the fraction of the interval before each in which the channel was busy."""
    ftm_error_m: NDArray[np.float64]
    errors: ErrorEnvelopes | None
    """The errors of the whole time in formation, for the page"""


class _Results(NamedTuple):
    """What `finish` has computed."""

    summary: dict[str, Any]
    manifest: dict[str, Any]
    drawn: Drawn


def finish(
    folder: RunFolder, scenario: Scenario, outcome: RunOutcome, *, draw: bool = True
) -> dict[str, Any]:
    """Write tables, summary, manifest and figures of a run whose processes have ended; returns the summary.

    The raw logs are deleted once the manifest is complete, before the figures are drawn. Until then no table
    is left if an error or a signal ends it. Raises OSError if the folder cannot be written.
    """
    try:
        results = _write_tables(folder, scenario, outcome)
        with interrupts_deferred():
            folder.write_manifest(manifest_text(results.manifest))
            delete_raw(folder)
    except BaseException:
        if not folder.is_reported():
            folder.delete_tables()
        raise
    if draw:
        results.manifest["figures"], patterns = _draw(folder, scenario, results.drawn)
        folder.write_manifest(manifest_text(results.manifest))
        _write_page(folder, scenario, results.drawn, patterns, results.summary, results.manifest)
    return results.summary


def _write_tables(folder: RunFolder, scenario: Scenario, outcome: RunOutcome) -> _Results:
    """Write tables and summary."""
    plan, start_us = scenario.plan(), flown_start_us(folder.events)
    simulated_us = outcome.simulated_us or 0
    add_truth(folder, scenario)
    flight = write_tables(folder, scenario, lambda time_us: plan.places(since_start_s(time_us, start_us)))
    return_freed_memory()
    whole = flight_in(flight, scenario, start_us=start_us)
    error_m, requested = _sessions(folder)
    hashes = {name: sha256_of(folder.path / name) for name in LOGS}
    if folder.sensors.exists():
        hashes[folder.sensors.name] = sha256_of(folder.sensors)
    log_sha256 = hashlib.sha256("".join(hashes.values()).encode()).hexdigest()
    if folder.receptions.exists():
        hashes[folder.receptions.name] = sha256_of(folder.receptions)
    window = _window(whole, outcome.formed_us, scenario)
    errors = _errors(whole, window, folder)
    antenna = _antenna(window, scenario)
    antenna_report.write(folder, antenna, scenario)
    return_freed_memory()
    summary = {
        "scenario": scenario.name,
        "seed": scenario.run.seed,
        "status": outcome.status,
        "reason": outcome.reason,
        "agents": scenario.agents,
        "simulated_s": simulated_us / 1e6,
        "wall_s": None if outcome.wall_s is None else round(outcome.wall_s, 3),
        "real_time_factor": round(simulated_us / 1e6 / outcome.wall_s, 3) if outcome.wall_s else None,
        "formed_s": None if outcome.formed_us is None else outcome.formed_us / 1e6,
        "moves_s": None if start_us is None else start_us / 1e6,
        "formation_s": float(window.time_us[-1] - window.time_us[0]) / 1e6 if len(window) else 0.0,
        "formation_rms_m": errors.rms_m,
        "vehicles": errors.vehicles,
        **_radio(folder, scenario, error_m, requested),
        "max_gain_dbi": antenna_report.numbers(antenna),
        "collisions": sum(b'"event":"collision"' in line for line in folder.events.read_bytes().splitlines()),
        "deterministic": not outcome.nondeterminism,
        "log_sha256": log_sha256,
    }
    packets = program_packets(outcome.processes)
    if packets is not None:
        summary["program_packets"] = packets
    if frames := telemetry_frames(outcome.processes):
        summary["telemetry_frames"] = frames
    if serial := telemetry_serial(outcome.processes):
        summary["telemetry_serial"] = serial
    if outcome.profile:
        summary["profile"] = msgspec.to_builtins(outcome.profile)
    _write_json(folder.summary, summary)
    air = read(folder.raw_air, AIR_RECORD)
    occupancy = _occupancy(air["time_us"], air["busy_ns"])
    drawn = Drawn(whole, errors.drawn, antenna, occupancy, error_m, errors.envelopes)
    solver = None if antenna.solver is None else asdict(antenna.solver)
    manifest = make_manifest(scenario, outcome, hashes=hashes, antenna=solver)
    return _Results(summary, manifest, drawn)


def finish_later(folder: RunFolder) -> dict[str, Any]:
    """Write tables, summary, figures and manifest of a run whose launcher did not; returns the summary.

    If its launcher was killed, the flight ends with its raw logs. Raises NotARun, also for a run in flight,
    and OSError.
    """
    with folder.held():
        outcome = read_outcome(folder)
        if not folder.events.exists():
            raise NotARun(f"{folder.path}: its flight has not begun: {outcome.reason}")
        scenario = read_raw_scenario(folder)
        if outcome.simulated_us is None:
            formed_us = _formed_us(folder)
            layout = truth_record(scenario.most_rotors)
            last = read_rows(folder.raw_truth, layout, max(0, count(folder.raw_truth, layout) - 1), 1)
            times_us = (*last["time_us"].tolist(), formed_us or 0)  # events are written earlier
            outcome = msgspec.structs.replace(outcome, simulated_us=max(times_us), formed_us=formed_us)
        return finish(folder, scenario, outcome)


def delete_raw(folder: RunFolder) -> None:
    """Delete the raw logs of a run that has tables; NFS keeps those that are in use under other names.

    Raises OSError.
    """

    def leave_used(_function: object, _path: str, raised: tuple[Any, BaseException, Any]) -> None:
        error = raised[1]
        if not isinstance(error, OSError) or error.errno not in _IN_USE:
            raise error

    shutil.rmtree(folder.raw, onerror=leave_used)


def _formed_us(folder: RunFolder) -> int | None:
    """Return when the formation was reached, from the run's events."""
    for line in _whole_lines(folder.events):
        if b'"event":"formed"' in line:
            return msgspec.json.decode(line, type=Formed).time_us
    return None


def _whole_lines(events: Path) -> list[bytes]:
    """Return the events, without a last line that was cut off."""
    return events.read_bytes().split(b"\n")[:-1]


def draw_again(folder: RunFolder, scenario: Scenario, *, formed_us: int | None) -> list[str]:
    """Draw the figures of a run that was reported, from its tables; returns their names.

    The manifest lists them. Patterns are computed again. Raises OSError, and KeyError or ValueError for
    tables of another scenario.
    """
    whole = read_flight(folder, scenario)
    window = _window(whole, formed_us, scenario)
    errors = _errors(whole, window, folder)
    air, sessions = pq.read_table(folder.air), pq.read_table(folder.ftm)
    completed = np.array(sessions["status"].to_pylist(), dtype=np.str_) == "ok"
    error_m = (sessions["distance_m"].to_numpy() - sessions["true_distance_m"].to_numpy())[completed]
    occupancy = _occupancy(air["time_us"].to_numpy(), air["busy_ns"].to_numpy())
    antenna = _antenna(window, scenario)
    drawn = Drawn(whole, errors.drawn, antenna, occupancy, error_m, errors.envelopes)
    folder.figures.mkdir(exist_ok=True)
    written, patterns = _draw(folder, scenario, drawn)
    manifest = msgspec.json.decode(folder.manifest.read_bytes()) | {"figures": written}
    folder.write_manifest(manifest_text(manifest))
    summary = msgspec.json.decode(folder.summary.read_bytes(), type=dict[str, Any])
    _write_page(folder, scenario, drawn, patterns, summary, manifest)
    return written


def _window(whole: Flight, formed_us: int | None, scenario: Scenario) -> Flight:
    """Return the part of the flight after the formation was reached; nothing of a hold.

    In a hold the formation is reached when the released vehicles are on station. A ground station may fly the
    others, and these too at any time.
    """
    begin_us = np.iinfo(np.int64).max if formed_us is None or scenario.onboard.hold else formed_us
    return whole.at(slice(int(np.searchsorted(whole.time_us, begin_us)), None))


class _Errors(NamedTuple):
    """What is kept of the errors of all instants in formation, which are large."""

    rms_m: dict[str, float | None]
    vehicles: list[dict[str, Any]]
    drawn: tuple[NDArray[np.int64], FormationError] | None
    envelopes: ErrorEnvelopes | None


def _errors(whole: Flight, window: Flight, folder: RunFolder) -> _Errors:
    error = _formation_error(window, folder)
    return _Errors(
        rms_m=_formation(error),
        vehicles=_vehicles(whole, error, folder),
        drawn=_drawn_error(window, error),
        envelopes=None if error is None else ErrorEnvelopes(window.time_us, error),
    )


def _formation_error(window: Flight, folder: RunFolder) -> FormationError | None:
    """Return the error of the formation; None if it was not reached, or the application flies elsewhere."""
    applications = folder.applications()
    flies_elsewhere = applications.phases and not applications.placed
    return None if flies_elsewhere or not len(window) else formation_error(window)


def _drawn_error(
    window: Flight, error: FormationError | None
) -> tuple[NDArray[np.int64], FormationError] | None:
    if error is None:
        return None
    rows = figures.drawn_instants(len(window))
    return window.time_us[rows], error.at(rows)


def _antenna(window: Flight, scenario: Scenario) -> Aperture:
    """Return the results of the antenna in formation; only a note for a hold."""
    if scenario.onboard.hold:
        return Aperture(note="a hold has no formation")
    return antenna_report.measure(window, scenario)


def _formation(error: FormationError | None) -> dict[str, float | None]:
    if error is None:
        return dict.fromkeys(("absolute", "shape", "absolute_horizontal", "shape_horizontal"))
    return {
        "absolute": _round(error.absolute.rms_m),
        "shape": _round(error.shape.rms_m),
        "absolute_horizontal": _round(error.absolute.horizontal_rms_m),
        "shape_horizontal": _round(error.shape.horizontal_rms_m),
    }


def _losses(folder: RunFolder, kind: str) -> dict[int, str]:
    """Return reason and time of the events of a kind, by vehicle."""
    events = map(msgspec.json.decode, _whole_lines(folder.events))
    return {
        event["instance"]: f"{event['reason']}, t = {event['time_us'] * 1e-6:.2f} s"
        for event in events
        if event["event"] == kind
    }


def _vehicles(whole: Flight, error: FormationError | None, folder: RunFolder) -> list[dict[str, Any]]:
    losses, applications_lost = (_losses(folder, kind) for kind in ("vehiclelost", "applicationlost"))
    vehicles = whole.alive.shape[1]
    absolute = error.absolute.vehicle_rms_m if error else (None,) * vehicles
    shape = error.shape.vehicle_rms_m if error else (None,) * vehicles
    return [
        {
            "uav": i,
            "alive": bool(whole.alive[-1, i]) if len(whole) else True,
            "lost": losses.get(i),
            "application_lost": applications_lost.get(i),
            "absolute_rms_m": _round(absolute[i]),
            "shape_rms_m": _round(shape[i]),
        }
        for i in range(vehicles)
    ]


def _radio(
    folder: RunFolder, scenario: Scenario, error_m: NDArray[np.float64], requested: int
) -> dict[str, Any]:
    receivers = dict.fromkeys(("delivered", "collided", "lost_to_noise"), 0)
    for frames in read_blocks(folder.raw_frames, FRAME_LOG):
        for name in receivers:
            receivers[name] += int(frames[name].sum())
    air = read(folder.raw_air, AIR_RECORD)
    busy = float(air["busy_ns"][-1] / (air["time_us"][-1] * 1e3)) if len(air) else 0.0
    return {
        "frames": {"sent": count(folder.raw_frames, FRAME_LOG), **receivers},
        "channel_busy_fraction": round(busy, 5),
        "ftm": {
            "format": format_name(scenario.radio.ftm, scenario.radio.bandwidth_mhz),
            "requested": requested,
            "completed": len(error_m),
            "failed": requested - len(error_m),
            "error_mean_m": _round(float(error_m.mean()) if len(error_m) else None),
            "error_std_m": _round(float(error_m.std(ddof=1)) if len(error_m) > 1 else None),
        },
    }


def _sessions(folder: RunFolder) -> tuple[NDArray[np.float64], int]:
    """Return measured minus true distance of every completed session, and the number of all sessions."""
    differences_m = [np.empty(0)]
    for sessions in read_blocks(folder.raw_sessions, SESSION_LOG):
        completed = sessions[sessions["status"] == b"ok"]
        differences_m.append(completed["distance_m"] - completed["true_distance_m"])
    return np.concatenate(differences_m), count(folder.raw_sessions, SESSION_LOG)


def _round(value: float | None) -> float | None:
    return None if value is None else round(value, 4)


def _write_json(path: Path, content: dict[str, Any]) -> None:
    write_whole(path, msgspec.json.format(msgspec.json.encode(content), indent=2) + b"\n")


def _draw(
    folder: RunFolder, scenario: Scenario, drawn: Drawn
) -> tuple[list[str], tuple[Pattern, Pattern] | None]:
    """Write every figure for which the run has data, one after the other.

    Returns the names of the files, and the ideal and the median pattern if they are drawn.
    """
    whole, error, antenna, (time_us, busy_fraction), error_m, _ = drawn
    patterns: tuple[Pattern, Pattern] | None = None
    makers: dict[str, Callable[[], Figure]] = {}
    if len(whole):
        makers["tracks"] = lambda: figures.tracks_figure(whole, scenario.wind)
    if error is not None:
        makers["formation_error"] = lambda: figures.formation_error_figure(*error)
    gains, ideal = antenna.series, antenna.ideal
    if gains is not None and ideal is not None and len(gains.patterns):
        places_ned_m, heading_rad = scenario.places_ned_m(), antenna_report.heading_rad(scenario)
        perfect, flown = patterns = figure_patterns(gains, places_ned_m, heading_rad, scenario.antenna)
        max_gain_dbi, ideal_dbi = gains.max_gain_dbi, ideal.max_gain_dbi
        makers["gain_density"] = lambda: gain_density_figure({"flown": max_gain_dbi}, ideal_dbi)
        makers["patterns"] = lambda: patterns_figure({"Ideal": perfect, "Flown": flown})
    if len(time_us):
        makers["channel"] = lambda: figures.channel_figure(time_us, busy_fraction)
    if len(error_m):
        makers["ftm_error"] = lambda: figures.ftm_error_figure(error_m)
    title, written = f"{scenario.name}, seed {scenario.run.seed}", list[str]()
    for name, make in makers.items():
        written += figures.save(make(), folder.figures / name, title)
        whole.release()
        return_freed_memory()
    return sorted(written), patterns


def _write_page(
    folder: RunFolder, scenario: Scenario, drawn: Drawn, patterns: tuple[Pattern, Pattern] | None,
    summary: dict[str, Any], manifest: dict[str, Any],
) -> None:  # fmt: skip
    """Write ``report.html``. Raises OSError."""
    computed = Computed(
        errors=drawn.errors, antenna=drawn.antenna, patterns=patterns, occupancy=drawn.occupancy
    )
    write_page(folder, scenario, computed, summary=summary, manifest=manifest)


def _occupancy(
    time_us: NDArray[np.int64], busy_ns: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return ends and busy fractions of intervals of 1 s (of the run, if it is shorter than two)."""
    if len(time_us) < 2:
        return np.empty(0, dtype=np.int64), np.empty(0)
    rows = np.unique(np.searchsorted(time_us, np.arange(time_us[0], time_us[-1] + 1, 1_000_000)))
    if len(rows) < 2:
        rows = np.array([0, len(time_us) - 1])
    return time_us[rows][1:], np.diff(busy_ns[rows]) / (np.diff(time_us[rows]) * 1e3)
