"""babeld on a line of five vehicles: convergence, four hops, a lost vehicle, a line that closes up."""

import re
import sys
import tempfile
import time
from functools import partial
from math import sqrt
from pathlib import Path
from statistics import median

from msgspec import Struct

from harness.launch.swarm import Swarm
from studies.common.report import Check, ReportTable, Section, filled
from studies.common.runner import Job, Results
from studies.programs import route_watch
from studies.programs.flight import LATENESS_COLUMN, Flown, Lateness, after, fly, program
from studies.programs.plan import ProgramsPlan
from studies.programs.route_history import all_connected, all_direct, first_s, none_between

UAVS = range(5)
MIDDLE = 2
PINGS, PING_AFTER_S = 20, 14.0
KILL_S, END_S = 20.0, 45.0
"""Simulated time at which the middle vehicle is killed, and end of the flight"""
CLOSE_S, CLOSED_END_S = 20.0, 85.0
SPACING_M, CLOSE_SPACING_M = 300.0, 30.0
WEAK_FRACTION = 0.039
"""Fraction of the time for which a link is too weak: Rician fading, K of 12 dB, with a margin of 3.3 dB"""
ANSWERED_FRACTION = (1.0 - WEAK_FRACTION) ** 8
"""Expected fraction of answered pings, over four hops and back"""
MOST_CONVERGENCE_S, MOST_WITHDRAWAL_S, MOST_SHORTENING_S = 12.0, 12.0, 55.0
BABELD = (
    "babeld", "-d", "1", "-h", "1", "-H", "1", "-I", "babel-{uav}.pid", "-S", "babel-{uav}.state",
    "-C", "redistribute local if wlan0", "-C", "redistribute local deny", "wlan0",
)  # fmt: skip
_RADIO = """
[radio]
bandwidth_mhz = 20
path_loss_exponent = 2.5
control_mode = "ofdm6"
broadcast_mode = "ofdm6"
broadcast_rts = false
data_mode = "ofdm12"
"""
_LINES, _CLOSING = "lines", "closing"
_ANSWERED = re.compile(r"(\d+) packets transmitted, (\d+) received")


class Line(Struct, frozen=True, kw_only=True):
    """Wall times of one flight of the line, None: it did not happen."""

    seed: int
    converged_s: float | None
    """From the start of the programs until all have routes to all"""
    answered: int
    """Echo requests over four hops"""
    withdrawn_s: float | None
    """From the end of the middle vehicle until no vehicle has a route across the gap"""
    lateness: Lateness


class Closing(Struct, frozen=True, kw_only=True):
    """Wall times of one flight of the line that closes up."""

    seed: int
    converged_s: float | None
    shortened_s: float | None
    """From the beginning of the manoeuvre until all paths have one hop"""
    in_range_s: float | None
    """Likewise, from when the ends are as near to each other as neighbours were"""
    lateness: Lateness


def jobs(plan: ProgramsPlan) -> dict[str, list[Job]]:
    """Return one job for each flight."""
    seeds = range(1, plan.seeds + 1)
    return {
        _LINES: [partial(fly_line, seed) for seed in seeds],
        _CLOSING: [partial(fly_closing, seed) for seed in seeds],
    }


def routed(scenario: str, *, folder: str) -> str:
    """Return a scenario with babeld, whose files are in a folder, and a watch of routes on all vehicles."""
    babeld = [word.replace("babel-", f"{folder}/babel-") for word in BABELD]
    watch = (sys.executable, "-I", "-S", str(Path(route_watch.__file__)))
    return scenario + program("babeld", "all", babeld) + program("routes", "all", watch)


def line_scenario(*, folder: str, ping_after_s: float = PING_AFTER_S, pings: int = PINGS) -> str:
    """Return the scenario of a line whose vehicles reach their neighbours only; the first pings the last."""
    text = f"""agents = {len(UAVS)}
[formation]
shape = "line"
spacing_m = {SPACING_M}
[onboard]
localisation = "gps"
hold = true
{_RADIO}tx_power_dbm = 30.0
"""
    last = UAVS[-1]
    ping = ("ping", "-c", pings, "-i", 0.2, f"10.1.0.{last}")
    return routed(text, folder=folder) + program("ping", UAVS[0], after(ping_after_s, *ping))


def closing_scenario(*, folder: str) -> str:
    """Return the scenario of a line with the same link budgets over a tenth of the distance."""
    text = f"""agents = {len(UAVS)}
[formation]
shape = "line"
spacing_m = {CLOSE_SPACING_M}
[onboard]
application = "studies.programs.closing_line:ClosingLine"
settings = {{ close_at_s = {CLOSE_S} }}
[sensors]
profile = "ideal"
{_RADIO}tx_power_dbm = 5.0
"""
    return routed(text, folder=folder)


def fly_line(seed: int) -> Line:
    """Fly the line, and kill its middle vehicle. Raises SwarmError."""
    marks: list[float] = []

    def course(swarm: Swarm) -> None:
        marks.append(time.monotonic())
        swarm.run(until_s=KILL_S)
        swarm.kill(MIDDLE)
        marks.append(time.monotonic())
        swarm.run(until_s=END_S)

    with tempfile.TemporaryDirectory(prefix="coflight-") as folder:
        flown = fly(line_scenario(folder=folder), speed=1.0, seed=seed, course=course)
    began_s, killed_s = marks
    logs = route_logs(flown)
    found = _ANSWERED.search(flown.logs[UAVS[0], "ping"])
    return Line(
        seed=seed,
        converged_s=_since(began_s, first_s(logs, all_connected(UAVS), from_s=began_s)),
        answered=0 if found is None else int(found[2]),
        withdrawn_s=_since(
            killed_s,
            first_s(logs, none_between(UAVS[:MIDDLE], UAVS[MIDDLE + 1 :]), from_s=killed_s),
        ),
        lateness=flown.lateness,
    )


def fly_closing(seed: int) -> Closing:
    """Fly the line that closes up. Raises SwarmError."""
    marks: list[float] = []

    def course(swarm: Swarm) -> None:
        marks.append(time.monotonic())
        swarm.run(until_s=CLOSE_S)
        marks.append(time.monotonic())
        swarm.run_until(
            lambda truth: (
                abs(truth.vehicles[0].pos_ned_m[1] - truth.vehicles[-1].pos_ned_m[1]) <= CLOSE_SPACING_M
            ),
            timeout_s=CLOSED_END_S - CLOSE_S,
            every_s=0.2,
        )
        marks.append(time.monotonic())
        swarm.run(until_s=CLOSED_END_S)

    with tempfile.TemporaryDirectory(prefix="coflight-") as folder:
        flown = fly(closing_scenario(folder=folder), speed=1.0, seed=seed, course=course)
    began_s, closing_s, near_s = marks
    logs = route_logs(flown)
    direct_s = first_s(logs, all_direct(UAVS), from_s=closing_s)
    return Closing(
        seed=seed,
        converged_s=_since(began_s, first_s(logs, all_connected(UAVS), from_s=began_s)),
        shortened_s=_since(closing_s, direct_s),
        in_range_s=_since(near_s, direct_s),
        lateness=flown.lateness,
    )


def route_logs(flown: Flown) -> dict[int, str]:
    """Return the output of the watches by vehicle."""
    return {uav: flown.logs[uav, "routes"] for uav in UAVS}


def _since(begin_s: float, wall_s: float | None) -> float | None:
    return None if wall_s is None else wall_s - begin_s


def _largest(values: list[float | None]) -> float:
    """Return the largest of some times; infinite if one is missing."""
    return max((float("inf") if each is None else each for each in values), default=0.0)


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


def judge(_plan: ProgramsPlan, results: Results) -> Section:
    """Judge the times, of which all flights have to have each."""
    lines: list[Line] = results[_LINES]
    closings: list[Closing] = results[_CLOSING]
    converged = [each.converged_s for each in lines] + [each.converged_s for each in closings]
    withdrawn = [each.withdrawn_s for each in lines]
    shortened = [each.in_range_s for each in closings]
    typical = median(each for each in converged if each is not None)
    answered_std = sqrt(PINGS * ANSWERED_FRACTION * (1.0 - ANSWERED_FRACTION))
    return Section(
        title="Routes of babeld",
        conditions=filled(
            f"{len(UAVS)} vehicles in a line, {SPACING_M:.0f} m apart, of which each receives its neighbours "
            "only, each with `babeld -h 1 -H 1 wlan0`, at speed 1. With a margin of 3.3 dB and Rician fading "
            f"(K of 12 dB) a link is too weak for {100 * WEAK_FRACTION:.1f} % of the time, each time for "
            f"longer than all retries take: {100 * ANSWERED_FRACTION:.0f} % of the pings over four hops and "
            "back are expected to be answered, and the required number is three standard deviations fewer. "
            f"The middle vehicle is killed at {KILL_S:.0f} s. In other flights the line is "
            f"{CLOSE_SPACING_M:.0f} m "
            f"apart with 25 dB less power, and closes up to 4.5 m from {CLOSE_S:.0f} s on. babeld smooths "
            "the metric of a route with a half-life of 4 s from infinity (65,535) on, so a direct path of "
            "metric 96 replaces one of two hops 38 s after its first announcement. A program on each vehicle "
            "reads the kernel's routes "
            f"every {1e3 * route_watch.PERIOD_S:.0f} ms; times are of the wall clock, in which "
            f"babeld lives. Median convergence {typical:.1f} s."
        )
        + "\n",
        checks=(
            Check("slowest convergence", _largest(converged), "s", at_most=MOST_CONVERGENCE_S),
            Check(
                f"least answers of {PINGS} over four hops", min(each.answered for each in lines),
                at_least=PINGS * ANSWERED_FRACTION - 3.0 * answered_std,
            ),
            Check("slowest withdrawal", _largest(withdrawn), "s", at_most=MOST_WITHDRAWAL_S),
            Check("slowest shortening, from in range", _largest(shortened), "s", at_most=MOST_SHORTENING_S),
        ),
        tables=(
            ReportTable(
                caption="Line: wall times from the start, and from the end of the middle vehicle.",
                columns=("seed", "all routes, s", "answers", "withdrawn, s", LATENESS_COLUMN),
                rows=tuple(
                    (
                        str(each.seed), _text(each.converged_s), f"{each.answered} of {PINGS}",
                        _text(each.withdrawn_s), each.lateness.text,
                    )
                    for each in lines
                ),
            ),
            ReportTable(
                caption=(
                    "Line that closes up: wall times from the start, from the beginning of the manoeuvre, "
                    "and from when its ends are as near as neighbours were."
                ),
                columns=(
                    "seed", "all routes, s", "one hop, from the manoeuvre, s", "one hop, from in range, s",
                    LATENESS_COLUMN,
                ),
                rows=tuple(
                    (
                        str(each.seed), _text(each.converged_s), _text(each.shortened_s),
                        _text(each.in_range_s), each.lateness.text,
                    )
                    for each in closings
                ),
            ),
        ),
    )  # fmt: skip
