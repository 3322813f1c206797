"""Reference results for the same traffic: tables in studies/reference; its README states their origin."""

from collections.abc import Mapping
from typing import TypeVar

import msgspec
from msgspec import Struct

from netsim.model.config import BandwidthMhz, Mode
from studies.common.reference import reference_table

NS3_PAYLOAD_OVERHEAD_BYTES = 8 + 20 + 8
"""UDP, IPv4 and LLC/SNAP headers around a UDP payload."""
BIANCHI_PACKET_BYTES = 1500
BIANCHI_UDP_BYTES = BIANCHI_PACKET_BYTES + 8 - NS3_PAYLOAD_OVERHEAD_BYTES
"""UDP payload with the same MAC payload as the reference's packets, which have LLC/SNAP but neither IP nor
UDP."""


T = TypeVar("T", bound=Struct)


class Saturated(Struct, frozen=True, kw_only=True):
    """Throughput of saturated stations."""

    stations: int
    rts: bool
    rate_mbps: int
    payload_bytes: int
    throughput_mbps: float


class Broadcasts(Struct, frozen=True, kw_only=True):
    """Result of periodic broadcasts; a negative jitter is a phase drawn once, uniform in the period."""

    stations: int
    payload_bytes: int
    period_s: float
    jitter_s: float
    seconds: float
    """Simulated time in ns-3"""
    delivery_ratio: float
    mean_delay_ms: float
    """0 if nothing was delivered"""


class ErrorCurve(Struct, frozen=True, kw_only=True):
    """Packet error rate of one mode and length over the signal-to-noise ratio."""

    mode: Mode
    width_mhz: BandwidthMhz
    frame_bytes: int
    model: str
    """``nist`` or ``table``"""
    snr_db: tuple[float, ...]
    per: tuple[float, ...]


def ns3_saturation() -> list[Saturated]:
    """Return runs of ns-3 3.37: 802.11a, UDP, control frames at 6 Mbit/s."""
    return [
        _read({**row, "rate_mbps": row["rate"].removeprefix("OfdmRate").removesuffix("Mbps")}, Saturated)
        for row in reference_table("ns3_saturation.csv")
    ]


def bianchi() -> list[Saturated]:
    """Return the values of Bianchi's model in ns-3's own test, for packets of `BIANCHI_PACKET_BYTES`."""
    fixed = {"rts": False, "payload_bytes": BIANCHI_PACKET_BYTES}
    return [_read({**row, **fixed}, Saturated) for row in reference_table("bianchi.csv")]


def ns3_broadcasts() -> list[Broadcasts]:
    """Return runs of ns-3 3.37: 802.11a at 6 Mbit/s, UDP.

    With these lengths, one for each of two sets, the ns-3 program reproduces the rows of the table exactly.
    """
    return [
        _read({**row, "seconds": 60.0 if float(row["period_s"]) == 0.1 else 20.0}, Broadcasts)
        for row in reference_table("ns3_broadcast.csv")
    ]


def ns3_phase_draws() -> dict[tuple[int, float], list[tuple[float, float]]]:
    """Return delivery ratio and mean delay (ms) of ns-3's runs with further seeds, by (stations, period, s).

    For rows with phases drawn once and periods so short that the result depends on the phases.
    """
    draws: dict[tuple[int, float], list[tuple[float, float]]] = {}
    for row in reference_table("ns3_broadcast_phases.csv"):
        key = (int(row["n"]), float(row["period_s"]))
        draws.setdefault(key, []).append((float(row["delivery_ratio"]), float(row["mean_delay_ms"])))
    return draws


def ns3_error_curves() -> list[ErrorCurve]:
    """Return ns-3 3.37's error models: NIST for non-HT modes, tables of link simulations for VHT."""
    points: dict[tuple[str, int, int], list[tuple[float, float]]] = {}
    for row in reference_table("ns3_per.csv"):
        column = "per_table" if row["mode"].startswith("vht") else "per_nist"
        key = (row["mode"], int(row["width_mhz"]), int(row["bytes"]))
        points.setdefault(key, []).append((float(row["snr_db"]), float(row[column])))
    return [
        ErrorCurve(
            mode=mode,  # type: ignore[arg-type]  # the table contains no others
            width_mhz=width_mhz,  # type: ignore[arg-type]
            frame_bytes=frame_bytes,
            model="table" if mode.startswith("vht") else "nist",
            snr_db=tuple(snr_db for snr_db, _ in curve),
            per=tuple(per for _, per in curve),
        )
        for (mode, width_mhz, frame_bytes), curve in points.items()
    ]


def _read(row: Mapping[str, object], kind: type[T]) -> T:
    """Return a row of a table, whose texts are converted to the types of the fields."""
    return msgspec.convert({**row, "stations": row["n"]}, kind, strict=False)
