"""Order and cancellation of scheduled calls, and independence of random streams."""

import numpy as np
import pytest

from netsim.model.event_queue import NEVER_NS, EventQueue
from netsim.model.random_streams import FloatStream, Model, RandomStreams


def test_calls_run_in_order_of_time_and_then_of_scheduling():
    queue, ran = EventQueue(), []
    for time_ns, name in ((20, "b"), (10, "a"), (20, "c"), (31, "late")):
        queue.at(time_ns, ran.append, name)
    queue.run_until(30)
    assert ran == ["a", "b", "c"]
    assert (queue.now_ns, queue.next_ns()) == (30, 31)


def test_a_call_may_schedule_another_at_the_same_instant():
    queue, ran = EventQueue(), []
    queue.at(10, lambda _: queue.at(10, ran.append, queue.now_ns), None)
    queue.run_until(10)
    assert ran == [10]


def test_cancelled_calls_neither_run_nor_count_as_next():
    queue, ran = EventQueue(), []
    event = queue.at(10, ran.append, "x")
    queue.cancel(event)
    queue.cancel(event)
    assert queue.next_ns() == NEVER_NS
    queue.run_until(20)
    assert not ran


def test_between_function_runs_before_each_call_and_changes_nothing():
    queue, ran = EventQueue(), []
    for time_ns in (10, 20, 20):
        queue.at(time_ns, ran.append, time_ns)
    queue.between = lambda: ran.append("between")
    queue.run_until(20)
    assert [each for each in ran if each != "between"] == [10, 20, 20]
    assert all(ran[i - 1] == "between" for i, each in enumerate(ran) if each != "between")
    queue.between, before = None, ran.count("between")
    queue.at(30, ran.append, 30)
    queue.run_until(30)
    assert ran.count("between") == before


def test_scheduling_in_the_past_is_rejected():
    queue = EventQueue()
    queue.run_until(10)
    with pytest.raises(ValueError, match="is 10 ns"):
        queue.at(9, print, None)


def test_streams_differ_by_model_and_link_and_not_by_order_of_use():
    streams = RandomStreams(np.random.SeedSequence(7))
    first = {
        key: streams.generator(*key).random()
        for key in ((Model.FADING, 0, 1), (Model.FADING, 1, 0), (Model.HOST, 0))
    }
    again = {
        key: RandomStreams(np.random.SeedSequence(7)).generator(*key).random() for key in reversed(first)
    }
    assert first == again
    assert len(set(first.values())) == 3


def test_uniforms_match_the_generator():
    uniforms = FloatStream(np.random.default_rng(3).random)
    expected = np.random.default_rng(3).random(2 * FloatStream.BLOCK).tolist()
    assert [uniforms.draw() for _ in expected] == expected


def test_normals_match_the_generator():
    normals = FloatStream(np.random.default_rng(3).standard_normal)
    single = np.random.default_rng(3)
    expected = [float(single.standard_normal()) for _ in range(2 * FloatStream.BLOCK)]
    assert [normals.draw() for _ in expected] == expected
