"""Export an array at one instant as a NEC deck with wires, feeds, ground and wavelength."""

from collections.abc import Sequence

from antenna.analysis.patterns import Pattern
from antenna.model.config import AntennaConfig
from antenna.model.deck import Ground, write_deck
from antenna.model.geometry import Snapshot


def ground_of(config: AntennaConfig) -> Ground | None:
    """Return the ground of a deck; None is free space."""
    match config.ground:
        case "none":
            return None
        case "perfect":
            return Ground()
        case "real":
            return Ground(
                permittivity=config.ground_permittivity, conductivity_s_m=config.ground_conductivity_s_m
            )


def deck_of(
    snapshot: Snapshot, config: AntennaConfig, pattern: Pattern, *, comments: Sequence[str] = ()
) -> str:
    """Return the NEC deck of a snapshot, with comments on its frame and the pattern's maximum."""
    maximum = (
        f"{pattern.backend}: {pattern.max_gain_dbi:.2f} dBi at theta {pattern.max_theta_deg:.1f},"
        f" phi {pattern.max_phi_deg:.1f}"
    )
    return write_deck(
        snapshot, config.element(), config.wavelength_m, ground=ground_of(config),
        step_deg=config.grid_deg, comments=[*comments, "coflight: x broadside, y end-fire, z up", maximum],
    )  # fmt: skip
