"""Layout of the tables: rows for compiled code, tables for Python, growth. 5 s."""

import numpy as np
import pytest
from netsim_air import Air
from numba import njit

from netsim.mac.jobs import JobOutcome
from netsim.model import codes as c
from netsim.model import tables as t
from netsim.model.event_queue import EventQueue
from netsim.model.events import drop_next, schedule

STATIONS, CATEGORIES = 5, 3
HEADER_WORDS = t.AIR.itemsize // 8
ACCESSORS = {
    "stations": t.station, "draws": t.draws, "queues": t.queue, "ends": t.end, "links": t.link,
    "budgets": t.budget, "modes": t.mode, "records": t.record, "events": t.event, "jobs": t.job,
    "calls": t.call, "arrivals": t.arrival, "ended_jobs": t.ended_job, "signals": t.signal,
    "overlaps": t.overlap, "on_air": t.on_air, "paths": t.path,
}  # fmt: skip


def numbered():
    """Return a block whose table entries are all different."""
    block = t.new_block(stations=STATIONS, categories=CATEGORIES)
    block[HEADER_WORDS:] = np.arange(HEADER_WORDS, len(block))
    return block


def test_every_table_has_an_accessor():
    assert ("air", *ACCESSORS) == t.Tables._fields


@pytest.mark.parametrize("name", [name for name in ACCESSORS if name != "draws"])
def test_compiled_code_and_python_access_the_same_rows(name):
    """Read and write the last single number of the last record; draws are vectors only."""
    block, record_of = numbered(), ACCESSORS[name]
    table = getattr(t.tables_of(block), name)
    field = next(n for n in reversed(table.dtype.names) if not table.dtype[n].shape)

    @njit
    def row(block, i, value):
        record = record_of(t.open_air(block), i)
        before = record[field]
        record[field] = value
        return before

    @njit
    def cell(block, i, k, value):
        record = record_of(t.open_air(block), i, k)
        before = record[field]
        record[field] = value
        return before

    last = tuple(length - 1 for length in table.shape)
    expected = table[field][last]
    assert (row if table.ndim == 1 else cell)(block, *last, 7) == expected
    assert table[field][last] == 7


def test_tables_are_contiguous_and_fill_the_block():
    block = numbered()
    lying = np.concatenate([table.reshape(-1).view(np.int64) for table in t.tables_of(block)])
    assert lying.tolist() == block.tolist()


def test_growing_keeps_all_table_entries():
    block = numbered()
    more = {"events": 500, "jobs": 40, "signals": 60}
    new = t.grown(block, **more)
    old_tables, new_tables = t.tables_of(block), t.tables_of(new)
    for name, before, after in zip(ACCESSORS, old_tables[1:], new_tables[1:], strict=True):
        kept = after[tuple(slice(length) for length in before.shape)].copy()
        if name == "signals":  # the last of the free rows is followed by the new ones
            kept["next_signal"] = before["next_signal"]
        assert kept.tobytes() == before.tobytes(), name
        assert len(after) >= more.get(name, 0)


@njit
def take(block):
    return t.take_signal(t.open_air(block))


@njit
def end(block, row):
    t.end_signal(t.open_air(block), row)


def test_rows_of_signals_are_reused_after_release():
    block = t.new_block(stations=STATIONS, categories=CATEGORIES)
    rows = len(t.tables_of(block).signals)
    taken = [take(block) for _ in range(rows)]
    assert sorted(taken) == list(range(rows))
    assert t.tables_of(block).air[0].free_signal == c.NOTHING
    block = t.grown(block, signals=rows + 2)
    tables = t.tables_of(block)
    assert sorted(take(block) for _ in range(2)) == [rows, rows + 1]
    # the second is among the first one's overlaps: its row is free when both are over
    first, second = taken[:2]
    tables.overlaps["signal"][first, 0] = second
    tables.signals["overlap_count"][first] = tables.signals["references"][second] = 1
    end(block, second)
    assert tables.air[0].free_signal == c.NOTHING
    end(block, first)
    assert {take(block), take(block)} == {first, second}


@njit
def order_of(block, times_ns):
    """Schedule events and return the times and orders of all, as they come."""
    air = t.open_air(block)
    for at_ns in times_ns:
        schedule(air, at_ns, c.DETECT, 0)
    order = []
    while air.events:
        order.append((t.event(air, 0).at_ns, t.event(air, 0).order))
        drop_next(air)
    return order


def test_events_are_ordered_by_time_and_then_by_scheduling():
    block = t.new_block(stations=STATIONS, categories=CATEGORIES)
    order = order_of(block, np.random.default_rng(1).integers(10, size=60))
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
    air = Air(40, access="edca")
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
    tables = air.radios.tables
    assert len(air.outcomes) == 1500
    assert (len(tables.jobs), len(tables.signals)) == (16, 20)
