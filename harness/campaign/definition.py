"""Campaign files: variations of a scenario and their seeds.

    scenario = "../article.toml"        # relative to this file
    seeds = 10                          # 1 to 10; or a list, or {from = 11, to = 20}

    [set]                               # for every run
    run.duration_s = 30.0

    [[cases]]                           # named changes
    name = "ftm"
    onboard.localisation = "ftm"

    [sweep]                             # all combinations, in every case
    wind.mean_n = [0, 2, 5]
    antenna.wavelength_m = {from = 5.0, to = 20.0, step = 2.5}

All resulting scenarios are loaded and validated before the first flight.
"""

import hashlib
import itertools
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta, Struct, structs
from msgspec.structs import force_setattr, replace

from foundation.text_file import TextFileError
from harness.campaign.store import CampaignError
from harness.campaign.values import flat, plain, spread, toml_text
from harness.scenario import packaged
from harness.scenario.scenario import Scenario, ScenarioError
from harness.scenario.scenario_file import load as load_scenario
from harness.scenario.scenario_file import read_table
from harness.scenario.validation_errors import explain

SEED_PATH = "run.seed"
MOST_RUNS = 1_000_000
KEPT = ("gains", "flight", "radio", "ftm", "air")
"""Series of a run that can be stored: the maximum gain over time, and the tables of its folder"""

Seed = Annotated[int, Meta(ge=0, le=2**63 - 1)]


class _Seeds(
    Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, rename={"first": "from", "last": "to"}
):
    first: Seed
    last: Seed


class _Fields(Struct, frozen=True, kw_only=True):
    """Fields of a `Campaign` constructed by a program."""

    seeds: tuple[Seed, ...]
    fixed: dict[str, Any]
    sweep: dict[str, Any]
    keep: tuple[str, ...]
    overrides: tuple[str, ...]


class _File(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, rename={"fixed": "set"}):
    scenario: str
    """A file, relative to the campaign's, or the name of a packaged one"""
    seeds: Annotated[int, Meta(ge=1, le=MOST_RUNS)] | list[Seed] | _Seeds = 1
    keep: list[str] = []
    fixed: dict[str, Any] = {}
    sweep: dict[str, Any] = {}
    cases: list[dict[str, Any]] = []


class Case(Struct, frozen=True, kw_only=True):
    """A named set of changes of the scenario, by path."""

    name: str
    settings: dict[str, Any] = {}


class Campaign(Struct, frozen=True, kw_only=True):
    """All runs: every case with every combination of swept values and every seed, in this order.

    Constructed in a program it is validated like a file: tables may be nested, values may be NumPy's, and
    seeds and swept values may be any list or range. Raises CampaignError.
    """

    name: str
    scenario: Path
    seeds: tuple[int, ...]
    fixed: dict[str, Any] = {}
    """Values for every run, by path of the scenario"""
    sweep: dict[str, tuple[Any, ...]] = {}
    """Lists of values to combine, by path"""
    cases: tuple[Case, ...] = ()
    """Default: one case without changes, with the campaign's name"""
    overrides: tuple[str, ...] = ()
    """``PATH=VALUE`` for every run, from the command line"""
    keep: tuple[str, ...] = ()
    """Series to store, some of `KEPT`"""
    origin: str = "campaign"
    """Prefix of error messages: the file"""

    def __post_init__(self) -> None:
        """Convert values given by a program to a file's form, and validate the definition of the runs."""
        try:
            given = self._normalised()
        except msgspec.ValidationError as error:
            raise CampaignError(f"{self.origin}: {explain(error, _EXPECTED)}") from None
        except ValueError as error:
            raise CampaignError(f"{self.origin}: {error}") from None
        for name, value in given.items():
            force_setattr(self, name, value)
        for name in self.keep:
            if name not in KEPT:
                raise CampaignError(f"{self.origin}: keep: {name!r}: expected some of {', '.join(KEPT)}")
        if not self.seeds or len(set(self.seeds)) < len(self.seeds):
            raise CampaignError(f"{self.origin}: seeds: expected at least one, and none twice")
        names = [case.name for case in self.cases]
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise CampaignError(f"{self.origin}: cases: two are named {twice!r}")
        combinations = math.prod(map(len, self.sweep.values()))
        runs = max(1, len(self.cases)) * combinations * len(self.seeds)
        if runs > MOST_RUNS:
            raise CampaignError(f"{self.origin}: {runs} runs; expected at most {MOST_RUNS}")
        self._check_paths()

    def _normalised(self) -> dict[str, Any]:
        """Return the fields converted to a file's form; raises ValueError, ValidationError."""
        names = _Fields.__struct_fields__
        fields = msgspec.convert({name: plain(name, getattr(self, name)) for name in names}, _Fields)
        sweep = _named("sweep", fields.sweep, ranges=True)
        return structs.asdict(fields) | {
            "scenario": Path(self.scenario),
            "fixed": _named("set", fields.fixed),
            "sweep": {path: spread(f"sweep.{path}", value) for path, value in sweep.items()},
            "cases": tuple(
                _case(number, plain(f"cases[{number}]", case.settings), case.name)
                for number, case in enumerate(self.cases)
            ),
        }

    def _check_paths(self) -> None:
        """Check that no change of a run silently overwrites another one."""
        of_cases = [(path, f"case {case.name!r}") for case in self.cases for path in case.settings]
        earlier = [*((path, "set") for path in self.fixed), *of_cases]
        swept = [(path, "sweep") for path in self.sweep]
        for path, where in [*earlier, *swept]:
            if _covers(path, SEED_PATH):
                raise CampaignError(f"{self.origin}: {where}: {path}: the seeds are set by `seeds` alone")
        for number, (path, _) in enumerate(swept):
            for other, where in [*earlier, *swept[:number], *swept[number + 1 :]]:
                if _covers(path, other):
                    raise CampaignError(
                        f"{self.origin}: sweep: {path}: {where} sets {other} too; set each path in one place"
                    )
        for override in self.overrides:
            path = override.partition("=")[0].strip()
            for other, where in [*of_cases, *swept, (SEED_PATH, "seeds")]:
                if _covers(path, other):
                    raise CampaignError(
                        f"{self.origin}: --set {override}: {where} sets {other} too; change it there"
                    )


class Run(Struct, frozen=True, kw_only=True):
    """One row of the table."""

    case: str
    swept: tuple[Any, ...]
    """Values of the swept paths, in order"""
    seed: int
    settings: tuple[str, ...]
    """Overrides of the campaign's scenario, without the seed"""
    scenario: Scenario
    digest: str
    """Hash of scenario, options and sources: runs with equal digests are one flight"""
    options: dict[str, Any] = {}
    """Further arguments of the function that flies it: `harness.campaign.store.Flying`"""

    def describe(self, campaign: Campaign) -> str:
        """Return its name in one line."""
        return ", ".join([self.case, *_swept_texts(campaign, self.swept), f"seed {self.seed}"])


def load(path: str | Path, overrides: Sequence[str] = (), keep: Iterable[str] = ()) -> Campaign:
    """Read a campaign file; ``overrides`` apply to every run, ``keep`` is added to the file's ``keep``.

    Raises CampaignError with one line that names the file and the error.
    """
    path = packaged.find(path)
    try:
        table = read_table(path)
    except TextFileError as error:
        names = ", ".join(name for name in packaged.names() if "/" in name)
        raise CampaignError(f"{error}; campaigns by name: {names}") from None
    if "scenario" not in table:
        raise CampaignError(
            f"{path}: it names no scenario, as a campaign does; coflight fly flies a scenario"
        )
    try:
        file = msgspec.convert(table, _File)
        return Campaign(
            name=path.stem,
            scenario=packaged.find(file.scenario, root=path.parent),
            seeds=_seeds(file.seeds),
            fixed=file.fixed,
            sweep=file.sweep,
            cases=tuple(
                Case(name=case.get("name", ""), settings={key: case[key] for key in case if key != "name"})
                for case in file.cases
            ),
            overrides=tuple(overrides),
            keep=tuple(dict.fromkeys([*file.keep, *keep])),
            origin=str(path),
        )
    except msgspec.ValidationError as error:
        raise CampaignError(f"{path}: {explain(error, _EXPECTED, kind=_File, table=table)}") from None
    except ValueError as error:
        raise CampaignError(f"{path}: {error}") from None


_EXPECTED = {r"seeds": "a number of seeds, a list of them, or {from=, to=}"}


def expand(campaign: Campaign, *, state: str) -> list[Run]:
    """Return all runs of a campaign in the table's order; ``state`` is the hash of the sources.

    Raises CampaignError with campaign, case, and a line for each wrong field.
    """
    runs = []
    for case in campaign.cases or (Case(name=campaign.name),):
        for swept in itertools.product(*campaign.sweep.values()):
            values = campaign.fixed | case.settings | dict(zip(campaign.sweep, swept, strict=True))
            settings = (
                *(f"{path}={toml_text(value)}" for path, value in values.items()),
                *campaign.overrides,
            )
            try:
                scenario = load_scenario(campaign.scenario, settings)
            except ScenarioError as error:
                which = ", ".join([f"case {case.name!r}", *_swept_texts(campaign, swept)])
                text = str(error) if campaign.overrides else str(error).removeprefix("--set ")
                raise CampaignError(f"{campaign.origin}: {which}: {text}") from None
            for seed in campaign.seeds:
                flown = replace(scenario, run=replace(scenario.run, seed=seed))
                digest = hashlib.sha256(msgspec.json.encode((state, flown))).hexdigest()[:16]
                run = Run(
                    case=case.name, swept=swept, seed=seed, settings=settings, scenario=flown, digest=digest
                )
                runs.append(run)
    return runs


def _swept_texts(campaign: Campaign, swept: Sequence[Any]) -> list[str]:
    return [f"{path} = {toml_text(value)}" for path, value in zip(campaign.sweep, swept, strict=True)]


def _covers(path: str, other: str) -> bool:
    """Whether setting one path overwrites the other."""
    return other == path or other.startswith(f"{path}.")


def _named(table: str, values: dict[str, Any], *, ranges: bool = False) -> dict[str, Any]:
    """Return the values of `flat`; errors begin with the table's name, and a repeated path is an error."""
    try:
        found = list(flat(values, ranges=ranges))
        paths = [path for path, _ in found]
        if twice := next((path for path in paths if paths.count(path) > 1), None):
            raise ValueError(f"{twice}: stands twice")  # noqa: TRY301  the table's name is added below
    except ValueError as error:
        raise ValueError(f"{table}.{error}") from None
    return dict(found)


def _case(number: int, settings: dict[str, Any], name: object) -> Case:
    if not isinstance(name, str) or not name:
        raise ValueError(f"cases[{number}].name: expected a name")
    return Case(name=name, settings=_named(f"cases[{number}]", settings))


def _seeds(seeds: int | list[int] | _Seeds) -> tuple[int, ...]:
    if isinstance(seeds, int):
        return tuple(range(1, seeds + 1))
    if isinstance(seeds, list):
        return tuple(seeds)
    if seeds.last - seeds.first >= MOST_RUNS:
        raise ValueError(f"seeds: expected at most {MOST_RUNS}")
    return tuple(range(seeds.first, seeds.last + 1))
