"""Figures of a campaign's table: what is drawn against which factor, and their files."""

import itertools
import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from scipy.stats import t

from harness.campaign.figures import MOST_LINES, QUANTITIES, draw_table, factor_figure, factors, intervals
from harness.cli import report

SHAPE = QUANTITIES[0]
METADATA = {b"campaign": b"gales", b"scenario": b"article"}


def _table(seeds=4, failed=(), **swept):
    """Make a table: the shape error is 1 + seed / 10 m, plus 2 m times the number of each swept value."""
    names = list(swept)
    rows = []
    for numbers in itertools.product(*(range(len(values)) for values in swept.values())):
        for seed in range(1, seeds + 1):
            lost = len(rows) in failed
            rows.append(
                {
                    "case": "gales",
                    **{name: swept[name][number] for name, number in zip(names, numbers, strict=True)},
                    "seed": seed,
                    "status": "failed" if lost else "completed",
                    "digest": f"{len(rows):x}",
                    SHAPE.column: None if lost else 1.0 + seed / 10.0 + 2.0 * sum(numbers),
                    "channel_busy_fraction": None if lost else 0.05,
                    "vehicles_lost": None if lost else 0,
                }
            )
    return pa.Table.from_pylist(rows).replace_schema_metadata(METADATA)


def _caption(figure):
    (legend,) = figure.legends
    return legend.get_title().get_text(), [text.get_text() for text in legend.get_texts()]


def _points(axes):
    """Return x and y of every line, and the ends of its intervals."""
    return [
        (*container.lines[0].get_data(), np.array(container.lines[2][0].get_segments())[:, :, 1])
        for container in axes.containers
    ]


def test_points_are_means_and_bars_are_students_intervals():
    rows = _table(**{"wind.mean_n": [0.0, 2.0, 5.0]})
    assert factors(rows) == ("wind.mean_n",)
    figure = factor_figure(rows, "wind.mean_n")
    shape, busy = figure.axes  # no vehicle is lost, and there are no gains
    assert (shape.get_title(), busy.get_title()) == (SHAPE.label, "Channel busy (%)")
    ((x, y, bars),) = _points(shape)
    np.testing.assert_allclose(x, [0.0, 2.0, 5.0])
    np.testing.assert_allclose(y, [1.25, 3.25, 5.25])
    half = t.ppf(0.975, 3) * np.std([1.1, 1.2, 1.3, 1.4], ddof=1) / 2.0
    np.testing.assert_allclose(bars, np.array([y - half, y + half]).T)
    np.testing.assert_allclose(_points(busy)[0][1], 5.0)
    assert shape.get_xlabel() == "wind.mean_n"  # the table states no unit
    assert _caption(figure)[0].startswith("mean and 95% interval")
    assert [label.get_text() for label in shape.get_xticklabels()] == ["0", "2", "5"]


def test_an_axis_has_the_unit_that_the_table_states():
    rows = _table(**{"wind.mean_n": [0.0, 2.0]})
    place = rows.schema.get_field_index("wind.mean_n")
    schema = rows.schema.set(place, rows.schema.field(place).with_metadata({"unit": "N"}))
    assert factor_figure(rows.cast(schema), "wind.mean_n").axes[0].get_xlabel() == "wind.mean_n (N)"


def test_single_flights_are_not_called_intervals():
    figure = factor_figure(_table(seeds=1, **{"wind.mean_n": [0.0, 2.0]}), "wind.mean_n")
    assert _caption(figure)[0].startswith("one flight each, so without intervals")


def test_failed_runs_are_left_out_and_counted():
    rows = _table(failed=(0, 5), **{"wind.mean_n": [0.0, 2.0]})
    figure = factor_figure(rows, "wind.mean_n")
    np.testing.assert_allclose(_points(figure.axes[0])[0][1], [1.3, 3.0 + (0.1 + 0.3 + 0.4) / 3.0])
    title, _ = _caption(figure)
    assert title.endswith("6 runs, 4 seeds\n2 failed runs left out")
    assert factor_figure(_table(seeds=1, failed=(0,)), "case") is None  # no run has results


def test_another_factor_has_a_line_for_each_value():
    rows = _table(**{"wind.mean_n": [0, 2, 5], "onboard.localisation": ["gps", "ftm"]})
    by_wind, by_word = (factor_figure(rows, factor) for factor in factors(rows))
    title, lines = _caption(by_wind)
    assert "\na line for each onboard.localisation" in title
    assert lines == ["onboard.localisation = gps", "onboard.localisation = ftm"]
    gps, ftm = _points(by_wind.axes[0])
    np.testing.assert_allclose(gps[1] + 2.0, ftm[1])
    assert (np.abs(gps[0] - [0, 2, 5]) < 0.1).all()
    assert (gps[0] < ftm[0]).all()  # beside each other
    shape = by_word.axes[0]
    assert [label.get_text() for label in shape.get_xticklabels()] == ["gps", "ftm"]
    assert len(_points(shape)) == 3


def test_too_many_lines_are_pooled():
    winds_n = list(range(MOST_LINES + 1))
    rows = _table(**{"wind.mean_n": winds_n, "agents": [4, 8]})
    figure = factor_figure(rows, "agents")
    title, lines = _caption(figure)
    assert "\npooled over wind.mean_n" in title
    assert lines == ["all runs"]
    ((x, y, _),) = _points(figure.axes[0])
    np.testing.assert_allclose(x, [4, 8])
    np.testing.assert_allclose(y, 1.25 + 2.0 * np.mean(winds_n) + np.array([0.0, 2.0]))
    ticks = factor_figure(rows, "wind.mean_n").axes[0].get_xticks()
    assert (ticks % 1.0 == 0.0).all()


def test_a_campaign_of_seeds_alone_has_one_point():
    rows = _table()
    assert factors(rows) == ("case",)
    (value,) = intervals(rows, "case", SHAPE).values()
    assert (value.count, value.value) == (4, pytest.approx(1.25))
    assert len(_points(factor_figure(rows, "case").axes[0])[0][0]) == 1


def test_rows_of_one_flight_count_once():
    rows = _table(seeds=2)
    (value,) = intervals(pa.concat_tables([rows, rows]), "case", SHAPE).values()
    assert value.count == 2


@pytest.fixture
def folder(tmp_path):
    """Return the folder of a campaign that has ended."""
    rows = _table(failed=(1,), **{"wind.mean_n": [0, 2], "onboard.localisation": ["gps", "ftm"]})
    pq.write_table(rows, tmp_path / "table.parquet")
    return tmp_path


FILES = [
    f"by-{factor}.{suffix}" for factor in ("wind.mean_n", "onboard.localisation") for suffix in ("png", "pdf")
]


def test_every_factor_has_both_files_beside_the_table(folder):
    assert draw_table(folder / "table.parquet") == FILES
    before = {name: (folder / name).read_bytes() for name in FILES}
    assert {name: content[1:4] for name, content in before.items()} == {
        name: b"PDF" if name.endswith("pdf") else b"PNG" for name in FILES
    }
    assert draw_table(folder / "table.parquet") == FILES
    assert {name: (folder / name).read_bytes() for name in FILES} == before


LONG = {"onboard.localisation": ["gps", "ftm"], "radio.broadcast_rts": [True, False], "agents": [4, 8]}


@pytest.mark.parametrize("others", [{}, {"onboard.localisation": ["gps", "ftm"]}, LONG])
def test_nothing_covers_a_panel_or_is_cut_off(others):
    figure = factor_figure(_table(failed=(1,), **{"wind.mean_n": [0, 2], **others}), "wind.mean_n")
    figure.suptitle("Campaign")
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw(renderer)
    (legend,) = figure.legends
    boxes = [axes.get_tightbbox(renderer) for axes in figure.axes]
    around = legend.get_window_extent(renderer)
    assert not any(around.overlaps(box) for box in boxes)
    assert 0.0 <= around.x0 < around.x1 <= figure.bbox.x1
    assert not any(one.overlaps(other) for one, other in itertools.combinations(boxes, 2))


def test_report_shows_a_campaign_and_draws_it_again(folder, capsys):
    assert report.main([str(folder)]) == report.FINE
    assert capsys.readouterr().out.splitlines()[0] == "16 runs: 15 completed, 1 failed"
    assert not (folder / FILES[0]).exists()
    assert report.main([str(folder), "--figures", "--json"]) == report.FINE
    shown = json.loads(capsys.readouterr().out)
    assert shown["figures"] == [str(folder / name) for name in FILES]
    assert all((folder / name).exists() for name in FILES)


def test_another_table_is_one_line(tmp_path, capsys):
    pq.write_table(pa.table({"x": [1]}), tmp_path / "table.parquet")
    assert report.main([str(tmp_path), "--figures"]) == report.BAD_INPUT
    reason = "no campaign of this version wrote it: fly the campaign again"
    assert capsys.readouterr().err == f"coflight: {tmp_path}/table.parquet: {reason}\n"
