"""How a run ended, as its launcher reports it; `harness.records.manifest` keeps it in the run's folder."""

from typing import Any

from msgspec import Struct

from foundation.profiling.profiler import KindProfile
from harness.records.versions import Checkout

RUNNING = "running"


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
    """``running``, or ``completed``, ``not_formed``, ``failed``, ``interrupted``, ``held`` (a hold that
    its user ended)"""
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
