"""The localisation filter by itself: run the studies of `studies.codesign.study`, store and judge them."""

import hashlib
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec import Struct

from harness.campaign.store import Flown, Store
from studies.codesign.batch import RANGE_WINDOW_US
from studies.codesign.cases import CodesignPlan, wind_agents
from studies.codesign.results import state
from studies.codesign.simulated import Trouble
from studies.codesign.study import LocalisationResult, localisation_study
from studies.common.report import PASSED, Check, ReportTable, Section

OVER_BOUND_MOST = 1.5
"""Relative position error over the Cramer-Rao bound at the article's geometry"""
RUNS_PER_SEED, RUNS_LEAST = 10, 100
START_METHOD = "spawn"
"""No fork: this process may have threads, and a worker must start like a new program."""
_SEED = 5
_STUDIED = ("study.py", "simulated.py", "bounds.py", "batch.py")


class Setting(Struct, frozen=True):
    """Setting of one study."""

    agents: int
    loss: float
    scheduled: bool
    batch: bool
    """Compute the batch optimum too, which takes most of the time"""


ARTICLE_SETTING = Setting(agents=8, loss=0.0, scheduled=False, batch=True)
SETTINGS = (
    ARTICLE_SETTING,
    Setting(agents=8, loss=0.3, scheduled=False, batch=False),
    Setting(agents=8, loss=0.0, scheduled=True, batch=False),
    Setting(agents=4, loss=0.0, scheduled=False, batch=False),
    Setting(agents=16, loss=0.0, scheduled=False, batch=False),
)


def _arguments(setting: Setting, runs: int) -> dict[str, Any]:
    """Return the arguments of a study in the article's geometry, adapted to the number of UAVs."""
    return {
        "places_ned_m": wind_agents("ftm", setting.agents, 5).scenario(CodesignPlan(), 1).places_ned_m(),
        "runs": runs,
        "seed": _SEED,
        "trouble": Trouble(loss=setting.loss),
        "scheduled": setting.scheduled,
        "batch": setting.batch,
    }


def studies(
    plan: CodesignPlan, data: Path, *, workers: int, done: Callable[[int, int], None]
) -> dict[Setting, LocalisationResult]:
    """Run the studies that are not stored yet, with ``RUNS_PER_SEED`` runs for each of the plan's seeds.

    ``done`` is called with the number of finished studies and their total. Returns all studies.
    """
    runs, sources, store = RUNS_PER_SEED * plan.seeds, _state(), Store(data)
    arguments = {setting: _arguments(setting, runs) for setting in SETTINGS}
    digests = {setting: _digest(sources, arguments[setting]) for setting in SETTINGS}
    found = {
        setting: msgspec.convert(stored.summary, LocalisationResult)
        for setting in SETTINGS
        if (stored := store.get(digests[setting])) is not None
    }
    missing = [setting for setting in SETTINGS if setting not in found]
    done(len(found), len(SETTINGS))
    if not missing:
        return found
    with ProcessPoolExecutor(workers, mp_context=get_context(START_METHOD)) as pool:
        waiting = {pool.submit(localisation_study, **arguments[setting]): setting for setting in missing}
        for future in as_completed(waiting):
            setting, result = waiting[future], future.result()
            found[setting] = result
            summary = msgspec.to_builtins(result)
            store.put(Flown(digest=digests[setting], status="completed", summary=summary, state=sources), {})
            done(len(found), len(SETTINGS))
    return found


def judge_estimator(results: dict[Setting, LocalisationResult]) -> Section:
    """Check the study of the article's geometry, and list the others."""
    article = results[ARTICLE_SETTING]
    low, high = article.nees_band
    return Section(
        title="The estimator by itself",
        conditions=(
            "The localisation filter processes simulated measurements of known statistics, as received by "
            "one UAV of the formation. It is compared with the posterior Cramer-Rao bound of these "
            "measurements and with the batch optimum (least squares over all fixes and the distances of "
            f"the last {RANGE_WINDOW_US * 1e-6:g} s). Errors are horizontal, after the best rigid "
            "alignment, rms over UAVs and runs; the table also contains the error that the filter "
            "predicts. NEES is the squared error normalised by the filter's covariance, mean over the "
            "runs: the expected value for N UAVs is 2 N - 3, and the band contains 95 % of such means of a "
            "consistent filter. A filter below the band is too cautious, above it overconfident. The "
            "requirement applies to the article's geometry; others outside the band are marked.\n"
        ),
        checks=(
            Check("runs", float(article.runs), at_least=float(RUNS_LEAST)),
            Check(
                "relative position error over the Cramer-Rao bound, article's geometry",
                article.filter_over_bound, at_most=OVER_BOUND_MOST,
            ),
            Check("its NEES", article.nees, at_least=low, at_most=high),
        ),
        tables=(
            ReportTable(
                caption="Errors in metres.",
                columns=(
                    "UAVs", "lost", "ranging", "runs", "bound", "filter", "filter predicts",
                    "filter over bound", "batch", "batch over bound", "NEES", "expected", "band",
                    "consistent",
                ),
                rows=tuple(_row(setting, results[setting]) for setting in SETTINGS),
            ),
        ),
    )  # fmt: skip


def _row(setting: Setting, result: LocalisationResult) -> tuple[str, ...]:
    low, high = result.nees_band
    batch, over_bound = result.batch_m, result.batch_over_bound
    return (
        str(setting.agents), f"{setting.loss:.0%}", "scheduled" if setting.scheduled else "all pairs",
        str(result.runs), f"{result.bound_m:.3f}", f"{result.filter_m:.3f}",
        f"{result.predicted_m:.3f}", f"{result.filter_over_bound:.2f}",
        "–" if batch is None else f"{batch:.3f}", "–" if over_bound is None else f"{over_bound:.2f}",
        f"{result.nees:.2f}", str(2 * setting.agents - 3), f"{low:.2f} to {high:.2f}", _verdict(result),
    )  # fmt: skip


def _verdict(result: LocalisationResult) -> str:
    """Return whether the NEES is in its band, or on which side of it."""
    low, high = result.nees_band
    if low <= result.nees <= high:
        return PASSED
    return "**too cautious**" if result.nees < low else "**overconfident**"


def _state() -> str:
    content = hashlib.sha256(state().encode())
    for name in _STUDIED:
        content.update((Path(__file__).parent / name).read_bytes())
    return content.hexdigest()[:16]


def _digest(state: str, arguments: dict[str, Any]) -> str:
    content = msgspec.json.encode((state, arguments), enc_hook=np.ndarray.tolist)
    return hashlib.sha256(content).hexdigest()[:16]
