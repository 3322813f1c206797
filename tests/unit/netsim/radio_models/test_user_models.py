"""Models of users take the place of the built-in ones: those that compute the same give the same frames."""

from math import cos, radians, sin

import numpy as np
import pytest
from netsim_swarm import Swarm, make_links

from netsim.model.config import InterfererConfig, RadioConfig, RadioModel
from netsim.model.random_streams import RandomStreams
from netsim.phy.errors import error_table, packet_error_rate
from netsim.phy.modes import phy_mode
from netsim.phy.path_loss import friis_loss_db
from netsim.phy.propagation import Trajectories
from netsim.radio_models.registry import make_models
from netsim.wire.messages import Delivery

PLACES = [(0.0, 0.0, -10.0), (20.0, 5.0, -12.0), (-60.0, 30.0, -8.0), (90.0, -250.0, -30.0)]
POWER_LAW = RadioModel(model="user_radio_models:PowerLaw", settings={"exponent": 2.7})


def moving(at_s):
    """Places and velocities of stations that fly apart."""
    velocities = np.array([(3.0, 0.0, 0.0), (0.0, -4.0, 0.5), (-2.0, 1.0, 0.0), (5.0, -5.0, 0.0)])
    return np.array(PLACES) + at_s * velocities, velocities


def traffic(*, motion=moving, **settings):
    """Fates of all frames, receptions and ranging results of 0.4 s of dense traffic."""
    ended = []
    swarm = Swarm(PLACES, motion=motion, on_transmission=ended.append, **settings)
    for at_us in range(1_000, 400_000, 4_000):
        swarm.broadcast(at_us // 4_000 % 4, at_us, payload=bytes(400))
        if at_us % 20_000 == 1_000:
            swarm.request(0, 1, at_us)
    swarm.run(480_000)
    frames = [
        (each.source, each.start_ns, each.delivered, each.collided, each.lost_to_noise) for each in ended
    ]
    powers_dbm = [item.rssi_dbm for _, item in swarm.received if isinstance(item, Delivery)]
    others = [item for _, item in swarm.received if not isinstance(item, Delivery)]
    return frames, powers_dbm, others


ARRAYS = {"nlos_fraction": 1.0, "nlos_loss_db": 0.0}
"""Without effect on powers; the built-in power law is then computed for the same times as a user's."""


@pytest.mark.parametrize(
    "settings",
    [
        {"motion": None},
        {"motion": None, "rician_k_db": None},
        {"motion": None, "channel": "ideal"},
        {**ARRAYS, "motion": moving},
    ],
)
def test_a_power_law_of_a_user_gives_the_frames_of_the_built_in_one(settings):
    frames, powers_dbm, rangings = traffic(path_loss_exponent=2.7, **settings)
    of_user, of_user_dbm, of_user_rangings = traffic(path_loss=POWER_LAW, **settings)
    assert any(frame[4] for frame in frames)  # some are lost to noise
    assert of_user == frames
    assert of_user_dbm == pytest.approx(powers_dbm, abs=1e-9)
    assert [each.status for each in of_user_rangings] == [each.status for each in rangings]


def test_in_motion_the_frames_differ_by_nanoseconds_of_delay_from_those_of_the_kernel():
    # computed for the beginning of a cell of 4 ms, in which stations move 3 cm, instead of that of the frame
    frames, powers_dbm, _ = traffic(path_loss_exponent=2.7, motion=moving, access="dcf")
    of_user, of_user_dbm, _ = traffic(path_loss=POWER_LAW, motion=moving, access="dcf")
    assert [(frame[0], *frame[2:]) for frame in of_user] == [(frame[0], *frame[2:]) for frame in frames]
    differences_ns = np.array([frame[1] for frame in of_user]) - [frame[1] for frame in frames]
    assert 0 < np.abs(differences_ns).max() <= 20
    assert of_user_dbm == pytest.approx(powers_dbm, abs=0.02)


def test_budgets_at_rest_are_those_of_the_built_in_power_law_to_rounding():
    rng = np.random.default_rng(3)
    for stations in (5, 20):  # all links together, or a station's at once
        places = rng.uniform(-300.0, 300.0, (stations, 3))
        rows = []
        for path_loss in (POWER_LAW, "log_distance"):
            trajectories = Trajectories(stations)
            links = make_links(
                RadioConfig(rician_k_db=None, path_loss=path_loss, path_loss_exponent=2.7),
                trajectories,
                stations,
                1,
            )
            trajectories.set(0, places, np.zeros((stations, 3)))
            rows.append([links.row(source, 0) for source in range(stations)])
        for own, built_in in zip(*rows, strict=True):
            assert own.powers_mw == pytest.approx(built_in.powers_mw, rel=1e-12)
            assert own.delays_ns.tolist() == built_in.delays_ns.tolist()


def test_a_function_of_the_distance_is_a_path_loss():
    assert powers_dbm(path_loss="user_radio_models:free_space") == pytest.approx(
        powers_dbm(path_loss="friis")
    )


def powers_dbm(places=PLACES, attitudes=None, **settings):
    """Received powers from the first station, dBm, at rest."""
    trajectories = Trajectories(len(places))
    links = make_links(RadioConfig(**{"rician_k_db": None, **settings}), trajectories, len(places), 1)
    trajectories.set(0, places, np.zeros((len(places), 3)), attitudes)
    return 10.0 * np.log10(links.row(0, 0).powers_mw[1:])


def interferer_dbm(**settings):
    interferer = InterfererConfig(pos_ned_m=(100.0, 0.0, -10.0), duty_cycle=0.5)
    trajectories = Trajectories(2)
    config = RadioConfig(rician_k_db=None, interferers=(interferer,), **settings)
    links = make_links(config, trajectories, 2, 1)
    trajectories.set(0, PLACES[:2], np.zeros((2, 3)))
    return 10.0 * np.log10(links.interferer_row(0, 0).powers_mw)


def test_interferers_have_the_path_loss_and_the_pattern_of_a_user():
    assert interferer_dbm(path_loss=POWER_LAW) == pytest.approx(interferer_dbm(path_loss_exponent=2.7))
    # both stations point to the north: the interferer is ahead of the first, and nearly ahead of the second
    ahead = np.array([1.0, (1.0 + 80.0 / np.linalg.norm((80.0, 5.0, 2.0))) / 2.0])
    cardioid_dbm = interferer_dbm(antenna="user_radio_models:Cardioid")
    assert cardioid_dbm == pytest.approx(interferer_dbm() + 20.0 * np.log10(ahead))


def test_attenuation_and_blockage_apply_to_the_path_loss_of_a_user():
    plain = powers_dbm(path_loss=POWER_LAW)
    settings = {"nlos_fraction": 1.0, "nlos_loss_db": 7.0, "extra_attenuation_db": 5.0}
    assert powers_dbm(path_loss=POWER_LAW, **settings) == pytest.approx(plain - 12.0)


def test_shadowing_of_a_user_adds_to_the_path_loss():
    north = np.array([place[0] > 5.0 for place in PLACES[1:]])
    shadowed = powers_dbm(shadowing="user_radio_models:Wall")
    assert shadowed == pytest.approx(powers_dbm() - 30.0 * north)


def test_a_pattern_turns_with_the_vehicle_and_counts_at_both_ends():
    places = [(0.0, 0.0, -10.0), (0.0, 50.0, -10.0)]  # the second is in the east
    for yaw_deg, other_deg in ((90.0, 0.0), (90.0, -90.0), (30.0, 200.0)):
        attitudes = [(cos(radians(yaw) / 2), 0.0, 0.0, sin(radians(yaw) / 2)) for yaw in (yaw_deg, other_deg)]
        # angles between ahead and the other station, which is east or west
        cosines = np.cos(np.radians([yaw_deg - 90.0, other_deg + 90.0]))
        expected = 20.0 * np.log10(np.prod(0.5 + 0.5 * cosines))
        own = powers_dbm(places, attitudes, antenna="user_radio_models:Cardioid") - powers_dbm(places)
        assert own == pytest.approx(expected, abs=1e-9)


def test_a_pattern_is_computed_alike_for_few_and_for_many_stations():
    rng = np.random.default_rng(4)
    places, attitudes = rng.uniform(-100.0, 100.0, (20, 3)), rng.normal(size=(20, 4))
    attitudes /= np.linalg.norm(attitudes, axis=1)[:, None]
    settings = {"antenna": "user_radio_models:Cardioid"}
    many = powers_dbm(places, attitudes, **settings)
    assert many[:7] == pytest.approx(powers_dbm(places[:8], attitudes[:8], **settings))


def test_a_dipole_as_a_pattern_has_the_gain_of_the_built_in_one_between_upright_vehicles():
    # of equal polarisation; the built-in one has an unpolarised field of 1 % in addition
    own = powers_dbm(antenna="user_radio_models:Dipole")
    assert own == pytest.approx(powers_dbm(antenna="dipole"), abs=0.1)


def test_fading_called_from_python_gives_the_bytes_of_the_kernel():
    settings = {"rician_k_db": 0.0, "fading_doppler_hz": 30.0}
    assert traffic(fading="user_radio_models:Rician", **settings) == traffic(**settings)
    assert traffic(**settings) != traffic(rician_k_db=None)


def test_an_error_model_of_a_user_gives_the_bytes_of_the_built_in_one():
    assert traffic(error_model="user_radio_models:Published") == traffic()


def test_frames_are_lost_by_the_error_model_of_a_user():
    config = RadioConfig(error_model="user_radio_models:LossPerBit")
    streams = RandomStreams(np.random.SeedSequence(1))
    table = error_table(phy_mode("vht_mcs0", 80), make_models(config, 2, streams).error_model)
    assert table.hazard_per_bit(100.0) == pytest.approx(1e-3)
    swarm = Swarm(
        [(0.0, 0.0, -10.0), (10.0, 0.0, -10.0)], error_model="user_radio_models:LossPerBit", rician_k_db=None
    )
    swarm.broadcast(0, 1_000, payload=bytes(1_400))
    swarm.run(20_000)
    assert not swarm.received
    assert swarm.emulator.counters.broadcasts_lost_to_noise[1] == 1
    # the tables of the built-in model are as before
    assert packet_error_rate(phy_mode("vht_mcs0", 80), 1_000, 100.0) < 1e-9


def test_the_random_stream_of_a_model_depends_on_the_seed_alone():
    config = RadioConfig(path_loss="user_radio_models:Drawn")
    losses = [
        make_models(config, 2, RandomStreams(np.random.SeedSequence(seed))).path_loss for seed in (1, 1, 2)
    ]
    distances_m = np.array([[5.0]])
    first, same, other = (float(each.loss_db(None, None, distances_m)[0, 0]) for each in losses)
    assert first == same == losses[0]._model.of_seed_1
    assert first != other
    assert powers_dbm(path_loss="user_radio_models:Drawn") == pytest.approx(
        powers_dbm(path_loss="friis")[0]
        + friis_loss_db(float(np.linalg.norm(np.subtract(PLACES[0], PLACES[1]))), 5210.0)
        - first
    )
