"""Campaigns of `harness.campaign` for the comparison with the article.

``kept``        flights of the article's scenario that are retained with their tracks
``explaining``  the same formation with other position sources, controls, sensors and gusts, by named change
``crowded``     the article's scenario with frequent ranging and with the normal one, of equal length
``article``     the article's scenario: every wavelength in every wind

The first is part of the last and flown once. All use the same seeds, hence the same winds.
"""

from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta, Struct

from harness.campaign import Campaign, Case

SCENARIO = Path(__file__).parents[2] / "scenarios" / "article.toml"
WAVELENGTH, WIND = "antenna.wavelength_m", "wind.mean_n"
ARTICLE, KEPT, EXPLAINING, CROWDED = "article", "kept", "explaining", "crowded"
UNCROWDED = "uncrowded"
"""Reference of `CROWDED`: the same seeds and length, with the ranging of the article's scenario."""
SNAPSHOT_RATE_HZ = 10.0
"""Rate of patterns: a density of ten flights then has thousands of instants."""
FIGURE_WAVELENGTH_M, FIGURE_WIND_N = 10.0, 5.0
"""Conditions of the pattern in the article's figure."""
CROWDED_FTM_PERIOD_S = 0.1
"""Period of all pairs: 560 ranging sessions a second of 1.5 ms, with contention (docs/concepts/radio.md)."""

_CASCADE: dict[str, Any] = {"autopilot.params.CF_DOB_EN": 0}
_OWN_GUSTS: dict[str, Any] = _CASCADE | {"wind.correlation": 0.0}
GPS, GPS_HALF_METRE, CASCADE, OWN_GUSTS, GAZEBO = "gps", "gps-0.5m", "cascade", "own-gusts", "gazebo"
CHANGES: dict[str, dict[str, Any]] = {
    GPS: {"onboard.localisation": "gps"},
    GPS_HALF_METRE: {"onboard.localisation": "gps", "sensors.gps.horizontal_bias_std_m": 0.5},
    CASCADE: _CASCADE,
    OWN_GUSTS: _OWN_GUSTS,
    GAZEBO: _OWN_GUSTS | {"sensors.profile": "gazebo", "onboard.localisation": "gps"},
}
MEANINGS = {
    ARTICLE: "ranging (FTM) and the disturbance observer: `scenarios/article.toml`",
    GPS: "GPS alone, slow error of 1.5 m on each axis",
    GPS_HALF_METRE: "GPS alone, slow error of 0.5 m on each axis",
    CASCADE: "ranging, PX4's cascade without the observer",
    OWN_GUSTS: "ranging, PX4's cascade, individual gusts for each UAV",
    GAZEBO: "GPS alone with the error of PX4's Gazebo plugin (millimetres), PX4's cascade, individual gusts",
    CROWDED: "the article's scenario, but each UAV ranges to every other one ten times as often",
    UNCROWDED: "the article's scenario with the same seeds and the same flight time",
}


class ArticlePlan(Struct, frozen=True, kw_only=True):
    """Number and duration of the flights."""

    seeds: Annotated[int, Meta(ge=1, le=1000)] = 8
    """Flights of every wavelength in every wind."""
    duration_s: Annotated[float, Meta(ge=6.0, le=600.0)] = 30.0
    """Time in formation."""
    wavelengths_m: tuple[float, ...] = (5.0, 7.5, 10.0, 15.0, 20.0)
    winds_n: tuple[float, ...] = (0.0, 2.0, 5.0)
    """Mean force on each vehicle."""
    kept_wavelengths_m: tuple[float, ...] = (5.0, 10.0)
    kept_seeds: int = 3
    """Limit of flights retained with their tracks, for each wavelength and wind."""
    explaining_wavelengths_m: tuple[float, ...] = (5.0, 10.0)
    explaining_seeds: int = 3
    """Limit of flights for each change."""
    explaining_winds_n: tuple[float, ...] = (5.0,)
    crowded_seeds: int = 4
    """Limit of flights; 0 for none."""
    crowded_duration_s: float = 30.0
    """Limit of the time in formation: contention takes long to compute."""
    draws: int = 1000
    """Random formations for each size of the position error."""


QUICK = ArticlePlan(
    seeds=2, duration_s=10.0, wavelengths_m=(5.0, 10.0, 20.0), kept_seeds=2, explaining_seeds=2,
    explaining_wavelengths_m=(5.0, 10.0), explaining_winds_n=(5.0,), crowded_seeds=0, draws=300,
)  # fmt: skip


def campaigns(plan: ArticlePlan) -> dict[str, Campaign]:
    """Return the campaigns by name in the order of flight; the last one's table remains in the folder."""
    seeds = tuple(range(1, plan.seeds + 1))
    fixed = {"run.duration_s": plan.duration_s, "antenna.snapshot_rate_hz": SNAPSHOT_RATE_HZ}
    crowded = {
        "run.duration_s": min(plan.duration_s, plan.crowded_duration_s),
        WAVELENGTH: FIGURE_WAVELENGTH_M,
        WIND: FIGURE_WIND_N,
    }
    often = Case(name=CROWDED, settings={"onboard.ftm_period_s": CROWDED_FTM_PERIOD_S})
    made = [
        Campaign(
            name=KEPT, scenario=SCENARIO, seeds=seeds[: plan.kept_seeds], fixed=fixed,
            sweep={WAVELENGTH: plan.kept_wavelengths_m, WIND: plan.winds_n},
            cases=(Case(name=ARTICLE),), keep=("gains", "flight"), origin=KEPT,
        ),
        Campaign(
            name=EXPLAINING, scenario=SCENARIO, seeds=seeds[: plan.explaining_seeds], fixed=fixed,
            sweep={WAVELENGTH: plan.explaining_wavelengths_m, WIND: plan.explaining_winds_n},
            cases=tuple(Case(name=name, settings=changes) for name, changes in CHANGES.items()),
            keep=("gains",), origin=EXPLAINING,
        ),
        Campaign(
            name=ARTICLE, scenario=SCENARIO, seeds=seeds, fixed=fixed,
            sweep={WAVELENGTH: plan.wavelengths_m, WIND: plan.winds_n},
            cases=(Case(name=ARTICLE),), keep=("gains",), origin=ARTICLE,
        ),
    ]  # fmt: skip
    if plan.crowded_seeds:
        over_a_full_channel = Campaign(
            name=CROWDED, scenario=SCENARIO, seeds=seeds[: plan.crowded_seeds], fixed=fixed | crowded,
            cases=(often, Case(name=UNCROWDED)), keep=("gains",), origin=CROWDED,
        )  # fmt: skip
        made.insert(-1, over_a_full_channel)
    return {each.name: each for each in made}
