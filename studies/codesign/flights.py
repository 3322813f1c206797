"""Fly and measure one flight of the experiment in this process, without leaving files."""

import shutil
from pathlib import Path

from harness.launch.one_process import OneProcessSwarm
from harness.launch.processes import SwarmError
from harness.launch.swarm import SwarmTimeoutError
from harness.records.run_folder import RunFolder
from studies.codesign.measures import measure, read_tables
from studies.codesign.results import CodesignFlown, CodesignTask, broken


def fly_task(task: CodesignTask) -> CodesignFlown:
    """Fly a task; errors are reported in the result. A formation that is not reached is a valid result."""
    folder = Path(task.folder)
    shutil.rmtree(folder, ignore_errors=True)  # left by a killed campaign
    try:
        return _fly(task, folder)
    except Exception as error:  # noqa: BLE001  a failed flight must not end the campaign
        return broken(task, f"{type(error).__name__}: {error}".splitlines()[0])
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _fly(task: CodesignTask, folder: Path) -> CodesignFlown:
    run = task.scenario.run
    with OneProcessSwarm(task.scenario, out=folder) as swarm:
        try:
            swarm.run_until_formed(timeout_s=run.reach_timeout_s)
            for fault in task.faults:
                swarm.inject(fault)
            swarm.run_for(run.duration_s)
        except SwarmTimeoutError:
            pass
        summary = swarm.summary(draw=False)
    if summary["status"] == "failed":
        raise SwarmError(summary["reason"])
    formed_s = summary["formed_s"]
    measures = measure(
        read_tables(RunFolder(folder), task.scenario.agents),
        task.scenario,
        formed_us=None if formed_s is None else round(formed_s * 1e6),
        wall_s=summary["wall_s"],
        gains=task.gains,
    )
    return CodesignFlown(case=task.case, seed=task.seed, digest=task.digest, measures=measures)
