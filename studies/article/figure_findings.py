"""Statements on the pattern in 5 N at 10 m, the article's figure 4.

Numbers are of the flight that is shown, as the article's are; verdicts of all kept flights of that pattern.
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
"""Powers over all directions that differ by less are the same."""


def lobe_loses_area(evidence: Evidence) -> Finding:
    """Solid angles of the main lobe, above the ideal's outline and its own."""
    ideal, median, mean = (evidence.pattern(name) for name in (IDEAL, MEDIAN, FLOWN))
    share = median.effective_lobe_sr / ideal.lobe_sr
    shares = evidence.pattern_estimate(lambda of: of[MEDIAN].effective_lobe_sr / of[IDEAL].lobe_sr)
    return by_margins(
        {"share": replace(shares, value=LOBE_SHARE - shares.value)}, unit="",
        found=f"{median.effective_lobe_sr:.3f} sr of {ideal.lobe_sr:.3f} sr, {share:.1%}; of the flight's "
        f"mean {mean.effective_lobe_sr / ideal.lobe_sr:.1%}; within half of its own maximum "
        f"{median.lobe_sr / ideal.lobe_sr:.1%}; {_over(shares)} {shares.text()}",
        why=f"The maximum is {median.max_gain_dbi:.2f} dBi, ideally {ideal.max_gain_dbi:.2f} dBi. "
        f"Tilted vehicles in their places keep "
        f"{evidence.pattern(IN_PLACE).effective_lobe_sr / ideal.lobe_sr:.1%}, upright ones where they flew "
        f"{evidence.pattern(UPRIGHT).effective_lobe_sr / ideal.lobe_sr:.1%}.",
    )  # fmt: skip


def lower_throughout(evidence: Evidence) -> Finding:
    """Share of the directions with less gain than ideal."""
    ideal, median, mean = (evidence.pattern(name) for name in (IDEAL, MEDIAN, FLOWN))
    shares = evidence.pattern_estimate(lambda of: of[MEDIAN].lower_share)
    return by_margins(
        {"share": replace(shares, value=shares.value - LOWER_SHARE)}, unit="",
        found=f"in {median.lower_share:.0%} of them; in the flight's mean in {mean.lower_share:.0%}; "
        f"{_over(shares)} {shares.text()}",
        why=f"Over all directions the mean gain is {median.mean_dbi:.2f} dBi as flown and "
        f"{ideal.mean_dbi:.2f} dBi ideally"
        + (
            ": what some directions lose others have to gain."
            if abs(median.mean_dbi - ideal.mean_dbi) <= LOSSLESS_DB
            else "."
        ),
    )  # fmt: skip


def symmetry_lost(evidence: Evidence) -> Finding:
    """Difference from the mirror image."""
    ideal, median, mean = (evidence.pattern(name) for name in (IDEAL, MEDIAN, FLOWN))
    flown = evidence.pattern_estimate(lambda of: of[MEDIAN].asymmetry_db)
    ideally = evidence.pattern_estimate(lambda of: of[IDEAL].asymmetry_db)
    words = []
    if ideally.value > SYMMETRIC_DB:
        words.append("The ideal pattern is not symmetric itself.")
    if flown.value < ASYMMETRY_DB:
        words.append(f"The flown one differs from its mirror image by less than {ASYMMETRY_DB:g} dB.")
    return by_margins(
        {
            "flown": replace(flown, value=flown.value - ASYMMETRY_DB),
            "ideal": replace(ideally, value=SYMMETRIC_DB - ideally.value),
        },
        found=f"{median.asymmetry_db:.2f} dB rms, in the flight's mean {mean.asymmetry_db:.2f} dB, ideal "
        f"{ideal.asymmetry_db:.2f} dB; of that mean the vehicles make "
        f"{evidence.pattern(UPRIGHT).asymmetry_db:.2f} dB upright where they flew, and "
        f"{evidence.pattern(IN_PLACE).asymmetry_db:.2f} dB tilted in their places; {_over(flown)} "
        f"{flown.text(2)} dB",
        why=" ".join(words),
    )  # fmt: skip


def region_is_adequate(evidence: Evidence) -> Finding:
    """Ideal gain in the article's region."""
    ideal = evidence.pattern(IDEAL)
    return Finding(
        found=f"up to {ideal.region_max_dbi:.2f} dBi, {ideal.region_dbi:.2f} dBi in the mean",
        agrees=ideal.region_max_dbi >= ADEQUATE_DBI,
        why="Upright dipoles radiate little towards their ends. "
        f"On the article's scale of colours, from {COLOUR_FLOOR_DBI:g} to {COLOUR_TOP_DBI:g} dB, the region "
        f"reaches {(ideal.region_max_dbi - COLOUR_FLOOR_DBI) / (COLOUR_TOP_DBI - COLOUR_FLOOR_DBI):.0%}.",
    )  # fmt: skip


def region_is_reduced(evidence: Evidence) -> Finding:
    """Flown gain in the article's region."""
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
        "dBi in the flight's mean. These are means of power. By decibels, as the colours have it, the region "
        f"has {colours[0]:.2f}, {colours[1]:.2f} and {colours[2]:.2f} dB. Of the mean, tilted vehicles in "
        f"their places have {evidence.pattern(IN_PLACE).region_dbi:.2f} dBi, upright ones where they flew "
        f"{evidence.pattern(UPRIGHT).region_dbi:.2f} dBi.",
    )  # fmt: skip


def region_by_tilt(evidence: Evidence) -> Finding:
    """What is left of the deficit when the vehicles are set upright."""
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
        {"deficit": deficit, "what upright vehicles leave of it": remains},
        found=f"flight's mean {_lower(ideal - flown)}; upright where they flew {_lower(ideal - upright)}; "
        f"tilted in their places {_lower(ideal - tilted)}",
        why="Positions take part in it." if deficit.value > 0.0 else "There is no deficit.",
    )  # fmt: skip


def _lower(by_db: float) -> str:
    return f"{abs(by_db):.2f} dB {'lower' if by_db >= 0.0 else 'higher'} than ideal"


def _over(estimate: ComparedEstimate) -> str:
    return f"over {estimate.flights} flights" if estimate.flights > 1 else "over one flight"


def _negative(estimate: ComparedEstimate) -> ComparedEstimate:
    return replace(estimate, value=-estimate.value)
