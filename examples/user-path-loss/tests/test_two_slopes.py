"""The path loss has its two slopes, and frames in the emulator and in flight have its loss."""

from math import log10
from pathlib import Path

import numpy as np
import pytest

from coflight import OneProcessSwarm, Swarm
from harness.scenario.scenario import ScenarioError
from harness.scenario.scenario_file import load
from netsim.emulator.emulator import Emulator
from netsim.model.config import RadioConfig, RadioModel
from netsim.wire.messages import Broadcast, Delivery, TxBatch

SCENARIO = Path(__file__).parents[1] / "street.toml"
SETTINGS = {"breakpoint_m": 20.0, "exponent_beyond": 5.0}


def received_dbm(path_loss, distances_m):
    """Received powers of a broadcast at these distances; NaN where it is not received."""
    config = RadioConfig(path_loss=path_loss, rician_k_db=None, broadcast_rts=False, broadcast_mode="ofdm6")
    count = len(distances_m) + 1
    emulator = Emulator(config=config, stations=count, seed=np.random.SeedSequence(1))
    emulator.submit(TxBatch(station=0, now_us=0, items=(Broadcast(seq=0, at_us=0, payload=b"x"),)))
    places_ned_m = np.array([(d, 0.0, -10.0) for d in (0.0, *distances_m)])
    arrived = emulator.advance(
        to_us=20_000, at_us=0, pos_ned_m=places_ned_m, vel_ned_m_s=np.zeros((count, 3))
    )
    powers_dbm = dict.fromkeys(range(1, count), float("nan"))
    for station, items in arrived.items():
        for item in items:
            if isinstance(item, Delivery):
                powers_dbm[station] = item.rssi_dbm
    return np.array([powers_dbm[station] for station in range(1, count)])


@pytest.mark.parametrize("model", ["two_slopes", "two_slopes:TwoSlopes"])
def test_frames_have_the_loss_of_free_space_up_to_the_breakpoint_and_more_beyond(model):
    distances_m = [2.0, 19.9, 40.0, 60.0, 1_000.0]
    free_dbm = received_dbm("friis", distances_m[:4])
    own_dbm = received_dbm(RadioModel(model=model, settings=SETTINGS), distances_m)
    # 30 dB more per decade beyond 20 m
    assert own_dbm[:4] - free_dbm == pytest.approx([0.0, 0.0, -30.0 * log10(2.0), -30.0 * log10(3.0)])
    assert np.isnan(own_dbm[4])  # 51 dB more than free space


def test_wrong_settings_are_refused_when_the_scenario_is_read():
    expected = r"radio\.path_loss\.settings\.breakpoint_m: expected `float` >= 1\.0"
    with pytest.raises(ScenarioError, match=expected):
        load(SCENARIO, ["radio.path_loss.settings.breakpoint_m=0.5"])


def test_a_loss_that_no_frame_overcomes_reaches_the_radio_of_a_swarm(swarm):
    # 1 m is the least distance, with 47 dB; a frame of -20 dBm arrives above -82 dBm within 1.6 m only
    losses = ["radio.path_loss.settings.breakpoint_m=1", "radio.path_loss.settings.exponent_beyond=8"]
    flight = swarm(SCENARIO, overrides=[*losses, "radio.tx_power_dbm=-20"])
    truth = flight.run_for(8.0)
    assert truth.alive.all()
    frames = flight.summary(draw=False)["frames"]
    assert frames["sent"] > 0
    assert frames["delivered"] == 0


def test_the_flight_is_the_same_in_one_process_and_in_many(tmp_path):
    hashes = set()
    for kind in (Swarm, OneProcessSwarm):
        with kind(SCENARIO, seed=2, out=tmp_path / kind.__name__) as flight:
            flight.run(until_s=8.0)
            summary = flight.summary(draw=False)
            assert summary["frames"]["delivered"] > 0
            hashes.add(summary["log_sha256"])
    assert len(hashes) == 1
