"""Runs of the reference programs: their arguments and the columns that they print."""

from collections.abc import Iterator
from itertools import product

from msgspec import Struct

RUNS = range(1, 6)
"""Values of ns-3's ``RngRun``."""
FEW_RUNS = range(1, 3)
"""For one sender without losses, whose only randomness is the backoff: runs differ by less than 1 %."""
TIMED_RUNS = range(1, 4)
LONGEST_PPDU_US = 5_484.0
"""aPPDUMaxTime of HT, VHT and HE PPDUs (IEEE 802.11-2020, tables 19-25 and 21-28)."""
_MCS = (0, 4, 9)

Arguments = dict[str, str | int | float]


class Table(Struct, frozen=True, kw_only=True):
    """A table of `studies.reference`, one run of a program a row."""

    name: str
    """File name without extension."""
    program: str
    columns: tuple[str, ...]
    """What the program prints, in order."""
    runs: tuple[Arguments, ...]
    """Options of each run without ``--``."""
    alone: bool = False
    """Whether the runs measure processor time, so that only one may run at a time."""


def tables() -> tuple[Table, ...]:
    """Return all tables."""
    return (
        Table(
            name="ns3_mixed",
            program="mixed",
            columns=(
                "layout", "senders", "radius_m", "mode", "short_bytes", "long_bytes", "undetected_dbm", "run",
                "seconds", "short_mbps", "long_mbps", "short_unacknowledged", "long_unacknowledged",
                "short_dropped", "long_dropped",
            ),
            runs=tuple(_mixed()),
        ),
        Table(
            name="ns3_range",
            program="range",
            columns=(
                "standard", "mode", "rts", "slot_us", "distance_m", "run", "datagrams", "transmissions",
                "received", "acknowledged", "timed_out",
            ),
            runs=tuple(_range()),
        ),
        Table(
            name="ns3_ampdu",
            program="ampdu",
            columns=(
                "standard", "width_mhz", "streams", "mcs", "senders", "payload_bytes", "ampdu_bytes",
                "amsdu_bytes", "loss", "hidden", "rts", "run", "seconds", "throughput_mbps", "ppdus_per_s",
                "mpdus_per_ppdu", "ppdu_us", "block_acks_per_s", "block_ack_requests_per_s", "rts_per_s",
                "dropped_per_s",
            ),
            runs=tuple(_ampdu()),
        ),
        Table(
            name="ns3_he_airtime",
            program="he",
            columns=(
                "width_mhz", "streams", "mcs", "guard_interval_ns", "payload_bytes", "mpdus", "psdu_bytes",
                "preamble_us", "ppdu_us",
            ),
            runs=tuple(_he_airtimes()),
        ),
        Table(
            name="ns3_he",
            program="he",
            columns=(
                "width_mhz", "streams", "mcs", "guard_interval_ns", "payload_bytes", "ampdu_bytes",
                "block_ack_frames", "run", "seconds", "throughput_mbps", "ppdus_per_s", "mpdus_per_ppdu",
                "ppdu_us",
            ),
            runs=tuple(_he()),
        ),
        Table(
            name="ns3_lean",
            program="lean",
            columns=(
                "traffic", "stations", "mode", "payload_bytes", "period_s", "sessions_per_s", "run",
                "seconds", "cpu_s", "wall_s", "ppdus_per_s", "received_mbps", "sessions_completed_per_s",
                "events_per_s",
            ),
            runs=tuple(_lean()),
            alone=True,
        ),
    )  # fmt: skip


def _mixed() -> Iterator[Arguments]:
    for layout, senders, run in product(("centre", "ring"), (9, 10), RUNS):
        yield {"layout": layout, "senders": senders, "radius": 50, "seconds": 30, "RngRun": run}
    for run in RUNS:
        yield {
            "layout": "centre",
            "senders": 10,
            "radius": 50,
            "undetected": -62,
            "seconds": 30,
            "RngRun": run,
        }


def _range() -> Iterator[Arguments]:
    """Half of the slot, 9 us and 3 us more for each coverage class, is the longest delay: 1349.1 m a 9 us."""
    near_m = (100, 1000, 1300, 1340, 1348, 1349, 1350, 1360, 1400, 2000, 4800)
    slots_m = {9: near_m, 12: (1340, 1360, 1790, 1798, 1799, 1810), 15: (1810, 2240, 2248, 2249, 2260)}
    for slot_us, distances_m in slots_m.items():
        for distance_m in distances_m:
            yield {"slot": slot_us, "distance": distance_m, "datagrams": 50, "RngRun": 1}
    others: tuple[Arguments, ...] = ({"rts": 1}, {"mode": "OfdmRate54Mbps"}, {"vht": 1, "mode": "VhtMcs0"})
    for options, distance_m in product(others, (1340, 1348, 1349, 1360)):
        yield {**options, "distance": distance_m, "datagrams": 50, "RngRun": 1}


def _ampdu() -> Iterator[Arguments]:
    several: list[Arguments] = []
    several += [{"senders": senders} for senders in (1, 5, 20)]
    several += [{"senders": senders, "rts": 1} for senders in (5, 20)]
    several += [{"senders": senders, "loss": 0.1} for senders in (1, 5)]
    several += [{"senders": 2, "hidden": 1, "rts": rts} for rts in (0, 1)]
    several += [{"amsdu": 3_839, "loss": 0.1}]
    pairs: list[Arguments] = [{"rts": 1}, {"ampdu": 1_048_575}, {"ampdu": 0}]
    pairs += [{"amsdu": amsdu_bytes} for amsdu_bytes in (3_839, 7_935)]
    pairs += [{"streams": streams} for streams in (2, 4)]
    both = [*product(several, _MCS, RUNS), *product(pairs, _MCS, FEW_RUNS)]
    for setting, mcs, run in both:
        yield {**setting, "mcs": mcs, "seconds": 1, "RngRun": run}
    for streams, mcs, run in product((1, 2, 4), (0, 4, 7), FEW_RUNS):
        yield {"standard": "ht", "width": 40, "streams": streams, "mcs": mcs, "seconds": 1, "RngRun": run}


def _he_airtimes() -> Iterator[Arguments]:
    for width, streams, mcs, interval_ns, mpdus in product(
        (20, 80), (1, 2), (0, 5, 11), (800, 1600, 3200), (1, 3, 10, 40)
    ):
        yield {
            "what": "airtime", "width": width, "streams": streams, "mcs": mcs, "gi": interval_ns,
            "mpdus": mpdus,
        }  # fmt: skip


def _he() -> Iterator[Arguments]:
    aggregation: tuple[Arguments, ...] = (
        {"ampdu": 0}, {"ampdu": 65_535}, {"ampdu": 6_500_631}, {"ampdu": 6_500_631, "window": 256},
    )  # fmt: skip
    for width, mcs, limits, run in product((20, 80), (0, 5, 11), aggregation, FEW_RUNS):
        yield {"width": width, "mcs": mcs, **limits, "seconds": 1, "RngRun": run}


def _lean() -> Iterator[Arguments]:
    for mode, senders, run in product(("OfdmRate6Mbps", "OfdmRate54Mbps"), (5, 20, 50), TIMED_RUNS):
        yield {"stations": senders, "mode": mode, "warmup": 1, "seconds": 2, "RngRun": run}
    swarms = ((8, 0.1, 0), (8, 0.1, 56), (64, 0.1, 0), (64, 0.1, 135), (64, 0.2, 135))
    for (stations, period_s, sessions_per_s), run in product(swarms, TIMED_RUNS):
        yield {
            "traffic": "swarm", "stations": stations, "payload": 300, "period": period_s,
            "sessions": sessions_per_s, "warmup": 1, "seconds": 2, "RngRun": run,
        }  # fmt: skip
