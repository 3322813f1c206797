"""Error, delay, collisions and air time of UWB ranging: one pair, or all pairs of stations."""

from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from foundation.types import Vector
from netsim.lab.bench import HEIGHT_M, RadioBench, ring_ned_m
from netsim.lab.ranging import MESH_RADIUS_M
from netsim.model.config import RadioConfig
from netsim.uwb.config import UwbConfig
from netsim.uwb.exchanges import UwbCounters
from netsim.uwb.frames import airtime_us, exchange_us
from netsim.wire.messages import FtmRequest, FtmResult

_RADIO = RadioConfig(rician_k_db=None, host_latency_us=0, host_jitter_us=0)


class UwbPairResult(Struct, frozen=True, kw_only=True):
    """Statistics of the distances of one pair; None where too few exchanges completed."""

    error_mean_m: float | None
    """Mean error, that of the pair's clocks and antenna delays."""
    error_std_m: float | None
    """Standard deviation of the error; None for fewer than two."""
    rx_power_dbm: float | None
    """Received power of the responder's frames."""
    exchange_ms: float
    """Time from the beginning of an exchange to the end of its last frame."""
    airtime_ms: float
    """Sum of the air times of its frames."""
    completed: int
    failed: int


class UwbMeshResult(Struct, frozen=True, kw_only=True):
    """Result of ranging between all pairs."""

    stations: int
    ranges_per_s: float
    """Requested distances per second, of all stations."""
    completed_fraction: float
    error_mean_m: float | None
    """Mean error over all distances."""
    error_std_m: float | None
    """Standard deviation over all distances, constant errors of the pairs included."""
    noise_std_m: float | None
    """Standard deviation of a pair's distances, root mean square over the pairs measured twice or more."""
    mean_delay_ms: float | None
    """Mean time from request to result of completed requests."""
    airtime_fraction: float
    """Air time of all frames per time."""
    collided_fraction: float
    """Share of the frames that arrived at their addressees and were lost to overlapping frames."""
    exchanges_per_request: float


def uwb_range_pair(*, distance_m: float, exchanges: int, uwb: UwbConfig, seed: int = 1) -> UwbPairResult:
    """Simulate consecutive exchanges between two stations. Raises ValueError for inconsistent settings."""
    places_ned_m = [(0.0, 0.0, -HEIGHT_M), (distance_m, 0.0, -HEIGHT_M)]
    requests_us = [(0, 1, uwb.request_timeout_us * k) for k in range(exchanges)]
    results, _ = _run(places_ned_m, requests_us, uwb, seed)
    good = [result for _, result in results if result.status == "ok"]
    errors_m = np.array([result.distance_m - distance_m for result in good])
    return UwbPairResult(
        error_mean_m=float(errors_m.mean()) if good else None,
        error_std_m=float(errors_m.std(ddof=1)) if len(good) > 1 else None,
        rx_power_dbm=float(np.mean([result.rssi_dbm for result in good])) if good else None,
        exchange_ms=exchange_us(uwb) / 1e3,
        airtime_ms=airtime_us(uwb) / 1e3,
        completed=len(good),
        failed=exchanges - len(good),
    )


def uwb_range_mesh(
    *,
    stations: int,
    period_s: float,
    seconds: float,
    uwb: UwbConfig,
    each_pair_once: bool = False,
    seed: int = 1,
) -> UwbMeshResult:
    """Simulate ranging from every station to every other once in a period.

    The requests of a station are spread evenly over the period, from a random phase.
    With ``each_pair_once`` it ranges to the half of the others that follows it only. The stations are on a
    circle of 30 m diameter. Raises ValueError for inconsistent settings.
    """
    rng = np.random.default_rng(seed)
    requests_us: list[tuple[int, int, int]] = []
    periods = max(1, round(seconds / period_s))
    for station in range(stations):
        ahead = range(1, stations)
        if each_pair_once:
            ahead = range(1, (stations + 1) // 2 + (stations % 2 == 0 and station < stations // 2))
        peers = [(station + k) % stations for k in ahead]
        phase_s = rng.uniform(0.0, period_s)
        requests_us += [
            (station, peer, round(1e6 * (phase_s + period_s * (period + k / len(peers)))))
            for period in range(periods)
            for k, peer in enumerate(peers)
        ]
    places_ned_m = ring_ned_m(stations, MESH_RADIUS_M)
    results, counters = _run(places_ned_m, requests_us, uwb, seed)
    duration_s = (max(at_us for *_, at_us in requests_us) + uwb.request_timeout_us) / 1e6
    return _mesh_result(np.array(places_ned_m), requests_us, results, counters, duration_s)


def _run(
    places_ned_m: Sequence[Vector], requests_us: list[tuple[int, int, int]], uwb: UwbConfig, seed: int
) -> tuple[list[tuple[int, FtmResult]], UwbCounters]:
    """Simulate requests (station, peer, time); return the results by station, and the counters.

    The sequence number of a result is the index of its request.
    """
    bench = RadioBench(_RADIO, places_ned_m, seed, uwb)
    for seq, (station, peer, at_us) in enumerate(requests_us):
        bench.submit(station, FtmRequest(seq=seq, at_us=at_us, peer=peer))
    items = bench.run(max(at_us for *_, at_us in requests_us) + uwb.request_timeout_us)
    counters = bench.emulator.counters.uwb
    if counters is None:
        raise ValueError("the emulator has no UWB radios")
    return [(station, item) for station, item in items if isinstance(item, FtmResult)], counters


def _mesh_result(
    places_ned_m: np.typing.NDArray[np.float64],
    requests_us: list[tuple[int, int, int]],
    results: list[tuple[int, FtmResult]],
    counters: UwbCounters,
    duration_s: float,
) -> UwbMeshResult:
    good = [(station, result) for station, result in results if result.status == "ok"]
    by_pair: dict[tuple[int, int], list[float]] = {}
    for station, result in good:
        true_m = float(np.linalg.norm(places_ned_m[station] - places_ned_m[result.peer]))
        by_pair.setdefault((station, result.peer), []).append(result.distance_m - true_m)
    errors_m = np.array([error_m for errors_m in by_pair.values() for error_m in errors_m])
    noise_m2 = [float(np.var(errors_m, ddof=1)) for errors_m in by_pair.values() if len(errors_m) > 1]
    delays_us = [result.ended_ns / 1e3 - requests_us[result.seq][2] for _, result in good]
    arrived = sum(counters.outcomes.values())
    return UwbMeshResult(
        stations=len(places_ned_m),
        ranges_per_s=len(requests_us) / duration_s,
        completed_fraction=len(good) / len(requests_us),
        error_mean_m=float(errors_m.mean()) if good else None,
        error_std_m=float(errors_m.std(ddof=1)) if len(good) > 1 else None,
        noise_std_m=float(np.sqrt(np.mean(noise_m2))) if noise_m2 else None,
        mean_delay_ms=float(np.mean(delays_us)) / 1e3 if good else None,
        airtime_fraction=counters.airtime_us / (1e6 * duration_s),
        collided_fraction=counters.outcomes["collided"] / max(arrived, 1),
        exchanges_per_request=counters.exchanges / len(requests_us),
    )
