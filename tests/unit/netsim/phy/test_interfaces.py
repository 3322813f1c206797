"""The interfaces of the radio's models: a minimal model of each works in place of the built-in one."""

import numpy as np
import pytest
from netsim_swarm import Swarm

from netsim.emulator.emulator import Emulator
from netsim.model.config import RadioConfig
from netsim.phy import errors
from netsim.phy.errors import error_model, packet_error_rate
from netsim.phy.fading import SECTORS
from netsim.phy.modes import phy_mode
from netsim.phy.path_loss import friis_loss_db
from netsim.wire.messages import Broadcast, Delivery, TxBatch

PLACES_NED_M = np.array([(0.0, 0.0, -10.0), (10.0, 0.0, -10.0)])
AT_REST = np.zeros((2, 3))
CONFIG = RadioConfig(host_latency_us=0, host_jitter_us=0, rician_k_db=None)


class ConstantLoss:
    """The same gain between all positions."""

    power_law_exponent, uses_attitudes = None, False

    def __init__(self, loss_db):
        self._gain = 10.0 ** (-loss_db / 10.0)

    def between_stations(self, sources, pos_ned_m, axes_ned):
        assert axes_ned is None
        return self.from_others(pos_ned_m[sources], pos_ned_m, axes_ned)

    def from_others(self, from_ned_m, to_ned_m, _to_axes_ned):
        distances_m = np.linalg.norm(to_ned_m - from_ned_m[:, None], axis=2)
        return np.full_like(distances_m, self._gain), distances_m


class ConstantFade:
    """The same power gain on all links at all times: a line of sight without waves."""

    def __init__(self, gain, stations):
        self.block = np.zeros(2 + stations**2 * (2 + 5 * SECTORS))
        self.block[1] = gain**0.5
        self.moves_ns = []

    def move(self, at_ns, _pos_ned_m, _vel_ned_m_s):
        self.moves_ns.append(at_ns)


class LossPerBit:
    """Loses the same share of bits at every ratio up to a limit."""

    def hazard(self, _mode):
        return lambda snr_db: 1e-3 if snr_db < 40.0 else 0.0


def rssi_dbm(**models):
    """Received power of one broadcast."""
    emulator = Emulator(config=CONFIG, stations=2, seed=np.random.SeedSequence(1), **models)
    emulator.submit(TxBatch(station=0, now_us=0, items=(Broadcast(seq=0, at_us=0, payload=b"x"),)))
    arrived = emulator.advance(to_us=8_000, at_us=0, pos_ned_m=PLACES_NED_M, vel_ned_m_s=AT_REST)
    (item,) = (each for each in arrived[1] if isinstance(each, Delivery))
    return item.rssi_dbm


def test_the_emulator_uses_another_propagation():
    received_dbm = rssi_dbm(propagation=lambda _config, _streams: ConstantLoss(20.0))
    at_1_m_dbm = CONFIG.tx_power_dbm + 2 * CONFIG.antenna_gain_dbi - friis_loss_db(1.0, CONFIG.frequency_mhz)
    assert received_dbm == pytest.approx(at_1_m_dbm - 20.0)


def test_the_emulator_uses_another_fading():
    fading = ConstantFade(0.25, 2)
    received_dbm = rssi_dbm(fading=lambda _config, _stations, _streams: fading)
    assert received_dbm == pytest.approx(rssi_dbm() + 10.0 * np.log10(0.25))
    assert fading.moves_ns == [0]


def test_frames_are_lost_by_another_error_model(monkeypatch):
    monkeypatch.setattr(errors, "ERRORS", LossPerBit())
    error_model.cache_clear()
    try:
        rate = packet_error_rate(phy_mode("vht_mcs0", 80), 1_000, 100.0)
        assert rate == pytest.approx(1.0 - np.exp(-8.0))
        swarm = Swarm([(0.0, 0.0, -10.0), (10.0, 0.0, -10.0)])
        swarm.broadcast(0, 1_000, payload=bytes(1_400))
        swarm.run(20_000)
        assert not swarm.received
        assert swarm.emulator.counters.broadcasts_lost_to_noise[1] == 1
    finally:
        error_model.cache_clear()
