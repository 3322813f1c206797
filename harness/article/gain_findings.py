"""Statements on the maximum gain: wavelength, wind, and the densities of figure 3."""

import itertools
from collections.abc import Callable, Iterable, Mapping

from harness.article.draws import Drawn
from harness.article.evidence import Evidence, Missing
from harness.article.finding import Finding
from harness.article.kept import FLOWN, IN_PLACE, UPRIGHT
from harness.article.plan import CHANGES, FIGURE_WAVELENGTH_M, MEANINGS

SHORT_M = 5.0
FLAT_PER_DB = 1.0
"""A Gaussian of 0.4 dB deviation has this peak."""
FLAT_OF_LONG = 0.5
CALM_WITHIN_DB = 0.3
NOTICEABLE_DB = 0.1
TILT_SHARE = 0.5
SENSITIVE = 2.0
ALIKE_WITHIN_DB = 0.3
RESILIENT_DB = 1.0
_FLAT, _NOT_FLAT = "Flights met the criterion with:", "They did not with:"


def short_is_lowest(evidence: Evidence) -> Finding:
    """Means by wavelength in every wind."""
    means = {
        wind_n: [evidence.gains(each, wind_n).mean_dbi for each in evidence.wavelengths_m]
        for wind_n in evidence.winds_n
    }
    lambdas = ", ".join(f"{each:g}" for each in evidence.wavelengths_m)
    words = [f"{wind_n:g} N {', '.join(f'{mean:.2f}' for mean in found)}" for wind_n, found in means.items()]
    lower = [
        f"λ {each:g} m in {wind_n:g} N"
        for wind_n, found in means.items()
        for each, mean in zip(evidence.wavelengths_m[1:], found[1:], strict=True)
        if mean <= found[0]
    ]
    return Finding(
        found=f"means at λ {lambdas} m, dBi: {'; '.join(words)}", agrees=not lower,
        why=f"No higher: {', '.join(lower)}.",
    )  # fmt: skip


def near_flat(evidence: Evidence) -> Finding:
    """Peaks of the densities of 5 and 10 m in 5 N, and what position error makes them flat."""
    wind_n = evidence.strongest_n
    short, long = (evidence.peak_per_db(each, wind_n) for each in (SHORT_M, FIGURE_WAVELENGTH_M))
    gains = evidence.gains(SHORT_M, wind_n)
    return Finding(
        found=f"peak {short:.1f} per dB, of λ = 10 m {long:.1f}; λ = 5 m: {gains.mean_dbi:.2f} ± "
        f"{gains.std_db:.2f} dBi",
        agrees=is_flat(short, long),
        why=f"Our UAVs hold their places to σ = {evidence.sigma_m(SHORT_M, wind_n):.2f} m on each horizontal "
        f"axis. {_implied_text(evidence.drawn)} {_flat_changes_text(evidence)}",
    )  # fmt: skip


def is_flat(short_per_db: float, long_per_db: float) -> bool:
    """Whether a density with this peak is nearly flat beside one with that."""
    return short_per_db <= min(FLAT_PER_DB, FLAT_OF_LONG * long_per_db)


def implied_sigmas_m(drawn: Mapping[tuple[float, float], Drawn]) -> list[float]:
    """Errors among those drawn with which both hold: 5 m nearly flat, and 10 m and more alike."""
    found = []
    for sigma_m in sorted({sigma_m for sigma_m, _ in drawn}):
        at = {wavelength_m: each for (sigma, wavelength_m), each in drawn.items() if sigma == sigma_m}
        long = [each.statistics.mean_dbi for each_m, each in at.items() if each_m >= FIGURE_WAVELENGTH_M]
        flat = is_flat(at[SHORT_M].peak_per_db, at[FIGURE_WAVELENGTH_M].peak_per_db)
        if flat and max(long) - min(long) <= ALIKE_WITHIN_DB:
            found.append(sigma_m)
    return found


def flat_from_m(drawn: Mapping[tuple[float, float], Drawn]) -> float | None:
    """Least error among those drawn with which the density of 5 m is nearly flat; None: with none."""
    flat = [
        sigma_m
        for sigma_m, wavelength_m in drawn
        if wavelength_m == SHORT_M
        and is_flat(drawn[sigma_m, SHORT_M].peak_per_db, drawn[sigma_m, FIGURE_WAVELENGTH_M].peak_per_db)
    ]
    return min(flat, default=None)


def _implied_text(drawn: Mapping[tuple[float, float], Drawn]) -> str:
    least_m, both_m = flat_from_m(drawn), implied_sigmas_m(drawn)
    if least_m is None:
        return "No error that was drawn gives so flat a density."
    text = f"Random formations give so flat a density from σ = {least_m:g} m on"
    if both_m and len(both_m) > 1:
        return f"{text}, and with 10 m and more alike as well for σ = {both_m[0]:g} to {both_m[-1]:g} m."
    return f"{text}, and with 10 m and more alike as well for " + (
        f"σ = {both_m[0]:g} m." if both_m else "no σ that was drawn."
    )


def _flat_changes_text(evidence: Evidence) -> str:
    """Which of the flown changes makes it flat."""
    flat: list[str] = []
    others: list[str] = []
    for name in CHANGES:
        try:
            peaks = [
                evidence.peak_per_db(m, evidence.strongest_n, name) for m in (SHORT_M, FIGURE_WAVELENGTH_M)
            ]
            sigma_m = evidence.sigma_m(SHORT_M, evidence.strongest_n, name)
        except Missing:
            continue
        words = f"{MEANINGS[name]} (σ = {sigma_m:.2f} m, peaks {peaks[0]:.1f} and {peaks[1]:.1f} per dB)"
        (flat if is_flat(*peaks) else others).append(words)
    said = [f"{what} {'; '.join(found)}." for what, found in ((_FLAT, flat), (_NOT_FLAT, others)) if found]
    return " ".join(said)


def falls_with_wind(evidence: Evidence) -> Finding:
    """Means by wind at every wavelength."""
    means = _by_wind(evidence, lambda wavelength_m, wind_n: evidence.gains(wavelength_m, wind_n).mean_dbi)
    rising = [
        wavelength_m for wavelength_m, found in means.items()
        if any(later >= earlier for earlier, later in itertools.pairwise(found))
    ]  # fmt: skip
    return Finding(
        found=_by_wind_text(evidence, means, "means, dBi", 3), agrees=not rising,
        why=f"It does not fall at λ = {_listed(rising)} m.",
    )  # fmt: skip


def flattens_with_wind(evidence: Evidence) -> Finding:
    """Deviations and peaks by wind at every wavelength."""
    stds = _by_wind(evidence, lambda wavelength_m, wind_n: evidence.gains(wavelength_m, wind_n).std_db)
    peaks = _by_wind(evidence, evidence.peak_per_db)
    others = [each for each in stds if stds[each][-1] <= stds[each][0] or peaks[each][-1] >= peaks[each][0]]
    deviations, highest = (
        _by_wind_text(evidence, found, what, digits)
        for found, what, digits in ((stds, "deviations, dB", 3), (peaks, "peaks, per dB", 1))
    )
    return Finding(
        found=f"{deviations}. {highest}", agrees=not others,
        why=f"It does not at λ = {_listed(others)} m.",
    )  # fmt: skip


def calm_is_ideal(evidence: Evidence) -> Finding:
    """What the formation loses without wind."""
    losses_db = {
        each: evidence.ideal_dbi(each) - evidence.gains(each, evidence.calm_n).mean_dbi
        for each in evidence.wavelengths_m
    }
    return Finding(
        found=_losses_text("less than ideal without wind", losses_db),
        agrees=all(abs(loss_db) <= CALM_WITHIN_DB for loss_db in losses_db.values()),
        why=f"Position errors remain without wind: σ = "
        f"{evidence.sigma_m(evidence.wavelengths_m[0], evidence.calm_n):.2f} m at the shortest wavelength.",
    )  # fmt: skip


def noticeable(evidence: Evidence) -> Finding:
    """What wind costs the means."""
    losses_db = {each: evidence.wind_loss_db(each) for each in evidence.wavelengths_m}
    return Finding(
        found=_losses_text("cost of 5 N", losses_db),
        agrees=all(loss_db >= NOTICEABLE_DB for loss_db in losses_db.values()),
        why="Ranging and the disturbance observer hold the shape in the wind. "
        f"{_tilt_text(evidence)}",
    )  # fmt: skip


def by_angles(evidence: Evidence) -> Finding:
    """What tilt and positions cost, each alone, in 5 N more than without wind."""
    windy = evidence.separation(FIGURE_WAVELENGTH_M, evidence.strongest_n)
    calm = evidence.separation(FIGURE_WAVELENGTH_M, evidence.calm_n)
    more_db = {name: windy.loss_db(name) - calm.loss_db(name) for name in (FLOWN, UPRIGHT, IN_PLACE)}
    return Finding(
        found=f"5 N cost {more_db[FLOWN]:.3f} dB more than no wind: tilt alone {more_db[IN_PLACE]:.3f} dB, "
        f"positions alone {more_db[UPRIGHT]:.3f} dB. {_tilt_text(evidence)}",
        agrees=more_db[FLOWN] > 0.0 and more_db[IN_PLACE] >= TILT_SHARE * more_db[FLOWN],
        why="Positions alone cost more of it.",
    )  # fmt: skip


def _tilt_text(evidence: Evidence) -> str:
    try:
        windy = evidence.separation(FIGURE_WAVELENGTH_M, evidence.strongest_n)
        calm = evidence.separation(FIGURE_WAVELENGTH_M, evidence.calm_n)
    except Missing as missing:
        return f"{missing}."
    return (
        f"In {windy.wind_n:g} N vehicles tilt by {windy.tilt_rms_deg:.1f}° rms and the maximum is "
        f"{windy.pointing_rms_deg:.1f}° rms from +y, without wind {calm.tilt_rms_deg:.1f}° and "
        f"{calm.pointing_rms_deg:.1f}°; the formation as a whole is turned by {windy.turned_rms_deg:.1f}° "
        f"and {calm.turned_rms_deg:.1f}° rms."
    )


def short_is_sensitive(evidence: Evidence) -> Finding:
    """Cost of wind at 5 m and at longer wavelengths."""
    short_db = evidence.wind_loss_db(SHORT_M)
    long_db = {each: evidence.wind_loss_db(each) for each in evidence.long_m}
    return Finding(
        found=_losses_text("cost of 5 N", {SHORT_M: short_db, **long_db}),
        agrees=short_db > 0.0 and short_db >= SENSITIVE * max(long_db.values()),
        why="Tilt costs the same at every wavelength; only what positions cost goes by σ/λ. "
        f"{_separations_text(evidence)}",
    )  # fmt: skip


def _separations_text(evidence: Evidence) -> str:
    """What tilt and positions cost alone at both wavelengths whose flights were kept."""
    words = []
    for wavelength_m in (SHORT_M, FIGURE_WAVELENGTH_M):
        try:
            found = evidence.separation(wavelength_m, evidence.strongest_n)
        except Missing:
            continue
        words.append(
            f"λ {wavelength_m:g} m in 5 N: {found.loss_db(FLOWN):.2f} dB below ideal, tilt alone "
            f"{found.loss_db(IN_PLACE):.2f} dB, positions alone {found.loss_db(UPRIGHT):.2f} dB"
        )
    return f"{'; '.join(words)}." if words else ""


def long_are_alike(evidence: Evidence) -> Finding:
    """Means of 10 m and more in 5 N."""
    means = {each: evidence.gains(each, evidence.strongest_n).mean_dbi for each in evidence.long_m}
    span_db = max(means.values()) - min(means.values())
    words = ", ".join(f"{mean:.2f}" for mean in means.values())
    return Finding(
        found=f"means at λ {_listed(means)} m in 5 N: {words} dBi, {span_db:.2f} dB apart",
        agrees=span_db <= ALIKE_WITHIN_DB, why=_separations_text(evidence),
    )  # fmt: skip


def resilient(evidence: Evidence) -> Finding:
    """Cost of wind at 10 m and more."""
    losses_db = {each: evidence.wind_loss_db(each) for each in evidence.long_m}
    return Finding(
        found=_losses_text("cost of 5 N", losses_db), agrees=max(losses_db.values()) <= RESILIENT_DB,
        why=_separations_text(evidence),
    )  # fmt: skip


def _by_wind(evidence: Evidence, what: Callable[[float, float], float]) -> dict[float, list[float]]:
    """A number by wavelength, of every wind, rising; raises Missing with fewer than two winds."""
    if len(evidence.winds_n) < 2:
        raise Missing("fewer than two winds were flown")
    return {each: [what(each, wind_n) for wind_n in evidence.winds_n] for each in evidence.wavelengths_m}


def _by_wind_text(evidence: Evidence, found: Mapping[float, list[float]], what: str, digits: int) -> str:
    words = [f"λ {each:g} m {', '.join(f'{v:.{digits}f}' for v in values)}" for each, values in found.items()]
    return f"{what}, in {_listed(evidence.winds_n)} N: {'; '.join(words)}"


def _losses_text(what: str, losses_db: Mapping[float, float]) -> str:
    words = ", ".join(f"{loss_db:.3f}" for loss_db in losses_db.values())
    return f"{what} at λ {_listed(losses_db)} m: {words} dB"


def _listed(values: Iterable[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)
