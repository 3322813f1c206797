"""Large swarms: start-up, memory, descriptors and speed, without and under load."""

import os
import time
from functools import partial

from msgspec import Struct

from harness.launch.swarm import Swarm
from harness.scenario.packaged import find
from studies.common.report import Check, ReportTable, Section, filled
from studies.common.runner import Job, Results
from studies.soak.load import busy_processors
from studies.soak.measure import measure
from studies.soak.plan import SoakPlan

START_LIMIT_S = 300.0
"""Wall time to the first step, also under load"""
LOADS = (0, 2)
"""Processes that compute beside the flight"""
_GROUP = "sizes"


class Size(Struct, frozen=True, kw_only=True):
    """Cost of one size under one load."""

    agents: int
    load: int
    start_s: float
    real_time_factor: float
    memory_gb: float
    """Of all processes, shared pages counted once"""
    most_descriptors: int
    """Of any process"""


def jobs(plan: SoakPlan) -> dict[str, list[Job]]:
    """Return one job that flies all sizes, since flights beside each other would be load."""
    return {_GROUP: [partial(fly_all, plan.sizes, plan.size_s)]}


def fly_all(sizes: tuple[int, ...], duration_s: float) -> list[Size]:
    """Fly all sizes, without and with load. Raises SwarmError."""
    return [fly(agents, load, duration_s) for agents in sizes for load in LOADS]


def fly(agents: int, load: int, duration_s: float) -> Size:
    """Fly from the ground for ``duration_s`` beside ``load`` busy processes. Raises SwarmError."""
    with busy_processors(load):
        wall_s = time.monotonic()
        with Swarm(find("swarm64"), agents=agents) as swarm:
            step_s = swarm.scenario.run.step_us * 1e-6
            swarm.run(until_s=2.0 * step_s)
            began_s = time.monotonic()
            swarm.run_for(duration_s)
            ended_s = time.monotonic()
            measured = [measure(pid) for pid in (os.getpid(), *swarm.pids.values())]
    return Size(
        agents=agents,
        load=load,
        start_s=began_s - wall_s,
        real_time_factor=duration_s / (ended_s - began_s),
        memory_gb=sum(each.shared_mb for each in measured) / 1e3,
        most_descriptors=max(each.descriptors for each in measured),
    )


def judge(plan: SoakPlan, results: Results) -> Section:
    """Compare the start-up with its limit; tabulate the rest."""
    sizes: list[Size] = results[_GROUP][0]
    return Section(
        title="Large swarms",
        conditions=filled(
            f"`scenarios/swarm64.toml` with other numbers of UAVs, from the ground on for {plan.size_s:g} s, "
            f"alone and beside {LOADS[-1]} processes that compute, on {os.cpu_count()} processors. More than "
            "254 UAVs are refused: MAVLink numbers systems from 1 to 255, and 255 is a ground station's."
        )
        + "\n",
        checks=tuple(
            Check(
                f"{each.agents} UAVs, {each.load} busy processes: start", each.start_s, "s",
                at_most=START_LIMIT_S,
            )
            for each in sizes
        ),
        tables=(
            ReportTable(
                caption="Costs. Real-time factor on the ground and in take-off.",
                columns=("UAVs", "busy", "start, s", "real-time factor", "memory, GB", "descriptors"),
                rows=tuple(
                    (
                        str(each.agents),
                        str(each.load),
                        f"{each.start_s:.1f}",
                        f"{each.real_time_factor:.2f}",
                        f"{each.memory_gb:.2f}",
                        str(each.most_descriptors),
                    )
                    for each in sizes
                ),
            ),
        ),
    )  # fmt: skip
