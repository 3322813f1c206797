"""Statements on the loss of the maximum gain due to wind, by wavelength, and on its cause."""

import itertools
from collections.abc import Sequence
from functools import partial

from studies.article.comparison import ComparedEstimate, jackknife, mean_dbi, shape_m
from studies.article.evidence import Evidence, Missing, wind_loss_db
from studies.article.finding import Finding, by_margins
from studies.article.gain_findings import ALIKE_WITHIN_DB, SHORT_M, estimates_text
from studies.article.plan import ARTICLE, FIGURE_WAVELENGTH_M
from studies.article.retained_flights import FLOWN, IN_PLACE, UPRIGHT

NOTICEABLE_DB = 0.1
TILT_SHARE = 0.5
SENSITIVE = 2.0
EFFECT_ALIKE_DB = NOTICEABLE_DB
RESILIENT_DB = 1.0
MAXIMUM_DB, SHAPE_GROWTH = 1.0, 1.5


def noticeable(evidence: Evidence) -> Finding:
    """Measure the loss of the means due to wind."""
    losses, margins = _wind_losses(evidence, evidence.wavelengths_m), {}
    for each in evidence.wavelengths_m:
        margins[f"λ {each:g} m"] = evidence.estimate(
            evidence.windy_and_calm(each), lambda windy, calm: wind_loss_db(windy, calm) - NOTICEABLE_DB
        )
    gaining = [name for name, loss in losses.items() if loss.positive is False]
    gain = f"With wind the mean is higher at {', '.join(gaining)}. " if gaining else ""
    return by_margins(
        margins, found=_losses_text(losses),
        why=f"{gain}{_shapes_text(evidence)} {_tilt_text(evidence)}",
    )  # fmt: skip


def _wind_losses(evidence: Evidence, wavelengths_m: Sequence[float]) -> dict[str, ComparedEstimate]:
    return {f"λ {each:g} m": evidence.wind_loss(each) for each in wavelengths_m}


def _losses_text(losses: dict[str, ComparedEstimate]) -> str:
    counts = sorted({loss.flights for loss in losses.values()})
    seeds = " to ".join(str(count) for count in dict.fromkeys((counts[0], counts[-1])))
    return f"loss in 5 N, dB ({seeds} seeds): {estimates_text(losses)}"


def _shapes_text(evidence: Evidence) -> str:
    """Return the shape errors at the figure's wavelength in both winds, as text."""
    try:
        windy, calm = (evidence.shape([key], shape_m) for key in evidence.windy_and_calm(FIGURE_WAVELENGTH_M))
    except Missing:
        return ""
    return f"At λ 10 m the shape error is {calm.text()} m without wind and {windy.text()} m in 5 N."


def by_angles(evidence: Evidence) -> Finding:
    """Measure the additional losses in 5 N due to tilt only and to positions only."""
    windy = evidence.separation(FIGURE_WAVELENGTH_M, evidence.strongest_n)
    calm = evidence.separation(FIGURE_WAVELENGTH_M, evidence.calm_n)
    seeds = sorted(set(windy.seeds) & set(calm.seeds))
    if not seeds:
        raise Missing("no seed was retained in 5 N and without wind")

    def more_db(variant: str, of: Sequence[int]) -> float:
        return windy.loss_db(variant, of) - calm.loss_db(variant, of)

    whole, tilt, positions = (jackknife(seeds, partial(more_db, name)) for name in (FLOWN, IN_PLACE, UPRIGHT))
    beyond = jackknife(seeds, lambda of: more_db(IN_PLACE, of) - TILT_SHARE * more_db(FLOWN, of))
    if whole.value <= 0.0:
        why = "There is no loss in 5 N."
    elif positions.value > tilt.value:
        why = "Positions alone cause more of it."
    else:
        why = "Neither alone causes that much: the loss of both together exceeds the sum."
    return by_margins(
        {"loss in 5 N": whole, "tilt alone": beyond},
        found=f"loss from no wind to 5 N {whole.text()} dB: tilt alone {tilt.text()} dB, positions alone "
        f"{positions.text()} dB. {_tilt_text(evidence)}",
        why=why,
    )  # fmt: skip


def _tilt_text(evidence: Evidence) -> str:
    try:
        windy = evidence.separation(FIGURE_WAVELENGTH_M, evidence.strongest_n)
        calm = evidence.separation(FIGURE_WAVELENGTH_M, evidence.calm_n)
    except Missing as missing:
        return f"{missing}."
    return (
        f"In {windy.wind_n:g} N the tilt of the vehicles is {windy.tilt_rms_deg:.1f}° rms and the angle of "
        f"the maximum from +y {windy.pointing_rms_deg:.1f}° rms, without wind {calm.tilt_rms_deg:.1f}° and "
        f"{calm.pointing_rms_deg:.1f}°; the rotation of the formation is {windy.turned_rms_deg:.1f}° and "
        f"{calm.turned_rms_deg:.1f}° rms."
    )


def short_is_sensitive(evidence: Evidence) -> Finding:
    """Compare the loss due to wind at 5 m with that at longer wavelengths."""
    short = evidence.windy_and_calm(SHORT_M)
    margins = {"loss at λ 5 m": evidence.wind_loss(SHORT_M)}
    for each in evidence.long_m:
        margins[f"relative to λ {each:g} m"] = evidence.estimate(
            [*short, *evidence.windy_and_calm(each)],
            lambda *cells: wind_loss_db(*cells[:2]) - SENSITIVE * wind_loss_db(*cells[2:]),
        )
    return by_margins(
        margins, found=_losses_text(_wind_losses(evidence, [SHORT_M, *evidence.long_m])),
        why=_separations_text(evidence),
    )  # fmt: skip


def _separations_text(evidence: Evidence) -> str:
    """Return the losses of tilt and of positions at both wavelengths with retained flights, as text."""
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
    """Compare the losses due to wind at 10 m and more, and the means in 5 N."""
    margins = {}
    for one_m, other_m in itertools.combinations(evidence.long_m, 2):
        pair = f"λ {one_m:g} and {other_m:g} m"
        margins[f"{pair}, loss in 5 N"] = evidence.estimate(
            [*evidence.windy_and_calm(one_m), *evidence.windy_and_calm(other_m)],
            lambda *cells: EFFECT_ALIKE_DB - abs(wind_loss_db(*cells[:2]) - wind_loss_db(*cells[2:])),
        )
        margins[f"{pair}, means"] = evidence.estimate(
            [(ARTICLE, each, evidence.strongest_n) for each in (one_m, other_m)],
            lambda one, other: ALIKE_WITHIN_DB - abs(mean_dbi(one) - mean_dbi(other)),
        )
    losses = _wind_losses(evidence, evidence.long_m)
    values = [loss.value for loss in losses.values()]
    means = {
        f"λ {each:g} m": evidence.estimate([(ARTICLE, each, evidence.strongest_n)], mean_dbi)
        for each in evidence.long_m
    }
    levels = [mean.value for mean in means.values()]
    return by_margins(
        margins,
        found=f"{_losses_text(losses)}: {max(values) - min(values):.3f} dB apart; means in 5 N, dBi: "
        f"{estimates_text(means, 2)}: {max(levels) - min(levels):.2f} dB apart",
        why=_separations_text(evidence),
    )  # fmt: skip


def resilient(evidence: Evidence) -> Finding:
    """Measure the loss due to wind at 10 m and more."""
    margins = {
        f"λ {each:g} m": evidence.estimate(
            evidence.windy_and_calm(each), lambda windy, calm: RESILIENT_DB - wind_loss_db(windy, calm)
        )
        for each in evidence.long_m
    }
    return by_margins(
        margins, found=_losses_text(_wind_losses(evidence, evidence.long_m)), why=_separations_text(evidence)
    )


def shape_not_maximum(evidence: Evidence) -> Finding:
    """Measure the loss and the growth of the shape error in 5 N at 10 m."""
    keys = evidence.windy_and_calm(FIGURE_WAVELENGTH_M)
    loss = evidence.wind_loss(FIGURE_WAVELENGTH_M)
    growth = evidence.shape(keys, lambda windy, calm: shape_m(windy) / shape_m(calm))
    margins = {
        "maximum, dB": evidence.estimate(keys, lambda windy, calm: MAXIMUM_DB - wind_loss_db(windy, calm)),
        "shape error, ratio": evidence.shape(
            keys, lambda windy, calm: shape_m(windy) / shape_m(calm) - SHAPE_GROWTH
        ),
    }
    return by_margins(
        margins, unit="", why=f"{_shapes_text(evidence)}",
        found=f"the maximum is {loss.text()} dB lower; shape error {growth.text(2)} times that without wind",
    )  # fmt: skip
