"""Random bytes at all ports and sockets of a run, of its own user and of another one."""

from functools import partial

from msgspec.structs import replace

from harness.launch.swarm import Swarm
from studies.attacks.comparison import COLUMNS, Attack, Comparison, checks, compare, row
from studies.attacks.launch import can_be_another
from studies.attacks.plan import AttacksPlan
from studies.attacks.sockets import OpenSockets
from studies.attacks.tasks import RandomBytes
from studies.common.report import ReportTable, Section, filled
from studies.common.runner import Job, Results

_GROUP = "bytes"
LINKS = ("unix", "tcp")


def jobs(plan: AttacksPlan) -> dict[str, list[Job]]:
    """Return a comparison for each user and link of the radio."""
    users = (False, True) if can_be_another() else (False,)
    count = len(users) * len(LINKS)
    part = replace(
        plan, random_bytes=plan.random_bytes // count, small_datagrams=plan.small_datagrams // count
    )
    return {_GROUP: [partial(fly, part, link, is_other) for link in LINKS for is_other in users]}


def fly(plan: AttacksPlan, link: str, is_other: bool) -> Comparison:  # noqa: FBT001  pickled with its position
    """Send the plan's bytes to all that is open. Raises SwarmError, AttackError."""

    def prepare(swarm: Swarm) -> list[Attack]:
        opened = OpenSockets(swarm)
        task = RandomBytes(
            datagrams_to=opened.datagrams,
            streams_to=opened.listening,
            sockets=opened.named,
            total_bytes=plan.random_bytes,
            small_datagrams=plan.small_datagrams,
            seed=2 * LINKS.index(link) + is_other,
        )
        return [Attack(task=task, is_other=is_other)]

    user = "another user" if is_other else "own user"
    return compare(
        f"{user}, radio over {link}",
        prepare,
        overrides=[f"ports.radio_link={link}"],
        least_s=plan.least_s,
        may_influence=not is_other,
    )


def judge(plan: AttacksPlan, results: Results) -> Section:
    """Compare the flights with those without bytes."""
    comparisons: list[Comparison] = results[_GROUP]
    return Section(
        title="Random bytes",
        conditions=filled(
            f"{plan.random_bytes:,} bytes to all UDP ports, listening TCP ports and named Unix sockets of "
            f"flying runs, {plan.small_datagrams:,} datagrams of at most 280 bytes among them; half of the "
            "bytes to streams have the frames of Zenoh. A datagram of the own user may be a valid "
            "message by accident, one of 65,536 with the form of one, which the manifest then names."
        )
        + "\n",
        checks=tuple(check for comparison in comparisons for check in checks(comparison)),
        tables=(ReportTable(caption="Attacks.", columns=COLUMNS, rows=tuple(map(row, comparisons))),),
    )
