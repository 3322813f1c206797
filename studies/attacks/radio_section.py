"""Attacks on the radio: other users, the own user without a password, and a guest that forges and floods."""

from collections.abc import Sequence
from functools import partial

from harness.launch.swarm import Swarm
from netsim.transport.guest_access import read_guest_access
from studies.attacks.comparison import AGENTS, COLUMNS, Attack, Comparison, checks, compare, row
from studies.attacks.launch import can_be_another
from studies.attacks.plan import AttacksPlan
from studies.attacks.tasks import (
    AlteredConnections,
    BatchFlood,
    ForgedBatches,
    KeyExpressions,
    Login,
    RefusedLogins,
    Task,
)
from studies.common.report import ReportTable, Section, filled
from studies.common.runner import Job, Results

_GROUP = "radio"
GUEST = "attacker"
STATION = AGENTS
"""The guest's: after the vehicles."""
_GUESTS = f"radio.guests=[{{name='{GUEST}', pos_ned_m=[0.0, -20.0, -1.5]}}]"
LINKS = ("unix", "tcp")
REFUSED_LIMIT_S = 0.5


def jobs(plan: AttacksPlan) -> dict[str, list[Job]]:
    """Return the comparisons, the longest first."""
    comparisons = [
        partial(fly, plan, "guest: flood", "unix"),
        *(partial(fly, plan, "guest: names", link) for link in LINKS),
        *(partial(fly, plan, "guest: altered bytes", link) for link in LINKS),
        *(partial(fly, plan, "guest: forged batches", link) for link in LINKS),
        *(partial(fly, plan, "own user, no password", link) for link in LINKS),
    ]
    if can_be_another():
        comparisons += [partial(fly, plan, "another user", link) for link in LINKS]
    return {_GROUP: comparisons}


def fly(plan: AttacksPlan, kind: str, link: str) -> Comparison:
    """Attack the radio in one way. Raises SwarmError, AttackError."""

    def prepare(swarm: Swarm) -> list[Attack]:
        return [
            Attack(task=each, is_other=kind == "another user")
            for each in _tasks(plan, kind, guest_login(swarm))
        ]

    return compare(
        f"{kind}, {link}",
        prepare,
        overrides=[f"ports.radio_link={link}", _GUESTS],
        least_s=plan.least_s,
        may_influence=kind in ("guest: flood", "guest: altered bytes"),
    )


def guest_login(swarm: Swarm) -> Login:
    """Return the login of the run's guest. Raises TransportError."""
    access = read_guest_access(swarm.path)
    login = access.guests[GUEST]
    return Login(endpoint=access.endpoint, run_id=access.run_id, user=login.user, password=login.password)


def without_password(login: Login) -> list[Login]:
    """Return logins for the same radio that it has to refuse."""
    users = [
        (login.user, ""),
        (login.user, "1234"),
        ("vehicles", "1234"),
        ("vehicles", ""),
        ("root", "1"),
        ("", ""),
    ]
    return [
        Login(endpoint=login.endpoint, run_id=login.run_id, user=user, password=password)
        for user, password in users
    ]


def _tasks(plan: AttacksPlan, kind: str, login: Login) -> Sequence[Task]:
    altered = partial(AlteredConnections, station=STATION, connections=plan.altered_connections, seed=3)
    match kind:
        case "guest: flood":
            return [BatchFlood(login=login, station=STATION, count=plan.flood_messages)]
        case "guest: names":
            return [KeyExpressions(login=login, count=plan.key_expressions)]
        case "guest: altered bytes":
            return [altered(login=login)]
        case "guest: forged batches":
            return [
                ForgedBatches(login=login, stations=AGENTS + 1, station=STATION, count=plan.forged_batches)
            ]
        case _:
            wrong = without_password(login)
            return [RefusedLogins(logins=wrong, limit_s=REFUSED_LIMIT_S), altered(login=wrong[2])]


def judge(plan: AttacksPlan, results: Results) -> Section:
    """Require that only a guest's own batches have an effect, which the manifest names."""
    comparisons: list[Comparison] = results[_GROUP]
    return Section(
        title="The radio",
        conditions=filled(
            f"A guest with its password forges {plan.forged_batches:,} batches as other stations and to "
            f"them, sends {plan.flood_messages:,} of its own as fast as it can, declares "
            f"{plan.key_expressions:,} names at the router, and opens {plan.altered_connections} "
            "connections through a relay that alters bytes. "
            "Another user, and the own user without a password, try wrong passwords and as "
            "many altered connections. Only the flood and the altered connections of the guest may "
            "change the flight."
        )
        + "\n",
        checks=tuple(check for comparison in comparisons for check in checks(comparison)),
        tables=(ReportTable(caption="Attacks.", columns=COLUMNS, rows=tuple(map(row, comparisons))),),
    )
