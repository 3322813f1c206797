"""Throughput of saturated stations, for comparison with Bianchi's model.

G. Bianchi, "Performance analysis of the IEEE 802.11 distributed coordination function", IEEE JSAC, 2000.
Stations send datagrams to one more station, the sink, by DCF with control frames at 6 Mbit/s. All are in
range with equal powers and no channel errors. Retries are unlimited, as in the model; the emulator's default
limit is `netsim.model.config.RadioConfig.retry_limit`.
"""

from msgspec import Struct

from netsim.lab.bench import CLOSE_M, RadioBench, ring_ned_m
from netsim.model.config import Mode, RadioConfig
from netsim.phy.frames import FrameKind
from netsim.wire.messages import Sent, Unicast

STEP_US = 5_000
WARM_UP_US = 500_000
QUEUED_FRAMES = 32
"""More than a station can send in a step."""
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
        queue_frames=2 * QUEUED_FRAMES,
        queue_lifetime_us=60_000_000,
        host_latency_us=0,
        host_jitter_us=0,
    )
    bench = RadioBench(config, ring_ned_m(stations + 1, CLOSE_M), seed)
    sink, payload = stations, bytes(payload_bytes)
    for station in range(stations):
        _feed(bench, station, sink, payload, QUEUED_FRAMES)
    end_us = WARM_UP_US + round(seconds * 1e6)
    acknowledged = dropped = contended = collided = 0
    while bench.now_us < end_us:
        measured = bench.now_us >= WARM_UP_US
        done = [0] * stations
        for station, item in bench.run(min(bench.now_us + STEP_US, end_us)):
            if isinstance(item, Sent):
                done[station] += 1
                if measured:
                    acknowledged += item.status == "acknowledged"
                    dropped += item.status != "acknowledged"
        for station, count in enumerate(done):
            if count:
                _feed(bench, station, sink, payload, count)
        contends = FrameKind.RTS if rts else FrameKind.DATA
        for frame in bench.emulator.take_frames():
            if measured and frame.kind == contends:
                contended += 1
                collided += frame.collided
    return SaturationResult(
        throughput_mbps=acknowledged * payload_bytes * 8 / (end_us - WARM_UP_US),
        collisions_fraction=collided / contended if contended else 0.0,
        dropped=dropped,
    )


def _feed(bench: RadioBench, station: int, sink: int, payload: bytes, count: int) -> None:
    bench.submit(
        station,
        *(
            Unicast(seq=bench.next_seq(station), at_us=bench.now_us, destination=sink, payload=payload)
            for _ in range(count)
        ),
    )
