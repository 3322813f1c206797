"""Users of a Zenoh router, and the rules by which it accepts their messages.

Pure: `netsim.transport.zenoh_session` passes the results to Zenoh. A rule allows a message if its key
expression includes the message's: ``**`` of a client does not match a rule for one key. All else is denied.
Zenoh computes the permissions of a declared key once, not for each message.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple


class User(NamedTuple):
    """What a client presents to the router."""

    name: str
    """Without a colon."""
    password: str


class Rights(NamedTuple):
    """What a user may do, by key expressions."""

    user: User
    shares: tuple[str, ...] = ()
    """Keys at which it may publish, subscribe, query and reply."""
    asks: tuple[str, ...] = ()
    """Keys that it may query."""
    served: tuple[str, ...] = ()
    """Key expressions at which the router serves them: without their declarations a client sends none."""
    serves: tuple[str, ...] = ()
    """Keys at which it may reply to queries."""
    publishes: tuple[str, ...] = ()
    """Keys at which it may publish to the router's subscribers."""
    subscribes: tuple[str, ...] = ()
    """Keys at which it may receive what the router publishes."""


_SHARED = ("put", "declare_subscriber", "query", "declare_queryable", "reply")
_SERVED = ("declare_queryable", "reply")


def dictionary(rights: Sequence[Rights]) -> str:
    """Return the users as the lines of Zenoh's dictionary file."""
    return "".join(f"{each.user.name}:{each.user.password}\n" for each in rights)


def access_control(rights: Sequence[Rights]) -> dict[str, Any]:
    """Return the value of ``access_control`` in Zenoh's settings."""
    by_user = {each.user.name: list(_rules(each)) for each in rights}
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule for rules in by_user.values() for rule in rules],
        "subjects": [{"id": name, "usernames": [name]} for name in by_user],
        "policies": [
            {"subjects": [name], "rules": [rule["id"] for rule in rules]}
            for name, rules in by_user.items()
            if rules
        ],
    }


def _rules(rights: Rights) -> Iterator[dict[str, Any]]:
    """Yield the rules of one user; ingress is from the client to the router."""
    for flow, messages, keys in (
        ("ingress", _SHARED, rights.shares),
        ("egress", _SHARED, rights.shares),
        ("ingress", ("query",), rights.asks),
        ("egress", ("reply",), rights.asks),
        ("egress", ("declare_queryable",), rights.served),
        ("ingress", _SERVED, rights.serves),
        ("egress", ("query",), rights.serves),
        ("ingress", ("put",), rights.publishes),
        # without the subscriber's declaration a client sends nothing
        ("egress", ("declare_subscriber",), rights.publishes),
        ("ingress", ("declare_subscriber",), rights.subscribes),
        ("egress", ("put",), rights.subscribes),
    ):
        if keys:
            yield {
                "id": f"{rights.user.name} {flow} {messages[0]}",
                "messages": list(messages),
                "flows": [flow],
                "permission": "allow",
                "key_exprs": list(keys),
            }
