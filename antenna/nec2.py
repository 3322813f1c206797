"""NEC2 as backend, through PyNEC: the method of moments on thin wires, in free space.

This is the only import of PyNEC, which is optional. PyNEC keeps the interpreter's lock while it computes:
several cores take several processes, see `antenna.parallel`.
"""

from collections.abc import Sequence

from antenna.backend import BackendUnavailable
from antenna.config import AntennaConfig
from antenna.geometry import Array, ElementsTouch, Snapshot, check_apart
from antenna.patterns import Pattern, directions_deg, make_pattern

SPEED_OF_LIGHT_M_S = 299_792_458.0
SEGMENT_MATCH = 1e-3
"""Wire ends nearer than this part of a segment are one node to NEC2 (User's Guide, structure geometry)."""


class Nec2Unavailable(BackendUnavailable):
    """PyNEC, which brings NEC2, is not installed."""


try:
    import PyNEC
except ImportError as error:
    raise Nec2Unavailable("NEC2 patterns need PyNEC: pip install 'coflight[nec2]'") from error


class Nec2:
    """Patterns of straight dipoles, each fed at the middle one of its segments."""

    name = "nec2"

    def __init__(self, config: AntennaConfig) -> None:
        self._config = config
        self._theta_deg, self._phi_deg = directions_deg(config.grid_deg)
        segment_m = config.element_length_m / config.segments
        # NEC2 does not notice wires that overlap in parallel, and joins ends that nearly meet.
        self._clearance_m = max(2.0 * config.element_radius_m, SEGMENT_MATCH * segment_m)

    def patterns(self, snapshots: Sequence[Snapshot]) -> list[Pattern | ElementsTouch]:
        """See `antenna.backend.Backend`."""
        results: list[Pattern | ElementsTouch] = []
        for snapshot in snapshots:
            try:
                results.append(self.pattern(snapshot))
            except ElementsTouch as touch:
                results.append(touch)
        return results

    def pattern(self, snapshot: Snapshot) -> Pattern:
        """Pattern of one snapshot; raises `ElementsTouch`."""
        check_apart(snapshot, self._config.element_length_m, self._clearance_m)
        far_field = _FarField(snapshot, self._config)
        step_deg = float(self._theta_deg[1])
        gain_dbi = far_field.gain_dbi(len(self._theta_deg), len(self._phi_deg), step_deg)
        return make_pattern(gain_dbi, far_field.gain_at, snapshot, self._config.wavelength_m)


class _FarField:
    """One array in NEC2: built on construction, solved by the first request for gains."""

    def __init__(self, snapshot: Snapshot, config: AntennaConfig) -> None:
        self._context = PyNEC.nec_context()
        self._requests = 0
        geometry = self._context.get_geometry()
        half_m = 0.5 * config.element_length_m * snapshot.axes
        starts_m, ends_m = (snapshot.centres_m - half_m).tolist(), (snapshot.centres_m + half_m).tolist()
        for tag, (start_m, end_m) in enumerate(zip(starts_m, ends_m, strict=True), start=1):
            geometry.wire(tag, config.segments, *start_m, *end_m, config.element_radius_m, 1.0, 1.0)
        self._context.geometry_complete(0)
        frequency_mhz = SPEED_OF_LIGHT_M_S / config.wavelength_m / 1e6
        self._context.fr_card(0, 1, frequency_mhz, 0.0)
        middle = config.segments // 2 + 1
        for tag, voltage in enumerate(snapshot.voltages.tolist(), start=1):
            if voltage != 0.0:  # NEC2 takes a source of 0 V for one of 1 V
                self._context.ex_card(0, tag, middle, 0, voltage.real, voltage.imag, 0.0, 0.0, 0.0, 0.0)

    def gain_dbi(self, theta_count: int, phi_count: int, step_deg: float) -> Array:
        """(theta_count, phi_count) gains from theta = phi = 0 in equal steps."""
        return self._request(theta_count, phi_count, 0.0, 0.0, step_deg)

    def gain_at(self, theta_deg: float, phi_deg: float) -> float:
        """Gain in one direction."""
        return float(self._request(1, 1, theta_deg, phi_deg, 0.0)[0, 0])

    def _request(
        self, theta_count: int, phi_count: int, theta_deg: float, phi_deg: float, step_deg: float
    ) -> Array:
        """Power gains (theta_count, phi_count) of one RP card in normal mode."""
        self._context.rp_card(
            0, theta_count, phi_count, 0, 0, 0, 0, theta_deg, phi_deg, step_deg, step_deg, 0.0, 0.0
        )
        gain_dbi: Array = self._context.get_radiation_pattern(self._requests).get_gain()
        self._requests += 1
        return gain_dbi
