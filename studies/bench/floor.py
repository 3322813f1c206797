"""The least that a lockstep simulation of N processes in Python can cost: ``python -m studies.bench.floor``.

N processes, forked from this one, decode every HIL_SENSOR, check its CRC and answer HIL_ACTUATOR_CONTROLS.
This process steps N PyBullet bodies, reads them, packs the sensors and takes the answers. Sockets, order of
sending and receiving, and scheduling are those of a flight; estimator, control, sensors' errors, wind, radio
and logs are not there. Two floors: ``lockstep`` is that, and in ``echo`` bytes of the same lengths go to and
fro with no physics and no codec.

Wall clock, sockets and processes: an edge. It imports no more than it needs: its processes are to be bare.
"""

import contextlib
import gc
import os
import socket
import statistics
import struct
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
from fastcrc import crc16

from harness.world.physics.bare import GRAVITY_M_S2, MASS_KG, BareWorld
from studies.bench.floor_job import FloorCost, FloorJob, FloorSpeed

STEP_US = 4_000
WARM_UP_STEPS = 50
SLICES = 5
"""Parts of a measurement, of which the median counts: a hiccup of the machine spoils one."""
_HEADER = struct.Struct("<BBBBBBBHB")
_CRC = struct.Struct("<H")
_MAGIC = 0xFD
_SENSOR, _SENSOR_EXTRA = struct.Struct("<Q13fI"), 108
_SENSOR_KIND = 107
_ANSWER, _ANSWER_EXTRA = struct.Struct("<QQ16fB"), 47
_ANSWER_KIND = 93
_FIELDS_UPDATED = 0x1FFF
_ARMED = 129
_LOCKSTEP = 1
_RECEIVE_BYTES = 4096


class LostError(Exception):
    """A bare process ended or answered nonsense; the text is one line."""


def frame(fields: struct.Struct, kind: int, extra: int, sequence: int, *values: float) -> bytes:
    """Make a MAVLink 2 frame; trailing zeros are left in, which the standard allows a receiver to take."""
    payload = fields.pack(*values)
    head = _HEADER.pack(_MAGIC, len(payload), 0, 0, sequence, 1, 1, kind & 0xFFFF, kind >> 16)
    checked = head[1:] + payload
    return head + payload + _CRC.pack(crc16.mcrf4xx(checked + bytes((extra,))))


def fields_of(data: bytes, fields: struct.Struct, kind: int, extra: int) -> tuple[float, ...] | None:
    """Unpack one frame of that kind; None if it is anything else."""
    if len(data) != _HEADER.size + fields.size + _CRC.size or data[0] != _MAGIC:
        return None
    if int.from_bytes(data[7:10], "little") != kind:
        return None
    end = _HEADER.size + fields.size
    if crc16.mcrf4xx(data[1:end] + bytes((extra,))) != _CRC.unpack_from(data, end)[0]:
        return None
    return fields.unpack_from(data, _HEADER.size)


def answer(data: bytes, sequence: int) -> bytes:
    """What a bare vehicle says to its sensors: motors that hold it up. Raises LostError for what are none."""
    sensed = fields_of(data, _SENSOR, _SENSOR_KIND, _SENSOR_EXTRA)
    if sensed is None:
        raise LostError("no HIL_SENSOR")
    controls = (0.7, 0.7, 0.7, 0.7, *(0.0,) * 12)
    return frame(
        _ANSWER, _ANSWER_KIND, _ANSWER_EXTRA, sequence, sensed[0], _LOCKSTEP, *controls, _ARMED
    )  # fmt: skip


def _answer_all(link: socket.socket) -> None:
    sequence = 0
    while data := link.recv(_RECEIVE_BYTES):
        link.sendall(answer(data, sequence))
        sequence = (sequence + 1) % 256


def _echo_all(link: socket.socket) -> None:
    reply = bytes(_HEADER.size + _ANSWER.size + _CRC.size)
    while link.recv(_RECEIVE_BYTES):
        link.sendall(reply)


class Bare(NamedTuple):
    """Processes that do nothing but answer."""

    links: list[socket.socket]
    pids: list[int]


@contextlib.contextmanager
def bare_processes(agents: int, work: Callable[[socket.socket], None]) -> Iterator[Bare]:
    """Fork so many processes, each of which does its work at its end of a TCP connection until it is closed.

    Raises OSError.
    """
    links: list[socket.socket] = []
    pids: list[int] = []
    try:
        with socket.create_server(("127.0.0.1", 0), backlog=agents) as listener:
            for _ in range(agents):
                theirs = socket.create_connection(listener.getsockname())
                ours, _ = listener.accept()
                links.append(ours)
                for end in (ours, theirs):
                    end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                pid = os.fork()
                if pid == 0:
                    _live(theirs, links, work)
                pids.append(pid)
                theirs.close()
        yield Bare(links, pids)
    finally:
        for link in links:
            link.close()
        for pid in pids:
            os.waitpid(pid, 0)


def _live(
    link: socket.socket, others: Sequence[socket.socket], work: Callable[[socket.socket], None]
) -> None:
    """Be a bare process; never returns."""
    status = 1
    try:
        for other in others:  # or nobody would notice when the parent closes them
            other.close()
        if sys.platform == "linux":  # as vehicles are
            with contextlib.suppress(OSError):
                os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
        with contextlib.suppress(OSError):
            work(link)
        status = 0
    finally:
        os._exit(status)


def _exchange(links: Sequence[socket.socket], frames: Sequence[bytes]) -> list[bytes]:
    """Send everybody a frame and wait for the answers, the last first, as a flight does."""
    for link, data in zip(links, frames, strict=True):
        link.sendall(data)
    answers = [link.recv(_RECEIVE_BYTES) for link in reversed(links)]
    if b"" in answers:
        raise LostError("a bare process has ended")
    return answers


def _lockstep_steps(links: Sequence[socket.socket], world: BareWorld) -> Iterator[None]:
    lifts_n = [1.01 * MASS_KG * GRAVITY_M_S2] * len(links)
    time_us = sequence = 0
    while True:
        time_us += STEP_US
        sequence = (sequence + 1) % 256
        frames = [
            frame(
                _SENSOR, _SENSOR_KIND, _SENSOR_EXTRA, sequence,
                time_us, 0.0, 0.0, -GRAVITY_M_S2, *turning, *position, *velocity, 1.0, _FIELDS_UPDATED,
            )
            for (position, _), (velocity, turning) in world.step(lifts_n)
        ]  # fmt: skip
        for data in _exchange(links, frames):
            told = fields_of(data, _ANSWER, _ANSWER_KIND, _ANSWER_EXTRA)
            if told is None or told[0] != time_us:
                raise LostError("no HIL_ACTUATOR_CONTROLS of this step")
        yield


def _echo_steps(links: Sequence[socket.socket]) -> Iterator[None]:
    sensors = [bytes(_HEADER.size + _SENSOR.size + _CRC.size)] * len(links)
    while True:
        _exchange(links, sensors)
        yield


def _speed(
    agents: int,
    work: Callable[[socket.socket], None],
    make_steps: Callable[[Sequence[socket.socket]], Iterator[None]],
    wall_s: float,
) -> FloorSpeed:
    """Step so many for so long."""
    with bare_processes(agents, work) as bare:
        steps = make_steps(bare.links)
        for _ in range(WARM_UP_STEPS):
            next(steps)  # sockets, caches and the scheduler find their ways
        own_s, theirs_s = time.process_time(), sum(map(_cpu_s, bare.pids))
        counts, factors = [], []
        for _ in range(SLICES):
            begin_s, count = time.perf_counter(), 0
            while time.perf_counter() - begin_s < wall_s / SLICES:
                next(steps)
                count += 1
            factors.append(count * STEP_US * 1e-6 / (time.perf_counter() - begin_s))
            counts.append(count)
        simulated_s = sum(counts) * STEP_US * 1e-6
        return FloorSpeed(
            real_time_factor=statistics.median(factors),
            server_cpu_s_per_simulated_s=(time.process_time() - own_s) / simulated_s,
            vehicles_cpu_s_per_simulated_s=(sum(map(_cpu_s, bare.pids)) - theirs_s) / simulated_s,
        )


def _cpu_s(pid: int) -> float:
    """Processor time of another process of one thread, to the nanosecond: its `times` count in hundredths."""
    return int(Path(f"/proc/{pid}/schedstat").read_text(encoding="ascii").split()[0]) * 1e-9


def measure(job: FloorJob) -> FloorCost:
    """Measure both floors, one after the other. Raises OSError or LostError."""
    gc.collect()
    gc.freeze()
    with BareWorld(job.agents, step_us=STEP_US) as world:
        lockstep = _speed(job.agents, _answer_all, lambda links: _lockstep_steps(links, world), job.wall_s)
    echo = _speed(job.agents, _echo_all, _echo_steps, job.wall_s)
    return FloorCost(agents=job.agents, lockstep=lockstep, echo=echo)


def main(arguments: Sequence[str]) -> int:
    """Measure what the one argument, a `FloorJob` in JSON, says; the cost is the last line on stdout."""
    try:
        cost = measure(msgspec.json.decode(arguments[0], type=FloorJob))
    except (OSError, LostError) as error:
        sys.stderr.write(f"floor: {error}\n")
        return 2
    sys.stdout.write(msgspec.json.encode(cost).decode() + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
