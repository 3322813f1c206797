"""Mutated MAVLink of the run's own user: all messages of the dialect, all commands."""

from functools import partial

from harness.launch.swarm import Swarm
from studies.attacks.comparison import AGENTS, COLUMNS, Attack, Comparison, checks, compare, row
from studies.attacks.plan import AttacksPlan
from studies.attacks.sockets import vehicle_ports
from studies.attacks.tasks import MutatedMavlink
from studies.common.report import Check, ReportTable, Section, filled
from studies.common.runner import Job, Results

_GROUP = "mavlink"
FRAMES_S = 250.0
"""To each port: below the budget of a link, so that the messages are read."""
SEEDS = (1, 2)


def jobs(plan: AttacksPlan) -> dict[str, list[Job]]:
    """Return comparisons of some seeds."""
    return {_GROUP: [partial(fly, plan, seed) for seed in SEEDS]}


def fly(plan: AttacksPlan, seed: int) -> Comparison:
    """Send mutated messages to all links of all vehicles. Raises SwarmError, AttackError."""

    def prepare(swarm: Swarm) -> list[Attack]:
        task = MutatedMavlink(
            datagrams_to=[address for i in range(AGENTS) for address in vehicle_ports(swarm, i)],
            systems=[i + 1 for i in range(AGENTS)],
            rounds=plan.mavlink_rounds,
            frames_s=FRAMES_S,
            seed=seed,
        )
        return [Attack(task=task)]

    return compare(f"seed {seed}", prepare, least_s=plan.least_s, may_influence=True)


def judge(plan: AttacksPlan, results: Results) -> Section:
    """Require that no process ends, that all values are finite, and that the manifest names the sender."""
    comparisons: list[Comparison] = results[_GROUP]
    named = [
        Check(f"{comparison.title}: named influences", len(comparison.attacked.causes), at_least=1.0)
        for comparison in comparisons
        if comparison.attacked is not None
    ]
    return Section(
        title="Mutated MAVLink",
        conditions=filled(
            f"{plan.mavlink_rounds} rounds over all messages of the dialect and all commands, of the run's "
            f"own user to both links of {AGENTS} vehicles, {FRAMES_S:g} a second to each: random contents, "
            "extremes of all types with not-a-number and infinity, wrong bits, cut payloads with right "
            "checksums, and frames with wrong ones. Nothing is left out: commands that reboot or terminate "
            "a vehicle, files, parameters and signing are included. The flights may differ; no "
            "process may end."
        )
        + "\n",
        checks=(*(check for comparison in comparisons for check in checks(comparison)), *named),
        tables=(ReportTable(caption="Attacks.", columns=COLUMNS, rows=tuple(map(row, comparisons))),),
    )
