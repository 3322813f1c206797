"""Speed of a flight beside many valid datagrams a second to one vehicle."""

import contextlib
import statistics
import time
from functools import partial

from msgspec import Struct
from msgspec.structs import replace

from harness.launch.swarm import Swarm
from harness.scenario.packaged import find
from studies.attacks.comparison import AGENTS, BEGIN_S, ROW, SEED
from studies.attacks.launch import AttackProcess, can_be_another
from studies.attacks.plan import AttacksPlan
from studies.attacks.sockets import vehicle_ports
from studies.attacks.tasks import SteadyDatagrams
from studies.common.report import Check, ReportTable, Section, filled
from studies.common.runner import Job, Results

_GROUP = "datagrams"
LEAST_SHARE = 0.5
LEAST_SENT = 0.9
"""Share of the rate that has to be reached, median of the pairs"""


class Sender(Struct, frozen=True, kw_only=True):
    """A program that sends datagrams."""

    name: str
    is_other: bool
    rate_s: float
    sockets: int = 1
    one_port: bool = False


class Pair(Struct, frozen=True, kw_only=True):
    """Real-time factors of two flights, without and with datagrams of a sender."""

    sender: Sender
    without: float
    beside: float
    sent_s: float
    """Datagrams per second"""

    @property
    def share(self) -> float:
        """Share of the speed that is left."""
        return self.beside / self.without


def senders(plan: AttacksPlan) -> list[Sender]:
    """Return all senders, those of another user as far as this process may start them."""
    own = Sender(name="own user", is_other=False, rate_s=plan.datagrams_s)
    if not can_be_another():
        return [own]
    many = Sender(
        name=f"another user, {plan.many_sockets:,} sockets",
        is_other=True,
        rate_s=plan.many_sockets_datagrams_s,
        sockets=plan.many_sockets,
    )
    one_port = replace(many, name=f"{many.name} of one port", one_port=True)
    return [own, Sender(name="another user", is_other=True, rate_s=plan.datagrams_s), many, one_port]


def jobs(plan: AttacksPlan) -> dict[str, list[Job]]:
    """Return one job, since flights beside each other would measure each other."""
    return {_GROUP: [partial(fly_all, plan)]}


def fly_all(plan: AttacksPlan) -> list[Pair]:
    """Fly all pairs of each sender. Raises SwarmError, AttackError."""
    return [fly_pair(plan, sender) for _ in range(plan.pairs) for sender in senders(plan)]


def fly_pair(plan: AttacksPlan, sender: Sender) -> Pair:
    """Fly without and with datagrams. Raises SwarmError, AttackError."""
    without, _ = _fly(plan, None)
    beside, sent_s = _fly(plan, sender)
    return Pair(sender=sender, without=without, beside=beside, sent_s=sent_s)


def _fly(plan: AttacksPlan, sender: Sender | None) -> tuple[float, float]:
    """Return the real-time factor and the datagrams per second."""
    sent_s = 0.0
    with Swarm(find("article"), agents=AGENTS, seed=SEED, overrides=ROW) as swarm:
        swarm.run(until_s=BEGIN_S)
        with contextlib.ExitStack() as stack:
            process = None
            if sender is not None:
                address = vehicle_ports(swarm, 0)[0]
                task = SteadyDatagrams(
                    datagrams_to=address,
                    rate_s=sender.rate_s,
                    sockets=sender.sockets,
                    one_port=sender.one_port,
                )
                process = stack.enter_context(AttackProcess(task, is_other=sender.is_other))
            wall_begin_s = time.monotonic()
            swarm.run_for(plan.pair_s)
            factor = plan.pair_s / (time.monotonic() - wall_begin_s)
            if process is not None:
                sent_s = float(process.report().counts["per second"])
    return factor, sent_s


def judge(plan: AttacksPlan, results: Results) -> Section:
    """Compare the share of the speed with its limit."""
    pairs: list[Pair] = results[_GROUP][0]
    by_sender: dict[str, list[Pair]] = {}
    for pair in pairs:
        by_sender.setdefault(pair.sender.name, []).append(pair)
    checks = []
    for name, each in by_sender.items():
        share = statistics.median(pair.share for pair in each)
        sent = statistics.median(pair.sent_s for pair in each)
        least_s = LEAST_SENT * each[0].sender.rate_s
        checks += [
            Check(f"{name}: share of the speed that is left", share, at_least=LEAST_SHARE),
            Check(f"{name}: datagrams per second", sent, at_least=least_s),
        ]
    return Section(
        title="Speed beside datagrams",
        conditions=filled(
            f"{plan.datagrams_s:,.0f} heartbeats a second to the ground station's link of one of {AGENTS} "
            f"vehicles, in turns without and with, {plan.pairs} pairs of {plan.pair_s:g} s, as fast as "
            f"possible; medians. Another user also sends {plan.many_sockets_datagrams_s:,.0f} a second from "
            f"{plan.many_sockets:,} sockets in turn, once of as many ports and once of one port at as many "
            "addresses. The sender is a program of the same machine, so its own processor time is included."
        )
        + "\n",
        checks=tuple(checks),
        tables=(
            ReportTable(
                caption="Real-time factors.",
                columns=("sender", "without", "beside", "share", "datagrams/s"),
                rows=tuple(
                    (
                        name,
                        f"{pair.without:.2f}",
                        f"{pair.beside:.2f}",
                        f"{pair.share:.2f}",
                        f"{pair.sent_s:,.0f}",
                    )
                    for name, each in by_sender.items()
                    for pair in each
                ),
            ),
        ),
    )
