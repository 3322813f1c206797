"""Benchmark of the emulated radio: saturated stations, optionally against a peer program; a swarm's traffic.

No module below this one reads the clock. Wall time and processor time are measured; processor time is less
sensitive to other load on the machine.

A ratio of speeds belongs to the peer program. One whose senders offer more than the channel carries spends
most of its time on traffic that its queues drop; a lean one queues the next frame when one has ended. Such
a program is `studies/ns3/lean.cc`.
"""

import gc
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from unittest import mock

from msgspec import Struct

from harness.scenario.scenario import Scenario
from netsim.lab.saturation import WARM_UP_US, saturate
from netsim.model.event_queue import EventQueue
from netsim.wire.lockstep import pack_rows, unpack_rows
from netsim.wire.messages import RxBatch, TxBatch, decode, encode
from studies.radio.article_traffic import Step, advance, emulator_of, record
from studies.radio.saturation_section import MODES

PAYLOAD_BYTES = 1000
FASTER_LIMIT = 5.0
"""Smallest allowed ratio of speeds, emulator over peer, also over a lean one"""
REAL_TIME_LIMIT = 0.15
"""Largest allowed share of one core at real time, for the article's swarm"""


class RadioCost(Struct, frozen=True, kw_only=True):
    """Time spent on a simulated second, in seconds."""

    wall_s: float
    cpu_s: float


class SaturatedCost(Struct, frozen=True, kw_only=True):
    """Saturated stations: medians over the repetitions, per simulated second."""

    stations: int
    rate_mbps: int
    process: RadioCost
    """Complete process"""
    run: RadioCost
    """Without start-up and exit of the process"""
    peer: RadioCost | None
    """Complete process of the peer program"""
    faster_wall: float | None
    """Speed over the peer's speed, complete processes, wall time"""
    faster_cpu: float | None
    faster_run: float | None
    """The same without our start-up, processor time"""


class ArticleCost(Struct, frozen=True, kw_only=True):
    """A swarm's traffic in lockstep: medians over the repetitions, per simulated second."""

    stations: int
    emulator: RadioCost
    with_messages: RadioCost
    """Including decoding and encoding of the messages from and to other processes"""
    floor: RadioCost
    """Python's event queue only: as many events without effect; the channel's events are compiled"""
    events: float
    frames: float
    steps_run: float
    """Share of the steps in which the channel was not idle"""


def bench_saturated(
    *, stations: int, rate_mbps: int, seconds: float, peer: Sequence[str], peer_s: float, repeats: int
) -> SaturatedCost:
    """Run emulator and peer in turn.

    Raises subprocess.CalledProcessError or OSError if the peer fails.
    """
    command = [
        sys.executable, "-m", "coflight", "radio", "saturation", "--stations", str(stations),
        "--rate-mbps", str(rate_mbps), "--payload", str(PAYLOAD_BYTES), "--seconds", str(seconds), "--json",
    ]  # fmt: skip

    def run() -> None:
        saturate(
            stations=stations, rts=False, mode=MODES[rate_mbps], payload_bytes=PAYLOAD_BYTES, seconds=seconds
        )

    run()
    simulated_s = seconds + 1e-6 * WARM_UP_US
    processes, runs, peers = [], [], []
    for _ in range(repeats):
        processes.append(_process_cost(command, simulated_s))
        runs.append(_cost(run, simulated_s))
        if peer:
            peers.append(_process_cost(peer, peer_s))
    process, alone = _median(processes), _median(runs)
    other = _median(peers) if peers else None
    return SaturatedCost(
        stations=stations, rate_mbps=rate_mbps, process=process, run=alone, peer=other,
        faster_wall=other.wall_s / process.wall_s if other else None,
        faster_cpu=other.cpu_s / process.cpu_s if other else None,
        faster_run=other.cpu_s / alone.cpu_s if other else None,
    )  # fmt: skip


def bench_article(scenario: Scenario, *, seconds: float, repeats: int) -> ArticleCost:
    """Record a swarm's traffic once and replay it ``repeats`` times, each to a new emulator."""
    steps = record(scenario, seconds)
    with _scheduling() as intervals:
        frames, steps_run = play(scenario, steps)
    messages = _packed(steps)
    alone, with_messages, floors = [], [], []
    for _ in range(repeats):
        alone.append(_cost(lambda: play(scenario, steps), seconds))
        with_messages.append(_cost(lambda: _play_messages(scenario, messages), seconds))
        floors.append(_cost(lambda: _play_empty(intervals), seconds))
    return ArticleCost(
        stations=scenario.agents, emulator=_median(alone), with_messages=_median(with_messages),
        floor=_median(floors), events=sum(len(times_ns) for _, times_ns in intervals) / seconds,
        frames=frames / seconds, steps_run=steps_run / len(steps),
    )  # fmt: skip


def play(scenario: Scenario, steps: Sequence[Step]) -> tuple[int, int]:
    """Simulate recorded steps as the time master requests them; return frames sent and steps run.

    Idle steps are skipped: see `harness.simulator.emulator_client`.
    """
    emulator, run, frames = emulator_of(scenario), 0, 0
    for step in steps:
        if step.batches or emulator.next_event_us <= step.to_us:
            advance(emulator, step)
            frames += len(emulator.take_frames())
            emulator.take_sessions()
            run += 1
    return frames, run


class _Packed(Struct, frozen=True, kw_only=True):
    """A step as encoded messages."""

    at_us: int
    to_us: int
    batches: tuple[bytes, ...]
    motion: tuple[bytes, ...]


def _packed(steps: Sequence[Step]) -> list[_Packed]:
    return [
        _Packed(
            at_us=step.at_us,
            to_us=step.to_us,
            batches=tuple(map(encode, step.batches)),
            motion=tuple(map(pack_rows, step.motion)),
        )
        for step in steps
    ]


def _play_messages(scenario: Scenario, steps: Sequence[_Packed]) -> None:
    emulator, stations = emulator_of(scenario), scenario.agents
    for packed in steps:
        if not packed.batches and emulator.next_event_us > packed.to_us:
            continue
        batches = [decode(TxBatch, message) for message in packed.batches]
        pos_ned_m, vel_ned_m_s, q_ned_frd = (
            unpack_rows(rows, stations=stations, columns=columns)
            for rows, columns in zip(packed.motion, (3, 3, 4), strict=True)
        )
        if pos_ned_m is None or vel_ned_m_s is None or q_ned_frd is None:
            raise RuntimeError("messages that this benchmark encoded cannot be decoded")
        step = Step(
            at_us=packed.at_us,
            to_us=packed.to_us,
            batches=tuple(batch for batch in batches if batch is not None),
            motion=(pos_ned_m, vel_ned_m_s, q_ned_frd),
        )
        for station, items in advance(emulator, step).items():
            encode(RxBatch(station=station, release_us=packed.to_us, items=tuple(items)))
        emulator.take_frames()
        emulator.take_sessions()


_Intervals = list[tuple[int, list[int]]]
"""Runs of the event queue: (end, times of the events scheduled before and during it), nanoseconds."""


@contextmanager
def _scheduling() -> Iterator[_Intervals]:
    """Record the times of all events scheduled with event queues."""
    intervals: _Intervals = []
    times_ns: list[int] = []
    schedule, run_until = EventQueue.at, EventQueue.run_until

    def noted_at(queue: EventQueue, time_ns: int, *call: object) -> object:
        times_ns.append(time_ns)
        return schedule(queue, time_ns, *call)  # type: ignore[arg-type]  # any callback and its arguments

    def noted_run_until(queue: EventQueue, time_ns: int) -> None:
        run_until(queue, time_ns)
        intervals.append((time_ns, times_ns.copy()))
        times_ns.clear()

    with mock.patch.multiple(EventQueue, at=noted_at, run_until=noted_run_until):
        yield intervals


def _play_empty(intervals: _Intervals) -> None:
    """Schedule and run events without effect at the same times."""
    queue = EventQueue()
    for until_ns, times_ns in intervals:
        for time_ns in times_ns:
            queue.at(time_ns, _nothing, None)
        queue.run_until(until_ns)


def _nothing(_argument: None) -> None:
    pass


def _cost(work: Callable[[], object], simulated_s: float) -> RadioCost:
    """Return the cost of a call; older objects are frozen for garbage collection, as in the emulator."""
    gc.collect()
    gc.freeze()
    wall_s, cpu_s = time.perf_counter(), time.thread_time()
    work()
    spent = RadioCost(
        wall_s=(time.perf_counter() - wall_s) / simulated_s, cpu_s=(time.thread_time() - cpu_s) / simulated_s
    )
    gc.unfreeze()
    return spent


def _process_cost(command: Sequence[str], simulated_s: float) -> RadioCost:
    """Return the cost of a process and its children."""
    wall_s, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return RadioCost(wall_s=(time.perf_counter() - wall_s) / simulated_s, cpu_s=cpu_s / simulated_s)


def _median(costs: Sequence[RadioCost]) -> RadioCost:
    return RadioCost(
        wall_s=statistics.median(cost.wall_s for cost in costs),
        cpu_s=statistics.median(cost.cpu_s for cost in costs),
    )
