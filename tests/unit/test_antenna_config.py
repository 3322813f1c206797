import msgspec
import pytest

from antenna.config import AntennaConfig


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"segments": 8}, "odd"),
        ({"element_radius_m": 0.002}, "radii"),
        ({"segments": 99}, "radii"),
        ({"wavelength_m": 0.0}, "wavelength_m"),
        ({"grid_deg": 45.0}, "grid_deg"),
        ({"ground": "real"}, "backend: batch knows no real ground; expected nec2 or nec2c"),
        ({"ground": "real", "backend": "nec2", "excitation": "optimum"}, "excitation: .* no real ground"),
        ({"element_kind": "deck"}, "element_file: the kind deck needs one"),
        ({"element_kind": "deck", "element_deck": " \n"}, "element_file: the kind deck needs one"),
        ({"element_kind": "deck", "element_deck": "GW 1 9 0 0 0 0 0 1 1\nXX"}, "line 2: card 'XX'"),
        ({"element_file": "a.nec"}, "element_file: a dipole has none; expected element_kind deck"),
        ({"element_kind": "loop", "element_deck": "CE"}, "element_deck: a loop has none"),
    ],
)
def test_what_no_solver_can_do_is_refused_at_the_door(settings, message):
    with pytest.raises(msgspec.ValidationError, match=message):
        msgspec.convert(settings, AntennaConfig)


@pytest.mark.parametrize("excitation", ["end_fire", "hansen_woodyard"])
def test_over_a_real_ground_feeds_that_need_no_solver_are_had(excitation):
    settings = {"ground": "real", "backend": "nec2c", "excitation": excitation}
    assert msgspec.convert(settings, AntennaConfig).excitation == excitation


def test_defaults_pass_their_own_checks():
    assert msgspec.convert({}, AntennaConfig) == AntennaConfig()
