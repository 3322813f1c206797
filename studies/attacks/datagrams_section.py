"""Speed of a flight beside many valid datagrams a second to one vehicle."""

import contextlib
import statistics
import time
from functools import partial

from msgspec import Struct

from harness.launch.swarm import Swarm
from harness.scenario.packaged import find
from studies.attacks.duel import AGENTS, BEGIN_S, ROW, SEED
from studies.attacks.launch import Intruder, can_be_another
from studies.attacks.plan import AttacksPlan
from studies.attacks.sockets import vehicle_ports
from studies.attacks.tasks import SteadyDatagrams
from studies.common.report import Check, ReportTable, Section, filled
from studies.common.runner import Job, Results

_GROUP = "datagrams"
LEAST_SHARE = 0.5
LEAST_SENT = 0.9
"""Share of the rate that has to be reached, median of the pairs"""


class Pair(Struct, frozen=True, kw_only=True):
    """Real-time factors of two flights, without and with datagrams."""

    is_other: bool
    without: float
    beside: float
    sent_s: float
    """Datagrams per second"""

    @property
    def share(self) -> float:
        """Share of the speed that is left."""
        return self.beside / self.without


def jobs(plan: AttacksPlan) -> dict[str, list[Job]]:
    """Return one job, since flights beside each other would measure each other."""
    return {_GROUP: [partial(fly_all, plan)]}


def fly_all(plan: AttacksPlan) -> list[Pair]:
    """Fly all pairs of each user. Raises SwarmError, IntruderError."""
    users = (False, True) if can_be_another() else (False,)
    return [fly_pair(plan, is_other=is_other) for _ in range(plan.pairs) for is_other in users]


def fly_pair(plan: AttacksPlan, *, is_other: bool) -> Pair:
    """Fly without and with datagrams. Raises SwarmError, IntruderError."""
    without, _ = _fly(plan, rate_s=0.0, is_other=is_other)
    beside, sent_s = _fly(plan, rate_s=plan.datagrams_s, is_other=is_other)
    return Pair(is_other=is_other, without=without, beside=beside, sent_s=sent_s)


def _fly(plan: AttacksPlan, *, rate_s: float, is_other: bool) -> tuple[float, float]:
    """Return the real-time factor and the datagrams per second."""
    sent_s = 0.0
    with Swarm(find("article"), agents=AGENTS, seed=SEED, overrides=ROW) as swarm:
        swarm.run(until_s=BEGIN_S)
        with contextlib.ExitStack() as stack:
            intruder = None
            if rate_s:
                task = SteadyDatagrams(datagrams_to=vehicle_ports(swarm, 0)[0], rate_s=rate_s)
                intruder = stack.enter_context(Intruder(task, is_other=is_other))
            wall_begin_s = time.monotonic()
            swarm.run_for(plan.pair_s)
            factor = plan.pair_s / (time.monotonic() - wall_begin_s)
            if intruder is not None:
                sent_s = float(intruder.report().counts["per second"])
    return factor, sent_s


def judge(plan: AttacksPlan, results: Results) -> Section:
    """Compare the share of the speed with its limit."""
    pairs: list[Pair] = results[_GROUP][0]
    by_user = {
        name: [each for each in pairs if each.is_other is is_other]
        for is_other, name in ((False, "own user"), (True, "another user"))
    }
    checks = []
    for name, each in by_user.items():
        if each:
            share = statistics.median(pair.share for pair in each)
            sent = statistics.median(pair.sent_s for pair in each)
            checks += [
                Check(f"{name}: share of the speed that is left", share, at_least=LEAST_SHARE),
                Check(f"{name}: datagrams per second", sent, at_least=LEAST_SENT * plan.datagrams_s),
            ]
    return Section(
        title="Speed beside datagrams",
        conditions=filled(
            f"{plan.datagrams_s:,.0f} heartbeats a second to the ground station's link of one of {AGENTS} "
            f"vehicles, in turns without and with, {plan.pairs} pairs of {plan.pair_s:g} s, as fast as "
            "possible; medians. The sender is a program of the same machine, so its own processor time is "
            "included."
        )
        + "\n",
        checks=tuple(checks),
        tables=(
            ReportTable(
                caption="Real-time factors.",
                columns=("user", "without", "beside", "share", "datagrams/s"),
                rows=tuple(
                    (
                        name,
                        f"{pair.without:.2f}",
                        f"{pair.beside:.2f}",
                        f"{pair.share:.2f}",
                        f"{pair.sent_s:,.0f}",
                    )
                    for name, each in by_user.items()
                    for pair in each
                ),
            ),
        ),
    )
