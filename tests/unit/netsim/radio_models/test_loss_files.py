"""Path losses from files: what was sampled is reproduced within the error of the interpolation."""

import numpy as np
import pytest
import xarray as xr
from netsim_swarm import make_links

from foundation.extensions import ExtensionError
from harness.scenario.scenario import ScenarioError
from harness.scenario.scenario_file import load as load_scenario
from netsim.model.config import RadioConfig, RadioModel
from netsim.model.random_streams import RandomStreams
from netsim.phy.path_loss import friis_loss_db
from netsim.phy.propagation import Trajectories
from netsim.radio_models.registry import make_models

MHZ = 5210.0
AT_1_M_DB = friis_loss_db(1.0, MHZ)


def created(model, folder, **settings):
    choice = RadioModel(model=model, settings=settings, folder=str(folder))
    config = RadioConfig(frequency_mhz=MHZ, path_loss=choice)
    return make_models(config, 2, RandomStreams(np.random.SeedSequence(1))).path_loss


def refusal(model, folder, **settings):
    with pytest.raises(ExtensionError) as caught:
        created(model, folder, **settings)
    text = str(caught.value)
    assert "\n" not in text
    return text


def of_distance(loss, distances_m):
    places = np.zeros((1, 3)), np.zeros((len(distances_m), 3))
    return loss.loss_db(*places, np.array([distances_m]))[0]


# --- table


def write_table(folder, rows, header="distance_m,loss_db"):
    lines = [header, *(",".join(map(str, row)) for row in rows)]
    (folder / "loss.csv").write_text("\n".join(lines) + "\n")


def test_the_table_of_a_power_law_is_that_power_law(tmp_path):
    # a power law is a straight line over the logarithm: few rows are exact
    write_table(tmp_path, [(d, AT_1_M_DB + 31.0 * np.log10(d)) for d in (1.0, 7.0, 200.0, 5_000.0)])
    distances_m = np.geomspace(1.0, 5_000.0, 50)
    losses_db = of_distance(created("table", tmp_path, file="loss.csv"), distances_m)
    assert losses_db == pytest.approx(AT_1_M_DB + 31.0 * np.log10(distances_m), abs=1e-9)


def test_rows_of_a_curve_are_reproduced_within_the_error_of_linear_interpolation(tmp_path):
    def curve_db(distance_m):
        return 60.0 + 25.0 * np.log10(distance_m) + 3.0 * np.sin(2.0 * np.log(distance_m))

    rows = np.geomspace(2.0, 800.0, 60)
    write_table(tmp_path, [(d, curve_db(d)) for d in rows])
    distances_m = np.geomspace(2.0, 800.0, 1_001)
    losses_db = of_distance(created("table", tmp_path, file="loss.csv"), distances_m)
    # h^2 / 8 times the largest second derivative over the natural logarithm, 3 * 2^2
    bound_db = np.log(rows[1] / rows[0]) ** 2 / 8.0 * 12.0
    worst_db = np.abs(losses_db - curve_db(distances_m)).max()
    assert 0.5 * bound_db < worst_db <= bound_db


def test_beyond_the_rows_the_loss_is_continued_as_in_free_space(tmp_path):
    write_table(tmp_path, [(10.0, 30.0), (100.0, 90.0)])
    losses_db = of_distance(created("table", tmp_path, file="loss.csv"), [1.0, 5.0, 200.0, 1_000.0])
    assert losses_db == pytest.approx([10.0, 30.0 - 20.0 * np.log10(2.0), 90.0 + 20.0 * np.log10(2.0), 110.0])
    write_table(tmp_path, [(100.0, 30.0), (200.0, 40.0)])
    assert of_distance(created("table", tmp_path, file="loss.csv"), [1.0]) == [0.0]


def test_budgets_use_the_table(tmp_path):
    write_table(tmp_path, [(1.0, 60.0), (10.0, 60.0), (100.0, 90.0)])
    choice = RadioModel(model="table", settings={"file": "loss.csv"}, folder=str(tmp_path))
    config = RadioConfig(path_loss=choice, rician_k_db=None, tx_power_dbm=10.0, antenna_gain_dbi=1.0)
    trajectories = Trajectories(3)
    links = make_links(config, trajectories, 3, 1)
    trajectories.set(0, [(0.0, 0.0, 0.0), (0.0, 5.0, 0.0), (100.0, 0.0, 0.0)], np.zeros((3, 3)))
    assert 10.0 * np.log10(links.row(0, 0).powers_mw[1:]) == pytest.approx([12.0 - 60.0, 12.0 - 90.0])


@pytest.mark.parametrize(
    ("rows", "header", "expected"),
    [
        ([], "distance,loss", "line 1: 'distance,loss'; expected distance_m,loss_db"),
        ([(1, 2)], "distance_m,loss_db", "1 rows; expected at least 2"),
        ([(1, 50), ("x", 2)], "distance_m,loss_db", "line 3: 'x,2'; expected two numbers"),
        ([(1, 50), (2, 60, 3)], "distance_m,loss_db", "line 3: '2,60,3'; expected two numbers"),
        ([(0, 50), (2, 60)], "distance_m,loss_db", "line 2: 0 m, 50 dB; expected a distance above 0"),
        ([(1, 50), (2, "nan")], "distance_m,loss_db", "line 3: 2 m, nan dB; expected a distance above 0"),
        ([(1, 50), (2, 60), (2, 61)], "distance_m,loss_db", "line 4: 2 m after 2 m; expected increasing"),
    ],
)
def test_wrong_tables_are_named_with_the_line(tmp_path, rows, header, expected):
    write_table(tmp_path, rows, header)
    text = refusal("table", tmp_path, file="loss.csv")
    assert text.startswith(f"radio.path_loss.settings.file: {tmp_path / 'loss.csv'}: {expected}")


def test_a_missing_table_is_named(tmp_path):
    assert refusal("table", tmp_path, file="no.csv").endswith("no.csv: there is no such file")
    assert refusal("table", tmp_path) == "radio.path_loss.settings: missing key `file`"


# --- grid

EAST_M, NORTH_M, UP_M = np.linspace(-50.0, 50.0, 11), np.linspace(-40.0, 40.0, 9), np.linspace(0.0, 30.0, 4)
TRANSMITTERS_M = np.array([(0.0, 0.0, 10.0), (30.0, -20.0, 5.0)])


def excess_db(pos_enu_m):
    """An excess loss that is linear in each coordinate, so that trilinear interpolation is exact."""
    east, north, up = np.moveaxis(np.asarray(pos_enu_m), -1, 0)
    return 10.0 + 0.1 * east - 0.05 * north + 0.02 * up + 0.001 * east * north


def dataset(excess, transmitters_m=TRANSMITTERS_M, **attributes):
    """The file of a ray tracer that finds free space and an excess loss from each transmitter."""
    points_m = np.stack(np.meshgrid(EAST_M, NORTH_M, UP_M, indexing="ij"), axis=-1)
    away_m = np.linalg.norm(points_m - transmitters_m[:, None, None, None], axis=-1)
    gains_db = -(AT_1_M_DB + 20.0 * np.log10(np.maximum(away_m, 1.0)) + excess(points_m))
    dims = ("transmitter", "east_m", "north_m", "up_m")
    names = ("transmitter_east_m", "transmitter_north_m", "transmitter_up_m")
    return xr.Dataset(
        {
            "path_gain_db": (dims, gains_db),
            **{name: ("transmitter", transmitters_m[:, i]) for i, name in enumerate(names)},
        },
        coords={"east_m": EAST_M, "north_m": NORTH_M, "up_m": UP_M},
        attrs=attributes,
    )


def write_grid(folder, data, engine="h5netcdf"):
    data.to_netcdf(folder / "gains.nc", engine=engine)
    return {"file": "gains.nc"}


def ned(pos_enu_m):
    east, north, up = np.moveaxis(np.asarray(pos_enu_m), -1, 0)
    return np.stack((north, east, -up), axis=-1)


def loss_between(loss, a_enu_m, b_enu_m):
    a_m, b_m = np.atleast_2d(a_enu_m), np.atleast_2d(b_enu_m)
    distances_m = np.maximum(np.linalg.norm(b_m - a_m[:, None], axis=-1), 1.0)
    return loss.loss_db(ned(a_m), ned(b_m), distances_m), distances_m


@pytest.mark.parametrize("engine", ["h5netcdf", "scipy"])
def test_links_that_end_at_a_transmitter_have_the_loss_of_the_file(tmp_path, engine):
    loss = created("grid", tmp_path, **write_grid(tmp_path, dataset(excess_db, frequency_mhz=MHZ), engine))
    places_m = np.random.default_rng(2).uniform((-50, -40, 0), (50, 40, 30), (20, 3))
    for transmitter_m in TRANSMITTERS_M:
        losses_db, distances_m = loss_between(loss, transmitter_m, places_m)
        expected_db = AT_1_M_DB + 20.0 * np.log10(distances_m[0]) + excess_db(places_m)
        # the other samples have weights of at most 0.01 / d^2 relative to the one that is exact
        assert losses_db[0] == pytest.approx(expected_db, abs=0.01)


def test_a_constant_excess_loss_is_that_of_every_link(tmp_path):
    loss = created(
        "grid", tmp_path, **write_grid(tmp_path, dataset(lambda points_m: 7.0 + 0.0 * points_m[..., 0]))
    )
    places_m = np.random.default_rng(3).uniform(-100.0, 100.0, (12, 3))  # also outside the grid
    losses_db, distances_m = loss_between(loss, places_m, places_m)
    assert losses_db == pytest.approx(AT_1_M_DB + 20.0 * np.log10(distances_m) + 7.0)


def test_the_loss_is_equal_in_both_directions_and_between_those_of_the_file(tmp_path):
    loss = created("grid", tmp_path, **write_grid(tmp_path, dataset(excess_db)))
    places_m = np.random.default_rng(4).uniform((-50, -40, 0), (50, 40, 30), (30, 3))
    losses_db, distances_m = loss_between(loss, places_m, places_m)
    assert losses_db == pytest.approx(losses_db.T, abs=1e-9)
    of_link = losses_db - AT_1_M_DB - 20.0 * np.log10(distances_m)
    of_ends = excess_db(places_m)
    assert (of_link >= np.minimum.outer(of_ends, of_ends) - 1e-9).all()
    assert (of_link <= np.maximum.outer(of_ends, of_ends) + 1e-9).all()


def test_points_without_a_path_have_the_excess_loss_of_the_settings(tmp_path):
    data = dataset(excess_db)
    data["path_gain_db"][:, :4] = np.nan
    data["path_gain_db"][:, 4, 0] = -np.inf
    settings = write_grid(tmp_path, data)
    loss = created("grid", tmp_path, no_path_loss_db=45.0, **settings)
    for place_m in ((-40.0, 10.0, 10.0), (EAST_M[4], NORTH_M[0], 10.0)):
        losses_db, distances_m = loss_between(loss, TRANSMITTERS_M[0], place_m)
        assert losses_db == pytest.approx(AT_1_M_DB + 20.0 * np.log10(distances_m) + 45.0, abs=0.01)


def test_a_file_of_one_transmitter_needs_no_dimension_for_it(tmp_path):
    both = dataset(excess_db, TRANSMITTERS_M[:1])
    loss = created("grid", tmp_path, **write_grid(tmp_path, both.isel(transmitter=0)))
    same = created(
        "grid", tmp_path, **write_grid(tmp_path, both.transpose("up_m", "north_m", "transmitter", "east_m"))
    )
    ends = (3.0, 4.0, 5.0), (-20.0, 10.0, 12.0)
    assert loss_between(loss, *ends)[0] == loss_between(same, *ends)[0]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (
            lambda data: data.drop_vars("path_gain_db"),
            "no variable path_gain_db; expected path_gain_db",
        ),
        (lambda data: data.drop_vars("transmitter_up_m"), "no variable transmitter_up_m; expected "),
        (lambda data: data.isel(up_m=0), "path_gain_db has the dimensions "),
        (lambda data: data.isel(up_m=[0]), "up_m: expected at least two increasing, finite coordinates"),
        (lambda data: data.isel(up_m=[1, 0]), "up_m: expected at least two increasing, finite coordinates"),
        (
            lambda data: data.isel(transmitter=0).assign(path_gain_db=data["path_gain_db"]),
            "transmitter_east_m and",
        ),
        (
            lambda data: data.assign_attrs(frequency_mhz=2437.0),
            "it is for 2437 MHz; radio.frequency_mhz is",
        ),
        (
            lambda data: data.assign_attrs(frequency_mhz="C band"),
            "attribute frequency_mhz: 'C band'; exp",
        ),
        (
            lambda data: data.isel(transmitter=[]),
            "transmitter_east_m and others: expected one value",
        ),
        (lambda data: data.assign(path_gain_db=data["path_gain_db"] - np.inf), "path_gain_db: no point has"),
        (lambda data: -data, "path gains of up to "),
    ],
)
def test_wrong_grids_are_named_with_what_is_expected(tmp_path, change, expected):
    settings = write_grid(tmp_path, change(dataset(excess_db)))
    text = refusal("grid", tmp_path, **settings)
    assert text.startswith(f"radio.path_loss.settings.file: {tmp_path / 'gains.nc'}: {expected}")


def test_other_files_are_no_grids(tmp_path):
    assert refusal("grid", tmp_path, file="no.nc").endswith("no.nc: there is no such file")
    (tmp_path / "gains.nc").write_text("distance_m,loss_db\n")
    assert f"settings.file: {tmp_path / 'gains.nc'}: " in refusal("grid", tmp_path, file="gains.nc")


def test_a_grid_of_another_place_is_refused_when_the_scenario_is_read(tmp_path):
    """In coordinates of a map projection, say; one that reaches a single place of the formation is not."""
    file = tmp_path / "street.toml"
    file.write_text('[radio.path_loss]\nmodel = "grid"\nsettings = { file = "gains.nc" }\n')
    data = dataset(excess_db)
    write_grid(tmp_path, data.assign_coords(east_m=EAST_M + 4e5))
    with pytest.raises(ScenarioError, match=r"path_loss: grid: the grid has points from .* no vehicle has"):
        load_scenario(file)
    at_its_corner = EAST_M - EAST_M[-1] + load_scenario("article").places_ned_m()[:, 1].max()
    data = data.assign_coords(east_m=at_its_corner, north_m=np.linspace(-100.0, 100.0, len(NORTH_M)))
    write_grid(tmp_path, data)
    assert load_scenario(file).radio.path_loss.model == "grid"
