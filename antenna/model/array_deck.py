"""Write an array at one instant as a NEC deck with wires, feeds, ground and wavelength."""

from collections.abc import Sequence

from antenna.analysis.patterns import Pattern, directions_deg
from antenna.model.clearance import placed_wires_m
from antenna.model.config import AntennaConfig
from antenna.model.elements import Element
from antenna.model.geometry import Snapshot

SPEED_OF_LIGHT_M_S = 299_792_458.0


def deck_of(
    snapshot: Snapshot, config: AntennaConfig, pattern: Pattern, *, comments: Sequence[str] = ()
) -> str:
    """Return the deck of a snapshot, with comments on its frame and the pattern's maximum."""
    maximum = (
        f"{pattern.backend}: {pattern.max_gain_dbi:.2f} dBi at theta {pattern.max_theta_deg:.1f},"
        f" phi {pattern.max_phi_deg:.1f}"
    )
    comments = [*comments, "coflight: x broadside, y end-fire, z up", maximum]
    return write_deck(snapshot, config, step_deg=config.grid_deg, comments=comments)


def write_deck(
    snapshot: Snapshot, config: AntennaConfig, *, step_deg: float = 5.0, comments: Sequence[str] = ()
) -> str:
    """Return the deck of a snapshot, with a request for the gain on a grid of the sphere.

    Element k has the tags k W + 1 to (k + 1) W, where W is its number of wires.
    """
    element, grounded = config.element(), config.ground != "none"
    cards = [f"CM {comment}" for comment in comments] + ["CE"]
    for k, wires in enumerate(placed_wires_m(snapshot, element)):
        for w, (wire, ends_m) in enumerate(zip(element.wires, wires, strict=True)):
            numbers = (*ends_m[0].tolist(), *ends_m[1].tolist(), wire.radius_m)
            tag = k * len(element.wires) + w + 1
            cards.append(f"GW {tag} {wire.segments} " + " ".join(f"{value:.9g}" for value in numbers))
    cards.append(f"GE {int(grounded)}")
    if config.ground == "perfect":
        cards.append("GN 1")
    elif config.ground == "real":
        cards.append(f"GN 2 0 0 0 {config.ground_permittivity:.9g} {config.ground_conductivity_s_m:.9g}")
    cards.append(f"FR 0 1 0 0 {SPEED_OF_LIGHT_M_S / config.wavelength_m / 1e6:.12g} 0")
    fed, segment = feed(element)
    for k, voltage in enumerate(snapshot.voltages.tolist()):
        if voltage != 0.0:  # NEC2 treats a source of 0 V as 1 V
            tag = k * len(element.wires) + fed + 1
            cards.append(f"EX 0 {tag} {segment + 1} 0 {voltage.real:.9g} {voltage.imag:.9g}")
    theta_deg, phi_deg = directions_deg(step_deg)
    rows = len(theta_deg) // 2 + 1 if grounded else len(theta_deg)
    step = f"{theta_deg[1]:.9g}"
    cards += [f"RP 0 {rows} {len(phi_deg)} 1000 0 0 {step} {step} 0 0", "EN"]
    return "\n".join(cards) + "\n"


def feed(element: Element) -> tuple[int, int]:
    """Return the wire and its segment at which an element is fed, both from 0."""
    segment = element.feed_segment
    for number, wire in enumerate(element.wires):
        if segment < wire.segments:
            return number, segment
        segment -= wire.segments
    raise AssertionError("feed_segment is not a segment of the element")
