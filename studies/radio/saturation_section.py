"""Saturated stations against ns-3's runs and Bianchi's model."""

from collections.abc import Sequence
from pathlib import Path

from msgspec import Struct

from netsim.lab.saturation import SaturationResult, saturate
from netsim.model.config import Mode
from studies.common.report import Check, ReportTable, Section
from studies.common.runner import Job, Results
from studies.radio.figures import save_saturation
from studies.radio.peers import BIANCHI_PACKET_BYTES, BIANCHI_UDP_BYTES, Saturated, bianchi, ns3_saturation
from studies.radio.plan import RadioPlan
from studies.radio.statistics import Mean, mean_of

TOLERANCE = 0.03
MODES: dict[int, Mode] = {6: "ofdm6", 24: "ofdm24", 54: "ofdm54"}


class _Run(Struct, frozen=True, kw_only=True):
    stations: int
    rts: bool
    rate_mbps: int
    payload_bytes: int
    seconds: float
    seed: int


def _saturate(run: _Run) -> SaturationResult:
    return saturate(
        stations=run.stations,
        rts=run.rts,
        mode=MODES[run.rate_mbps],
        payload_bytes=run.payload_bytes,
        seconds=run.seconds,
        seed=run.seed,
    )


def jobs(plan: RadioPlan) -> dict[str, list[Job]]:
    """Every row of both references with each seed."""
    groups: dict[str, list[Job]] = {}
    for name, row in _rows(plan):
        payload_bytes = BIANCHI_UDP_BYTES if name == "bianchi" else row.payload_bytes
        seconds = plan.packets * 8 * payload_bytes / (row.throughput_mbps * 1e6)
        groups[_key(name, row)] = [
            (
                _saturate,
                _Run(
                    stations=row.stations, rts=row.rts, rate_mbps=row.rate_mbps, payload_bytes=payload_bytes,
                    seconds=seconds, seed=seed,
                ),
            )
            for seed in range(1, plan.seeds + 1)
        ]  # fmt: skip
    return groups


def judge(plan: RadioPlan, results: Results, images: Path | None) -> Section:
    """Compare the mean throughput of every row."""
    ours = {key: mean_of([_payload_mbps(key, result) for result in group]) for key, group in results.items()}
    rows = _rows(plan)
    checks = tuple(
        Check(
            name=f"{_TOLD[name]}, {row.rate_mbps} Mbit/s{', RTS' if row.rts else ''}, n = {row.stations}",
            value=ours[_key(name, row)].value,
            unit="Mbit/s",
            at_least=(1.0 - TOLERANCE) * row.throughput_mbps,
            at_most=(1.0 + TOLERANCE) * row.throughput_mbps,
        )
        for name, row in rows
    )
    figures: tuple[tuple[str, str], ...] = ()
    if images is not None:
        save_saturation(
            images / "radio-saturation.png",
            [(name, row, ours[_key(name, row)]) for name, row in rows],
        )
        figures = (("radio-saturation.png", "throughput of saturated stations beside ns-3's and Bianchi's"),)
    worst = max(abs(_deviation(ours[_key(name, row)], row)) for name, row in rows)
    collisions = {key: mean_of([r.collisions_fraction for r in group]) for key, group in results.items()}
    return Section(
        title="Saturated stations",
        conditions=(
            "Stations that always have a datagram for one more station, the sink: 802.11a, DCF, RTS at "
            "6 Mbit/s, all in range and none stronger than another, no channel errors, no retry limit. "
            "ns-3's rows are one run of ns-3 3.37 each, with 1000 B of UDP, and have 1 % of noise. "
            "Bianchi's are the values by which ns-3 checks itself (DIFS after collisions, corrected for "
            f"finite windows): packets of {BIANCHI_PACKET_BYTES} B over LLC/SNAP without IP and UDP, here "
            f"{BIANCHI_UDP_BYTES} B of UDP, whose frame has as many bytes. Required is the throughput "
            f"within {100 * TOLERANCE:.0f} %, the mean of {plan.seeds} runs of about {plan.packets} "
            f"datagrams. The greatest deviation is {100 * worst:.1f} %.\n"
        ),
        checks=checks,
        tables=tuple(
            ReportTable(
                caption=f"Ours ± standard error, Mbit/s ({told}; deviation; frames that collide):",
                columns=("n", *(_column(*column) for column in _columns(rows, name))),
                rows=_cells(rows, name, ours, collisions),
            )
            for name, told in _TOLD.items()
        ),
        figures=figures,
    )


_TOLD = {"ns3": "ns-3", "bianchi": "Bianchi"}


def _rows(plan: RadioPlan) -> list[tuple[str, Saturated]]:
    both = [*(("ns3", row) for row in ns3_saturation()), *(("bianchi", row) for row in bianchi())]
    return [(name, row) for name, row in both if row.stations <= plan.stations]


def _key(name: str, row: Saturated) -> str:
    return f"{name}/{row.rate_mbps}/{row.rts}/{row.stations}"


def _payload_mbps(key: str, result: SaturationResult) -> float:
    """Throughput of what the reference counts as payload."""
    scale = BIANCHI_PACKET_BYTES / BIANCHI_UDP_BYTES if key.startswith("bianchi") else 1.0
    return scale * result.throughput_mbps


def _deviation(ours: Mean, row: Saturated) -> float:
    return ours.value / row.throughput_mbps - 1.0


def _columns(rows: Sequence[tuple[str, Saturated]], name: str) -> list[tuple[int, bool]]:
    return sorted({(row.rate_mbps, row.rts) for which, row in rows if which == name})


def _column(rate_mbps: int, rts: bool) -> str:  # noqa: FBT001  # a key of the table
    return f"{rate_mbps} Mbit/s{', RTS' if rts else ''}"


def _cells(
    rows: Sequence[tuple[str, Saturated]], name: str, ours: dict[str, Mean], collisions: dict[str, Mean]
) -> tuple[tuple[str, ...], ...]:
    """One row for each number of stations."""
    cells = {}
    for which, row in rows:
        if which == name:
            key = _key(name, row)
            cells[row.stations, row.rate_mbps, row.rts] = (
                f"{ours[key].text(3)} ({row.throughput_mbps:.3f}; {100 * _deviation(ours[key], row):+.1f} %; "
                f"{100 * collisions[key].value:.0f} %)"
            )
    return tuple(
        (str(n), *(cells.get((n, *column), "") for column in _columns(rows, name)))
        for n in sorted({key[0] for key in cells})
    )
