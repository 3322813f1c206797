"""Error, delay and airtime of ranging: one pair, or all pairs of stations."""

import numpy as np
from msgspec import Struct

from netsim.emulator.records import FrameRecord
from netsim.lab.bench import HEIGHT_M, RadioBench, ring_ned_m
from netsim.mac.access_parameters import EDCA
from netsim.model.config import BandwidthMhz, FtmConfig, Mode, RadioConfig
from netsim.phy.frames import FrameKind
from netsim.phy.timing import timing_of
from netsim.wire.messages import FtmRequest, FtmResult

STEP_US = 1_000
MESH_RADIUS_M = 15.0
FTM_MODES: dict[BandwidthMhz, Mode] = {20: "ofdm6", 40: "vht_mcs0", 80: "vht_mcs0"}
"""Most robust mode of measurement frames by channel width."""


class FtmResultSummary(Struct, frozen=True, kw_only=True):
    """Statistics of the sessions of one pair; None where too few sessions completed."""

    error_mean_m: float | None
    """Mean error of the sessions' distances."""
    error_std_m: float | None
    """Standard deviation of that error; None for fewer than two."""
    round_trip_std_m: float | None
    """Standard deviation of a single round trip's range within sessions of two or more."""
    airtime_ms: float
    """Airtime of a session: its frames, SIFS, and AIFS and mean backoff of every exchange."""
    completed: int
    failed: int


class MeshResult(Struct, frozen=True, kw_only=True):
    """Result of ranging between all pairs."""

    stations: int
    completed_fraction: float
    mean_delay_ms: float | None
    """Mean time from request to result of completed sessions; None without any."""
    round_trips_mean: float
    """Mean over completed sessions, 0 without any; a burst that runs out of time has fewer than requested."""
    busy_fraction: float
    """Fraction of the time with a frame on the air."""
    airtime_fraction: float
    """Airtime of all requested sessions without losses, per time; above 1 they do not fit."""


def range_pair(
    *,
    distance_m: float,
    width_mhz: BandwidthMhz,
    sessions: int,
    ftms_per_burst: int,
    bias_m: float = 0.0,
    mode: Mode | None = None,
    seed: int = 1,
) -> FtmResultSummary:
    """Simulate consecutive sessions between two stations, without fading.

    ``bias_m`` is the pair's calibration offset. Raises ValueError for a mode not available at that width.
    """
    ftm = FtmConfig(
        ftms_per_burst=ftms_per_burst,
        mode=mode or FTM_MODES[width_mhz],
        calibration_bias_m=bias_m,
        burst_duration_us=128_000,
        request_timeout_us=500_000,
    )
    places_ned_m = [(0.0, 0.0, -HEIGHT_M), (distance_m, 0.0, -HEIGHT_M)]
    bench = RadioBench(_config(width_mhz, ftm), places_ned_m, seed)
    results: list[FtmResult] = []
    airtime_ns = 0
    for _ in range(sessions):
        bench.submit(0, FtmRequest(seq=bench.next_seq(0), at_us=bench.now_us, peer=1))
        found: list[FtmResult] = []
        while not found:
            found = [item for _, item in bench.run(bench.now_us + STEP_US) if isinstance(item, FtmResult)]
        results += found
        # the last ACK is still on the air when the result arrives
        bench.run(bench.now_us + STEP_US)
        airtime_ns += airtime_of_ns(bench.emulator.take_frames())
    good = [result for result in results if result.status == "ok"]
    errors_m = np.array([result.distance_m - distance_m for result in good])
    variances_m2 = [result.distance_std_m**2 for result in good if result.round_trips > 1]
    return FtmResultSummary(
        error_mean_m=float(errors_m.mean()) if good else None,
        error_std_m=float(errors_m.std(ddof=1)) if len(good) > 1 else None,
        round_trip_std_m=float(np.sqrt(np.mean(variances_m2))) if variances_m2 else None,
        airtime_ms=airtime_ns / sessions / 1e6,
        completed=len(good),
        failed=sessions - len(good),
    )


def airtime_of_ns(frames: list[FrameRecord]) -> int:
    """Return the time for which ranging frames occupy the medium at 5 GHz, contention included."""
    access, timing = EDCA["vo"], timing_of(RadioConfig())
    contention_ns = access.aifs_ns(timing) + timing.slot_ns * access.cw_min // 2
    total_ns = 0
    for frame in frames:
        total_ns += frame.end_ns - frame.start_ns
        total_ns += timing.sifs_ns if frame.kind == FrameKind.ACK else contention_ns
    return total_ns


def range_mesh(
    *,
    stations: int,
    period_s: float,
    seconds: float,
    width_mhz: BandwidthMhz = 80,
    ftms_per_burst: int = 8,
    mode: Mode | None = None,
    seed: int = 1,
) -> MeshResult:
    """Simulate ranging from every station to every other once in a period.

    A station's requests are spread evenly over the period, from a random phase. The time-out of a request is
    the period, at most 1.5 s. The stations are on a circle of 30 m diameter. Raises ValueError for a mode not
    available at that width.
    """
    timeout_us = min(max(round(1e6 * period_s), 1_000), 1_500_000)
    ftm = FtmConfig(
        ftms_per_burst=ftms_per_burst, mode=mode or FTM_MODES[width_mhz], request_timeout_us=timeout_us
    )
    bench = RadioBench(_config(width_mhz, ftm), ring_ned_m(stations, MESH_RADIUS_M), seed)
    phases_s = np.random.default_rng(seed).uniform(0.0, period_s, stations)
    requested_us: dict[tuple[int, int], int] = {}
    periods = max(1, round(seconds / period_s))
    for period in range(periods):
        for station in range(stations):
            peers = [(station + k) % stations for k in range(1, stations)]
            for k, peer in enumerate(peers):
                at_us = round(1e6 * (phases_s[station] + period_s * (period + k / len(peers))))
                seq = bench.next_seq(station)
                requested_us[station, seq] = at_us
                bench.submit(station, FtmRequest(seq=seq, at_us=at_us, peer=peer))
    end_us = round(1e6 * period_s * periods)
    items = bench.run(end_us)
    busy_fraction = bench.emulator.busy_ns / (1e3 * end_us)
    items += bench.run(end_us + round(1e6 * period_s) + timeout_us + 10_000)
    good = [(station, item) for station, item in items if isinstance(item, FtmResult) and item.status == "ok"]
    delays_us = [item.ended_ns / 1e3 - requested_us[station, item.seq] for station, item in good]
    alone = range_pair(
        distance_m=MESH_RADIUS_M,
        width_mhz=width_mhz,
        sessions=1,
        ftms_per_burst=ftms_per_burst,
        mode=mode,
        seed=seed,
    )
    return MeshResult(
        stations=stations,
        completed_fraction=len(good) / len(requested_us),
        mean_delay_ms=float(np.mean(delays_us)) / 1e3 if delays_us else None,
        round_trips_mean=float(np.mean([item.round_trips for _, item in good])) if good else 0.0,
        busy_fraction=busy_fraction,
        airtime_fraction=alone.airtime_ms / 1e3 * stations * (stations - 1) / period_s,
    )


def _config(width_mhz: BandwidthMhz, ftm: FtmConfig) -> RadioConfig:
    return RadioConfig(
        bandwidth_mhz=width_mhz, rician_k_db=None, ftm=ftm, host_latency_us=0, host_jitter_us=0
    )
