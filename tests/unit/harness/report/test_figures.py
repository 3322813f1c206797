import numpy as np
import pytest
from antenna_arrays import vertical_snapshot
from antenna_hertzian import exact_patterns
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.image import imread

from antenna.analysis.gain_figures import gain_density_figure, patterns_figure
from antenna.model.geometry import grid
from autopilot.onboard.formation_plan import FormationPlan
from autopilot.parameters.config import RacetrackMotion
from harness.records.flight import Flight
from harness.report import figures
from harness.report.formation_error import formation_error
from harness.world.wind import WindConfig


def _flight(vehicles=8, instants=40):
    rng = np.random.default_rng(1)
    places_ned_m = grid(vehicles, 4, 8.5, 2.5) * [1.0, 1.0, 0.0] + [0.0, 0.0, -10.0]
    alive = np.ones((instants, vehicles), bool)
    alive[20:, 1:2] = False
    alive[:, 2:3] = False
    return Flight(
        time_us=np.arange(instants, dtype=np.int64) * 100_000,
        pos_ned_m=places_ned_m + rng.normal(0.0, 0.5, (instants, vehicles, 3)),
        q_ned_frd=np.tile([1.0, 0.0, 0.0, 0.0], (instants, vehicles, 1)),
        desired_pos_ned_m=np.broadcast_to(places_ned_m, (instants, vehicles, 3)),
        heading_rad=np.zeros(instants),
        alive=alive,
    )


CALM = WindConfig(mean_n=0.0)


def _drawn(figure, tmp_path):
    """Save a figure, and check its files and what holds for every figure; returns the figure."""
    names = figures.save(figure, tmp_path / "drawn", "a_scenario, seed 7")
    assert names == ["drawn.png", "drawn.pdf"]
    pixels = imread(tmp_path / "drawn.png")[..., :3]
    assert min(pixels.shape[:2]) >= 400
    assert (pixels.min(axis=-1) < 0.9).mean() > 0.01
    pdf = (tmp_path / "drawn.pdf").read_bytes()
    assert pdf.startswith(b"%PDF-")
    assert b"CreationDate" not in pdf
    assert figure.get_suptitle() == "a_scenario, seed 7"
    canvas = FigureCanvasAgg(figure)
    legends = [legend.get_window_extent(canvas.get_renderer()) for legend in figure.legends]
    for axes in figure.axes:
        assert axes.get_legend() is None
        box = axes.get_tightbbox(canvas.get_renderer())
        assert not any(legend.overlaps(box) for legend in legends)
        assert 0.0 <= box.x0 < box.x1 <= figure.bbox.x1  # nothing is cut off
        assert 0.0 <= box.y0 < box.y1 <= figure.bbox.y1
    return figure


def _labels(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


@pytest.mark.parametrize("vehicles", [8, 32])
def test_flight_is_drawn_with_lost_vehicles_and_with_many(tmp_path, vehicles):
    flight = _flight(vehicles)
    for figure in (
        figures.tracks_figure(flight, CALM),
        figures.formation_error_figure(flight.time_us, formation_error(flight)),
    ):
        _drawn(figure, tmp_path)
        few = vehicles <= figures.LEGEND_VEHICLES
        assert [f"UAV {i}" in _labels(figure) for i in range(vehicles)] == [few] * vehicles
        bars = [axes for axes in figure.axes if axes.get_ylabel() == "UAV"]
        assert len(bars) == (0 if few else 1)
        for bar in bars:
            assert (bar.get_yticks() % 1.0 == 0.0).all()


def _moving_flight():
    plan = FormationPlan(grid(8, 4, 8.5, 2.5) - [0.0, 0.0, 20.0], 0.0, RacetrackMotion())
    since_s = np.linspace(-10.0, 130.0, 400)
    desired_ned_m = plan.places(since_s)
    alive = np.ones((400, 8), bool)
    alive[200:, 1] = False
    return Flight(
        time_us=(np.arange(400) * 350_000).astype(np.int64),
        pos_ned_m=desired_ned_m + np.random.default_rng(1).normal(0.0, 0.2, desired_ned_m.shape),
        q_ned_frd=np.tile([1.0, 0.0, 0.0, 0.0], (400, 8, 1)),
        desired_pos_ned_m=desired_ned_m,
        heading_rad=plan.headings(since_s),
        alive=alive,
    )


def test_tracks_mark_start_end_and_loss(tmp_path):
    """A square at every first position, a cross at that of the loss, a disc at the other last ones."""
    flight = _moving_flight()
    figure = _drawn(figures.tracks_figure(flight, WindConfig()), tmp_path)
    plan = figure.axes[0]
    marks = {
        marker: np.array([line.get_xydata()[0] for line in plan.lines if line.get_marker() == marker])
        for marker in ("s", "X")
    }
    np.testing.assert_allclose(marks["s"], flight.pos_ned_m[0, :, [1, 0]].T)
    np.testing.assert_allclose(marks["X"], flight.pos_ned_m[199, 1:2, [1, 0]].T)
    assert {"start", "last position", "lost", "desired", "every 11.6 s"} < set(_labels(figure))
    safe = figures.tracks_figure(_flight(1), WindConfig())  # no vehicle is lost, and nothing moves
    assert set(_labels(safe)) == {"UAV 0", "start", "last position", "desired place at the end", "desired"}


def test_tracks_of_a_long_flight_have_fewer_points_from_its_first_to_its_last(monkeypatch):
    monkeypatch.setattr(figures, "MOST_INSTANTS", 100)
    flight = _moving_flight()
    figure = figures.tracks_figure(flight, WindConfig())
    map_axes, heights = figure.axes[:2]
    tracks = [line for line in heights.lines if line.get_linestyle() == "-"]
    assert [len(line.get_xdata()) for line in tracks] == [100] * 8
    for line in tracks:
        assert (line.get_xdata()[0], line.get_xdata()[-1]) == (
            flight.time_us[0] / 1e6,
            flight.time_us[-1] / 1e6,
        )
    at_loss = [line.get_xydata()[0] for line in map_axes.lines if line.get_marker() == "X"]
    step_m = np.abs(np.diff(flight.pos_ned_m[195:200, 1, :2], axis=0)).sum(axis=0)[::-1]
    np.testing.assert_array_less(np.abs(at_loss - flight.pos_ned_m[199, 1, [1, 0]])[0], step_m + 1e-9)


@pytest.mark.parametrize(
    ("wind", "text"),
    [
        (WindConfig(mean_n=2.5, direction_deg=120.0), "Mean wind\n2.5 N"),
        (
            WindConfig(kind="velocity", mean_m_s=4.0, direction_deg=120.0),
            "Mean wind\n4 m/s\n10 m above ground",
        ),
    ],
)
def test_the_arrow_points_where_the_wind_blows_on_the_map(wind, text):
    """120 degrees clockwise from north: to the right and down on a map with north up."""
    figure = figures.tracks_figure(_flight(), wind)
    rose = figure.axes[2]
    assert rose.get_title() == text
    (arrow,) = rose.texts
    to, start = np.array(arrow.xy), np.array(arrow.get_position())
    np.testing.assert_allclose((to - start) / 2.0, [np.sin(np.radians(120.0)), np.cos(np.radians(120.0))])
    assert rose.get_aspect() == figure.axes[0].get_aspect() == 1.0


def test_no_arrow_without_mean_wind():
    rose = figures.tracks_figure(_flight(), CALM).axes[2]
    assert rose.get_title() == "No mean wind"
    assert not rose.texts


def test_error_of_a_lone_vehicle_is_drawn_without_a_shape(tmp_path):
    flight = _flight(1)
    error = formation_error(flight)
    assert error.shape.rms_m is None
    figure = _drawn(figures.formation_error_figure(flight.time_us, error), tmp_path)
    assert figure.axes[1].get_title() == "Shape: after the best rigid alignment; not defined"


def test_antenna_is_drawn(tmp_path):
    ideal = vertical_snapshot(grid(8, 4, 8.5, 2.5), 10.0)
    (pattern,) = exact_patterns([ideal], 10.0, 10.0)
    _drawn(patterns_figure({"Ideal": pattern, "Flown": pattern}), tmp_path)
    _drawn(gain_density_figure({"flown": np.linspace(11.0, 13.0, 60)}, 13.26), tmp_path)


@pytest.mark.parametrize("sessions", [1, 3, 500])
def test_radio_is_drawn(tmp_path, sessions):
    rng = np.random.default_rng(2)
    _drawn(figures.channel_figure(np.arange(1, 100) * 1_000_000, rng.random(99)), tmp_path)
    figure = _drawn(figures.ftm_error_figure(rng.normal(0.0, 0.1, sessions)), tmp_path)
    (axes,) = figure.axes
    assert (axes.get_yticks() % 1.0 == 0.0).all()  # numbers of sessions
    assert sum(bar.get_height() for bar in axes.patches) == sessions


def test_a_single_interval_of_the_channel_can_be_seen():
    """A line needs two points."""
    (axes,) = figures.channel_figure(np.array([800_000]), np.array([0.1])).axes
    assert axes.lines[0].get_marker() == "."


def test_equal_figures_give_equal_files(tmp_path):
    contents = set()
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        figures.save(figures.tracks_figure(_flight(), WindConfig()), tmp_path / name / "drawn", "title")
        contents.add(tuple((tmp_path / name / f"drawn.{suffix}").read_bytes() for suffix in figures.FORMATS))
    assert len(contents) == 1
