"""Foreign connections to vehicle slots and idle ones, from before the start to the end."""

from functools import partial

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder
from harness.launch.swarm import Swarm
from studies.attacks.comparison import AGENTS, COLUMNS, Attack, Comparison, checks, compare, row
from studies.attacks.launch import can_be_another
from studies.attacks.plan import AttacksPlan
from studies.attacks.sockets import HERE, OpenSockets, free_base
from studies.attacks.tasks import IdleConnections
from studies.common.report import Check, ReportTable, Section, filled
from studies.common.runner import Job, Results

_GROUP = "slots"
INTRODUCTION = Encoder(system=1, component=1).encode(common.MAVLink_heartbeat_message(2, 12, 0, 0, 0, 3))
"""First message of a vehicle."""


def jobs(plan: AttacksPlan) -> dict[str, list[Job]]:
    """Return a comparison for each user."""
    users = (False, True) if can_be_another() else (False,)
    return {_GROUP: [partial(fly, plan, is_other) for is_other in users]}


def fly(plan: AttacksPlan, is_other: bool) -> Comparison:  # noqa: FBT001  pickled with its position
    """Connect to the slots before the vehicles do, and to the radio. Raises SwarmError, AttackError."""
    base = free_base(AGENTS)
    names = ("gcs_local_udp", "companion_local_udp", "gcs_remote_udp", "companion_remote_udp", "radio_tcp")
    overrides = [
        "ports.simulator_link=tcp",
        "ports.radio_link=tcp",
        f"ports.simulator_tcp={base}",
        *(f"ports.{name}=0" for name in names),
    ]
    slots = IdleConnections(
        streams_to=[(HERE, base + i) for i in range(AGENTS)],
        count=plan.idle_connections,
        introduction=INTRODUCTION,
    )

    def prepare(swarm: Swarm) -> list[Attack]:
        radio = IdleConnections(
            streams_to=OpenSockets(swarm).listening, count=plan.idle_connections, introduction=b"\x00"
        )
        return [Attack(task=radio, is_other=is_other, lasts=True)]

    return compare(
        "another user" if is_other else "own user",
        prepare,
        overrides=overrides,
        before=[Attack(task=slots, is_other=is_other, lasts=True)],
        least_s=plan.least_s,
        ports="scenario",
    )


def judge(plan: AttacksPlan, results: Results) -> Section:
    """Require that the vehicles have their slots, and that the manifest counts the foreign connections."""
    comparisons: list[Comparison] = results[_GROUP]
    counted = [
        Check(
            f"{comparison.title}: rejected connections in the manifest",
            sum(each["count"] for each in comparison.attacked.details["physics"]["rejected_connections"]),
            at_least=1.0,
        )
        for comparison in comparisons
        if comparison.attacked is not None
    ]
    return Section(
        title="Foreign connections to slots, idle connections",
        conditions=filled(
            f"{plan.idle_connections} connections to the TCP port of each vehicle at the simulator, from the "
            "moment at which it listens; every second one sends a vehicle's first message. The same "
            "number to the radio in flight."
        )
        + "\n",
        checks=(*(check for comparison in comparisons for check in checks(comparison)), *counted),
        tables=(ReportTable(caption="Attacks.", columns=COLUMNS, rows=tuple(map(row, comparisons))),),
    )
