"""Receptions of every frame at every station, against counts, link budgets and the other frames (3 s)."""

import math

import msgspec
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from netsim_swarm import Swarm

from netsim.emulator.records import reception_log_rows
from netsim.model.config import InterfererConfig
from netsim.phy import receptions
from netsim.phy.path_loss import SPEED_OF_LIGHT_M_S, friis_loss_db
from netsim.phy.propagation import thermal_noise_mw
from netsim.phy.receptions import OUTCOMES, STATES

RUN_US = 40_000
PLACES = [(0.0, 0.0, -10.0), (9.0, 0.0, -10.0), (150.0, 0.0, -10.0), (290.0, 5.0, -10.0), (2_000.0, 0, -10.0)]
"""In range of each other, hidden from each other, and out of range."""
DELIVERED, COLLIDED, LOST = (OUTCOMES.index(name) for name in ("delivered", "collided", "lost_to_noise"))


def flown(seed, *, log_receptions=True, silent=None, places=PLACES, **changed):
    """Return the emulator's swarm and all transmissions after traffic drawn from a seed."""
    seen, rng = [], np.random.default_rng(seed)
    swarm = Swarm(places, seed=seed, on_transmission=seen.append, log_receptions=log_receptions, **changed)
    stations = len(places)
    for at_us in range(0, RUN_US, 8_000):
        for station in range(stations):
            for _ in range(rng.integers(0, 4)):
                swarm.broadcast(station, at_us + int(rng.integers(0, 200)), bytes(int(rng.integers(1, 900))))
            other = (station + 1 + int(rng.integers(0, stations - 1))) % stations
            swarm.unicast(station, other, at_us, bytes(200))
            swarm.request(station, other, at_us + 1)
        if silent is not None and at_us == 16_000:
            swarm.emulator.set_silent(silent)
        swarm.run(at_us + 8_000)
    swarm.run(RUN_US + 400_000)
    return swarm, seen


def longest_delay_ns(source):
    """Return the time of propagation from a station to the farthest other one, rounded up."""
    return math.ceil(max(math.dist(PLACES[source], place) for place in PLACES) / SPEED_OF_LIGHT_M_S * 1e9)


@settings(max_examples=12, deadline=None)
@example(seed=80, rts=True, silent=1, interferer=False)
@given(
    seed=st.integers(0, 2**31), rts=st.booleans(), silent=st.sampled_from([None, 1]),
    interferer=st.booleans(),
)  # fmt: skip
def test_counts_of_receptions_are_those_of_the_frames(seed, rts, silent, interferer):
    """And what a receiver did matches its outcome."""
    bursts = (InterfererConfig(pos_ned_m=(20.0, 20.0, 0.0), duty_cycle=0.1),) if interferer else ()
    swarm, seen = flown(seed, broadcast_rts=rts, silent=silent, interferers=bursts)
    frames = swarm.emulator.take_frames()
    assert len(frames) == len(seen) > 50
    for number, (frame, each) in enumerate(zip(frames, seen, strict=True)):
        rows = reception_log_rows(number, each)
        assert set(rows["receiver"]) == set(range(len(PLACES))) - {frame.source}
        assert set(rows["frame"]) == {number}
        assert (set(rows["start_ns"]), set(rows["source"])) == ({frame.start_ns}, {frame.source})
        counts = np.bincount(rows["outcome"], minlength=len(OUTCOMES))
        assert tuple(counts[1:4]) == (frame.delivered, frame.collided, frame.lost_to_noise)
        assert frame.destination == -1 or counts[1:4].sum() <= 1
        for row in rows:
            outcome, state = OUTCOMES[row["outcome"]], STATES[row["reception"]]
            assert outcome != "delivered" or state == "received"
            assert outcome not in ("collided", "lost_to_noise") or state not in ("received", "radio_off")
            assert (outcome == "radio_off") == (state == "radio_off")
            assert (state == "below_sensitivity") <= (row["rx_power_dbm"] < -82.0)
            assert outcome != "collided" or row["rx_power_dbm"] >= -82.0
            # outcomes are determined once the frame has ended at the farthest station, too: a radio that is
            # switched off before that does not receive it
            settled_ns = frame.end_ns + longest_delay_ns(frame.source)
            assert state != "radio_off" or (row["receiver"] == silent and settled_ns > 16_000_000)


@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_the_sinr_is_that_of_the_other_frames_on_the_air(seed):
    """The greatest total power at a begin of another frame, and which stations send, from the frames."""
    _, seen = flown(seed)
    noise_mw = thermal_noise_mw(80, 7.0)
    overlapped = 0
    for each in seen:
        others = [
            other
            for other in seen
            if other is not each
            and other.start_ns < each.end_ns + 20_000
            and each.start_ns < other.end_ns + 20_000
        ]
        for r in set(range(len(PLACES))) - {each.source}:
            begin_ns, end_ns = each.start_ns + each.delays_ns[r], each.end_ns + each.delays_ns[r]
            at_r = [
                (other.start_ns + other.delays_ns[r], other.end_ns + other.delays_ns[r], other)
                for other in others
            ]
            at_r = [(b, e, other) for b, e, other in at_r if b < end_ns and e > begin_ns]
            foreign = [(b, e, other.powers_mw[r]) for b, e, other in at_r if other.source != r]
            instants = [max(b, begin_ns) for b, _, _ in foreign]
            most_mw = max((sum(p for b, e, p in foreign if b <= t < e) for t in instants), default=0.0)
            sinr = each.powers_mw[r] / (noise_mw + most_mw)
            assert each.receptions.sinr[r] == pytest.approx(sinr, rel=1e-9)
            overlapped += most_mw > 0.0
            sends = any(other.source == r for _, _, other in at_r)
            assert sends or each.receptions.states[r] != receptions.TRANSMITTING
            assert not sends or each.receptions.states[r] in (
                receptions.TRANSMITTING, receptions.BELOW_SENSITIVITY,
            )  # fmt: skip
    assert overlapped > 20


@pytest.mark.parametrize("distance_m", [1.0, 30.0, 100.0])
def test_received_power_and_sinr_are_those_of_the_link_budget(distance_m):
    """EIRP minus Friis' loss, and over k T B F: two stations, no fading, no interference."""
    seen = []
    settings = {"path_loss": "friis", "rician_k_db": None, "tx_power_dbm": 13.0, "antenna_gain_dbi": 2.0}
    swarm = Swarm(
        [(0.0, 0.0, -50.0), (0.0, distance_m, -50.0)], on_transmission=seen.append, log_receptions=True,
        broadcast_rts=False, **settings,
    )  # fmt: skip
    swarm.broadcast(0, 0)
    swarm.run(8_000)
    (row,) = reception_log_rows(0, seen[0])
    power_dbm = 13.0 + 2.0 + 2.0 - friis_loss_db(distance_m, 5210.0)
    noise_dbm = -173.975 + 10 * np.log10(80e6) + 7.0
    assert row["rx_power_dbm"] == pytest.approx(power_dbm, abs=1e-4)
    assert row["sinr_db"] == pytest.approx(power_dbm - noise_dbm, abs=1e-2)
    assert OUTCOMES[row["outcome"]] == "delivered"


def test_the_power_of_an_interferer_is_part_of_the_sinr():
    """EIRP minus Friis' loss plus the receiver's gain; at 1 km it is 3 dB above the noise."""
    seen = []
    swarm = Swarm(
        [(0.0, 0.0, -50.0), (0.0, 30.0, -50.0)], on_transmission=seen.append, log_receptions=True,
        path_loss="friis", rician_k_db=None, tx_power_dbm=13.0, antenna_gain_dbi=2.0, broadcast_rts=False,
        interferers=(InterfererConfig(pos_ned_m=(0.0, 1_030.0, -50.0), eirp_dbm=20.0, duty_cycle=1.0),),
    )  # fmt: skip
    swarm.broadcast(0, 4_000)
    swarm.run(12_000)
    power_dbm = 13.0 + 2.0 + 2.0 - friis_loss_db(30.0, 5210.0)
    noise_mw = thermal_noise_mw(80, 7.0)
    interference_mw = 10.0 ** ((20.0 + 2.0 - friis_loss_db(1_000.0, 5210.0)) / 10.0)
    assert interference_mw > noise_mw
    (row,) = reception_log_rows(0, seen[0])
    expected_db = power_dbm - 10.0 * np.log10(noise_mw + interference_mw)
    assert row["sinr_db"] == pytest.approx(expected_db, abs=1e-2)


@pytest.mark.parametrize(("noise_figure_db", "least_dbm"), [(7.0, -82.0), (20.0, -70.95)])
def test_a_frame_is_below_sensitivity_under_the_preamble_power_and_4_db_over_the_noise(
    noise_figure_db, least_dbm
):
    """-82 dBm, or -174 dBm/Hz in 80 MHz with the noise figure and 4 dB more: the greater one."""
    states = {}
    for above_db in (-0.1, 0.1):
        seen = []
        swarm = Swarm(
            [(0.0, 0.0, -50.0), (0.0, 30.0, -50.0)], on_transmission=seen.append, log_receptions=True,
            path_loss="friis", rician_k_db=None, antenna_gain_dbi=0.0, broadcast_rts=False,
            noise_figure_db=noise_figure_db,
            tx_power_dbm=least_dbm + above_db + friis_loss_db(30.0, 5210.0),
        )  # fmt: skip
        swarm.broadcast(0, 0)
        swarm.run(8_000)
        (row,) = reception_log_rows(0, seen[0])
        states[above_db] = STATES[row["reception"]]
    assert states[-0.1] == "below_sensitivity"
    assert states[0.1] != "below_sensitivity"


@pytest.mark.parametrize("channel", ["emulated", "ideal"])
def test_the_log_changes_nothing_else(channel):
    def results(*, log_receptions):
        swarm, seen = flown(5, log_receptions=log_receptions, channel=channel)
        assert all((each.receptions is not None) == log_receptions for each in seen)
        return msgspec.msgpack.encode([swarm.received, swarm.emulator.take_frames(), swarm.emulator.counters])

    assert results(log_receptions=True) == results(log_receptions=False)


def test_on_the_ideal_channel_only_range_and_switched_off_radios_matter():
    swarm, seen = flown(5, channel="ideal", silent=1)
    for number, (frame, each) in enumerate(zip(swarm.emulator.take_frames(), seen, strict=True)):
        rows = reception_log_rows(number, each)
        counts = np.bincount(rows["outcome"], minlength=len(OUTCOMES))
        assert (counts[DELIVERED], counts[COLLIDED], counts[LOST]) == (
            frame.delivered,
            0,
            frame.lost_to_noise,
        )
        assert np.isnan(rows["sinr_db"]).all()
        on = rows[rows["outcome"] != OUTCOMES.index("radio_off")]
        received = [STATES[state] == "received" for state in on["reception"]]
        assert received == (on["rx_power_dbm"] >= -82.0).tolist()
