"""Link budgets: path loss, the ray that the ground reflects, antennas that tilt. Under 2 s."""

from itertools import product
from math import cos, log10, pi, radians, sin, sqrt

import numpy as np
import pytest
from msgspec import structs
from netsim_swarm import make_links

from netsim.model.config import InterfererConfig, RadioConfig, StationConfig
from netsim.phy.antenna import UNPOLARISED
from netsim.phy.path_loss import (
    LEAST_HEIGHT_M,
    SPEED_OF_LIGHT_M_S,
    ground_permittivity,
    ground_ray,
    reflection,
    two_ray_gain,
)
from netsim.phy.propagation import FARTHEST_PLACE_M, FASTEST_M_S, Trajectories, is_possible

MHZ = 5180.0
WAVE_NUMBER = 2.0 * pi * MHZ * 1e6 / SPEED_OF_LIGHT_M_S
LEVEL = (1.0, 0.0, 0.0, 0.0)
REST = (0.0, 0.0, 0.0)


def rolled(degrees):
    """About the body's x, which points north."""
    return (cos(radians(degrees) / 2), sin(radians(degrees) / 2), 0.0, 0.0)


def pitched(degrees):
    return (cos(radians(degrees) / 2), 0.0, sin(radians(degrees) / 2), 0.0)


def yawed(degrees):
    return (cos(radians(degrees) / 2), 0.0, 0.0, sin(radians(degrees) / 2))


def budget(places, attitudes=None, seed=5, **settings):
    """(Links, Trajectories) of stations at rest at these places."""
    config = RadioConfig(frequency_mhz=MHZ, rician_k_db=None, **settings)
    trajectories = Trajectories(len(places))
    links = make_links(config, trajectories, len(places), seed=seed)
    trajectories.set(0, list(places), [REST] * len(places), attitudes)
    return links, trajectories


def power_dbm(places, attitudes=None, **settings):
    """From the first to the second."""
    return 10.0 * log10(budget(places, attitudes, **settings)[0].row(0, 0).powers_mw[1])


def test_friis_equals_a_power_law_with_exponent_two():
    places = [(0.0, 0.0, 0.0), (30.0, 40.0, -10.0)]
    friis = power_dbm(places, path_loss="friis", path_loss_exponent=3.7)
    assert friis == pytest.approx(power_dbm(places, path_loss="log_distance", path_loss_exponent=2.0))
    assert power_dbm(places, path_loss_exponent=3.0) == pytest.approx(friis - 10.0 * log10(sqrt(2600.0)))


def test_array_and_kernel_budgets_are_equal():
    rng = np.random.default_rng(3)
    places = [tuple(place) for place in rng.uniform(-300.0, 300.0, (9, 3)).tolist()]
    plain, _ = budget(places, path_loss_exponent=2.3)
    arrays, _ = budget(places, path_loss_exponent=2.3, nlos_fraction=1.0, nlos_loss_db=0.0)
    for source in range(9):
        assert plain.row(source, 0).powers_mw == pytest.approx(arrays.row(source, 0).powers_mw, rel=1e-12)
        assert plain.row(source, 0).delays_ns.tolist() == arrays.row(source, 0).delays_ns.tolist()


# --- the ground


def test_fresnel_coefficients_at_special_angles():
    def at(sine, permittivity):
        place = np.array([[0.0, 0.0, -10.0]])
        angle = {"sine": np.array([[sine]]), "cosine": np.array([[sqrt(1.0 - sine**2)]])}
        ray = structs.replace(ground_ray(place, place, np.zeros((1, 1))), **angle)
        vertical, horizontal = reflection(permittivity, ray)
        return complex(vertical[0, 0]), complex(horizontal[0, 0])

    # straight down (n - 1) / (n + 1), with the signs of the convention; n^2 = 9
    assert at(1.0, 9.0 + 0j) == (pytest.approx(0.5), pytest.approx(-0.5))
    # no vertically polarised reflection at Brewster's angle, sin^2 = 1 / (1 + 9)
    assert abs(at(sqrt(0.1), 9.0 + 0j)[0]) < 1e-12
    # along the ground both fields are turned over
    assert at(1e-9, 9.0 + 0j) == (pytest.approx(-1.0), pytest.approx(-1.0))
    assert at(0.5, -1e14j) == (pytest.approx(1.0, abs=1e-6), pytest.approx(-1.0, abs=1e-6))


def test_ground_is_medium_dry_by_the_recommendation():
    # ITU-R P.2040-3, table 3, at 5.18 GHz: 15 * 5.18^-0.1 and 17.98 * 0.035 * 5.18^0.63
    permittivity = ground_permittivity(MHZ)
    assert permittivity.real == pytest.approx(12.73, abs=0.01)
    assert permittivity.imag == pytest.approx(-1.774, abs=0.005)


def two_fields(place, other, frequency_mhz):
    """Sum of the direct ray and the image's in complex numbers, against 1 / m."""
    wave_number = 2.0 * pi * frequency_mhz * 1e6 / SPEED_OF_LIGHT_M_S
    direct_m = float(np.linalg.norm(other - place))
    image_m = float(np.linalg.norm(other - place * (1.0, 1.0, -1.0)))
    sine = -(place[2] + other[2]) / image_m
    permittivity = ground_permittivity(MHZ)
    root = (permittivity - 1.0 + sine**2) ** 0.5
    gamma = (permittivity * sine - root) / (permittivity * sine + root)
    return (
        np.exp(-1j * wave_number * direct_m) / direct_m
        + gamma * np.exp(-1j * wave_number * image_m) / image_m
    )


def test_two_rays_are_the_sum_of_both_fields_averaged_over_the_channel():
    rng = np.random.default_rng(4)
    for width_mhz in (20, 80):
        for _ in range(20):
            place, other = rng.uniform((-200.0, -200.0, -60.0), (200.0, 200.0, -0.5), (2, 3))
            over_channel = [
                abs(two_fields(place, other, MHZ + offset)) ** 2
                for offset in (np.arange(200) + 0.5) / 200 * width_mhz - width_mhz / 2
            ]
            free_space_dbm = power_dbm([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)], path_loss="friis")
            expected_dbm = free_space_dbm + 10.0 * log10(np.mean(over_channel))
            places = [tuple(place), tuple(other)]
            assert power_dbm(places, path_loss="two_ray", bandwidth_mhz=width_mhz) == pytest.approx(
                expected_dbm, abs=0.01
            )


def test_far_away_the_power_falls_with_the_fourth_power_of_the_distance():
    # kD = 2 k h^2 / d = 0.090 at 2.4 km and h = 1 m, where the reflection is -1 but for
    # 2 e sin / sqrt(e - 1) = 0.006: power (2 k h^2 / d)^2 within 2 %
    places = [(0.0, 0.0, -1.0), (2_400.0, 0.0, -1.0)]
    ratio = 10 ** ((power_dbm(places, path_loss="two_ray") - power_dbm(places, path_loss="friis")) / 10.0)
    assert ratio == pytest.approx((2.0 * WAVE_NUMBER / 2_400.0) ** 2, rel=0.02)
    beyond = power_dbm([places[0], (4_796.0, 0.0, -1.0)], path_loss="two_ray")
    assert power_dbm(places, path_loss="two_ray") - beyond == pytest.approx(
        40.0 * log10(4796.0 / 2400.0), abs=0.1
    )


def test_landed_station_is_received_with_its_antenna_above_ground():
    # both on the ground, where the fields of an antenna at height 0 would cancel altogether
    landed = [(0.0, 0.0, 0.0), (100.0, 0.0, 0.0)]
    lifted = [(0.0, 0.0, -LEAST_HEIGHT_M), (100.0, 0.0, -LEAST_HEIGHT_M)]
    assert power_dbm(landed, path_loss="two_ray") == pytest.approx(power_dbm(lifted, path_loss="two_ray"))
    fall_db = power_dbm(landed, path_loss="two_ray") - power_dbm(landed, path_loss="friis")
    # 2 k h^2 / d = 0.022; the reflection is -1 but for 0.015, beside it in phase
    assert fall_db == pytest.approx(20.0 * log10(2.0 * WAVE_NUMBER * LEAST_HEIGHT_M**2 / 100.0), abs=3.0)


# --- antennas


def test_upright_dipoles_side_by_side_have_their_peak_gain():
    places = [(0.0, 0.0, -50.0), (20.0, 30.0, -50.0)]
    isotropic = power_dbm(places, antenna_gain_dbi=2.15)
    for attitudes in (None, [LEVEL, yawed(70.0)]):
        assert power_dbm(places, attitudes, antenna="dipole", antenna_gain_dbi=2.15) == pytest.approx(
            isotropic
        )


@pytest.mark.parametrize("elevation_deg", [15.0, 30.0, 45.0, 60.0])
def test_gain_falls_with_elevation_as_a_half_wave_dipoles(elevation_deg):
    # both see each other at the angle theta = 90 - elevation from their axes; power F^4, and the floor
    place = (100.0 * cos(radians(elevation_deg)), 0.0, -100.0 * sin(radians(elevation_deg)))
    theta = radians(90.0 - elevation_deg)
    gain = (cos(pi / 2 * cos(theta)) / sin(theta)) ** 2
    floor = UNPOLARISED * gain + UNPOLARISED**2 / 2
    expected_db = 10 * log10((gain**2 + floor) / (1 + UNPOLARISED + UNPOLARISED**2 / 2))
    fall_db = power_dbm([REST, place], antenna="dipole") - power_dbm([REST, place])
    assert fall_db == pytest.approx(expected_db, abs=1e-6)
    # which is the textbook's pattern within 0.6 dB as far as 60 degrees
    assert fall_db == pytest.approx(20 * log10(gain), abs=0.6)


def test_crossed_and_end_on_dipoles_have_realistic_loss():
    north = [REST, (100.0, 0.0, 0.0)]
    loss_db = {
        "crossed": power_dbm(north) - power_dbm(north, [LEVEL, rolled(90.0)], antenna="dipole"),
        "end": power_dbm(north) - power_dbm(north, [LEVEL, pitched(90.0)], antenna="dipole"),
        "ends": power_dbm(north) - power_dbm(north, [pitched(90.0)] * 2, antenna="dipole"),
    }
    assert loss_db == {
        "crossed": pytest.approx(20.0, abs=0.05),
        "end": pytest.approx(23.0, abs=0.1),
        "ends": pytest.approx(43.0, abs=0.1),
    }


def test_polarisation_is_lost_by_the_cosine_of_the_angle_between_the_dipoles():
    # rolling about the way between the two changes no pattern, only the angle of the polarisations
    north = [REST, (100.0, 0.0, 0.0)]
    for degrees in (10.0, 30.0, 60.0, 85.0):
        loss = 10 ** ((power_dbm(north, [LEVEL, rolled(degrees)], antenna="dipole") - power_dbm(north)) / 10)
        assert loss == pytest.approx(cos(radians(degrees)) ** 2, abs=UNPOLARISED)
        together = power_dbm(north, [rolled(degrees), rolled(degrees)], antenna="dipole")
        assert together == pytest.approx(power_dbm(north))


def dipole_field(axis, direction):
    """Balanis's far field as a vector, across the direction."""
    cosine = axis @ direction
    return cos(pi / 2 * cosine) / (1 - cosine**2) * (axis - cosine * direction)


def rotated_z(q):
    """Third column of the rotation, by the quaternion's product q k q*."""
    w, v = q[0], np.array(q[1:])
    k = np.array([0.0, 0.0, 1.0])
    return k + 2.0 * w * np.cross(v, k) + 2.0 * np.cross(v, np.cross(v, k))


def test_tilted_dipoles_over_the_ground_are_the_sum_of_two_field_vectors():
    """The reflected vector by cross products with the plane of incidence, for attitudes of all kinds."""
    rng = np.random.default_rng(6)
    permittivity = ground_permittivity(MHZ)
    free_space_mw = 10 ** (power_dbm([REST, (1.0, 0.0, 0.0)], path_loss="friis") / 10)
    for _ in range(40):
        place, other = rng.uniform((-80.0, -80.0, -60.0), (80.0, 80.0, -1.0), (2, 3))
        attitudes = rng.normal(size=(2, 4))
        attitudes = [tuple(q / np.linalg.norm(q)) for q in attitudes]
        axis, other_axis = (rotated_z(q) for q in attitudes)
        direct_m = np.linalg.norm(other - place)
        towards = (other - place) / direct_m
        image_m = np.linalg.norm(other - place * (1, 1, -1))
        before = (other * (1, 1, -1) - place) / image_m
        after = (other - place * (1, 1, -1)) / image_m
        side = np.cross(before, (0.0, 0.0, -1.0))
        side /= np.linalg.norm(side)
        up_before, up_after = np.cross(side, before), np.cross(side, after)
        sine = -after[2]
        root = (permittivity - 1 + sine**2) ** 0.5
        gamma_v = (permittivity * sine - root) / (permittivity * sine + root)
        gamma_h = (sine - root) / (sine + root)
        sent = dipole_field(axis, before)
        reflected = gamma_v * (sent @ up_before) * up_after + gamma_h * (sent @ side) * side
        direct = dipole_field(axis, towards) @ dipole_field(other_axis, -towards) / direct_m
        by_ground = reflected @ dipole_field(other_axis, -after) / image_m
        # the product of the fields is averaged over the channel of 20 MHz
        detour_m = image_m - direct_m
        mean = np.sinc(20e6 * detour_m / SPEED_OF_LIGHT_M_S)
        turned = by_ground * np.exp(-1j * WAVE_NUMBER * detour_m)
        polarised = direct**2 + abs(turned) ** 2 + 2 * direct * turned.real * mean
        gains = [
            [np.sum(dipole_field(a, way) ** 2) for a, way in ((axis, out), (other_axis, -into))]
            for out, into in ((towards, towards), (before, after))
        ]
        beside = 0.0
        for (near, far), way_m, kept in (
            (gains[0], direct_m, 1.0),
            (gains[1], image_m, (abs(gamma_v) ** 2 + abs(gamma_h) ** 2) / 2),
        ):
            beside += UNPOLARISED / 2 * (near + far + UNPOLARISED) * kept / way_m**2
        expected_mw = free_space_mw * (polarised + beside) / (1 + UNPOLARISED + UNPOLARISED**2 / 2)
        links, _ = budget(
            [tuple(place), tuple(other)],
            attitudes,
            antenna="dipole",
            path_loss="two_ray",
            bandwidth_mhz=20,
        )
        assert links.row(0, 0).powers_mw[1] == pytest.approx(expected_mw, rel=1e-6)


@pytest.mark.parametrize(
    ("antenna", "path_loss"), list(product(("isotropic", "dipole"), ("friis", "two_ray")))
)
def test_links_are_the_same_in_both_directions_and_finite_everywhere(antenna, path_loss):
    rng = np.random.default_rng(8)
    stations = 12
    places = [tuple(place) for place in rng.uniform((-60.0, -60.0, -40.0), (60.0, 60.0, 0.0), (stations, 3))]
    places[1], places[3] = places[0], (*places[2][:2], -30.0)  # one inside and one over another
    attitudes = [tuple(q / np.linalg.norm(q)) for q in rng.normal(size=(stations, 4))]
    links, _ = budget(
        places, attitudes, antenna=antenna, path_loss=path_loss, shadowing_std_db=6.0, nlos_fraction=0.4
    )
    powers = np.array([links.row(i, 0).powers_mw for i in range(stations)])
    assert np.isfinite(powers).all()
    assert (powers + np.eye(stations) > 0.0).all()
    assert powers == pytest.approx(powers.T, rel=1e-9)


def test_attitudes_matter_only_for_dipoles():
    north = [REST, (100.0, 0.0, 0.0)]
    for antenna, same in (("isotropic", True), ("dipole", False)):
        links, trajectories = budget(north, [LEVEL, LEVEL], antenna=antenna)
        row = links.row(0, 0)
        trajectories.set(4_000_000, north, [REST] * 2, [LEVEL, rolled(20.0)])
        assert (links.row(0, 4_000_000) is row) is same


# --- stations and interferers


def test_station_power_overrides_the_common_one():
    places = [REST, (10.0, 0.0, 0.0), (0.0, 10.0, 0.0)]
    links, _ = budget(places, tx_power_dbm=10.0, stations=(StationConfig(station=1, tx_power_dbm=23.0),))
    assert links.row(1, 0).powers_mw[0] / links.row(0, 0).powers_mw[1] == pytest.approx(10**1.3)
    assert links.row(2, 0).powers_mw[0] == pytest.approx(links.row(0, 0).powers_mw[2])


def test_an_interferer_arrives_with_its_power_and_the_receivers_gain():
    interferer = InterfererConfig(pos_ned_m=(100.0, 0.0, 0.0), eirp_dbm=20.0, duty_cycle=0.5)
    places = [REST, (0.0, 0.0, -80.0)]
    settings = {"antenna_gain_dbi": 3.0, "path_loss": "friis", "interferers": (interferer,)}
    links, _ = budget(places, **settings)
    links.set_extra_attenuation_db(30.0)
    row = links.interferer_row(0, 0)
    # 20 + 3 dB less Friis's 86.73 dB at 100 m
    assert 10 * log10(row.powers_mw[0]) == pytest.approx(20.0 + 3.0 - 86.73, abs=0.01)
    assert row.delays_ns[0] == 334
    # a dipole takes up half of what has any polarisation
    upright, _ = budget(places, antenna="dipole", **settings)
    assert upright.interferer_row(0, 0).powers_mw[0] == pytest.approx(row.powers_mw[0] / 2, rel=0.01)
    # and both rays together stay within 6 dB of one
    ground, _ = budget(places, **{**settings, "path_loss": "two_ray"})
    assert 0.0 < ground.interferer_row(0, 0).powers_mw[1] < 4.0 * row.powers_mw[1]


def test_two_rays_of_a_narrow_channel_have_notches_that_a_wide_one_has_not():
    # equal fields against each other leave nothing; over an 80 MHz channel and 3.7 m it is the powers' sum
    direct_m = np.array([[100.0]])
    ray = ground_ray(np.array([[0.0, 0.0, -10.0]]), np.array([[100.0, 0.0, -10.0]]), direct_m)
    detour_m = np.array([[SPEED_OF_LIGHT_M_S / 80e6]])
    ray = structs.replace(ray, distance_m=direct_m, detour_m=detour_m)
    against = -np.exp(2j * pi * MHZ * 1e6 * detour_m / SPEED_OF_LIGHT_M_S)
    assert two_ray_gain(direct_m, ray, 1.0, against, MHZ, 1e-3) * 1e4 == pytest.approx(0.0, abs=1e-6)
    assert two_ray_gain(direct_m, ray, 1.0, against, MHZ, 80.0) * 1e4 == pytest.approx(2.0)


def test_attitudes_need_not_be_of_unit_length():
    places = [(0.0, 0.0, -10.0), (20.0, 0.0, -13.0)]
    unit = power_dbm(places, [LEVEL, rolled(30.0)], antenna="dipole")
    longer = [(3.0, 0.0, 0.0, 0.0), tuple(0.2 * part for part in rolled(30.0))]
    assert power_dbm(places, longer, antenna="dipole") == pytest.approx(unit)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, "too large"])
@pytest.mark.parametrize("which", range(3))
def test_one_invalid_number_makes_a_motion_invalid(which, wrong):
    """Wherever it stands: no number, no finite one, or one farther, faster or longer than anything is."""
    limits = (FARTHEST_PLACE_M, FASTEST_M_S, 1.0)
    motion = np.full((4, 3), -limits[0]), np.full((4, 3), limits[1]), np.tile(rolled(30.0), (4, 1))
    assert is_possible(*motion)
    for index in np.ndindex(motion[which].shape):
        kept, motion[which][index] = (
            motion[which][index],
            1.1 * limits[which] if wrong == "too large" else wrong,
        )
        assert not is_possible(*motion)
        motion[which][index] = kept
    assert is_possible(*motion)
