"""Co-design in flight: a moving formation (many processes), baselines and faults (one process).

One seed each; `studies.codesign` has statistics over many. Some 90 s.
"""

import numpy as np
import pyarrow.parquet as pq
import pytest
from paths import SCENARIOS

from harness.launch.one_process import OneProcessSwarm
from harness.simulator.messages import FormationMoves
from harness.world.faults import RadioAttenuation, RangingBias

pytestmark = pytest.mark.multiprocess

ARTICLE = SCENARIOS / "article.toml"
SMALL = ["formation.columns=2", "antenna.snapshot_rate_hz=0.001"]
"""Four UAVs, two by two"""


def vectors(folder, name, agents, *, axes="ned"):
    """Return times (T,) in s and a recorded vector (T, N, 3)."""
    table = pq.read_table(folder / "flight.parquet")
    time_s = np.array(table["time_us"]).reshape(-1, agents)[:, 0] * 1e-6
    parts = [np.array(table[f"{name}.{axis}"]).reshape(-1, agents) for axis in axes]
    return time_s, np.stack(parts, axis=2)


def one_process(tmp_path, *, agents=4, overrides=()):
    small = SMALL if agents == 4 else SMALL[1:]
    return OneProcessSwarm(ARTICLE, agents=agents, overrides=[*small, *overrides], out=tmp_path / "run")


def test_formation_agrees_on_its_start_and_flies_its_track_in_shape(swarm, tmp_path):
    """12 m at 3 m/s and 1 m/s^2 take 3 s up, 1 s and 3 s down."""
    motion = 'formation.motion={kind="track", length_m=12.0, acceleration_m_s2=1.0, course_deg=90.0}'
    overrides = [*SMALL, motion, "onboard.ranging=scheduled"]
    flight = swarm(ARTICLE, agents=4, overrides=overrides, out=tmp_path / "run")
    flight.run_until_formed(timeout_s=60.0)
    flight.run_for(13.0)
    summary = flight.summary(draw=False)
    starts = [event for event in flight.events if isinstance(event, FormationMoves)]
    assert len(starts) == 1
    assert starts[0].start_us > starts[0].time_us  # agreed before the start
    assert summary["moves_s"] * 1e6 == pytest.approx(starts[0].start_us)
    assert summary["formation_rms_m"]["shape_horizontal"] < 0.25
    assert summary["collisions"] == 0
    time_s, pos_ned_m = vectors(tmp_path / "run", "pos_ned_m", 4)
    moving = (time_s > summary["moves_s"]) & (time_s < summary["moves_s"] + 7.0)
    centre_ned_m = pos_ned_m.mean(axis=1)
    assert np.ptp(centre_ned_m[moving, 1]) == pytest.approx(12.0, abs=0.7)
    _, desired_ned_m = vectors(tmp_path / "run", "desired_pos_ned_m", 4)
    assert desired_ned_m[-1, :, 1] - desired_ned_m[0, :, 1] == pytest.approx(12.0, abs=1e-3)
    # each pair is measured by one of its ends only
    sessions = pq.read_table(tmp_path / "run" / "ftm.parquet")
    pairs = set(
        zip(np.array(sessions["initiator"]).tolist(), np.array(sessions["peer"]).tolist(), strict=True)
    )
    assert len(pairs) == 6
    assert not any((b, a) in pairs for a, b in pairs)


def shape_m(tmp_path, overrides):
    with one_process(tmp_path, overrides=overrides) as flight:
        flight.run_until_formed(timeout_s=60.0)
        flight.run_for(5.0)
        summary = flight.summary(draw=False)
    assert summary["collisions"] == 0
    return summary


def test_truth_needs_no_radio_and_has_the_smallest_error(tmp_path):
    truth = shape_m(tmp_path / "truth", ["onboard.localisation=truth"])
    assert truth["ftm"]["requested"] == 0
    # with true positions the remaining error is that of control in the wind
    assert truth["formation_rms_m"]["absolute_horizontal"] < 0.25
    ftm = shape_m(tmp_path / "ftm", [])
    assert ftm["formation_rms_m"]["shape_horizontal"] < 0.25
    assert ftm["formation_rms_m"]["absolute_horizontal"] > truth["formation_rms_m"]["absolute_horizontal"]


def test_ideal_channel_has_no_losses_and_an_idle_medium(tmp_path):
    ideal = shape_m(tmp_path, ["radio.channel=ideal"])
    assert ideal["channel_busy_fraction"] == 0.0
    assert ideal["frames"]["collided"] == ideal["frames"]["lost_to_noise"] == 0
    assert ideal["ftm"]["completed"] == ideal["ftm"]["requested"] > 100
    assert ideal["formation_rms_m"]["shape_horizontal"] < 0.25


def test_wind_feed_forward_helps_an_autopilot_without_disturbance_observer(tmp_path):
    params = ["autopilot.params.CF_DOB_EN=0", "onboard.localisation=truth"]
    left = shape_m(tmp_path / "left", params)["formation_rms_m"]["absolute_horizontal"]
    fed = shape_m(tmp_path / "fed", [*params, "onboard.wind_feed_forward=true"])
    assert fed["formation_rms_m"]["absolute_horizontal"] < 0.7 * left


def test_shape_recovers_after_ten_seconds_without_a_channel(tmp_path):
    with one_process(tmp_path, agents=8) as flight:
        flight.run_until_formed(timeout_s=60.0)
        flight.inject(RadioAttenuation(attenuation_db=200.0, start_s=1.0, duration_s=10.0))
        flight.run_for(11.0)
        back_s = flight.truth.t_s
        flight.run_for(14.0)
        summary = flight.summary(draw=False)
    assert summary["collisions"] == 0
    sessions = pq.read_table(tmp_path / "run" / "ftm.parquet")
    at_s = np.array(sessions["measured_ns"]) * 1e-9
    fine = np.array(sessions["status"]) == "ok"
    assert not fine[(at_s > back_s - 9.7) & (at_s < back_s - 0.1)].any()
    time_s, pos_ned_m = vectors(tmp_path / "run", "pos_ned_m", 8)
    _, desired_ned_m = vectors(tmp_path / "run", "desired_pos_ned_m", 8)
    late = time_s > back_s + 10.0
    flown, desired = (
        rows[late][..., :2] - rows[late][..., :2].mean(axis=1, keepdims=True)
        for rows in (pos_ned_m, desired_ned_m)
    )
    a, b = (rows[..., 0] + 1j * rows[..., 1] for rows in (flown, desired))
    turn = np.exp(1j * np.angle((b.conj() * a).sum(axis=1)))[:, None]
    assert np.sqrt(np.mean(np.abs(a - b * turn) ** 2)) < 0.25


def test_ranging_bias_of_one_uav_does_not_displace_others(tmp_path):
    tracks = []
    for biased in (False, True):
        with one_process(tmp_path / str(biased), agents=8) as flight:
            flight.run_until_formed(timeout_s=60.0)
            if biased:
                flight.inject(RangingBias(uav=3, offset_m=5.0))
            flight.run_for(8.0)
            flight.summary(draw=False)
        tracks.append(vectors(tmp_path / str(biased) / "run", "pos_ned_m", 8)[1])
        sessions = pq.read_table(tmp_path / str(biased) / "run" / "ftm.parquet")
    # in the last flight radio 3 had the bias
    own = (np.array(sessions["initiator"]) == 3) & (np.array(sessions["status"]) == "ok")
    error_m = np.array(sessions["distance_m"])[own] - np.array(sessions["true_distance_m"])[own]
    assert np.median(error_m[-30:]) == pytest.approx(5.0, abs=0.1)
    others = [0, 1, 2, 4, 5, 6, 7]
    displacement_m = np.linalg.norm(tracks[1][:, others, :2] - tracks[0][:, others, :2], axis=2)
    assert displacement_m.max() < 0.3
