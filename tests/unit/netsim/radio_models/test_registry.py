"""Models are found by name; each error is one line with the field, the model and what is expected."""

import sys
import threading
from functools import partial

import msgspec
import numpy as np
import pytest
from netsim_swarm import Swarm

from foundation.extensions import ExtensionError, check_bounded
from harness.scenario.scenario import ScenarioError
from harness.scenario.scenario_file import load as load_scenario
from netsim.model.config import RadioConfig, RadioModel
from netsim.radio_models.registry import check_models, names, with_folder

OWN = "user_radio_models"
PLACES_NED_M = np.array([(0.0, 0.0, -10.0), (20.0, 0.0, -10.0)])


def refusal(kind, model, settings=None):
    choice = model if settings is None else RadioModel(model=model, settings=settings)
    with pytest.raises(ExtensionError) as caught:
        check_models(RadioConfig(**{kind: choice}), 2, PLACES_NED_M)
    text = str(caught.value)
    assert text.startswith(f"radio.{kind}")
    assert "\n" not in text
    return text


def test_built_in_names_are_those_of_the_fields_before():
    assert names("path_loss")[:5] == ["friis", "log_distance", "two_ray", "table", "grid"]
    assert names("antenna")[:2] == ["isotropic", "dipole"]


@pytest.mark.parametrize(
    ("kind", "model", "settings", "expected"),
    [
        ("path_loss", "fris", None, "no model 'fris'; did you mean friis? expected friis, log_"),
        ("fading", "nakagami", None, "no model 'nakagami'; expected rician, none, or package.module:"),
        ("path_loss", "friis", {"a": 1}, "settings: friis has none; expected fields of [radio]"),
        ("path_loss", "no_module:X", None, "no module no_module; expected it in "),
        ("path_loss", f"{OWN}:PowerLow", None, "has no PowerLow; did you mean user_radio_models:PowerLaw?"),
        ("path_loss", f"{OWN}:PowerLaw", None, "radio.path_loss.settings: missing key `exponent`"),
        ("path_loss", f"{OWN}:PowerLaw", {"exponent": "2"}, "settings.exponent: expected `float`, got"),
        ("path_loss", f"{OWN}:PowerLaw", {"exponent": 9}, "settings.exponent: expected `float` <= 8.0"),
        ("path_loss", f"{OWN}:PowerLaw", {"exponnt": 2}, "settings: unknown key `exponnt`; did you mean"),
        ("path_loss", f"{OWN}:free_space", {"a": 2}, "settings: user_radio_models:free_space is a func"),
        ("shadowing", f"{OWN}:Wall", {"a": 2}, "settings: user_radio_models:Wall has none; expected a"),
        ("shadowing", f"{OWN}:free_space", None, "user_radio_models:free_space is a function; expec"),
        ("path_loss", f"{OWN}:WithoutMethod", None, "WithoutMethod has no method loss_db(from_ned_m,"),
        ("fading", f"{OWN}:WithoutMove", None, "WithoutMove has no method move(at_ns, pos_ned_m,"),
        ("antenna", f"{OWN}:RaisesAtStart", None, "RaisesAtStart raised KeyError: 'level' at "),
        ("path_loss", f"{OWN}:RefusesSettings", {"exponent": 2}, "settings.exponent: 3 and 4 only"),
        ("path_loss", f"{OWN}:wrong_shape", None, ".loss_db returned the shape (3,); expected (2, 3), a"),
        ("path_loss", f"{OWN}:not_a_number", None, ".loss_db returned nan at a distance of 50"),
        ("path_loss", f"{OWN}:gain_above_one", None, "expected losses of 0 dB or more, since less is a"),
        ("path_loss", f"{OWN}:no_array", None, ".loss_db returned str; expected an array of floats, a loss"),
        ("path_loss", f"{OWN}:raises", None, ".loss_db raised TypeError: "),
        ("path_loss", f"{OWN}:exits", None, ".loss_db raised SystemExit: 3 at "),
        ("path_loss", f"{OWN}:changes_distances", None, ".loss_db raised ValueError: output array is read-"),
        ("path_loss", f"{OWN}:RefusesRadio", None, "RefusesRadio: 5 GHz only"),
        ("path_loss", f"{OWN}:UpwardsOnly", None, "returned 60 dB from [0.0, 0.0, -10.0] to [0.0, 50.0"),
        ("shadowing", f"{OWN}:InfiniteShadow", None, ".gain_db returned -inf at a distance of 50.99"),
        ("antenna", f"{OWN}:InfiniteGain", None, ".gain_db returned inf; expected gains in dB, or -inf"),
        ("fading", f"{OWN}:NegativeFading", None, ".gains returned -0.5; expected linear power gains of 0"),
        ("error_model", f"{OWN}:NoFunction", None, ".hazard returned float for ofdm24; expected a function"),
        ("error_model", f"{OWN}:NegativeHazard", None, ".hazard(ofdm24) returned -0.001 at 20 dB; expected"),
    ],
)  # fmt: skip
def test_each_error_is_one_line(kind, model, settings, expected):
    assert expected in refusal(kind, model, settings)


def test_a_model_that_does_not_return_is_given_up(monkeypatch):
    released = threading.Event()
    monkeypatch.setattr("user_radio_models.UNTIL", released)
    monkeypatch.setattr("netsim.radio_models.registry.check_bounded", partial(check_bounded, limit_s=0.2))
    assert refusal("path_loss", f"{OWN}:waits").endswith(
        f"{OWN}:waits does not return; it was given 0.2 s of wall time"
    )
    released.set()


def test_an_error_during_the_run_names_the_model_too():
    swarm = Swarm([(0.0, 0.0, -10.0), (0.0, 2_000.0, -10.0)], path_loss=f"{OWN}:fine_until_far")
    check_models(RadioConfig(path_loss=f"{OWN}:fine_until_far"), 2, PLACES_NED_M)
    swarm.broadcast(0, 1_000)
    with pytest.raises(ExtensionError, match=r"fine_until_far\.loss_db returned nan at a distance of 2000 m"):
        swarm.run(20_000)


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Return a folder of `sys.path` with a distribution that registers three models."""
    (tmp_path / "models_of_dist.py").write_text(
        "import numpy as np\n\ndef slope(distance_m):\n    return 50.0 + 30.0 * np.log10(distance_m)\n"
    )
    info = tmp_path / "models_of_dist-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: models-of-dist\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[coflight.radio]\npath_loss.slope = models_of_dist:slope\nantenna.slope = models_of_dist:absent\n"
        "fading.slope = absent_module:Fading\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    sys.modules.pop("models_of_dist", None)


def test_an_entry_point_is_a_name_of_its_kind(installed):
    assert installed.is_dir()
    assert "slope" in names("path_loss")
    assert "slope" not in names("shadowing")
    check_models(RadioConfig(path_loss="slope"), 2, PLACES_NED_M)
    assert "models_of_dist.py) has no absent" in refusal("antenna", "slope")
    assert "no module absent_module" in refusal("fading", "slope")
    assert "expected log_normal, none, or package.module:Class" in refusal("shadowing", "slope")
    assert "did you mean slope?" in refusal("path_loss", "slop")


def test_modules_of_the_folder_of_the_scenario_are_found_by_every_process(tmp_path):
    (tmp_path / "loss_beside.py").write_text(
        "def constant(distance_m):\n    return 0.0 * distance_m + 70.0\n"
    )
    file = tmp_path / "own.toml"
    file.write_text('[radio]\npath_loss = "loss_beside:constant"\n')
    scenario = load_scenario(file)
    assert scenario.radio.path_loss == RadioModel(model="loss_beside:constant", folder=str(tmp_path))
    assert str(tmp_path) not in sys.path
    # another process reads the scenario as JSON
    del sys.modules["loss_beside"]
    check_models(msgspec.json.decode(msgspec.json.encode(scenario.radio), type=RadioConfig), 8, PLACES_NED_M)
    del sys.modules["loss_beside"]


def test_wrong_models_are_reported_when_the_scenario_is_read(tmp_path):
    file = tmp_path / "own.toml"
    file.write_text('[radio.path_loss]\nmodel = "user_radio_models:PowerLaw"\nsettings = {exponent = 0}\n')
    with pytest.raises(ScenarioError) as caught:
        load_scenario(file)
    assert str(caught.value) == f"{file}: radio.path_loss.settings.exponent: expected `float` >= 1.0"
    assert load_scenario(file, ["radio.path_loss.settings.exponent=2"]).radio.path_loss.settings == {
        "exponent": 2
    }


def test_the_settings_of_built_in_models_stay_as_they_are(tmp_path):
    config = RadioConfig(path_loss="two_ray", antenna="dipole", shadowing_std_db=4.0)
    assert with_folder(config, tmp_path) is config
    assert np.isfinite(config.path_loss_exponent)
