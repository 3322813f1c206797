"""Statements on the pattern in 5 N at 10 m, the article's figure 4."""

from harness.article.evidence import Evidence
from harness.article.finding import Finding
from harness.article.kept import FLOWN, IN_PLACE, UPRIGHT
from harness.article.patterns import COLOUR_FLOOR_DBI, COLOUR_TOP_DBI

IDEAL, MEDIAN = "ideal", "median"
LOBE_SHARE = 0.98
LOWER_SHARE = 2.0 / 3.0
ASYMMETRY_DB, SYMMETRIC_DB = 1.0, 0.1
ADEQUATE_DBI = 0.0
REGION_DB = 1.0
REMAINS = 0.5
MAXIMUM_DB, SHAPE_DB = 1.0, 2.0


def lobe_loses_area(evidence: Evidence) -> Finding:
    """Solid angles of the main lobe, above the ideal's outline and its own."""
    ideal, median, mean = (evidence.pattern(name) for name in (IDEAL, MEDIAN, FLOWN))
    share = median.effective_lobe_sr / ideal.lobe_sr
    return Finding(
        found=f"{median.effective_lobe_sr:.3f} sr of {ideal.lobe_sr:.3f} sr, {share:.1%}; of the flight's "
        f"mean {mean.effective_lobe_sr / ideal.lobe_sr:.1%}; within half of its own maximum "
        f"{median.lobe_sr / ideal.lobe_sr:.1%}",
        agrees=share <= LOBE_SHARE,
        why=f"The maximum is {ideal.max_gain_dbi - median.max_gain_dbi:.2f} dB lower, and the lobe as wide: "
        f"tilted vehicles in their places keep "
        f"{evidence.pattern(IN_PLACE).effective_lobe_sr / ideal.lobe_sr:.1%}, upright ones where they flew "
        f"{evidence.pattern(UPRIGHT).effective_lobe_sr / ideal.lobe_sr:.1%}.",
    )  # fmt: skip


def lower_throughout(evidence: Evidence) -> Finding:
    """Share of the directions with less gain than ideal."""
    ideal, median, mean = (evidence.pattern(name) for name in (IDEAL, MEDIAN, FLOWN))
    return Finding(
        found=f"in {median.lower_share:.0%} of them; in the flight's mean in {mean.lower_share:.0%}",
        agrees=median.lower_share >= LOWER_SHARE,
        why=f"The array has no losses: over all directions the mean gain is {median.mean_dbi:.2f} dBi as "
        f"flown and {ideal.mean_dbi:.2f} dBi ideally, so what some directions lose others have to gain: "
        "nulls fill.",
    )  # fmt: skip


def symmetry_lost(evidence: Evidence) -> Finding:
    """Difference from the mirror image."""
    ideal, median, mean = (evidence.pattern(name) for name in (IDEAL, MEDIAN, FLOWN))
    return Finding(
        found=f"{median.asymmetry_db:.2f} dB rms, in the flight's mean {mean.asymmetry_db:.2f} dB, ideal "
        f"{ideal.asymmetry_db:.2f} dB; of that mean the vehicles make "
        f"{evidence.pattern(UPRIGHT).asymmetry_db:.2f} dB upright where they flew, and "
        f"{evidence.pattern(IN_PLACE).asymmetry_db:.2f} dB tilted in their places",
        agrees=median.asymmetry_db >= ASYMMETRY_DB and ideal.asymmetry_db <= SYMMETRIC_DB,
        why="Neither positions nor tilt make more, or the ideal pattern is not symmetric itself.",
    )  # fmt: skip


def region_is_adequate(evidence: Evidence) -> Finding:
    """Ideal gain in the article's region."""
    ideal = evidence.pattern(IDEAL)
    return Finding(
        found=f"up to {ideal.region_max_dbi:.2f} dBi, {ideal.region_dbi:.2f} dBi in the mean",
        agrees=ideal.region_max_dbi >= ADEQUATE_DBI,
        why="Upright dipoles radiate little towards their ends, and the array has its main lobe elsewhere. "
        f"On the article's scale of colours, from {COLOUR_FLOOR_DBI:g} to {COLOUR_TOP_DBI:g} dB, the region "
        f"reaches {(ideal.region_max_dbi - COLOUR_FLOOR_DBI) / (COLOUR_TOP_DBI - COLOUR_FLOOR_DBI):.0%} all "
        "the same.",
    )  # fmt: skip


def region_is_reduced(evidence: Evidence) -> Finding:
    """Flown gain in the article's region."""
    readings = [evidence.pattern(name) for name in (IDEAL, MEDIAN, FLOWN)]
    ideal, median, mean = (each.region_dbi for each in readings)
    colours = [each.region_colour_db for each in readings]
    shares = [each.region_lower_share for each in readings]
    return Finding(
        found=f"{ideal - median:.2f} dB lower, and lower in {shares[1]:.0%} of it; {ideal - mean:.2f} dB in "
        f"the flight's mean, and in {shares[2]:.0%}",
        agrees=ideal - max(median, mean) >= REGION_DB,
        why=f"The region has {ideal:.2f} dBi ideally, {median:.2f} dBi at the median instant and {mean:.2f} "
        "dBi in the flight's mean. These are means of power. Tilted dipoles have their null in the region "
        "instead of at the zenith, and fill the zenith, which weighs more. By decibels, as the colours have "
        f"it, the region loses {colours[0] - colours[1]:.2f} dB at the median instant and "
        f"{colours[0] - colours[2]:.2f} dB in the flight's mean.",
    )  # fmt: skip


def region_by_tilt(evidence: Evidence) -> Finding:
    """What is left of the deficit when the vehicles are set upright."""
    ideal, flown, upright, tilted = (
        evidence.pattern(name).region_dbi for name in (IDEAL, FLOWN, UPRIGHT, IN_PLACE)
    )
    return Finding(
        found=f"flight's mean {ideal - flown:.2f} dB below ideal; upright where they flew "
        f"{ideal - upright:.2f} dB; tilted in their places {ideal - tilted:.2f} dB",
        agrees=ideal - flown > 0.0 and ideal - upright <= REMAINS * (ideal - flown),
        why="Positions take part in it." if flown < ideal else "There is no deficit.",
    )  # fmt: skip


def shape_not_maximum(evidence: Evidence) -> Finding:
    """Maximum and whole pattern beside the ideal ones."""
    ideal, median = (evidence.pattern(name) for name in (IDEAL, MEDIAN))
    lower_db = ideal.max_gain_dbi - median.max_gain_dbi
    return Finding(
        found=f"maximum {lower_db:.2f} dB lower, pattern {median.difference_db:.2f} dB rms different",
        agrees=lower_db <= MAXIMUM_DB and median.difference_db >= SHAPE_DB,
        why=f"In the flight's mean the pattern differs by {evidence.pattern(FLOWN).difference_db:.2f} dB rms."
        "",
    )  # fmt: skip
