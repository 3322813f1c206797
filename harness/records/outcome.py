"""How a flight ended, from its launcher: kept beside the raw logs until the tables exist."""

from typing import Any

import msgspec
from msgspec import Struct

from foundation.profiling.profiler import KindProfile
from foundation.records.whole_file import write_whole
from harness.records.run_folder import NotARun, RunFolder
from harness.records.versions import Checkout


class ProcessRecord(Struct, frozen=True, kw_only=True):
    """One process of the run, for the manifest."""

    name: str
    pid: int
    ending: str
    details: dict[str, Any] = {}
    """Details of its last event."""


class RunOutcome(Struct, frozen=True, kw_only=True):
    """Data of a run from its launcher."""

    status: str
    """``completed``, ``not_formed``, ``failed``, ``interrupted``, or ``held``: a hold that its user ended."""
    reason: str | None = None
    command: tuple[str, ...]
    speed: float
    """Requested speed, simulated over wall time; 0: as fast as possible."""
    started_utc: str
    checkout: Checkout | None = None
    """State of coflight's checkout at the start"""
    wall_s: float | None
    """Wall time from the first step to the last; None if the end is not recorded."""
    simulated_us: int | None
    """None if the end is not recorded: that of the raw logs."""
    formed_us: int | None
    processes: tuple[ProcessRecord, ...]
    ground_messages: int = 0
    """Messages received from ground stations and companions."""
    interventions: tuple[str, ...] = ()
    """Interventions of a program or user at exact simulated times; they do not affect determinism."""
    nondeterminism: tuple[str, ...] = ()
    """Causes that made this run depend on more than scenario and seed."""
    profile: dict[str, KindProfile] = {}
    """Profile by kind of process, if requested"""


def write_outcome(folder: RunFolder, outcome: RunOutcome) -> None:
    """Replace the outcome beside the raw logs, for `read_outcome`. Raises OSError."""
    write_whole(folder.outcome, msgspec.json.encode(outcome))


def read_outcome(folder: RunFolder) -> RunOutcome:
    """Return the outcome beside the raw logs. Raises NotARun."""
    try:
        return msgspec.json.decode(folder.outcome.read_bytes(), type=RunOutcome)
    except (FileNotFoundError, NotADirectoryError):
        raise NotARun(
            f"{folder.path}: no run that has flown: it has neither manifest.json nor raw/outcome.json"
        ) from None
    except msgspec.DecodeError as error:
        raise NotARun(f"{folder.outcome}: of another version: {error}") from None
