"""Statements on the densities of the maximum gain, figure 3: wavelength and wind."""

import itertools
from collections.abc import Callable, Iterable, Mapping

from studies.article.campaign_data import Cell
from studies.article.comparison import ComparedEstimate, mean_dbi, peak_per_db, std_db
from studies.article.evidence import Evidence, Missing
from studies.article.finding import Finding, by_margins
from studies.article.monte_carlo import Drawn
from studies.article.plan import ARTICLE, CHANGES, FIGURE_WAVELENGTH_M, MEANINGS

SHORT_M = 5.0
FLAT_PER_DB = 1.0
"""Peak of a Gaussian density with 0.4 dB deviation."""
FLAT_OF_LONG = 0.5
CALM_WITHIN_DB = 0.3
ALIKE_WITHIN_DB = 0.3
_FLAT, _NOT_FLAT = "Flights that meet the criterion:", "Flights that do not:"


def short_is_lowest(evidence: Evidence) -> Finding:
    """Compare the means of the wavelengths in every wind."""
    shortest_m, *longer_m = evidence.wavelengths_m
    if not longer_m:
        raise Missing("only one wavelength was flown")
    margins, words = {}, []
    for wind_n in evidence.winds_n:
        means = [
            evidence.estimate([(ARTICLE, each, wind_n)], mean_dbi).value for each in evidence.wavelengths_m
        ]
        words.append(f"{wind_n:g} N {', '.join(f'{mean:.2f}' for mean in means)}")
        for each in longer_m:
            margins[f"λ {each:g} m in {wind_n:g} N"] = evidence.estimate(
                [(ARTICLE, each, wind_n), (ARTICLE, shortest_m, wind_n)],
                lambda longer, shortest: mean_dbi(longer) - mean_dbi(shortest),
            )
    return by_margins(
        margins, found=f"means at λ {listed(evidence.wavelengths_m)} m, dBi: {'; '.join(words)}"
    )


def near_flat(evidence: Evidence) -> Finding:
    """Compare the peaks of the densities of 5 and 10 m in 5 N, with the position errors that flatten them."""
    wind_n = evidence.strongest_n
    keys = [(ARTICLE, each, wind_n) for each in (SHORT_M, FIGURE_WAVELENGTH_M)]
    short, long = (evidence.estimate([key], peak_per_db) for key in keys)
    margins = {
        f"λ {SHORT_M:g} m, limit {FLAT_PER_DB:g} per dB": evidence.estimate(
            keys[:1], lambda short: FLAT_PER_DB - peak_per_db(short)
        ),
        f"relative to λ {FIGURE_WAVELENGTH_M:g} m": evidence.estimate(
            keys, lambda short, long: FLAT_OF_LONG * peak_per_db(long) - peak_per_db(short)
        ),
    }
    gains = evidence.gains(SHORT_M, wind_n)
    return by_margins(
        margins, unit=" per dB", digits=1,
        found=f"peak {short.text(1)} per dB, at λ = {FIGURE_WAVELENGTH_M:g} m {long.text(1)}; λ = "
        f"{SHORT_M:g} m: {gains.mean_dbi:.2f} ± {gains.std_db:.2f} dBi (deviation of all instants)",
        why=f"Our UAVs have a position error of σ = {evidence.sigma_m(SHORT_M, wind_n):.2f} m on each "
        f"horizontal axis. {_implied_text(evidence.drawn)} {_flat_changes_text(evidence)}",
    )  # fmt: skip


def is_flat(short_per_db: float, long_per_db: float) -> bool:
    """Return whether a density with peak ``short_per_db`` is nearly flat relative to ``long_per_db``."""
    return short_per_db <= min(FLAT_PER_DB, FLAT_OF_LONG * long_per_db)


def implied_sigmas_m(drawn: Mapping[tuple[float, float], Drawn]) -> list[float]:
    """Return the drawn errors for which 5 m is nearly flat and the means of 10 m and more agree."""
    found = []
    for sigma_m in sorted({sigma_m for sigma_m, _ in drawn}):
        at = {wavelength_m: each for (sigma, wavelength_m), each in drawn.items() if sigma == sigma_m}
        long = [each.statistics.mean_dbi for each_m, each in at.items() if each_m >= FIGURE_WAVELENGTH_M]
        flat = is_flat(at[SHORT_M].peak_per_db, at[FIGURE_WAVELENGTH_M].peak_per_db)
        if flat and max(long) - min(long) <= ALIKE_WITHIN_DB:
            found.append(sigma_m)
    return found


def flat_from_m(drawn: Mapping[tuple[float, float], Drawn]) -> float | None:
    """Return the smallest drawn error for which the density of 5 m is nearly flat; None if there is none."""
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
        return "No drawn error leads to such a flat density."
    both = f"σ = {listed(both_m)} m" if both_m else "no drawn σ"
    return (
        f"The smallest error of random formations with such a flat density is σ = {least_m:g} m; the means "
        f"of 10 m and more also agree for {both}."
    )


def _flat_changes_text(evidence: Evidence) -> str:
    """Return the flown changes that flatten the density, and those that do not."""
    flat: list[str] = []
    others: list[str] = []
    for name in CHANGES:
        try:
            short, long = (
                evidence.cell(each, evidence.strongest_n, name) for each in (SHORT_M, FIGURE_WAVELENGTH_M)
            )
            sigma_m = evidence.sigma_m(SHORT_M, evidence.strongest_n, name)
        except Missing:
            continue
        peaks = peak_per_db(short), peak_per_db(long)
        words = f"{MEANINGS[name]} (σ = {sigma_m:.2f} m, peaks {peaks[0]:.1f} and {peaks[1]:.1f} per dB)"
        (flat if is_flat(*peaks) else others).append(words)
    said = [f"{what} {'; '.join(found)}." for what, found in ((_FLAT, flat), (_NOT_FLAT, others)) if found]
    return " ".join(said)


def falls_with_wind(evidence: Evidence) -> Finding:
    """Compare the means of the winds at every wavelength."""
    margins = {
        f"λ {each:g} m, {low:g} to {high:g} N": evidence.estimate(
            [(ARTICLE, each, low), (ARTICLE, each, high)], lambda low, high: mean_dbi(low) - mean_dbi(high)
        )
        for each in evidence.wavelengths_m
        for low, high in itertools.pairwise(_several_winds(evidence))
    }
    return by_margins(margins, found=_by_wind(evidence, mean_dbi, "means, dBi", 3))


def flattens_with_wind(evidence: Evidence) -> Finding:
    """Compare deviations and peaks of the winds at every wavelength."""
    winds_n = _several_winds(evidence)
    weakest_n, strongest_n = winds_n[0], winds_n[-1]
    deviations: dict[str, ComparedEstimate] = {}
    peaks: dict[str, ComparedEstimate] = {}
    for each in evidence.wavelengths_m:
        keys = [(ARTICLE, each, weakest_n), (ARTICLE, each, strongest_n)]
        name = f"λ {each:g} m"
        deviations[f"{name}, deviation"] = evidence.estimate(
            keys, lambda low, high: std_db(high) - std_db(low)
        )
        peaks[f"{name}, peak, 1/dB"] = evidence.estimate(
            keys, lambda low, high: peak_per_db(low) - peak_per_db(high)
        )
    said = [
        _by_wind(evidence, std_db, "deviations, dB", 3), _by_wind(evidence, peak_per_db, "peaks, per dB", 1)
    ]  # fmt: skip
    return by_margins(deviations | peaks, found=". ".join(said), unit="")


def calm_is_ideal(evidence: Evidence) -> Finding:
    """Measure the loss without wind."""
    losses: dict[str, ComparedEstimate] = {}
    margins: dict[str, ComparedEstimate] = {}
    for each in evidence.wavelengths_m:
        ideal_dbi = evidence.ideal_dbi(each)
        key = (ARTICLE, each, evidence.calm_n)
        losses[f"λ {each:g} m"] = evidence.estimate(
            [key], lambda calm, ideal=ideal_dbi: ideal - mean_dbi(calm)
        )
        margins[f"λ {each:g} m"] = evidence.estimate(
            [key], lambda calm, ideal=ideal_dbi: CALM_WITHIN_DB - abs(ideal - mean_dbi(calm))
        )
    return by_margins(
        margins, found=f"loss from the ideal gain without wind, dB: {estimates_text(losses)}",
        why=_calm_text(evidence, losses),
    )  # fmt: skip


def _calm_text(evidence: Evidence, losses: Mapping[str, ComparedEstimate]) -> str:
    """Return the reason for losses, the position errors, and the wavelengths with a mean above the ideal."""
    above = [name for name, loss in losses.items() if loss.value < -CALM_WITHIN_DB]
    below = [name for name, loss in losses.items() if loss.value > CALM_WITHIN_DB]
    words = []
    if below:
        sigmas = [
            f"{evidence.sigma_m(each, evidence.calm_n):.2f} m at λ {each:g} m"
            for each in evidence.wavelengths_m
            if f"λ {each:g} m" in below
        ]
        words.append(f"Position errors remain without wind: σ = {', '.join(sigmas)}.")
    if above:
        words.append(f"Above the ideal at {', '.join(above)}.")
    return " ".join(words)


def _several_winds(evidence: Evidence) -> list[float]:
    if len(evidence.winds_n) < 2:
        raise Missing("fewer than two winds were flown")
    return evidence.winds_n


def _by_wind(evidence: Evidence, what: Callable[[Cell], float], name: str, digits: int) -> str:
    """Return a measure by wavelength in every wind, as text."""
    words = []
    for each in evidence.wavelengths_m:
        found = [evidence.estimate([(ARTICLE, each, wind_n)], what).value for wind_n in evidence.winds_n]
        words.append(f"λ {each:g} m {', '.join(f'{value:.{digits}f}' for value in found)}")
    return f"{name}, in {listed(evidence.winds_n)} N: {'; '.join(words)}"


def estimates_text(estimates: Mapping[str, ComparedEstimate], digits: int = 3) -> str:
    """Format estimates with their standard errors by name."""
    return ", ".join(f"{name} {estimate.text(digits)}" for name, estimate in estimates.items())


def listed(values: Iterable[float]) -> str:
    """Format numbers as a list."""
    return ", ".join(f"{value:g}" for value in values)
