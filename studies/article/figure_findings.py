"""Statements on the pattern in 5 N at 10 m, the article's figure 4.

Numbers are of the flight in the figure, as in the article; verdicts use all retained flights of that pattern.
"""

from msgspec.structs import replace

from studies.article.comparison import ComparedEstimate
from studies.article.evidence import Evidence
from studies.article.finding import Finding, by_margins
from studies.article.patterns import COLOUR_FLOOR_DBI, COLOUR_TOP_DBI
from studies.article.retained_flights import FLOWN, IN_PLACE, UPRIGHT

IDEAL, MEDIAN = "ideal", "median"
LOBE_SHARE = 0.98
LOWER_SHARE = 2.0 / 3.0
ASYMMETRY_DB, SYMMETRIC_DB = 1.0, 0.1
ADEQUATE_DBI = 0.0
REGION_DB = 1.0
REMAINS = 0.5
LOSSLESS_DB = 0.1
"""Powers over all directions that differ by less count as equal."""


def lobe_loses_area(evidence: Evidence) -> Finding:
    """Measure the solid angles of the main lobe, relative to the ideal and to its own maximum."""
    ideal, median, mean = (evidence.pattern(name) for name in (IDEAL, MEDIAN, FLOWN))
    share = median.effective_lobe_sr / ideal.lobe_sr
    shares = evidence.pattern_estimate(lambda of: of[MEDIAN].effective_lobe_sr / of[IDEAL].lobe_sr)
    return by_margins(
        {"share": replace(shares, value=LOBE_SHARE - shares.value)}, unit="",
        found=f"{median.effective_lobe_sr:.3f} sr of {ideal.lobe_sr:.3f} sr, {share:.1%}; flight's "
        f"mean {mean.effective_lobe_sr / ideal.lobe_sr:.1%}; above half of its own maximum "
        f"{median.lobe_sr / ideal.lobe_sr:.1%}; {_over(shares)} {shares.text()}",
        why=f"The maximum is {median.max_gain_dbi:.2f} dBi, ideally {ideal.max_gain_dbi:.2f} dBi. "
        "Tilted vehicles in their places have "
        f"{evidence.pattern(IN_PLACE).effective_lobe_sr / ideal.lobe_sr:.1%}, upright ones at flown "
        f"positions {evidence.pattern(UPRIGHT).effective_lobe_sr / ideal.lobe_sr:.1%}.",
    )  # fmt: skip


def lower_throughout(evidence: Evidence) -> Finding:
    """Measure the share of directions with less than the ideal gain."""
    ideal, median, mean = (evidence.pattern(name) for name in (IDEAL, MEDIAN, FLOWN))
    shares = evidence.pattern_estimate(lambda of: of[MEDIAN].lower_share)
    return by_margins(
        {"share": replace(shares, value=shares.value - LOWER_SHARE)}, unit="",
        found=f"in {median.lower_share:.0%} of them; in the flight's mean in {mean.lower_share:.0%}; "
        f"{_over(shares)} {shares.text()}",
        why=f"Over all directions the mean gain is {median.mean_dbi:.2f} dBi as flown and "
        f"{ideal.mean_dbi:.2f} dBi ideally"
        + (
            ": a loss in some directions is a gain in others."
            if abs(median.mean_dbi - ideal.mean_dbi) <= LOSSLESS_DB
            else "."
        ),
    )  # fmt: skip


def symmetry_lost(evidence: Evidence) -> Finding:
    """Measure the difference from the mirror image."""
    ideal, median, mean = (evidence.pattern(name) for name in (IDEAL, MEDIAN, FLOWN))
    flown = evidence.pattern_estimate(lambda of: of[MEDIAN].asymmetry_db)
    ideally = evidence.pattern_estimate(lambda of: of[IDEAL].asymmetry_db)
    words = []
    if ideally.value > SYMMETRIC_DB:
        words.append("The ideal pattern is not symmetric.")
    if flown.value < ASYMMETRY_DB:
        words.append(f"The flown pattern differs from its mirror image by less than {ASYMMETRY_DB:g} dB.")
    return by_margins(
        {
            "flown": replace(flown, value=flown.value - ASYMMETRY_DB),
            "ideal": replace(ideally, value=SYMMETRIC_DB - ideally.value),
        },
        found=f"{median.asymmetry_db:.2f} dB rms, in the flight's mean {mean.asymmetry_db:.2f} dB, ideal "
        f"{ideal.asymmetry_db:.2f} dB; in that mean "
        f"{evidence.pattern(UPRIGHT).asymmetry_db:.2f} dB with vehicles upright at flown positions, and "
        f"{evidence.pattern(IN_PLACE).asymmetry_db:.2f} dB tilted in their places; {_over(flown)} "
        f"{flown.text(2)} dB",
        why=" ".join(words),
    )  # fmt: skip


def region_is_adequate(evidence: Evidence) -> Finding:
    """Measure the ideal gain in the article's region."""
    ideal = evidence.pattern(IDEAL)
    return Finding(
        found=f"up to {ideal.region_max_dbi:.2f} dBi, mean {ideal.region_dbi:.2f} dBi",
        agrees=ideal.region_max_dbi >= ADEQUATE_DBI,
        why="Upright dipoles radiate little along their axis. "
        f"On the article's colour scale, from {COLOUR_FLOOR_DBI:g} to {COLOUR_TOP_DBI:g} dB, the region "
        f"reaches {(ideal.region_max_dbi - COLOUR_FLOOR_DBI) / (COLOUR_TOP_DBI - COLOUR_FLOOR_DBI):.0%}.",
    )  # fmt: skip


def region_is_reduced(evidence: Evidence) -> Finding:
    """Measure the flown gain in the article's region."""
    readings = [evidence.pattern(name) for name in (IDEAL, MEDIAN, FLOWN)]
    ideal, median, mean = (each.region_dbi for each in readings)
    colours = [each.region_colour_db for each in readings]
    shares = [each.region_lower_share for each in readings]
    at_median = evidence.pattern_estimate(lambda of: of[IDEAL].region_dbi - of[MEDIAN].region_dbi)
    in_mean = evidence.pattern_estimate(lambda of: of[IDEAL].region_dbi - of[FLOWN].region_dbi)
    return by_margins(
        {
            "median instant": replace(at_median, value=at_median.value - REGION_DB),
            "mean": replace(in_mean, value=in_mean.value - REGION_DB),
        },
        found=f"{_lower(ideal - median)}, and lower in {shares[1]:.0%} of it; {_lower(ideal - mean)} in the "
        f"flight's mean, and in {shares[2]:.0%}; {_over(at_median)} the difference from ideal is "
        f"{_negative(at_median).text(2)} dB and {_negative(in_mean).text(2)} dB",
        why=f"The region has {ideal:.2f} dBi ideally, {median:.2f} dBi at the median instant and {mean:.2f} "
        "dBi in the flight's mean. These are means of power. The means of the decibels, as in the colours, "
        f"are {colours[0]:.2f}, {colours[1]:.2f} and {colours[2]:.2f} dB. In the flight's mean, tilted "
        f"vehicles in their places have {evidence.pattern(IN_PLACE).region_dbi:.2f} dBi, upright ones at "
        f"flown positions {evidence.pattern(UPRIGHT).region_dbi:.2f} dBi.",
    )  # fmt: skip


def region_by_tilt(evidence: Evidence) -> Finding:
    """Measure the remaining deficit with upright vehicles."""
    ideal, flown, upright, tilted = (
        evidence.pattern(name).region_dbi for name in (IDEAL, FLOWN, UPRIGHT, IN_PLACE)
    )
    deficit = evidence.pattern_estimate(lambda of: of[IDEAL].region_dbi - of[FLOWN].region_dbi)
    remains = evidence.pattern_estimate(
        lambda of: (
            REMAINS * (of[IDEAL].region_dbi - of[FLOWN].region_dbi)
            - (of[IDEAL].region_dbi - of[UPRIGHT].region_dbi)
        )
    )
    return by_margins(
        {"deficit": deficit, "remainder with upright vehicles": remains},
        found=f"flight's mean {_lower(ideal - flown)}; upright at flown positions {_lower(ideal - upright)}; "
        f"tilted in their places {_lower(ideal - tilted)}",
        why="Position errors contribute to it." if deficit.value > 0.0 else "There is no deficit.",
    )  # fmt: skip


def _lower(by_db: float) -> str:
    return f"{abs(by_db):.2f} dB {'lower' if by_db >= 0.0 else 'higher'} than ideal"


def _over(estimate: ComparedEstimate) -> str:
    return f"over {estimate.flights} flights" if estimate.flights > 1 else "over one flight"


def _negative(estimate: ComparedEstimate) -> ComparedEstimate:
    return replace(estimate, value=-estimate.value)
