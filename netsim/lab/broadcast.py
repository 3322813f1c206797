"""Delivery ratio and delay of periodic broadcasts of many stations, as position beacons of a swarm.

There are no acknowledgements and no retries: a frame that collides is lost. All stations share one tick; the
datagram of a tick is sent after uniform jitter.
"""

import numpy as np
from msgspec import Struct

from netsim.lab.bench import CLOSE_M, RadioBench, ring_ned_m
from netsim.model.config import Mode, RadioConfig
from netsim.wire.messages import Broadcast, Delivery

DRAIN_US = 1_000_000
QUEUE_FRAMES = 500
QUEUE_LIFETIME_US = 500_000


class BroadcastResult(Struct, frozen=True, kw_only=True):
    """Result of periodic broadcasts. Delays are those of received datagrams, None without any."""

    delivery_ratio: float
    """Datagrams received, divided by datagrams sent times their intended receivers."""
    mean_delay_ms: float | None
    """From the application's call to the end of the frame at the receiver."""
    p50_ms: float | None
    p95_ms: float | None
    p99_ms: float | None


def broadcast(
    *,
    stations: int,
    payload_bytes: int,
    period_s: float,
    jitter_s: float,
    seconds: float,
    mode: Mode = "ofdm6",
    rts: bool = False,
    seed: int = 1,
) -> BroadcastResult:
    """Simulate broadcasts of every station, every ``period_s`` for ``seconds``, on a common tick.

    Each datagram has a jitter, uniform in [0, ``jitter_s``). With a negative ``jitter_s`` each station has
    one constant phase instead, uniform in the period.
    """
    config = RadioConfig(
        bandwidth_mhz=20,
        frequency_mhz=5180.0,
        rician_k_db=None,
        access="dcf",
        broadcast_mode=mode,
        broadcast_rts=rts,
        queue_frames=QUEUE_FRAMES,
        queue_lifetime_us=QUEUE_LIFETIME_US,
        host_latency_us=0,
        host_jitter_us=0,
    )
    bench = RadioBench(config, ring_ned_m(stations, CLOSE_M), seed)
    generator = np.random.default_rng(seed)
    phases_s = generator.uniform(0.0, period_s, stations) if jitter_s < 0.0 else np.zeros(stations)
    payload = bytes(payload_bytes)
    sent_us: list[list[int]] = [[0] for _ in range(stations)]
    """Send time by station and sequence number, which counts from 1."""
    delays_us: list[float] = []
    ticks = max(1, round(seconds / period_s))
    for tick in range(ticks):
        now_us = round(1e6 * tick * period_s)
        if now_us > bench.now_us:
            _gather(bench, now_us, sent_us, delays_us)
        jitters_s = generator.uniform(0.0, jitter_s, stations) if jitter_s > 0.0 else np.zeros(stations)
        for station in range(stations):
            at_us = round(1e6 * (tick * period_s + phases_s[station] + jitters_s[station]))
            sent_us[station].append(at_us)
            seq = bench.next_seq(station)
            bench.submit(station, Broadcast(seq=seq, at_us=at_us, payload=payload))
    _gather(bench, round(1e6 * (ticks * period_s + max(jitter_s, 0.0))) + DRAIN_US, sent_us, delays_us)
    delays_ms = np.array(delays_us) / 1e3
    percentiles_ms = np.percentile(delays_ms, (50, 95, 99)).tolist() if delays_us else [None] * 3
    expected = ticks * stations * (stations - 1)
    return BroadcastResult(
        delivery_ratio=len(delays_us) / expected if expected else 0.0,
        mean_delay_ms=float(delays_ms.mean()) if delays_us else None,
        p50_ms=percentiles_ms[0],
        p95_ms=percentiles_ms[1],
        p99_ms=percentiles_ms[2],
    )


def _gather(bench: RadioBench, until_us: int, sent_us: list[list[int]], delays_us: list[float]) -> None:
    for _, item in bench.run(until_us):
        if isinstance(item, Delivery):
            delays_us.append(item.received_ns / 1e3 - sent_us[item.source][item.seq])
    bench.emulator.take_frames()
