"""Backend ``nec2``: NEC2 through PyNEC, the method of moments on thin wires.

Only this module imports PyNEC, which is optional. PyNEC holds the interpreter lock while it computes, so
several cores need several processes, see `antenna.solvers.parallel`.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from antenna.analysis.patterns import from_dbi
from antenna.model.array_deck import SPEED_OF_LIGHT_M_S, feed
from antenna.model.clearance import placed_wires_m
from antenna.model.config import AntennaConfig
from antenna.model.geometry import Array, Snapshot
from antenna.solvers.interface import BackendUnavailable
from antenna.solvers.nec2_common import FarField, Nec2Solver


class Nec2Unavailable(BackendUnavailable):
    """PyNEC, which brings NEC2, is not installed."""


try:
    import PyNEC
except ImportError as error:
    raise Nec2Unavailable("NEC2 patterns need PyNEC: pip install 'coflight[nec2]'") from error


class PynecFarField(FarField):
    """One array in NEC2: built on construction, solved by the first request for gains."""

    def __init__(self, snapshot: Snapshot, config: AntennaConfig) -> None:
        super().__init__(snapshot, config)
        element = config.element()
        self._context = PyNEC.nec_context()
        self._requests = 0
        geometry = self._context.get_geometry()
        tag = 0
        for placed in placed_wires_m(snapshot, element).tolist():
            for wire, (start_m, end_m) in zip(element.wires, placed, strict=True):
                tag += 1
                geometry.wire(tag, wire.segments, *start_m, *end_m, wire.radius_m, 1.0, 1.0)
        self._context.geometry_complete(1 if self._grounded else 0)
        if config.ground == "perfect":
            self._context.gn_card(1, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        elif config.ground == "real":
            self._context.gn_card(
                2, 0, config.ground_permittivity, config.ground_conductivity_s_m, 0.0, 0.0, 0.0, 0.0
            )
        self._context.fr_card(0, 1, SPEED_OF_LIGHT_M_S / config.wavelength_m / 1e6, 0.0)
        fed_wire, segment = feed(element)
        for k, voltage in enumerate(snapshot.voltages.tolist()):
            if voltage != 0.0:  # NEC2 treats a source of 0 V as 1 V
                tag = k * len(element.wires) + fed_wire + 1
                self._context.ex_card(0, tag, segment + 1, 0, voltage.real, voltage.imag, 0.0, 0.0, 0.0, 0.0)

    def _grid(self, rows: int, columns: int, step_deg: float) -> Array:
        pattern = self._request(rows, columns, 0.0, 0.0, step_deg)
        # get_gain_vert and get_gain_horiz refer to the polarisation ellipse; the fields are phi-major
        powers = np.array([np.abs(f) ** 2 for f in (pattern.get_e_theta(), pattern.get_e_phi())])
        powers = powers.reshape(2, columns, rows).transpose(0, 2, 1)
        share = powers / np.maximum(powers.sum(axis=0), np.finfo(float).tiny)
        return np.asarray(share * from_dbi(pattern.get_gain()))

    def _towards_dbi(self, directions_deg: Sequence[tuple[float, float]]) -> list[float]:
        return [self._request(1, 1, *pair, 0.0).get_gain()[0, 0] for pair in directions_deg]

    def _request(self, rows: int, columns: int, theta_deg: float, phi_deg: float, step_deg: float) -> Any:  # noqa: ANN401  PyNEC has no types
        """Compute one RP card in normal mode and return its pattern."""
        self._context.rp_card(0, rows, columns, 0, 0, 0, 0, theta_deg, phi_deg, step_deg, step_deg, 0.0, 0.0)
        self._requests += 1
        return self._context.get_radiation_pattern(self._requests - 1)


class Nec2(Nec2Solver):
    """Patterns by PyNEC."""

    name = "nec2"
    far_field = PynecFarField
