"""Fly and measure one flight of the experiment in this process: see `harness.campaign.store.Flying`."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec

from harness.launch import one_process
from harness.records.run_folder import RunFolder
from harness.scenario.scenario import Scenario
from harness.world.faults import AnyFault
from studies.codesign.measures import measure, read_tables


def fly(scenario: Scenario, folder: Path, *, faults: Iterable[AnyFault], gains: bool) -> dict[str, Any]:
    """Fly with faults that are injected in formation; return the summary with only the flight's measures.

    A formation that is not reached is a valid result. Raises as `one_process.fly`.
    """
    summary = one_process.fly(scenario, folder, faults_in_formation=faults)
    formed_s = summary["formed_s"]
    measures = measure(
        read_tables(RunFolder(folder), scenario), scenario,
        formed_us=None if formed_s is None else round(formed_s * 1e6), wall_s=summary["wall_s"], gains=gains,
    )  # fmt: skip
    kept = {name: summary[name] for name in ("scenario", "seed", "status", "reason")}
    return kept | {"measures": msgspec.to_builtins(measures)}
