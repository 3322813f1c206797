"""Profile of a run: processor time by kind of process and part.

The processes sample themselves (`foundation.profiling.profiler`) and report in their last event; a process
that was killed reports nothing.
"""

from collections.abc import Mapping
from statistics import fmean
from typing import Any

import msgspec
from rich.table import Table

from foundation.profiling.profiler import KEY, KindProfile, Profile
from harness.launch.process_commands import PHYSICS, RADIO

VEHICLES = "vehicles"
KINDS = {PHYSICS: "physics server", RADIO: "802.11 emulator", VEHICLES: "vehicles"}
"""Kinds of process that report a profile, and their names in tables."""
_MANY = {"uav": VEHICLES, "application": "applications"}
"""Kinds of the processes that are numbered, by the first word of their names."""


def by_kind(finished: Mapping[str, Mapping[str, Any]]) -> dict[str, KindProfile]:
    """Return profiles by kind of process, from the details of every process's last event by its name."""
    reported: dict[str, list[Profile]] = {kind: [] for kind in KINDS}
    for name, details in finished.items():
        if KEY in details:
            reported.setdefault(kind_of(name), []).append(msgspec.convert(details[KEY], Profile))
    return {kind: _together(profiles) for kind, profiles in reported.items() if profiles}


def kind_of(name: str) -> str:
    """Return the kind of a process by its name."""
    return _MANY.get(name.partition(" ")[0], name)


def _together(profiles: list[Profile]) -> KindProfile:
    parts: dict[str, float] = {}
    for profile in profiles:
        for part, spent_s in profile.parts_cpu_s.items():
            parts[part] = parts.get(part, 0.0) + spent_s / profile.simulated_s
    return KindProfile(
        processes=len(profiles),
        cpu_s_per_simulated_s=sum(parts.values()),
        parts_cpu_s_per_simulated_s=dict(sorted(parts.items(), key=lambda item: -item[1])),
        waiting_fraction=fmean(profile.waiting_s / profile.wall_s for profile in profiles),
        queueing_fraction=fmean(profile.queueing_s / profile.wall_s for profile in profiles),
        samples=sum(profile.samples for profile in profiles),
    )


def profile_table(profile: Mapping[str, KindProfile], *, step_us: int) -> Table:
    """Return a table of a profile: a row per kind of process, followed by a row per part."""
    table = Table(title="where the processor time went")
    table.add_column("")
    for column in ("ms per simulated s", "us per step", "share"):
        table.add_column(column, justify="right")
    whole = sum(kind.cpu_s_per_simulated_s for kind in profile.values())

    def row(name: str, spent: float, style: str | None = None) -> None:
        figures = f"{1e3 * spent:.1f}", f"{step_us * spent:.0f}", f"{spent / whole:.1%}"
        table.add_row(name, *figures, style=style)

    for name, kind in profile.items():
        processes = f" ({kind.processes})" if name == VEHICLES else ""
        row(f"{KINDS.get(name, name)}{processes}", kind.cpu_s_per_simulated_s, "bold")
        for part, spent in kind.parts_cpu_s_per_simulated_s.items():
            row(f"  {part}", spent)
        waits = f"waits {kind.waiting_fraction:.0%}, queues {kind.queueing_fraction:.0%} of wall time"
        table.add_row(f"  {waits}", "", "", "", style="dim")
    row("all", whole, "bold")
    return table
