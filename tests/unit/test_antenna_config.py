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
    ],
)
def test_what_nec2_cannot_do_is_refused_at_the_door(settings, message):
    with pytest.raises(msgspec.ValidationError, match=message):
        msgspec.convert(settings, AntennaConfig)


def test_defaults_pass_their_own_checks():
    assert msgspec.convert({}, AntennaConfig) == AntennaConfig()
