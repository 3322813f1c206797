"""Routes of all vehicles over time, from the output of `route_watch`; pure."""

from collections.abc import Callable, Collection, Mapping

import msgspec

Table = Mapping[int, int]
"""Next vehicle by destination"""
Tables = Mapping[int, Table]
"""By vehicle"""

_table = msgspec.json.Decoder(dict[int, int])


def changes(logs: Mapping[int, str]) -> list[tuple[float, int, Table]]:
    """Return the changes of the vehicles' tables in order of time: wall time, vehicle, table."""
    found: list[tuple[float, int, Table]] = []
    for uav, log in logs.items():
        for line in log.splitlines():
            wall_s, _, table = line.partition(" ")
            found.append((float(wall_s), uav, _table.decode(table)))
    return sorted(found, key=lambda each: each[0])


def first_s(logs: Mapping[int, str], condition: Callable[[Tables], bool], *, from_s: float) -> float | None:
    """Return the wall time from ``from_s`` on at which a condition holds first; None: at no time."""
    tables: dict[int, Table] = {}
    wall_s = from_s
    held = False
    for changed_s, uav, table in changes(logs):
        if changed_s > from_s and held:
            break
        tables[uav] = table
        wall_s = max(changed_s, from_s)
        held = condition(tables)
    return wall_s if held else None


def hops(tables: Tables, source: int, destination: int) -> int | None:
    """Return the number of transmissions from one vehicle to another; None: no route, or a loop."""
    at, count = source, 0
    while at != destination:
        following = tables.get(at, {}).get(destination)
        count += 1
        if following is None or count > len(tables):
            return None
        at = following
    return count


def all_connected(uavs: Collection[int]) -> Callable[[Tables], bool]:
    """Return the condition that each vehicle has a complete path to each other one."""
    return lambda tables: all(hops(tables, a, b) is not None for a in uavs for b in uavs if a != b)


def all_direct(uavs: Collection[int]) -> Callable[[Tables], bool]:
    """Return the condition that all paths have one hop."""
    return lambda tables: all(hops(tables, a, b) == 1 for a in uavs for b in uavs if a != b)


def none_between(uavs: Collection[int], others: Collection[int]) -> Callable[[Tables], bool]:
    """Return the condition that no vehicle has a route to one of ``others``, and the reverse."""
    return lambda tables: (
        not any(b in tables.get(a, {}) or a in tables.get(b, {}) for a in uavs for b in others)
    )
