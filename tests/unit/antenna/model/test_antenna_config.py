import msgspec
import pytest

from antenna.model.config import AntennaConfig
from antenna.solvers.batch.accuracy import batch_accuracy
from antenna.solvers.interface import Accuracy


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"segments": 8}, "odd"),
        ({"element_radius_m": 0.002}, "radii"),
        ({"segments": 99}, "radii"),
        ({"wavelength_m": 0.0}, "wavelength_m"),
        ({"grid_deg": 45.0}, "grid_deg"),
        ({"grid_deg": 0.09}, r"Expected `float` >= 0.1 - at `\$.grid_deg`"),
        ({"element_length_m": 1e-320, "element_radius_m": 1e-9}, r"Expected `float` >= 1e-06"),
        ({"element_radius_m": 1e-320}, r"Expected `float` >= 1e-09"),
        ({"element_kind": "loop", "element_length_m": 0.03, "segments": 3, "element_radius_m": 0.0012},
         "a segment is 6.9 radii long"),
        ({"ground": "real"}, "backend: batch does not support real ground; expected nec2 or nec2c"),
        (
            {"ground": "real", "backend": "nec2", "excitation": "optimum"},
            "excitation: .* support real ground",
        ),
        ({"element_kind": "deck"}, "element_file: element_kind deck requires"),
        ({"element_kind": "deck", "element_deck": " \n"}, "element_file: element_kind deck requires"),
        ({"element_kind": "deck", "element_deck": "GW 1 9 0 0 0 0 0 1 1\nXX"}, "line 2: card 'XX'"),
        ({"element_kind": "deck", "element_deck": "GW 1 9 0 0 0 0 0 1 11\nEX 0 1 5 0 1 0"},
         "line 1: GW: radius of 11 m"),
        ({"element_file": "a.nec"}, "element_file: only for element_kind deck, not dipole"),
        ({"element_kind": "loop", "element_deck": "CE"}, "element_deck: only for element_kind deck"),
    ],
)  # fmt: skip
def test_invalid_settings_are_rejected_when_decoded(settings, message):
    with pytest.raises(msgspec.ValidationError, match=message):
        msgspec.convert(settings, AntennaConfig)


@pytest.mark.parametrize("excitation", ["end_fire", "hansen_woodyard"])
def test_feeds_without_a_solver_work_over_real_ground(excitation):
    settings = {"ground": "real", "backend": "nec2c", "excitation": excitation}
    assert msgspec.convert(settings, AntennaConfig).excitation == excitation


def test_defaults_are_valid():
    assert msgspec.convert({}, AntennaConfig) == AntennaConfig()


def _deck(*wires):
    cards = "\n".join(f"GW {tag} {wire}" for tag, wire in enumerate(wires, start=1))
    return {"element_kind": "deck", "element_deck": f"{cards}\nGE 0\nEX 0 1 2 0 1 0\nEN\n"}


LONG = {"element_length_m": 5.0, "element_radius_m": 0.001}
LOOP = {"element_kind": "loop", "element_radius_m": 0.001}
TRIANGLE = "3 0 0 0 0 0 .3 .001", "3 0 0 .3 0 .3 0 .001", "3 0 .3 0 0 0 0 .001"


@pytest.mark.parametrize(
    ("settings", "accuracy"),
    [
        ({}, Accuracy.SMALL_ELEMENTS),
        ({"wavelength_m": 5.0}, Accuracy.SMALL_ELEMENTS),
        ({"wavelength_m": 15.0}, Accuracy.SMALL_ELEMENTS),
        ({"wavelength_m": 15.0, "segments": 21}, Accuracy.FAINT_ELEMENTS),
        ({"wavelength_m": 20.0}, Accuracy.FAINT_ELEMENTS),
        ({"wavelength_m": 40.0, "segments": 3}, Accuracy.FAINT_ELEMENTS),
        (LONG | {"segments": 5}, Accuracy.LARGE_ELEMENTS),
        (LONG | {"segments": 3}, Accuracy.LONG_SEGMENTS),
        (LONG | {"wavelength_m": 5.0, "segments": 9}, Accuracy.LONG_SEGMENTS),
        (LONG | {"wavelength_m": 5.0, "segments": 11}, Accuracy.LARGEST_ELEMENTS),
        (LONG | {"wavelength_m": 9.99, "segments": 11}, Accuracy.LARGEST_ELEMENTS),
        (LOOP | {"element_length_m": 1.0, "segments": 12}, Accuracy.SMALL_ELEMENTS),
        (LOOP | {"element_length_m": 1.2, "segments": 12}, Accuracy.WIDE_LOOP),
        (LOOP | {"element_length_m": 10.0, "segments": 9}, Accuracy.LONG_SEGMENTS),
        (LOOP | {"element_length_m": 1.0, "segments": 7}, Accuracy.COARSE_LOOP),
        (_deck("9 0 0 -.5 0 0 .5 .001", "3 0 0 .5 .3 0 .6 .001"), Accuracy.LARGE_ELEMENTS),
        (_deck("9 0 0 -.2 0 0 .2 .001"), Accuracy.SMALL_ELEMENTS),
        (_deck("9 0 0 -.2 0 0 .2 .006"), Accuracy.SHORT_SEGMENTS),
        (_deck("9 0 0 -.9 0 0 .9 .001"), Accuracy.LARGE_DECK),
        (_deck(*TRIANGLE), Accuracy.RING_DECK),
        (_deck(*TRIANGLE[:2]), Accuracy.SMALL_ELEMENTS),
        (_deck("9 0 0 2.3 0 0 2.6 .001"), Accuracy.LARGEST_ELEMENTS),
    ],
)
def test_batch_accuracy_is_limited_to_the_range_compared_with_nec2(settings, accuracy):
    assert batch_accuracy(msgspec.convert(settings, AntennaConfig)) == accuracy
