"""The interface of a network emulator: a minimal one serves radios and time master in place of 802.11."""

from types import SimpleNamespace

import numpy as np

from harness.simulator.emulator_client import EmulatorClient
from harness.simulator.in_process_links import InProcessEmulatorLine, InProcessRadio
from netsim.wire.lockstep import Advanced
from netsim.wire.messages import Broadcast, Delivery, RxBatch

PERIOD_US, STEP_US = 20_000, 4_000
TRUTH = SimpleNamespace(
    pos_ned_m=np.zeros((2, 3)), vel_ned_m_s=np.zeros((2, 3)), q_ned_frd=np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
)


class Wire:
    """Delivers every broadcast to the other of two vehicles at the end of the interval."""

    stations, counters = 2, {}

    def __init__(self):
        self.reached_us, self._submitted = 0, []

    def open_logs(self):
        pass

    def close(self):
        pass

    def is_guest(self, _station):
        return False

    def submit(self, batch):
        self._submitted.append(batch)
        return True

    def missing(self, request):
        return set(request.senders) - {batch.station for batch in self._submitted}

    def advance(self, request):
        batches, self._submitted, self.reached_us = self._submitted, [], request.to_us
        return {
            1 - batch.station: RxBatch(
                station=1 - batch.station,
                release_us=request.release_us,
                items=tuple(
                    Delivery(
                        source=batch.station,
                        seq=item.seq,
                        received_ns=1_000 * request.to_us,
                        rssi_dbm=-50.0,
                        payload=item.payload,
                    )
                    for item in batch.items
                ),
            )
            for batch in batches
        }

    def advanced(self, *, delivered=(), missing=()):
        return Advanced(
            to_us=self.reached_us, quiet_until_us=1 << 40, busy_ns=0, delivered=delivered, missing=missing
        )

    def set_between_events(self, function):
        pass


def test_another_emulator_serves_the_radios_and_the_time_master():
    emulator = Wire()
    radios = [InProcessRadio(emulator, station) for station in range(2)]
    client = EmulatorClient(InProcessEmulatorLine(emulator, radios), period_us=PERIOD_US)
    radios[0].send(PERIOD_US, [Broadcast(seq=5, at_us=PERIOD_US, payload=b"abc")])
    client.begin(PERIOD_US, STEP_US, TRUTH, senders=(0,), extra_attenuation_db=0.0, range_offsets_m={})
    assert client.end() == ()
    assert client.delivered(2 * PERIOD_US) == (1,)
    (item,) = radios[1].receive(2 * PERIOD_US)
    assert (item.source, item.seq, item.payload) == (0, 5, b"abc")
