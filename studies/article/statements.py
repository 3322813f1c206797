"""The article's statements that can be measured: a criterion for each, and the verdict that follows from it.

Criteria were fixed before the flights of `studies.article.plan`; where other flights alike, or solutions, had
been published by then, the statement says which. A verdict is computed; a reason stands where it is no.
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
    """Whether a statement holds here."""

    AGREES = "yes"
    DIFFERS = "no"
    OPEN = "not told apart"
    """The difference from the criterion is within two standard errors over the flights."""
    UNKNOWN = "not measured"


class Statement(Struct, frozen=True, kw_only=True):
    """What the article says, in our words, and what that shall mean in numbers."""

    name: str
    said: str
    criterion: str
    measure: Callable[[Evidence], Finding]
    known: str = ""
    """What of it had been measured before the criterion was written, and where that stands."""


class Judged(Struct, frozen=True, kw_only=True):
    """A statement with what came out."""

    name: str
    said: str
    criterion: str
    found: str
    verdict: StatementVerdict
    why: str = ""
    known: str = ""


_VERDICTS = {True: StatementVerdict.AGREES, False: StatementVerdict.DIFFERS, None: StatementVerdict.OPEN}


def judge(statement: Statement, evidence: Evidence) -> Judged:
    """Measure one statement; what is missing is said in its place."""
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
    """Measure every statement, in the page's order."""
    return [judge(each, evidence) for each in STATEMENTS]


def count(judged: Iterable[Judged]) -> dict[StatementVerdict, int]:
    """How many have each verdict."""
    found = [each.verdict for each in judged]
    return {verdict: found.count(verdict) for verdict in StatementVerdict}


_CODESIGN = "[codesign-results.md](codesign-results.md)"
_IDEAL = "the ideal array by all solvers: [antenna-validation.md](antenna-validation.md)"
_GAINS = f"maximum gains at λ = 5 and 10 m in 2 and 5 N, with FTM and on GPS alone: {_CODESIGN}"
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
        criterion=f"every solver within {setup.IDEAL_WITHIN_DB:g} dB of it at every wavelength",
        measure=setup.ideal_gain, known=_IDEAL,
    ),
    Statement(
        name="band", said="Wavelengths of 5 to 20 m are frequencies of 60 to 15 MHz.",
        criterion="the frequency that solvers are told is that, to a whole MHz", measure=setup.band,
        known="the speed of light",
    ),
    Statement(
        name="exponential",
        said="The directivity falls exponentially with the variance of the position errors.",
        criterion=f"as long as at least {setup.EXPONENTIAL_SHARE:.0%} of the ideal gain is left, the mean "
        f"gain of random formations lies within {setup.EXPONENTIAL_WITHIN_DB:g} dB of one exponential in "
        "σ²/λ²",
        measure=setup.exponential_loss, known=_DRAWS,
    ),
    Statement(
        name="all distances", said="Each agent obtains a distance to every other by FTM.",
        criterion=f"at least {setup.SESSIONS_SHARE:.0%} of the sessions asked for give one",
        measure=setup.distances_to_all,
        known=f"shares of the sessions that complete: {_CODESIGN}",
    ),
    Statement(
        name="FTM accuracy",
        said="Outdoors FTM is accurate enough to correct the errors of GPS.",
        criterion=f"the shape error is at most {setup.FTM_SHARE:g} of that on GPS alone, at λ = 10 m in "
        "every wind that was flown with both, of the same seeds",
        measure=setup.ftm_corrects_gps,
        known=f"shape errors on GPS alone and with FTM: {_CODESIGN}",
    ),
    Statement(
        name="contention", said="Much contention for the channel harms the control of positions.",
        criterion=f"the shape error grows to at least {setup.CROWDED_GROWTH:g} times when everybody ranges "
        "to everybody ten times as often, of the same seeds and flights as long",
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
        criterion=f"it is nowhere above {gain.FLAT_PER_DB:g} per dB, nor above {gain.FLAT_OF_LONG:g} of the "
        "highest of λ = 10 m",
        measure=gain.near_flat, known=f"{_GAINS}; {_DRAWS}",
    ),
    Statement(
        name="wind lowers", said="Wind reduces the maximum gain that is reached.",
        criterion="at every wavelength the mean falls from each wind to the next",
        measure=gain.falls_with_wind, known=_GAINS,
    ),
    Statement(
        name="wind flattens", said="Wind flattens the densities.",
        criterion="at every wavelength the deviation grows, and the density's peak sinks, from the weakest "
        "wind to the strongest",
        measure=gain.flattens_with_wind, known=_GAINS,
    ),
    Statement(
        name="no wind", said="Without wind the gain stays close to the ideal 13.26 dB.",
        criterion=f"at every wavelength the mean is within {gain.CALM_WITHIN_DB:g} dB of ideal",
        measure=gain.calm_is_ideal,
    ),
    Statement(
        name="noticeable", said="Growing wind makes a noticeable reduction.",
        criterion=f"at every wavelength 5 N cost the mean at least {wind.NOTICEABLE_DB:g} dB",
        measure=wind.noticeable, known=_GAINS,
    ),
    Statement(
        name="angular deviation", said="That is since strong wind deviates the array's angles.",
        criterion=f"of what 5 N cost more than no wind, tilt alone (vehicles in their places) costs at least "
        f"{wind.TILT_SHARE:g} at λ = 10 m",
        measure=wind.by_angles,
    ),
    Statement(
        name="sensitive", said="λ = 5 m is much more sensitive to wind than 10 m and more.",
        criterion=f"5 N cost its mean at least {wind.SENSITIVE:g} times what they cost any of the longer ones"
        "",
        measure=wind.short_is_sensitive, known=_GAINS,
    ),
    Statement(
        name="alike", said="From 10 m on the wind's effect remains more or less the same.",
        criterion=f"5 N cost their means the same to {wind.EFFECT_ALIKE_DB:g} dB, and in 5 N these lie "
        f"within {gain.ALIKE_WITHIN_DB:g} dB",
        measure=wind.long_are_alike,
    ),
    Statement(
        name="resilient", said="So at ground penetrating radar's wavelengths the formation resists wind.",
        criterion=f"from 10 m on 5 N cost the mean at most {wind.RESILIENT_DB:g} dB", measure=wind.resilient,
        known=_GAINS,
    ),
    Statement(
        name="lobe", said="In 5 N at 10 m the main lobe loses part of its effective area.",
        criterion=f"the solid angle of the main lobe above half of the ideal maximum is at most "
        f"{pattern.LOBE_SHARE:g} of the ideal's, at the median instant",
        measure=pattern.lobe_loses_area,
    ),
    Statement(
        name="lower throughout", said="The gain is lower throughout the pattern.",
        criterion=f"at the median instant it is so in at least {pattern.LOWER_SHARE:.0%} of the directions "
        "whose ideal gain is above -10 dBi",
        measure=pattern.lower_throughout,
    ),
    Statement(
        name="symmetry", said="The pattern loses its perfect symmetry.",
        criterion=f"it differs from its mirror image in x by at least {pattern.ASYMMETRY_DB:g} dB rms, the "
        f"ideal one by at most {pattern.SYMMETRIC_DB:g} dB",
        measure=pattern.symmetry_lost,
    ),
    Statement(
        name="region: ideal", said="Ideally there is adequate gain between φ 180° and 225°, θ 0° and 45°.",
        criterion=f"somewhere in it at least {pattern.ADEQUATE_DBI:g} dBi, an isotropic antenna's",
        measure=pattern.region_is_adequate,
    ),
    Statement(
        name="region: reduced", said="There the flown formation has less.",
        criterion=f"its mean there is at least {pattern.REGION_DB:g} dB lower, at the median instant and in "
        "the flight's mean",
        measure=pattern.region_is_reduced,
    ),
    Statement(
        name="region: cause", said="The cause is that the formation makes up for the wind.",
        criterion=f"with the vehicles upright where they flew, at most {pattern.REMAINS:g} of the deficit in "
        "the flight's mean is left",
        measure=pattern.region_by_tilt,
    ),
    Statement(
        name="shape, not maximum",
        said="The wind hardly affects the main lobe's maximum, but the formation's whole shape.",
        criterion=f"at λ = 10 m 5 N cost the mean maximum at most {wind.MAXIMUM_DB:g} dB, and the shape "
        f"error is at least {wind.SHAPE_GROWTH:g} times that without wind",
        measure=wind.shape_not_maximum, known=f"{_GAINS}; {_SHAPES}",
    ),
)  # fmt: skip
