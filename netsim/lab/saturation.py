"""Throughput of saturated stations, for comparison with Bianchi's model.

G. Bianchi, "Performance analysis of the IEEE 802.11 distributed coordination function", IEEE JSAC, 2000.
Stations send datagrams to one more station, the sink, by DCF with control frames at 6 Mbit/s. All are in
range with equal powers and no channel errors. Retries are unlimited, as in the model; the emulator's default
limit is `netsim.model.config.RadioConfig.retry_limit`.
"""

from msgspec import Struct

from netsim.emulator.records import frame_log_rows
from netsim.lab.bench import CLOSE_M, RadioBench, ring_ned_m
from netsim.mac.jobs import JobOutcome
from netsim.model.config import Mode, RadioConfig
from netsim.phy.frames import FrameKind

WARM_UP_US = 500_000
UNLIMITED = 2**31


class SaturationResult(Struct, frozen=True, kw_only=True):
    """Result of a saturated channel."""

    throughput_mbps: float
    """Acknowledged UDP payload of all stations."""
    collisions_fraction: float
    """Fraction of contending frames (data, or RTS) that collided."""
    dropped: int
    """Datagrams dropped at the retry limit."""


def saturate(
    *,
    stations: int,
    rts: bool,
    mode: Mode,
    payload_bytes: int,
    seconds: float,
    seed: int = 1,
    retry_limit: int = UNLIMITED,
) -> SaturationResult:
    """Simulate ``stations`` with full queues for ``seconds``, after half a second of warm-up."""
    config = RadioConfig(
        bandwidth_mhz=20,
        frequency_mhz=5180.0,
        rician_k_db=None,
        access="dcf",
        control_mode="ofdm6",
        data_mode=mode,
        rts_threshold_bytes=0 if rts else 65_535,
        retry_limit=retry_limit,
    )
    bench = RadioBench(config, ring_ned_m(stations + 1, CLOSE_M), seed)
    for station in range(stations):
        bench.emulator.saturate(station, stations, payload_bytes)
    bench.run(WARM_UP_US)
    bench.emulator.take_frame_rows()
    before = bench.emulator.saturation.sum(axis=0)
    measured_us = round(seconds * 1e6)
    bench.run(WARM_UP_US + measured_us)
    ended = dict(zip(JobOutcome, (bench.emulator.saturation.sum(axis=0) - before).tolist(), strict=True))
    frames = frame_log_rows(bench.emulator.take_frame_rows())
    contending = frames[frames["kind"] == (FrameKind.RTS if rts else FrameKind.DATA).value.encode()]
    acknowledged = ended[JobOutcome.ACKNOWLEDGED]
    return SaturationResult(
        throughput_mbps=acknowledged * payload_bytes * 8 / measured_us,
        collisions_fraction=float(contending["collided"].mean()) if len(contending) else 0.0,
        dropped=sum(ended.values()) - acknowledged,
    )
