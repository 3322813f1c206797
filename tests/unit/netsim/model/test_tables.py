"""Layout of the tables: rows for compiled code, tables for Python, growth. 5 s."""

import numpy as np
import pytest
from netsim_air import Air

from netsim.mac.access_parameters import EDCA
from netsim.mac.jobs import JobOutcome
from netsim.model import columns as c
from netsim.model import tables as t
from netsim.model.event_queue import EventQueue
from netsim.model.events import drop_next, schedule

STATIONS, CATEGORIES = 5, 3


def numbered():
    """Return a block whose table entries are all different."""
    air = t.new_air(stations=STATIONS, categories=CATEGORIES)
    air[c.NUMBERS :] = np.arange(c.NUMBERS, len(air))
    return air


@pytest.mark.parametrize("name", t.Tables._fields)
def test_compiled_code_and_python_access_the_same_rows(name):
    air = numbered()
    table = getattr(t.tables_of(air), name)
    for row in range(len(table)):
        assert getattr(t, name)(air, row).tobytes() == table[row].tobytes()


def test_tables_are_contiguous_and_fill_the_block():
    air = numbered()
    lying = np.concatenate([table.reshape(-1).view(np.int64) for table in t.tables_of(air)])
    assert lying.tolist() == air[c.NUMBERS :].tolist()


def test_growing_keeps_all_table_entries():
    air = numbered()
    more = {"events": 500, "jobs": 40, "signals": 60}
    new = t.grown(air, **more)
    for name, before, after in zip(t.Tables._fields, t.tables_of(air), t.tables_of(new), strict=True):
        kept = after[: before.shape[0], : before.shape[1]].copy()
        if name == "signals":  # the last of the free rows is followed by the new ones
            kept[:, c.NEXT_SIGNAL] = before[:, c.NEXT_SIGNAL]
        assert kept.tobytes() == before.tobytes(), name
        assert len(after) >= more.get(name, 0)


def test_rows_of_signals_are_reused_after_release():
    air = t.new_air(stations=STATIONS, categories=CATEGORIES)
    rows = int(air[c.SIGNAL_ROWS])
    taken = [t.take_signal(air) for _ in range(rows)]
    assert sorted(taken) == list(range(rows))
    assert air[c.FREE_SIGNAL] == c.NOTHING
    air = t.grown(air, signals=rows + 2)
    assert sorted(t.take_signal(air) for _ in range(2)) == [rows, rows + 1]
    # the second is among the first one's overlaps: its row is free when both are over
    first, second = taken[:2]
    t.overlaps(air, first)[0] = second
    t.signals(air, first)[c.OVERLAPS] = t.signals(air, second)[c.HOLDERS] = 1
    t.end_signal(air, second)
    assert air[c.FREE_SIGNAL] == c.NOTHING
    t.end_signal(air, first)
    assert {t.take_signal(air), t.take_signal(air)} == {first, second}


def test_events_are_ordered_by_time_and_then_by_scheduling():
    rng = np.random.default_rng(1)
    air = t.new_air(stations=STATIONS, categories=CATEGORIES)
    for at_ns in rng.integers(10, size=60).tolist():
        schedule(air, at_ns, c.DETECT, 0)
    order = []
    while air[c.EVENTS]:
        order.append((int(t.events(air, 0)[c.AT]), int(t.events(air, 0)[c.ORDER])))
        drop_next(air)
    assert order == sorted(order)
    assert len(order) == 60


def test_python_calls_and_table_events_have_one_order():
    """A call at the time of a frame's end runs before it or after it, as it was scheduled before or after."""
    air, seen = Air(2), []
    note = lambda _: seen.append(list(air.outcomes))  # noqa: E731
    air.queue.at(1_160_000, note, None)
    air.send(1000, 0)
    air.queue.at(1_050_000, lambda _: air.queue.at(1_160_000, note, None), None)
    air.run(2_000)
    assert seen == [[], [JobOutcome.SENT]]


def test_first_frame_has_room_for_any_number_of_stations():
    air = Air(40, access=EDCA)
    air.send(1000, 0, category="be")
    air.run(2_000)
    assert air.outcomes == [JobOutcome.SENT]


def test_queue_works_without_an_event_source():
    queue, ran = EventQueue(), []
    queue.at(5, ran.append, "five")
    queue.run_until(10)
    assert (ran, queue.now_ns, queue.machine) == (["five"], 10, None)


def test_thousands_of_frames_do_not_grow_the_tables():
    air = Air(4)
    for k in range(1500):
        air.send(1000 + 700 * k, k % 4, (k + 1) % 4 if k % 3 else -1)
    air.run(1_200_000)
    sizes = [int(air.radios.air[which]) for which in (c.JOB_ROWS, c.SIGNAL_ROWS)]
    assert len(air.outcomes) == 1500
    assert sizes == [16, 20]
