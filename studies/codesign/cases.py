"""Cases of the co-design experiment, each a variant of the article's scenario, in groups.

A case can be in several groups and is flown once. All cases use the same seeds, hence the same winds and the
same GPS receiver errors, so they are compared in pairs of flights.
"""

from pathlib import Path

from msgspec import Struct
from msgspec.structs import replace

from harness.launch.swarm import CUT_DB
from harness.scenario.scenario import Scenario
from harness.scenario.scenario_file import load
from harness.world.faults import AnyFault, RadioAttenuation, RangingBias

ARTICLE = Path(__file__).parents[2] / "scenarios" / "article.toml"
WINDS_N = (0, 2, 5)
AGENTS = (4, 8, 16)
WAVELENGTHS_M = (5, 10)
BEACON_PERIODS_MS = (50, 100, 200, 500, 1000)
FTM_PERIODS_S = {8: (0.1, 0.25, 1.0), 16: (0.25, 1.0)}
"""By number of UAVs; 240 sessions every 0.25 s exceed the capacity of the channel."""
DROPPED = 0.3
LIAR = 3
LIE_M = 5.0
MOST_CUT_S = 10.0
MOST_LIAR_AFTER_S = 5.0
_NO_PATTERNS_HZ = 0.001
"""No patterns in flight: they are computed afterwards, see `studies.codesign.measures`."""


class CodesignPlan(Struct, frozen=True, kw_only=True):
    """Number and duration of the flights."""

    seeds: int = 10
    duration_s: float = 15.0
    """Time in formation"""

    @property
    def cut_s(self) -> float:
        """Duration of the channel outage, and time from the formation to it; 10 s except in quick plans."""
        return min(MOST_CUT_S, self.duration_s / 1.5)

    @property
    def liar_after_s(self) -> float:
        """Time from the formation to the start of the ranging bias."""
        return min(MOST_LIAR_AFTER_S, self.duration_s / 6.0)


QUICK = CodesignPlan(seeds=2, duration_s=8.0)


class CodesignCase(Struct, frozen=True, kw_only=True):
    """One variant of the article's scenario."""

    name: str
    localisation: str = "ftm"
    agents: int = 8
    wind_n: float = 5.0
    wavelength_m: float = 10.0
    beacon_period_ms: int = 100
    ranging: str = "all_pairs"
    ftm_period_s: float = 1.0
    channel: str = "emulated"
    drop_fraction: float = 0.0
    lies: bool = False
    """Whether the distances of one vehicle are biased from the start."""
    faults: tuple[AnyFault, ...] = ()
    """Their start times are relative to the instant at which the formation is reached."""
    longer_s: float = 0.0
    """Time in formation in addition to the plan's"""
    gains: bool = False
    """Whether antenna patterns are computed."""
    last: bool = False
    """Flown after all others: it only completes a table and is not required by a check."""

    def settings(self, plan: CodesignPlan) -> tuple[str, ...]:
        """Return the changes of the article's scenario, without the seed."""
        settings = [
            f"name={self.name}",
            f"agents={self.agents}",
            f"run.duration_s={plan.duration_s + self.longer_s}",
            f"formation.columns={self.agents // 2}",
            "formation.rows=2",
            f"wind.mean_n={self.wind_n}",
            f"antenna.wavelength_m={self.wavelength_m}",
            f"antenna.snapshot_rate_hz={_NO_PATTERNS_HZ}",
            f"onboard.localisation={self.localisation}",
            f"onboard.beacon_period_ms={self.beacon_period_ms}",
            f"onboard.ranging={self.ranging}",
            f"onboard.ftm_period_s={self.ftm_period_s}",
            f"radio.channel={self.channel}",
            f"radio.drop_fraction={self.drop_fraction}",
        ]
        if self.lies:
            settings.append(f"faults=[{{kind='ranging_bias', uav={LIAR}, offset_m={LIE_M}}}]")
        return tuple(settings)

    def scenario(self, plan: CodesignPlan, seed: int) -> Scenario:
        """Return the scenario for a seed."""
        return load(ARTICLE, [*self.settings(plan), f"run.seed={seed}"])


def wind_agents(localisation: str, agents: int, wind_n: float) -> CodesignCase:
    """Return the case with this wind and number of vehicles; 8 and 5 N are the article's scenario."""
    return CodesignCase(
        name=f"{localisation}-{agents}-{wind_n:g}n", localisation=localisation, agents=agents, wind_n=wind_n,
        gains=agents == 8 and wind_n >= 2, last=agents != 8 and wind_n != 5,
    )  # fmt: skip


BASE = wind_agents("ftm", 8, 5)
GPS_ALONE = wind_agents("gps", 8, 5)


def wavelength(localisation: str, wavelength_m: float, wind_n: float) -> CodesignCase:
    """Return the case with the array scaled to a wavelength."""
    case = wind_agents(localisation, 8, wind_n)
    if wavelength_m == case.wavelength_m:
        return case
    return replace(case, name=f"{case.name}-lambda{wavelength_m:g}", wavelength_m=wavelength_m)


def beacon_period(period_ms: int) -> CodesignCase:
    """Return the case with this beacon period."""
    if period_ms == BASE.beacon_period_ms:
        return BASE
    return replace(BASE, name=f"{BASE.name}-beacon{period_ms}", beacon_period_ms=period_ms, gains=False)


def all_pairs(agents: int, period_s: float) -> CodesignCase:
    """Return the case in which each vehicle ranges to every other one in each period."""
    case = wind_agents("ftm", agents, 5)
    if period_s == case.ftm_period_s:
        return case
    crowded = agents == 16  # contention takes minutes to compute
    return replace(
        case, name=f"{case.name}-every{period_s:g}s", ftm_period_s=period_s, gains=False, last=crowded
    )


def scheduled(agents: int) -> CodesignCase:
    """Return the case with scheduled ranging: one end of each pair measures when the distance is useful."""
    case = wind_agents("ftm", agents, 5)
    return replace(case, name=f"{case.name}-scheduled", ranging="scheduled", gains=False)


TRUTH = replace(BASE, name="truth-8-5n", localisation="truth", gains=False)
IDEAL = replace(BASE, name=f"{BASE.name}-ideal", channel="ideal", gains=False)
LOSSY = replace(BASE, name=f"{BASE.name}-lossy", drop_fraction=DROPPED, gains=False)
LIAR_FROM_START = replace(BASE, name=f"{BASE.name}-liar-from-start", lies=True, gains=False)


def cut(plan: CodesignPlan) -> CodesignCase:
    """Return the case with a channel outage, followed by twice its duration."""
    fault = RadioAttenuation(attenuation_db=CUT_DB, start_s=plan.cut_s, duration_s=plan.cut_s)
    longer_s = 4.0 * plan.cut_s - plan.duration_s
    return replace(BASE, name=f"{BASE.name}-cut", faults=(fault,), longer_s=longer_s, gains=False)


def liar_in_flight(plan: CodesignPlan) -> CodesignCase:
    """Return the case in which the distances of one vehicle become biased in flight."""
    fault = RangingBias(uav=LIAR, offset_m=LIE_M, start_s=plan.liar_after_s)
    return replace(BASE, name=f"{BASE.name}-liar", faults=(fault,), gains=False)


def groups(plan: CodesignPlan) -> dict[str, tuple[CodesignCase, ...]]:
    """Return the cases by group."""
    return {
        "wind_agents": tuple(
            wind_agents(localisation, agents, wind_n)
            for agents in AGENTS
            for wind_n in WINDS_N
            for localisation in ("gps", "ftm")
        ),
        "wavelength": tuple(
            wavelength(localisation, wavelength_m, wind_n)
            for wavelength_m in WAVELENGTHS_M
            for wind_n in (2, 5)
            for localisation in ("gps", "ftm")
        ),
        "beacon_period": tuple(beacon_period(period_ms) for period_ms in BEACON_PERIODS_MS),
        "ranging": tuple(
            case
            for agents, periods_s in FTM_PERIODS_S.items()
            for case in (*(all_pairs(agents, period_s) for period_s in periods_s), scheduled(agents))
        ),
        "baselines": (TRUTH, IDEAL, BASE, GPS_ALONE),
        "trouble": (BASE, LOSSY, cut(plan), liar_in_flight(plan), LIAR_FROM_START),
    }
