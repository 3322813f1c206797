"""The standard atmosphere against ISO 2533's table and against hydrostatics."""

import numpy as np
import pytest

from autopilot.estimation import atmosphere


@pytest.mark.parametrize(
    ("altitude_m", "temperature_k", "pressure_pa", "density_kg_m3"),
    [
        (0.0, 288.150, 101_325.0, 1.22500),
        (1_000.0, 281.650, 89_874.6, 1.11164),
        (5_000.0, 255.650, 54_019.9, 0.736116),
        (11_000.0, 216.650, 22_632.1, 0.363918),
    ],
)
def test_table_of_iso_2533(altitude_m, temperature_k, pressure_pa, density_kg_m3):
    assert atmosphere.temperature_k(altitude_m) == pytest.approx(temperature_k, abs=1e-9)
    assert atmosphere.pressure_pa(altitude_m) == pytest.approx(pressure_pa, abs=0.06)
    assert atmosphere.density_kg_m3(altitude_m) == pytest.approx(density_kg_m3, rel=5e-6)


def test_altitude_inverts_pressure_for_arrays_too():
    altitude_m = np.linspace(-500.0, 11_000.0, 24).reshape(4, 6)
    back_m = atmosphere.altitude_m(atmosphere.pressure_pa(altitude_m))
    np.testing.assert_allclose(back_m, altitude_m, atol=1e-8)


def test_pressure_falls_by_the_weight_of_the_air():
    slope_pa_m = (atmosphere.pressure_pa(488.5) - atmosphere.pressure_pa(487.5)) / 1.0
    assert slope_pa_m == pytest.approx(-atmosphere.density_kg_m3(488.0) * atmosphere.GRAVITY_M_S2, rel=1e-7)
