"""ping between two vehicles: round trips against those of the channel alone."""

import re
from functools import partial
from statistics import median, quantiles

import numpy as np
from msgspec import Struct

from netsim.emulator.emulator import Emulator
from netsim.model.config import RadioConfig
from netsim.wire.addresses import mac_address
from netsim.wire.packets import SentPacket
from studies.common.report import Check, ReportTable, Section, filled
from studies.common.runner import Job, Results
from studies.programs.flight import LATENESS_COLUMN, NO_APPLICATION, Lateness, after, fly, program
from studies.programs.plan import ProgramsPlan

PERIOD_S = 0.02
SIZES_BYTES = (56, 1_400)
"""Lengths of the data in the echo requests"""
MOST_EXCESS_MS = 1.0
"""Median round trip beyond that of the channel, at speed 1"""
_ICMP_AND_IP_BYTES = 8 + 20
_IPV4 = 0x0800
_STEP_US, _QUIET_NS = 10_000, 1_000_000
"""Simulated time of a round trip, and that before its request"""
_GROUP = "ping"
_TIME = re.compile(r"time=([\d.]+) ms")


class Pings(Struct, frozen=True, kw_only=True):
    """Round trips of one length."""

    data_bytes: int
    sent: int
    median_ms: float
    upper_ms: float
    """That 95 % do not exceed"""
    channel_ms: float
    """Median of the channel alone"""
    answered: int
    lateness: Lateness


def jobs(plan: ProgramsPlan) -> dict[str, list[Job]]:
    """Return one job for each length."""
    return {_GROUP: [partial(measure, size, plan.pings) for size in SIZES_BYTES]}


def scenario(data_bytes: int, count: int) -> str:
    """Return the scenario: one vehicle pings the other."""
    text = f"""agents = 2
[formation]
shape = "line"
[radio]
fading = "none"
broadcast_rts = false
{NO_APPLICATION}"""
    command = ("ping", "-i", PERIOD_S, "-s", data_bytes, "-c", count, "10.1.0.1")
    return text + program("ping", 0, after(0.5, *command))


def measure(data_bytes: int, count: int) -> Pings:
    """Fly, and compute the round trips of the channel. Raises SwarmError."""
    text = scenario(data_bytes, count)
    until_s = 2.0 + 1.5 * PERIOD_S * count
    flown = fly(text, speed=1.0, seed=1, course=lambda swarm: swarm.run(until_s=until_s))
    times_ms = [float(each) for each in _TIME.findall(flown.logs[0, "ping"])]
    return Pings(
        data_bytes=data_bytes,
        sent=count,
        answered=len(times_ms),
        median_ms=median(times_ms),
        upper_ms=quantiles(times_ms, n=20)[-1],
        channel_ms=median(channel_round_trips_ms(flown.radio, data_bytes, 50)),
        lateness=flown.lateness,
    )


def channel_round_trips_ms(config: RadioConfig, data_bytes: int, count: int) -> list[float]:
    """Return round trips on a channel whose hosts and machine take no time, from request to reply."""
    emulator = Emulator(config=config, stations=2, seed=np.random.SeedSequence([1]))
    still = np.zeros((2, 3))
    places_ned_m = np.array(((0.0, 0.0, 0.0), (0.0, 5.0, 0.0)))
    payload = b"\x45" + bytes(data_bytes + _ICMP_AND_IP_BYTES - 1)
    times_ms = []
    for number in range(count):
        begin_us = number * _STEP_US
        end_us = begin_us + _STEP_US
        emulator.begin(to_us=end_us, at_us=begin_us, pos_ned_m=places_ned_m, vel_ned_m_s=still)
        begin_ns = at_ns = 1_000 * begin_us + _QUIET_NS
        for source, destination in ((0, 1), (1, 0)):
            packet = SentPacket(
                station=source, destination=mac_address(destination), ether_type=_IPV4, category="be",
                read_ns=0, payload=payload,
            )  # fmt: skip
            emulator.submit_packet(packet, at_ns)
            while not (received := emulator.take_packets()):
                emulator.run_until(emulator.next_event_ns)
            at_ns = received[0].end_ns
        times_ms.append((at_ns - begin_ns) * 1e-6)
        emulator.run_until(1_000 * end_us)
        emulator.end()
    return times_ms


def judge(plan: ProgramsPlan, results: Results) -> Section:
    """Compare the medians."""
    found: list[Pings] = results[_GROUP]
    return Section(
        title="Round trips of ping",
        conditions=filled(
            f"{plan.pings} echo requests every {1e3 * PERIOD_S:.0f} ms between two vehicles at speed 1, mode "
            "ofdm24, no application. The channel's own round trip is computed with the same settings: "
            "contention, frames and acknowledgements, with hosts that answer at once. What ping measures "
            "beyond it are kernel, processes and machine."
        )
        + "\n",
        checks=tuple(
            check
            for each in found
            for check in (
                Check(
                    f"{each.data_bytes} B: median beyond the channel's",
                    each.median_ms - each.channel_ms,
                    "ms",
                    at_least=0.0,
                    at_most=MOST_EXCESS_MS,
                ),
                Check(f"{each.data_bytes} B: answered", each.answered / each.sent, at_least=1.0),
            )
        ),
        tables=(
            ReportTable(
                caption="Round trips in ms.",
                columns=("data, B", "channel alone", "median", "95 %", LATENESS_COLUMN),
                rows=tuple(
                    (
                        str(each.data_bytes),
                        f"{each.channel_ms:.2f}",
                        f"{each.median_ms:.2f}",
                        f"{each.upper_ms:.2f}",
                        each.lateness.text,
                    )
                    for each in found
                ),
            ),
        ),
    )  # fmt: skip
