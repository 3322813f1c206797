"""The manifest of a run, ``manifest.json``: what flies or flew, with what, and how it ended.

It exists from the moment in which the run has a folder, and is rewritten whole. Its readers distinguish:

running      ``status`` is ``running``, and a process holds ``raw/``
broken off   ``status`` is ``running``, and no process does: the launcher was killed, or its disk was full
ended        ``status`` is another one, ``complete`` is false: there are no tables yet
complete     ``complete`` is true: tables and summary exist
"""

import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct

from autopilot.onboard import factory
from autopilot.vehicle import extensions
from foundation.records.whole_file import sha256_of
from harness.records.outcome import RUNNING, RunOutcome
from harness.records.run_folder import NotARun, RunFolder
from harness.records.versions import DISTRIBUTIONS, origin_of, versions
from harness.scenario.scenario import Scenario
from harness.world import user_models
from netsim.radio_models import registry

_UNKNOWN = "its end is not recorded: its launcher was killed, or its disk was full"


def make_manifest(
    scenario: Scenario,
    outcome: RunOutcome,
    *,
    hashes: Mapping[str, str] | None = None,
    antenna: Mapping[str, str] | None = None,
    figures: Sequence[str] = (),
) -> dict[str, Any]:
    """Return the manifest of a run; ``hashes`` of its tables by name, if it has them.

    ``antenna`` names the solver of the patterns and its accuracy.
    """
    return {
        "status": outcome.status,
        "complete": hashes is not None,
        "reason": outcome.reason,
        "command": list(outcome.command),
        "started_utc": outcome.started_utc,
        "speed": outcome.speed or "max",
        "wall_s": outcome.wall_s,
        "simulated_us": outcome.simulated_us,
        "formed_us": outcome.formed_us,
        "seed": scenario.run.seed,
        "deterministic": None if outcome.status == RUNNING else not outcome.nondeterminism,
        "nondeterminism": list(outcome.nondeterminism),
        "interventions": list(outcome.interventions),
        "ground_messages": outcome.ground_messages,
        "processes": [msgspec.to_builtins(process) for process in outcome.processes],
        "profile": msgspec.to_builtins(outcome.profile),
        "versions": {"python": platform.python_version(), **versions(DISTRIBUTIONS)},
        "extensions": {
            field: origin_of(name, group)
            for field, (name, group) in (
                extensions.named(scenario.autopilot)
                | factory.named(scenario.onboard)
                | registry.named(scenario.channel)
                | user_models.named(scenario.sensors.extra, scenario.faults)
            ).items()
        },
        "checkout": msgspec.to_builtins(outcome.checkout),
        "platform": platform.platform(),
        "antenna": None if antenna is None else dict(antenna),
        "logs_sha256": dict(hashes or {}),
        "figures": list(figures),
        "scenario": msgspec.to_builtins(scenario),
    }


def manifest_text(content: Mapping[str, Any]) -> bytes:
    """Return the content of the manifest's file."""
    return msgspec.json.format(msgspec.json.encode(content), indent=2) + b"\n"


def altered_tables(folder: RunFolder) -> list[str]:
    """Return the names of the tables that are not as the run wrote them, or are missing. Raises OSError."""
    hashes = msgspec.json.decode(folder.manifest.read_bytes(), type=_Hashes).logs_sha256
    paths = {folder.path / Path(name).name: sha256 for name, sha256 in hashes.items()}
    return [path.name for path, sha256 in paths.items() if not path.is_file() or sha256_of(path) != sha256]


class _Hashes(Struct, frozen=True):
    logs_sha256: dict[str, str] = {}


def read_outcome(folder: RunFolder) -> RunOutcome:
    """Return how a run ended whose launcher has ended. Raises NotARun."""
    try:
        content = msgspec.json.decode(folder.manifest.read_bytes(), type=dict[str, Any])
        speed = 0.0 if content.get("speed") == "max" else content.get("speed")
        outcome = msgspec.convert(content | {"speed": speed}, RunOutcome)
    except (FileNotFoundError, NotADirectoryError):
        raise NotARun(f"{folder.path}: no run: it has no manifest.json") from None
    except msgspec.DecodeError as error:
        raise NotARun(f"{folder.manifest}: of another version: {error}") from None
    if outcome.status != RUNNING:
        return outcome
    return msgspec.structs.replace(outcome, status="interrupted", reason=_UNKNOWN, nondeterminism=(_UNKNOWN,))
