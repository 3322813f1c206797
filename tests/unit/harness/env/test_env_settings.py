"""Layout of observations and actions: names, bounds, ages, order of the neighbours."""

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.env.settings import MOST_AGE_S, NEIGHBOUR, OWN, EnvSettings, Neighbours

METRES = st.floats(-1e6, 1e6)
VECTORS = st.tuples(METRES, METRES, METRES)


@given(agents=st.integers(1, 12), size=st.integers(0, 5))
def test_each_element_has_one_name_and_bounds_in_order(agents, size):
    settings = EnvSettings(message_size=size)
    names = settings.observation_names(agents)
    low, high = settings.observation_bounds(agents)
    assert len(names) == len(set(names)) == len(OWN) + (agents - 1) * (len(NEIGHBOUR) + size)
    assert low.shape == high.shape == (len(names),)
    assert (low < high).all()


@given(
    agents=st.integers(1, 6), uav=st.integers(0, 5), size=st.integers(0, 3), pos=VECTORS, vel=VECTORS,
    now_us=st.integers(0, 10**10),
)  # fmt: skip
def test_an_observation_has_as_many_elements_as_names(agents, uav, size, pos, vel, now_us):
    neighbours = Neighbours(uav % agents, agents, size)
    row = neighbours.observation(now_us, pos_ned_m=pos, vel_ned_m_s=vel, place_ned_m=(0.0, 0.0, 0.0))
    assert row.shape == (len(EnvSettings(message_size=size).observation_names(agents)),)
    assert np.isfinite(row).all()


def named(neighbours, settings, agents, now_us, pos_ned_m=(1.0, 2.0, -3.0)):
    row = neighbours.observation(
        now_us, pos_ned_m=pos_ned_m, vel_ned_m_s=(0.1, 0.2, 0.3), place_ned_m=(4.0, 4.0, -4.0)
    )
    return dict(zip(settings.observation_names(agents), row.tolist(), strict=True))


def test_beacons_and_ranges_appear_under_the_sender_with_their_ages():
    settings = EnvSettings(message_size=1)
    neighbours = Neighbours(2, 4, 1)
    neighbours.on_beacon(
        3, 1_000_000, pos_ned_m=(11.0, 2.0, -3.0), vel_ned_m_s=(1.0, 0.0, 0.0), message=(0.5,)
    )
    neighbours.on_range(1, 1_500_000, 7.25)
    row = named(neighbours, settings, 4, 2_000_000)
    assert [row[f"next_1_{name}"] for name in ("pos_n_m", "pos_e_m", "vel_n_m_s")] == [10.0, 0.0, 1.0]
    assert row["next_1_beacon_age_s"] == pytest.approx(1.0)
    assert row["next_1_message_0"] == 0.5
    assert row["next_1_range_age_s"] == MOST_AGE_S  # no range to UAV 3
    # UAV 1 is the third after UAV 2 of four: 3, 0, 1
    assert (row["next_3_range_m"], row["next_3_range_age_s"]) == (7.25, pytest.approx(0.5))
    assert row["next_3_beacon_age_s"] == MOST_AGE_S
    assert row["next_3_pos_n_m"] == 0.0  # without a beacon, not minus the own position


def test_own_elements_are_the_way_to_the_place_the_position_and_the_velocity():
    row = named(Neighbours(0, 1, 0), EnvSettings(), 1, 0)
    assert list(row.values()) == [3.0, 2.0, -1.0, 1.0, 2.0, -3.0, 0.1, 0.2, 0.3]
    assert tuple(row) == OWN


def test_a_beacon_received_long_ago_is_as_old_as_none():
    neighbours = Neighbours(0, 2, 0)
    neighbours.on_beacon(1, 0, pos_ned_m=(5.0, 0.0, 0.0), vel_ned_m_s=(0.0, 0.0, 0.0), message=())
    row = named(neighbours, EnvSettings(), 2, 60_000_000)
    assert row["next_1_beacon_age_s"] == MOST_AGE_S
    assert row["next_1_pos_n_m"] == 4.0


def test_chosen_radio_adds_two_elements_to_actions():
    scheduled = EnvSettings(message_size=2).action_names()
    assert scheduled == ("vel_n", "vel_e", "vel_d", "message_0", "message_1")
    chosen = EnvSettings(setpoint="acceleration", message_size=2, radio="chosen").action_names()
    assert chosen == ("acc_n", "acc_e", "acc_d", "message_0", "message_1", "send", "range")


def test_settings_out_of_range_are_refused():
    with pytest.raises(msgspec.ValidationError, match="speed_max_m_s"):
        msgspec.convert({"speed_max_m_s": -1.0}, EnvSettings)
