"""Saturated stations compared with ns-3 and Bianchi's model."""

from collections.abc import Sequence
from functools import partial

from netsim.lab.saturation import SaturationResult, saturate
from netsim.model.config import Mode
from studies.common.report import Check, ReportFigure, ReportTable, Section
from studies.common.runner import Job, Results
from studies.radio.figures import save_saturation
from studies.radio.peers import BIANCHI_PACKET_BYTES, BIANCHI_UDP_BYTES, Saturated, bianchi, ns3_saturation
from studies.radio.plan import RadioPlan
from studies.radio.statistics import Mean, mean_of

TOLERANCE = 0.03
MODES: dict[int, Mode] = {6: "ofdm6", 24: "ofdm24", 54: "ofdm54"}


def jobs(plan: RadioPlan) -> dict[str, list[Job]]:
    """Return the jobs of every row of both references with each seed."""
    groups: dict[str, list[Job]] = {}
    for name, row in _rows(plan):
        payload_bytes = BIANCHI_UDP_BYTES if name == "bianchi" else row.payload_bytes
        seconds = plan.packets * 8 * payload_bytes / (row.throughput_mbps * 1e6)
        groups[_key(name, row)] = [
            partial(
                saturate, stations=row.stations, rts=row.rts, mode=MODES[row.rate_mbps],
                payload_bytes=payload_bytes, seconds=seconds, seed=seed,
            )
            for seed in range(1, plan.seeds + 1)
        ]  # fmt: skip
    return groups


def judge(plan: RadioPlan, results: Results) -> Section:
    """Compare the mean throughput of every row."""
    ours = {key: mean_of([_payload_mbps(key, result) for result in group]) for key, group in results.items()}
    rows = _rows(plan)
    checks = tuple(
        Check.near(
            f"{_LABELS[name]}, {_column(row.rate_mbps, row.rts)}, n = {row.stations}",
            ours[_key(name, row)].value, row.throughput_mbps, TOLERANCE, "Mbit/s",
        )
        for name, row in rows
    )  # fmt: skip
    shows = "throughput of saturated stations, compared with ns-3 and Bianchi's model"
    draw = partial(save_saturation, rows=[(name, row, ours[_key(name, row)]) for name, row in rows])
    worst = max(abs(_deviation(ours[_key(name, row)], row)) for name, row in rows)
    collisions = {key: mean_of([r.collisions_fraction for r in group]) for key, group in results.items()}
    return Section(
        title="Saturated stations",
        conditions=(
            "Each station always has a datagram for a common sink: 802.11a, DCF, RTS at 6 Mbit/s, all "
            "stations in range with equal power, no channel errors, no retry limit. A row of ns-3 is one "
            "run of ns-3 3.37 with 1000 B of UDP and has a statistical error of 1 %. Bianchi's values are "
            "those of ns-3's own test (DIFS after collisions, corrected for finite windows) for packets of "
            f"{BIANCHI_PACKET_BYTES} B over LLC/SNAP without IP and UDP; ours have {BIANCHI_UDP_BYTES} B of "
            f"UDP, which results in frames of the same length. The throughput, mean of {plan.seeds} runs of "
            f"about {plan.packets} datagrams, must agree within {100 * TOLERANCE:.0f} %. The greatest "
            f"deviation is {100 * worst:.1f} %.\n"
        ),
        checks=checks,
        tables=tuple(
            ReportTable(
                caption=f"Ours ± standard error, Mbit/s ({label}; deviation; share of colliding frames):",
                columns=("n", *(_column(*column) for column in _columns(rows, name))),
                rows=_cells(rows, name, ours, collisions),
            )
            for name, label in _LABELS.items()
        ),
        figures=(ReportFigure("radio-saturation.png", shows, draw),),
    )


_LABELS = {"ns3": "ns-3", "bianchi": "Bianchi"}


def _rows(plan: RadioPlan) -> list[tuple[str, Saturated]]:
    both = [*(("ns3", row) for row in ns3_saturation()), *(("bianchi", row) for row in bianchi())]
    return [(name, row) for name, row in both if row.stations <= plan.stations]


def _key(name: str, row: Saturated) -> str:
    return f"{name}/{row.rate_mbps}/{row.rts}/{row.stations}"


def _payload_mbps(key: str, result: SaturationResult) -> float:
    """Return the throughput of the payload as the reference counts it."""
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
    """Return one row for each number of stations."""
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
