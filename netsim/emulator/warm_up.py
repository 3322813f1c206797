"""A short simulation that runs every compiled kernel of the emulator, so that all are in the cache on disk.

Three stations in range of each other and one out of range send at the same time, beside an interferer. The
results are only checked roughly.
"""

import numpy as np

from foundation.kernels.warm_up import WarmUpError
from netsim.emulator.emulator import Emulator
from netsim.model.config import InterfererConfig, RadioConfig
from netsim.phy.frames import Transmission
from netsim.wire.messages import Broadcast, FtmRequest, TxBatch, TxItem, Unicast

STEP_US = 4_000
STEPS = 10
_PLACES_NED_M = np.array([(0.0, 0.0, -10.0), (0.0, 9.0, -10.0), (150.0, 0.0, -10.0), (4_000.0, 0.0, -10.0)])
_FAR = len(_PLACES_NED_M) - 1
_CONFIG = RadioConfig(
    data_mode="adaptive",
    queue_lifetime_us=10_000,
    broadcast_access_category="vi",
    host_jitter_us=0,  # frames submitted at the same time collide
    rts_threshold_bytes=0,
    interferers=(InterfererConfig(pos_ned_m=(20.0, 20.0, 0.0), duty_cycle=0.1),),
)


def warm_up() -> None:
    """Simulate 40 ms of broadcasts, ranging, collisions and unreachable unicasts. Raises WarmUpError."""
    stations = len(_PLACES_NED_M)
    seen: list[Transmission] = []
    emulator = Emulator(
        config=_CONFIG, stations=stations, seed=np.random.SeedSequence(0), on_transmission=seen.append
    )
    velocities_m_s = np.ones((stations, 3))
    for step in range(STEPS):
        now_us = step * STEP_US
        for station in range(stations):
            items: tuple[TxItem, ...] = (
                Broadcast(seq=3 * step + 1, at_us=now_us, payload=bytes(200)),
                FtmRequest(seq=3 * step + 2, at_us=now_us + 1_000, peer=(station + 1) % 3),
                Unicast(seq=3 * step + 3, at_us=now_us + 2_000, destination=_FAR, payload=bytes(50)),
            )
            emulator.submit(TxBatch(station=station, now_us=now_us, items=items))
        emulator.advance(
            to_us=now_us + STEP_US,
            at_us=now_us,
            pos_ned_m=_PLACES_NED_M + 1e-6 * now_us * velocities_m_s,
            vel_ned_m_s=velocities_m_s,
        )
    emulator.set_silent(_FAR)
    if emulator.next_event_ns <= 1_000 * STEPS * STEP_US:
        raise WarmUpError("radio warm-up: events are left at the end")
    if not any(frame.delivered for frame in seen) or not any(frame.collided for frame in seen):
        raise WarmUpError("radio warm-up: no frame was delivered, or none collided")
