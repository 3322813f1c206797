"""Serial modems in the emulator: whose bytes go where and when, beside an unchanged 802.11 channel."""

import numpy as np
import pytest

from netsim.emulator.service import EmulatorService
from netsim.model.config import GuestConfig, RadioConfig, ServerConfig
from netsim.serial_radio.config import SerialPairsConfig, SerialRadioConfig
from netsim.wire.lockstep import Advance, pack_rows
from netsim.wire.messages import Broadcast, SerialBytes, SerialReceived, SerialReport, Survey, TxBatch

VEHICLES, GROUND = 2, 3
"""Station 2 is a guest without a modem."""
STEP_US = 4_000
GUESTS = (
    GuestConfig(name="guest", pos_ned_m=(0.0, 9.0, 0.0)),
    GuestConfig(name="ground", pos_ned_m=(9.0, 0.0, 0.0)),
)
BEAT = bytes.fromhex("fd09000000ffbe000000") + bytes(11)
"""A HEARTBEAT to a modem, which looks at its length and id only."""


class Run:
    def __init__(self, **radio):
        self.service = EmulatorService(
            ServerConfig(
                run_id="test", stations=VEHICLES, seed=3, radio=RadioConfig(guests=GUESTS, **radio),
                serial=SerialPairsConfig(settings=SerialRadioConfig(), ground_station=GROUND),
            )
        )  # fmt: skip
        self.received = {station: [] for station in range(4)}

    def submit(self, station, *items):
        return self.service.submit(TxBatch(station=station, now_us=self.service.reached_us, items=items))

    def advance(self, seconds, pieces=1):
        for _ in range(round(seconds * 1e6 / STEP_US)):
            at_us = self.service.reached_us
            request = Advance(
                to_us=at_us + STEP_US, release_us=at_us + 2 * STEP_US, at_us=at_us,
                pos_ned_m=pack_rows(np.array([(0.0, 0.0, -5.0), (5.0, 0.0, -5.0)])),
                vel_ned_m_s=pack_rows(np.zeros((2, 3))),
                q_ned_frd=pack_rows(np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))), extra_attenuation_db=0.0,
            )  # fmt: skip
            self.service.begin(request)
            for piece in range(1, pieces + 1):
                self.service.run_until(1_000 * (at_us + STEP_US * piece // pieces))
            for station, batch in self.service.end(request).items():
                assert (batch.station, batch.release_us) == (station, at_us + 2 * STEP_US)
                self.received[station] += batch.items


def serial(peer, payload=BEAT, seq=0):
    return SerialBytes(seq=seq, at_us=0, peer=peer, payload=payload)


@pytest.mark.parametrize("channel", ["emulated", "ideal"])
def test_bytes_arrive_at_the_other_modem_of_the_pair_and_reports_at_the_own_host(channel):
    run = Run(channel=channel)
    assert run.submit(1, serial(GROUND, BEAT + b"rest"))
    assert run.submit(GROUND, serial(0, seq=1))
    run.advance(1.0)
    beat, rest, report = run.received[GROUND]
    assert all(isinstance(each, SerialReceived) for each in (beat, rest))
    assert [(each.peer, each.payload) for each in (beat, rest)] == [(1, BEAT), (1, b"rest")]
    assert isinstance(report, SerialReport)  # of the heartbeat to vehicle 0
    assert (report.peer, report.txbuf) == (0, 100)
    for vehicle, kind in ((0, SerialReceived), (1, SerialReport)):
        item, survey = run.received[vehicle]
        assert isinstance(item, kind)
        assert item.peer == GROUND
        assert isinstance(survey, Survey)
    assert run.received[2] == []
    counters = run.service.counters["serial_radio"]
    assert counters["vehicles"]["packets_sent"] == counters["ground_station"]["packets_received"] > 0


def test_a_station_cannot_write_to_a_modem_that_it_does_not_have():
    run = Run()
    for station, peer in ((0, 1), (2, 0), (2, GROUND), (GROUND, 2), (GROUND, GROUND), (0, 65_535)):
        assert not run.submit(station, serial(peer))
    without = EmulatorService(ServerConfig(run_id="test", stations=VEHICLES, seed=3))
    assert not without.submit(TxBatch(station=0, now_us=0, items=(serial(1),)))


def test_the_radio_of_the_ground_station_is_off_and_the_channel_is_that_without_modems():
    run = Run()
    item = Broadcast(seq=0, at_us=0, payload=b"beacon")
    assert run.submit(0, item, serial(GROUND))
    run.advance(0.5)
    assert [item.payload for item in run.received[1] if not isinstance(item, Survey)] == [b"beacon"]
    assert [type(item) for item in run.received[GROUND]] == [SerialReceived]


def test_modems_have_events_all_the_time_and_intervals_may_be_divided():
    found = []
    for pieces in (1, 3):
        run = Run()
        assert run.service.advanced().quiet_until_us < 1_000_000
        for seq in range(20):
            assert run.submit(0, serial(GROUND, seq=seq))
            assert run.submit(GROUND, serial(0, seq=seq))
            run.advance(0.1, pieces)
        assert run.service.advanced().quiet_until_us < run.service.reached_us + 1_000_000
        found.append(run.received)
    assert found[0] == found[1]
    assert len(found[0][GROUND]) > 20
