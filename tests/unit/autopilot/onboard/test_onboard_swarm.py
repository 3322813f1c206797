"""Eight applications on a lossy radio: benefit of ranging, and effect of faults."""

import numpy as np
import pytest
from onboard_world import Errors, SwarmWorld, article_places_ned_m, rms, shape_errors_m

from autopilot.parameters.onboard_config import OnboardConfig

PLACES = article_places_ned_m()
FORMATION_S = 15.0


def fly(seed=1, *, places=PLACES, formation_s=FORMATION_S, **kwargs):
    w = SwarmWorld(places_ned_m=places, seed=seed, **kwargs)
    w.run_until(lambda w: w.formed(), limit_s=40.0)
    w.formed_s = w.now_us * 1e-6
    w.run(formation_s)
    return w


def shape_rms_m(w, since_s=None, members=None):
    members = list(range(w.n)) if members is None else members
    truth, _ = w.flown(since_s=w.formed_s if since_s is None else since_s)
    return rms([shape_errors_m(row[members], w.places[members]) for row in truth])


def estimated_shape_rms_m(w):
    """Return the rms shape error of all UAVs' estimates of their own positions."""
    truth, estimates = w.flown(since_s=w.formed_s)
    return rms([shape_errors_m(*rows) for rows in zip(estimates, truth, strict=True)])


@pytest.fixture(scope="module")
def flown():
    return fly()


def test_with_ranging_the_flown_shape_is_within_25_cm(flown):
    assert shape_rms_m(flown) < 0.25


def test_gps_alone_is_at_least_five_times_worse(flown):
    alone = fly(config=OnboardConfig(localisation="gps"))
    assert shape_rms_m(alone) > 5.0 * shape_rms_m(flown)


def test_the_shape_of_all_own_estimates_has_the_predicted_accuracy(flown):
    # Each filter has its own data; the result requires that they agree on the heading of the whole.
    predicted_m = flown.apps[0].application.localisation.shape_std_m(flown.now_us)
    assert predicted_m < 0.12
    assert estimated_shape_rms_m(flown) < 1.25 * predicted_m


def height_rms_m(w):
    truth, _ = w.flown(since_s=w.formed_s)
    return rms(truth[:, :, 2] - w.places[:, 2])


def test_autopilots_whose_height_follows_their_gps_fly_as_well_as_with_a_barometric_height(flown):
    errors = Errors(gps_height_std_m=2.5, barometer_steps_m=3.0)
    w = fly(errors=errors)
    assert height_rms_m(w) < 1.3 * height_rms_m(flown) + 0.05
    assert shape_rms_m(w) < 1.2 * shape_rms_m(flown)
    assert {app.troubles()["height_steps"] for app in w.apps} <= {0, 1}


def test_uavs_keep_their_distance(flown):
    assert flown.least_distance_m > 1.2


def test_30_percent_loss_increases_the_errors_by_less_than_a_half(flown):
    lossy = fly(errors=Errors(radio_loss=0.3))
    assert estimated_shape_rms_m(lossy) < 1.5 * estimated_shape_rms_m(flown)
    assert shape_rms_m(lossy) < 1.5 * shape_rms_m(flown)


def test_the_shape_recovers_after_ten_seconds_without_a_channel():
    w = fly(seed=2, formation_s=3.0)
    w.radio_cut = True
    w.run(10.0)
    w.radio_cut = False
    w.run(10.0)
    back_s = w.now_us * 1e-6
    w.run(3.0)
    assert w.least_distance_m > 0.6
    assert shape_rms_m(w, since_s=back_s) < 0.3


def test_a_ranging_error_of_5_m_of_one_uav_displaces_the_others_by_less_than_30_cm():
    w = SwarmWorld(places_ned_m=PLACES, seed=3)
    w.run_until(lambda w: w.formed(), limit_s=40.0)
    w.range_error_m[2] = 5.0
    w.run(2.0)
    since_s = w.now_us * 1e-6
    w.run(8.0)
    assert shape_rms_m(w, since_s=since_s, members=[0, 1, 3, 4, 5, 6, 7]) < 0.3


def test_the_others_continue_when_one_fails():
    w = fly(seed=4, formation_s=1.0)
    w.dead.add(5)
    requests = []
    transmit = w._transmit
    w._transmit = lambda i, item: (
        requests.append((w.now_us, getattr(item, "peer", None))),
        transmit(i, item),
    )[1]
    w.run(8.0)
    # 3 s after its last beacon no UAV ranges to the failed one
    last_us = max(now_us for now_us, peer in requests if peer == 5)
    assert last_us < round(w.formed_s * 1e6) + 1_000_000 + 3_200_000
    assert shape_rms_m(w, since_s=w.now_us * 1e-6 - 4.0, members=[0, 1, 2, 3, 4, 6, 7]) < 0.3


@pytest.mark.parametrize("gust_std_m_s2", [0.15, 0.35])
def test_uavs_at_half_the_spacing_do_not_touch_after_a_permanent_channel_loss(gust_std_m_s2):
    """An odometry drift of 0.085 m per root second is small against a gap of 0.65 m for a short time only."""
    places = article_places_ned_m(spacing_east_m=4.25, spacing_north_m=1.25)
    w = fly(seed=5, places=places, formation_s=2.0, errors=Errors(gust_std_m_s2=gust_std_m_s2))
    w.radio_cut, w.least_distance_m = True, np.inf
    w.run(20.0)
    assert w.least_distance_m > 0.6


def test_uavs_at_half_the_spacing_do_not_touch():
    places = article_places_ned_m(spacing_east_m=4.25, spacing_north_m=1.25)
    w = fly(seed=5, places=places, formation_s=10.0, errors=Errors(gust_std_m_s2=0.15))
    assert w.least_distance_m > 0.5
    assert np.isfinite(shape_rms_m(w))
