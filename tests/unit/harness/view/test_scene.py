"""The scene of a run: what its pieces show, entity by entity."""

import numpy as np
import pytest
from paths import SCENARIOS
from view_pieces import line_of_vehicles

from antenna.analysis.patterns import Pattern, directions_deg
from autopilot.commander.failsafe import Cause
from autopilot.onboard.factory import layout_of
from harness.scenario.scenario_file import load
from harness.view.airframe_shape import FAST, SLOW
from harness.view.antenna_surface import FLOOR_DBI, make_surface
from harness.view.camera import overview
from harness.view.scene import SIGMAS, Scene, event_text
from harness.view.state_lines import RED

AGENTS = 3


@pytest.fixture
def scenario():
    return load(SCENARIOS / "article.toml", [f"agents={AGENTS}", "formation.columns=3"])


@pytest.fixture
def scene(scenario):
    return Scene(scenario, layout_of(scenario.onboard))


def by_path(entries):
    return {entry.path: entry for entry in entries}


def test_each_vehicle_has_its_drawing_at_its_place_and_attitude(scene, scenario):
    paths = [entry.path for entry in scene.static()]
    piece = line_of_vehicles(scenario)
    found = by_path(scene.entries(piece))
    for i, airframe in enumerate(scenario.airframes()):
        parts = ("airframe", "body", "name")
        assert [paths.count(f"world/uav-{i}/{part}") for part in parts] == [1, 1, 1]
        moves = found[f"world/uav-{i}"]
        assert moves.kind == "Transform3D"
        assert moves.times_us.tolist() == piece.flight["time_us"][:, 0].tolist()
        assert np.array_equal(moves.fields["translation"], piece.flight["pos_ned_m"][:, i])
        assert np.array_equal(moves.fields["quaternion"][:, 3], piece.flight["q_ned_frd"][:, i, 0])
        assert moves.others[0].lengths.tolist() == [len(airframe.rotors)] * len(piece.flight)


def test_rotors_are_coloured_by_their_speed(scene, scenario):
    piece = line_of_vehicles(scenario)
    propulsion = scenario.airframes()[0].propulsion
    piece.flight["rotor_speed_rad_s"][:, 0] = [0.0, propulsion.idle_rad_s + propulsion.range_rad_s, 0.0, 0.0]
    colours = by_path(scene.entries(piece))["world/uav-0"].others[0].fields["colors"]
    assert colours[:4].tolist() == [list(SLOW), list(FAST), list(SLOW), list(SLOW)]


def test_believed_positions_are_shown_where_known_and_with_their_deviations(scene, scenario):
    piece = line_of_vehicles(scenario)
    piece.flight["onboard_pos_ned_m"][0, 1] = np.nan
    piece.flight["alive"][1:, 2] = False
    piece.flight["onboard_pos_std_m"][:] = [0.5, 0.25, 2.0]
    found = by_path(scene.entries(piece))
    expected = [AGENTS - 1] + [AGENTS - 1] * (len(piece.flight) - 1)
    assert found["world/believed/positions"].lengths.tolist() == expected
    ellipsoids = found["world/believed/uncertainty"]
    assert ellipsoids.lengths.tolist() == expected
    assert np.allclose(ellipsoids.fields["half_sizes"], SIGMAS * np.array([0.5, 0.25, 2.0]))


def test_errors_and_heights_are_those_of_the_flight(scene, scenario):
    piece = line_of_vehicles(scenario)
    standing_m = scenario.airframes()[0].standing_height_m
    piece.flight["desired_pos_ned_m"] = piece.flight["pos_ned_m"] + [3.0, 4.0, standing_m]
    found = by_path(scene.entries(piece))
    assert np.allclose(found["plots/error/uavs"].fields["scalars"], 5.0)
    assert np.allclose(found["plots/error/shape"].fields["scalars"], 0.0, atol=1e-9)
    heights = found["plots/height/uavs"]
    assert heights.lengths.tolist() == [AGENTS] * len(piece.flight)
    assert np.allclose(heights.fields["scalars"], -piece.flight["pos_ned_m"][:, :, 2].ravel())
    assert np.allclose(
        found["world/errors"].fields["strips"][0][0] - piece.flight["pos_ned_m"][0, 0], [3, 4, 0]
    )


def test_states_are_entered_when_they_change(scene, scenario):
    piece = line_of_vehicles(scenario)
    piece.flight["causes"][2:, 0] = int(Cause.GPS_LOST)
    piece.flight["failsafe"][3:, 0] = True
    piece.flight["alive"][4:, 1] = False

    def states(entries, path):
        found = (e for e in entries if e.path == path and e.kind == "StateChange")
        return [(e.times_us[0], e.fields["state"][0]) for e in found]

    def colours(entries, path):
        last = [e for e in entries if e.path == path and e.kind == "StateConfiguration"][-1]
        return dict(zip(last.fields["values"], last.fields["colors"], strict=True))

    times_us = piece.flight["time_us"][:, 0]
    entries = scene.entries(piece)
    assert states(entries, "states/uav-0/failsafe") == [(times_us[3], "gps lost")]
    assert states(entries, "states/uav-1/mode")[-1] == (times_us[4], "lost")
    assert states(entries, "states/uav-2/mode") == [(times_us[0], states(entries, "states/uav-2/mode")[0][1])]
    assert colours(entries, "states/uav-0/failsafe") == {"gps lost": RED}
    first, second, third = (colours(entries, f"states/uav-{i}/mode") for i in range(AGENTS))
    assert first == third == {state: colour for state, colour in second.items() if state != "lost"}
    assert second["lost"] == RED
    again = scene.entries(line_of_vehicles(scenario, after_us=piece.until_us))
    assert not states(again, "states/uav-2/mode")


def test_a_viewer_that_is_behind_gets_the_last_instant_and_all_events(scene, scenario):
    piece = line_of_vehicles(scenario)
    piece.events.append({"event": "formed", "time_us": 50_000})
    found = by_path(scene.entries(piece, thin=True))
    assert found["world/uav-0"].times_us.tolist() == [piece.until_us]
    assert found["log/formed"].fields["text"] == ["formation reached"]
    assert scene.formed


def test_channel_occupancy_is_that_of_the_piece(scene, scenario):
    first = line_of_vehicles(scenario, busy_ns=[10_000_000])
    second = line_of_vehicles(scenario, after_us=first.until_us, busy_ns=[60_000_000])
    scene.entries(first)
    (percent,) = by_path(scene.entries(second))["plots/channel/busy"].fields["scalars"]
    assert percent == pytest.approx(100.0 * 50.0 / 200.0)


@pytest.mark.parametrize(
    ("event", "text"),
    [
        ({"event": "vehiclelost", "instance": 3, "reason": "it ended"}, "UAV 3: lost: it ended"),
        (
            {"event": "faultchanged", "instance": None, "number": 2, "what": "gps_loss", "change": "began"},
            "fault 2 (gps_loss) began",
        ),
        ({"event": "collision", "first": 1, "second": 2}, "UAV 1: touches UAV 2"),
    ],
)
def test_events_are_lines_of_the_log(event, text):
    assert event_text(event) == text


@pytest.mark.parametrize("heading_rad", [0.0, 0.7])
def test_the_surface_reaches_farthest_along_the_main_lobe(heading_rad):
    """A pattern with its maximum along +y, the heading of the formation, as cos^2 around it."""
    theta_deg, phi_deg = directions_deg(10.0)
    theta, phi = np.radians(theta_deg)[:, None], np.radians(phi_deg)[None, :]
    along = np.sin(theta) * np.sin(phi)
    gain_dbi = np.maximum(10.0 * np.log10(np.maximum(along, 1e-9)), -999.0) + 7.0
    pattern = Pattern(
        theta_deg=theta_deg, phi_deg=phi_deg, theta_gain_dbi=gain_dbi,
        phi_gain_dbi=np.full_like(gain_dbi, -999.99), max_gain_dbi=7.0, max_theta_deg=90.0,
        max_phi_deg=90.0, average_gain=1.0, backend="test",
    )  # fmt: skip
    centre_ned_m = np.array([10.0, 20.0, -5.0])
    surface = make_surface(pattern, heading_rad, centre_ned_m, size_m=4.0)
    forward = np.array([np.cos(heading_rad), np.sin(heading_rad), 0.0])
    assert np.allclose(surface.lobe_ned_m, 4.0 * forward)
    apart_m = np.linalg.norm(surface.vertices_ned_m - centre_ned_m, axis=1)
    farthest = surface.vertices_ned_m[apart_m.argmax()] - centre_ned_m
    assert np.allclose(farthest, 4.0 * forward, atol=1e-6)
    behind = (surface.vertices_ned_m - centre_ned_m) @ forward < -1e-6
    assert not behind.any()
    at_half = np.isclose(surface.gain_dbi, 0.5 * (7.0 + FLOOR_DBI), atol=0.5)
    assert np.all(np.abs(apart_m[at_half] - 2.0) < 0.2)
    assert surface.triangles.min() == 0
    assert surface.triangles.max() == len(surface.vertices_ned_m) - 1


def test_heights_on_the_ground_are_one_line(scene, scenario):
    piece = line_of_vehicles(scenario)
    piece.flight["pos_ned_m"][:, :, 2] = -0.055 + 1e-9 * np.arange(AGENTS)
    heights_m = by_path(scene.entries(piece))["plots/height/uavs"].fields["scalars"]
    assert set(heights_m.tolist()) == {0.055}


def test_the_camera_sees_places_ground_and_pattern_from_the_south():
    places_ned_m = np.array([[x, y, -10.0] for x in (0.0, 8.0) for y in (-9.0, 9.0)])
    position_ned_m, target_ned_m = overview(places_ned_m)
    assert target_ned_m.tolist() == [4.0, 0.0, -10.0]
    assert position_ned_m[0] < 0.0
    ahead = (target_ned_m - position_ned_m) / np.linalg.norm(target_ned_m - position_ned_m)
    for point_ned_m in (*places_ned_m, *(places_ned_m * [1.0, 1.0, 0.0])):
        towards = point_ned_m - position_ned_m
        assert ahead @ towards > np.cos(np.radians(0.5 * 55.0)) * np.linalg.norm(towards)
