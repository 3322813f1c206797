"""Statements of the article that can be measured, with their criteria and computed verdicts.

The criteria were fixed before the flights of `studies.article.plan`. If related results had been published by
then, the statement names them. A negative verdict has a reason.
"""

from collections.abc import Callable, Iterable
from enum import StrEnum

from msgspec import Struct

from studies.article import figure_findings as pattern
from studies.article import gain_findings as gain
from studies.article import setup_findings as setup
from studies.article import wind_findings as wind
from studies.article.evidence import Evidence, Missing
from studies.article.finding import Finding


class StatementVerdict(StrEnum):
    """Verdict on a statement."""

    AGREES = "yes"
    DIFFERS = "no"
    OPEN = "undecided"
    """The distance from the criterion is within two standard errors over the flights."""
    UNKNOWN = "not measured"


class Statement(Struct, frozen=True, kw_only=True):
    """A statement of the article, paraphrased, and its criterion in numbers."""

    name: str
    said: str
    criterion: str
    measure: Callable[[Evidence], Finding]
    known: str = ""
    """Related results from before the criterion was fixed, with their source."""


class Judged(Struct, frozen=True, kw_only=True):
    """A statement with its result."""

    name: str
    said: str
    criterion: str
    found: str
    verdict: StatementVerdict
    why: str = ""
    known: str = ""


_VERDICTS = {True: StatementVerdict.AGREES, False: StatementVerdict.DIFFERS, None: StatementVerdict.OPEN}


def judge(statement: Statement, evidence: Evidence) -> Judged:
    """Judge one statement; missing evidence is stated as its result."""
    try:
        finding = statement.measure(evidence)
    except Missing as missing:
        found, verdict, why = str(missing), StatementVerdict.UNKNOWN, ""
    else:
        found, why = finding.found, "" if finding.agrees else finding.why
        verdict = _VERDICTS[finding.agrees]
    return Judged(
        name=statement.name, said=statement.said, criterion=statement.criterion, found=found,
        verdict=verdict, why=why, known=statement.known,
    )  # fmt: skip


def judge_all(evidence: Evidence) -> list[Judged]:
    """Judge all statements in the order of the page."""
    return [judge(each, evidence) for each in STATEMENTS]


def count(judged: Iterable[Judged]) -> dict[StatementVerdict, int]:
    """Return the number of statements with each verdict."""
    found = [each.verdict for each in judged]
    return {verdict: found.count(verdict) for verdict in StatementVerdict}


_CODESIGN = "[codesign-results.md](codesign-results.md)"
_IDEAL = "the ideal array by all solvers: [antenna-validation.md](antenna-validation.md)"
_GAINS = f"maximum gains at λ = 5 and 10 m in 2 and 5 N, with FTM and GPS alone: {_CODESIGN}"
_SHAPES = f"shape errors in 0, 2 and 5 N: {_CODESIGN}"
_DRAWS = "maximum gains of random formations: `studies/reference/antenna_sensitivity.csv`"

STATEMENTS = (
    Statement(
        name="main lobe", said="The 4 x 2 formation is an end-fire array: its greatest gain is along y.",
        criterion=f"every solver has the ideal maximum within {setup.AXIS_WITHIN_DEG:g}° of +y",
        measure=setup.main_lobe_along_y, known=_IDEAL,
    ),
    Statement(
        name="ideal gain", said="The ideal gain is 13.26 dB.",
        criterion=f"every solver is within {setup.IDEAL_WITHIN_DB:g} dB of it at every wavelength",
        measure=setup.ideal_gain, known=_IDEAL,
    ),
    Statement(
        name="band", said="Wavelengths of 5 to 20 m are frequencies of 60 to 15 MHz.",
        criterion="the frequency in the solvers' input is that, rounded to whole MHz", measure=setup.band,
        known="the speed of light",
    ),
    Statement(
        name="exponential",
        said="The directivity falls exponentially with the variance of the position errors.",
        criterion=f"while at least {setup.EXPONENTIAL_SHARE:.0%} of the ideal gain remains, the mean "
        f"gain of random formations is within {setup.EXPONENTIAL_WITHIN_DB:g} dB of one exponential in "
        "σ²/λ²",
        measure=setup.exponential_loss, known=_DRAWS,
    ),
    Statement(
        name="all distances", said="Each agent obtains a distance to every other by FTM.",
        criterion=f"at least {setup.SESSIONS_SHARE:.0%} of the requested sessions return one",
        measure=setup.distances_to_all,
        known=f"shares of the sessions that complete: {_CODESIGN}",
    ),
    Statement(
        name="FTM accuracy",
        said="Outdoors FTM is accurate enough to correct the errors of GPS.",
        criterion=f"the shape error is at most {setup.FTM_SHARE:g} of that with GPS alone, at λ = 10 m in "
        "every wind flown with both, for the same seeds",
        measure=setup.ftm_corrects_gps,
        known=f"shape errors with GPS alone and with FTM: {_CODESIGN}",
    ),
    Statement(
        name="contention", said="Much contention for the channel harms the control of positions.",
        criterion=f"the shape error grows by a factor of at least {setup.CROWDED_GROWTH:g} if each UAV "
        "ranges to every other one ten times as often, for the same seeds and flight time",
        measure=setup.contention_harms,
        known=f"shape errors with ranging every 0.1 s and every second, 8 UAVs in 5 N: {_CODESIGN}",
    ),
    Statement(
        name="short wavelengths", said="Very short wavelengths hardly reach the array's gain.",
        criterion="the shortest wavelength has the lowest mean in every wind", measure=gain.short_is_lowest,
        known=_GAINS,
    ),
    Statement(
        name="near flat", said="In 5 N the density of λ = 5 m is nearly flat.",
        criterion=f"its peak is at most {gain.FLAT_PER_DB:g} per dB, and at most {gain.FLAT_OF_LONG:g} of "
        "the peak of λ = 10 m",
        measure=gain.near_flat, known=f"{_GAINS}; {_DRAWS}",
    ),
    Statement(
        name="wind lowers", said="Wind reduces the maximum gain.",
        criterion="at every wavelength the mean falls from each wind to the next",
        measure=gain.falls_with_wind, known=_GAINS,
    ),
    Statement(
        name="wind flattens", said="Wind flattens the densities.",
        criterion="at every wavelength the deviation is larger, and the density's peak lower, in the "
        "strongest wind than in the weakest",
        measure=gain.flattens_with_wind, known=_GAINS,
    ),
    Statement(
        name="no wind", said="Without wind the gain stays close to the ideal 13.26 dB.",
        criterion=f"at every wavelength the mean is within {gain.CALM_WITHIN_DB:g} dB of ideal",
        measure=gain.calm_is_ideal,
    ),
    Statement(
        name="noticeable", said="Growing wind makes a noticeable reduction.",
        criterion=f"at every wavelength 5 N reduce the mean by at least {wind.NOTICEABLE_DB:g} dB",
        measure=wind.noticeable, known=_GAINS,
    ),
    Statement(
        name="angular deviation", said="The reason is that strong wind deviates the array's angles.",
        criterion=f"at λ = 10 m, tilt alone (vehicles in their places) causes at least {wind.TILT_SHARE:g} "
        "of the loss from no wind to 5 N",
        measure=wind.by_angles,
    ),
    Statement(
        name="sensitive", said="λ = 5 m is much more sensitive to wind than 10 m and more.",
        criterion=f"5 N reduce its mean by at least {wind.SENSITIVE:g} times the loss at each longer one",
        measure=wind.short_is_sensitive, known=_GAINS,
    ),
    Statement(
        name="alike", said="From 10 m on the effect of wind is about the same.",
        criterion=f"the losses of their means in 5 N agree within {wind.EFFECT_ALIKE_DB:g} dB, and the "
        f"means in 5 N within {gain.ALIKE_WITHIN_DB:g} dB",
        measure=wind.long_are_alike,
    ),
    Statement(
        name="resilient",
        said="At the wavelengths of ground penetrating radar the formation therefore resists wind.",
        criterion=f"from 10 m on 5 N reduce the mean by at most {wind.RESILIENT_DB:g} dB",
        measure=wind.resilient, known=_GAINS,
    ),
    Statement(
        name="lobe", said="In 5 N at 10 m the main lobe loses part of its effective area.",
        criterion=f"the solid angle of the main lobe above half of the ideal maximum is at most "
        f"{pattern.LOBE_SHARE:g} of the ideal one, at the median instant",
        measure=pattern.lobe_loses_area,
    ),
    Statement(
        name="lower throughout", said="The gain is lower throughout the pattern.",
        criterion=f"at the median instant it is lower in at least {pattern.LOWER_SHARE:.0%} of the "
        "directions with an ideal gain above -10 dBi",
        measure=pattern.lower_throughout,
    ),
    Statement(
        name="symmetry", said="The pattern loses its perfect symmetry.",
        criterion=f"it differs from its mirror image in x by at least {pattern.ASYMMETRY_DB:g} dB rms, the "
        f"ideal pattern by at most {pattern.SYMMETRIC_DB:g} dB",
        measure=pattern.symmetry_lost,
    ),
    Statement(
        name="region: ideal",
        said="The ideal formation has adequate gain between φ 180° and 225°, θ 0° and 45°.",
        criterion=f"its maximum in this region is at least {pattern.ADEQUATE_DBI:g} dBi, as of an "
        "isotropic antenna",
        measure=pattern.region_is_adequate,
    ),
    Statement(
        name="region: reduced", said="The flown formation has less gain there.",
        criterion=f"its mean in the region is at least {pattern.REGION_DB:g} dB lower, at the median instant "
        "and in the flight's mean",
        measure=pattern.region_is_reduced,
    ),
    Statement(
        name="region: cause", said="The cause is that the formation compensates for the wind.",
        criterion=f"with the vehicles upright at their flown positions, at most {pattern.REMAINS:g} of the "
        "deficit in the flight's mean remains",
        measure=pattern.region_by_tilt,
    ),
    Statement(
        name="shape, not maximum",
        said="Wind hardly affects the main lobe's maximum, but affects the whole shape of the formation.",
        criterion=f"at λ = 10 m 5 N reduce the mean maximum by at most {wind.MAXIMUM_DB:g} dB, and the shape "
        f"error is at least {wind.SHAPE_GROWTH:g} times that without wind",
        measure=wind.shape_not_maximum, known=f"{_GAINS}; {_SHAPES}",
    ),
)  # fmt: skip
