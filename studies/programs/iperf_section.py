"""iperf3 with full queues: what its servers report, what the frame log has, and what the lab computes."""

import time
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from msgspec import Struct

from harness.launch.swarm import Swarm
from netsim.lab.saturation import UNLIMITED, saturate
from netsim.model.config import Mode
from studies.common.report import Check, ReportTable, Section, filled
from studies.common.runner import Job, Results
from studies.programs.flight import (
    LATENESS_COLUMN,
    NO_APPLICATION,
    UDP_AND_IP_BYTES,
    Lateness,
    data_frames,
    fly,
    iperf_report,
    program,
    until_success,
)
from studies.programs.plan import ProgramsPlan

MODE: Mode = "ofdm24"
PAYLOAD_BYTES = 1_000
TOLERANCE = 0.03
OFFERED = 1.3
"""Offered over expected goodput of a sender: the surplus waits in the kernel."""
EDGE_WALL_S = 4.0
"""Wall time at both ends that is left out: connections are made, then queues fill."""
LAB_S = 20.0
_FIRST_PORT = 5_201
_GROUP = "saturated"


class Saturated(Struct, frozen=True, kw_only=True):
    """Results of one number of senders; rates are of UDP payload in simulated time."""

    senders: int
    reported_mbps: float
    """By the iperf3 servers"""
    logged_mbps: float
    """Of the frame log"""
    lab_mbps: float
    reported_datagrams: int
    """That the servers have counted in the whole flight"""
    logged_datagrams: int
    """That the frame log has as delivered"""
    lateness: Lateness


def jobs(plan: ProgramsPlan) -> dict[str, list[Job]]:
    """Return one job for each number of senders."""
    return {
        _GROUP: [
            partial(measure, senders, plan.saturated_wall_s, plan.saturated_speed)
            for senders in plan.saturated
        ]
    }


def scenario(senders: int, wall_s: float, speed: float, offered_mbps: float) -> str:
    """Return the scenario: ``senders`` vehicles send to one more, the sink, with the radio of the lab.

    ``offered_mbps`` is each sender's rate in simulated time.
    """
    text = f"""agents = {senders + 1}
[formation]
shape = "ring"
[radio]
bandwidth_mhz = 20
frequency_mhz = 5180.0
path_loss = "studies.programs.radio_models:equal_loss"
fading = "none"
access = "dcf"
control_mode = "ofdm6"
data_mode = "{MODE}"
broadcast_mode = "ofdm6"
broadcast_rts = false
retry_limit = {UNLIMITED}
queue_lifetime_us = 60_000_000
host_latency_us = 0
host_jitter_us = 0
{NO_APPLICATION}"""
    for sender in range(senders):
        port = str(_FIRST_PORT + sender)
        server = ("iperf3", "--server", "--one-off", "--json", "--port", port)
        rate_bps = round(offered_mbps * speed * 1e6)
        client = (
            "iperf3", "--client", f"10.1.0.{senders}", "--port", port, "--udp", "--length", PAYLOAD_BYTES,
            "--bitrate", rate_bps, "--time", round(wall_s), "--json",
        )  # fmt: skip
        text += program(f"server{sender}", senders, server)
        text += program(f"client{sender}", sender, until_success(*client))
    return text


def measure(senders: int, wall_s: float, speed: float) -> Saturated:
    """Fly, and simulate the same channel in the lab. Raises SwarmError."""
    lab = saturate(stations=senders, rts=False, mode=MODE, payload_bytes=PAYLOAD_BYTES, seconds=LAB_S, seed=1)
    text = scenario(senders, wall_s, speed, OFFERED * lab.throughput_mbps / senders)
    marks: list[tuple[float, float]] = []

    def course(swarm: Swarm) -> None:
        while not marks or marks[-1][1] < (wall_s + 3.0) * speed:
            swarm.run_for(speed)
            wall_unix_s = time.time()  # noqa: TID251  as iperf3's own times
            marks.append((wall_unix_s, swarm.truth.t_s))

    flown = fly(text, speed=speed, seed=1, course=course)
    servers = [iperf_report(flown.logs[senders, f"server{sender}"]) for sender in range(senders)]
    delivered = data_frames(flown.frames, PAYLOAD_BYTES + UDP_AND_IP_BYTES, to=senders)
    delivered &= flown.frames["delivered"] > 0
    return Saturated(
        senders=senders,
        reported_mbps=1e-6 * reported_bps(servers, marks, EDGE_WALL_S),
        logged_mbps=8e-6
        * PAYLOAD_BYTES
        * rate_hz(flown.frames["start_ns"][delivered] * 1e-9, EDGE_WALL_S * speed),
        lab_mbps=lab.throughput_mbps,
        reported_datagrams=sum(each["sum"]["bytes"] for one in servers for each in one["intervals"])
        // PAYLOAD_BYTES,
        logged_datagrams=int(np.count_nonzero(delivered)),
        lateness=flown.lateness,
    )


def reported_bps(servers: list[dict[str, Any]], marks: Sequence[tuple[float, float]], edge_s: float) -> float:
    """Return the sum of the servers' rates while all of them receive, in simulated time.

    ``servers`` are reports of iperf3; ``marks`` are UNIX times and the simulated times that were reached
    then. ``edge_s`` of wall time is left out after the last server has begun, and before the first one ends.
    """
    spans = []
    for server in servers:
        begin_s = server["start"]["timestamp"]["timesecs"]
        sums = [each["sum"] for each in server["intervals"]]
        spans.append([(begin_s + each["start"], begin_s + each["end"], each["bytes"]) for each in sums])
    first_s = max(intervals[0][0] for intervals in spans) + edge_s
    last_s = min(intervals[-1][1] for intervals in spans) - edge_s
    walls_s, reached_s = zip(*marks, strict=True)
    total_bps = 0.0
    for intervals in spans:
        inside = [each for each in intervals if each[0] >= first_s and each[1] <= last_s]
        begin_s, end_s = np.interp((inside[0][0], inside[-1][1]), walls_s, reached_s)
        total_bps += 8 * sum(each[2] for each in inside) / float(end_s - begin_s)
    return total_bps


def rate_hz(times_s: np.ndarray[Any, np.dtype[np.float64]], edge_s: float) -> float:
    """Return the rate of events without the time ``edge_s`` at both ends."""
    first_s, last_s = times_s.min() + edge_s, times_s.max() - edge_s
    return float(np.count_nonzero((times_s >= first_s) & (times_s < last_s)) / (last_s - first_s))


def judge(plan: ProgramsPlan, results: Results) -> Section:
    """Compare reports, frame log and lab."""
    found: list[Saturated] = results[_GROUP]
    checks = []
    for each in found:
        name = f"{each.senders} senders: "
        checks += [
            Check.near(f"{name}iperf3 to lab", each.reported_mbps, each.lab_mbps, TOLERANCE, "Mbit/s"),
            Check.near(
                f"{name}iperf3 to frame log", each.reported_mbps, each.logged_mbps, TOLERANCE, "Mbit/s"
            ),
            Check(
                f"{name}datagrams of iperf3 minus delivered frames",
                each.reported_datagrams - each.logged_datagrams,
                at_least=-64.0 * each.senders,
                at_most=0.0,
            ),
        ]  # fmt: skip
    return Section(
        title="iperf3 at saturation",
        conditions=filled(
            f"Vehicles send UDP datagrams of {PAYLOAD_BYTES} B to one more vehicle by `iperf3 --udp`, each "
            f"{OFFERED:g} times its share of the channel for {plan.saturated_wall_s:g} s, at `--speed "
            f"{plan.saturated_speed:g}`: the rates of iperf3 are divided by the simulated time that passed "
            f"per second. Mode {MODE}, DCF, equal received powers, no retry limit, no application. The lab "
            f"is `coflight radio saturation` with the same settings: a core without processes, time and "
            f"sockets. The first and last {EDGE_WALL_S:g} s of wall time are left out. Datagrams that are on "
            "the way when the programs end are in the frame log alone."
        )
        + "\n",
        checks=tuple(checks),
        tables=(
            ReportTable(
                caption="Goodput in Mbit/s of UDP payload, and datagrams of the whole flight.",
                columns=(
                    "senders", "iperf3", "frame log", "lab", "datagrams, iperf3", "datagrams, frame log",
                    LATENESS_COLUMN,
                ),
                rows=tuple(
                    (
                        str(each.senders),
                        f"{each.reported_mbps:.3f}",
                        f"{each.logged_mbps:.3f}",
                        f"{each.lab_mbps:.3f}",
                        f"{each.reported_datagrams}",
                        f"{each.logged_datagrams}",
                        each.lateness.text,
                    )
                    for each in found
                ),
            ),
        ),
    )  # fmt: skip
