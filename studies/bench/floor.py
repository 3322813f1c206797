"""Minimal cost of a lockstep simulation with N processes in Python: ``python -m studies.bench.floor``.

N processes, forked from this one, decode every HIL_SENSOR, check its CRC and send HIL_ACTUATOR_CONTROLS. This
process steps N PyBullet bodies, reads them, encodes the sensors and receives the replies. Sockets, order of
sending and receiving, and scheduling are those of a flight; there is no estimator, control, sensor error,
wind, radio or log. This is the floor ``lockstep``; the floor ``echo`` exchanges bytes of the same lengths
without physics and codec.

The module uses wall clock, sockets and processes. It has few imports, so that its processes are small.
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

from studies.bench.bare_world import GRAVITY_M_S2, MASS_KG, BareWorld
from studies.bench.floor_job import FloorCost, FloorJob, FloorSpeed

STEP_US = 4_000
WARM_UP_STEPS = 50
SLICES = 5
"""Parts of a measurement; the median suppresses single disturbances."""
_HEADER = struct.Struct("<BBBBBBBHB")
_CRC = struct.Struct("<H")
_MAGIC = 0xFD
_SENSOR, _SENSOR_EXTRA = struct.Struct("<Q13fI"), 108
_SENSOR_KIND = 107
_REPLY, _REPLY_EXTRA = struct.Struct("<QQ16fB"), 47
_REPLY_KIND = 93
_FIELDS_UPDATED = 0x1FFF
_ARMED = 129
_LOCKSTEP = 1
_RECEIVE_BYTES = 4096


class LostError(Exception):
    """A bare process ended or sent an invalid reply; the text is one line."""


def frame(fields: struct.Struct, kind: int, extra: int, sequence: int, *values: float) -> bytes:
    """Return a MAVLink 2 frame with its trailing zeros, which the standard permits."""
    payload = fields.pack(*values)
    head = _HEADER.pack(_MAGIC, len(payload), 0, 0, sequence, 1, 1, kind & 0xFFFF, kind >> 16)
    checked = head[1:] + payload
    return head + payload + _CRC.pack(crc16.mcrf4xx(checked + bytes((extra,))))


def fields_of(data: bytes, fields: struct.Struct, kind: int, extra: int) -> tuple[float, ...] | None:
    """Unpack one frame of the given kind; None for any other data."""
    if len(data) != _HEADER.size + fields.size + _CRC.size or data[0] != _MAGIC:
        return None
    if int.from_bytes(data[7:10], "little") != kind:
        return None
    end = _HEADER.size + fields.size
    if crc16.mcrf4xx(data[1:end] + bytes((extra,))) != _CRC.unpack_from(data, end)[0]:
        return None
    return fields.unpack_from(data, _HEADER.size)


def reply(data: bytes, sequence: int) -> bytes:
    """Return a bare vehicle's motor controls for its sensors. Raises LostError for invalid sensors."""
    sensed = fields_of(data, _SENSOR, _SENSOR_KIND, _SENSOR_EXTRA)
    if sensed is None:
        raise LostError("no HIL_SENSOR")
    controls = (0.7, 0.7, 0.7, 0.7, *(0.0,) * 12)
    return frame(
        _REPLY, _REPLY_KIND, _REPLY_EXTRA, sequence, sensed[0], _LOCKSTEP, *controls, _ARMED
    )  # fmt: skip


def _reply_all(link: socket.socket) -> None:
    sequence = 0
    while data := link.recv(_RECEIVE_BYTES):
        link.sendall(reply(data, sequence))
        sequence = (sequence + 1) % 256


def _echo_all(link: socket.socket) -> None:
    data = bytes(_HEADER.size + _REPLY.size + _CRC.size)
    while link.recv(_RECEIVE_BYTES):
        link.sendall(data)


class Bare(NamedTuple):
    """Processes that only reply."""

    links: list[socket.socket]
    pids: list[int]


@contextlib.contextmanager
def bare_processes(agents: int, work: Callable[[socket.socket], None]) -> Iterator[Bare]:
    """Fork processes that each run ``work`` at one end of a TCP connection until it is closed.

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
                    _run(theirs, links, work)
                pids.append(pid)
                theirs.close()
        yield Bare(links, pids)
    finally:
        for link in links:
            link.close()
        for pid in pids:
            os.waitpid(pid, 0)


def _run(link: socket.socket, others: Sequence[socket.socket], work: Callable[[socket.socket], None]) -> None:
    """Run a bare process; never returns."""
    status = 1
    try:
        for other in others:  # otherwise the parent's close would not end the connections
            other.close()
        if sys.platform == "linux":  # as for vehicles
            with contextlib.suppress(OSError):
                os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
        with contextlib.suppress(OSError):
            work(link)
        status = 0
    finally:
        os._exit(status)


def _exchange(links: Sequence[socket.socket], frames: Sequence[bytes]) -> list[bytes]:
    """Send a frame on each link and wait for the replies, last link first, as in a flight."""
    for link, data in zip(links, frames, strict=True):
        link.sendall(data)
    replies = [link.recv(_RECEIVE_BYTES) for link in reversed(links)]
    if b"" in replies:
        raise LostError("a bare process has ended")
    return replies


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
            controls = fields_of(data, _REPLY, _REPLY_KIND, _REPLY_EXTRA)
            if controls is None or controls[0] != time_us:
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
    """Measure the speed of ``agents`` processes for ``wall_s``."""
    with bare_processes(agents, work) as bare:
        steps = make_steps(bare.links)
        for _ in range(WARM_UP_STEPS):
            next(steps)  # warm-up of sockets, caches and scheduler
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
    """Return another process's processor time with 1 ns resolution; its `times` have 10 ms. One thread."""
    return int(Path(f"/proc/{pid}/schedstat").read_text(encoding="ascii").split()[0]) * 1e-9


def measure(job: FloorJob) -> FloorCost:
    """Measure both floors, one after the other. Raises OSError or LostError."""
    gc.collect()
    gc.freeze()
    with BareWorld(job.agents, step_us=STEP_US) as world:
        lockstep = _speed(job.agents, _reply_all, lambda links: _lockstep_steps(links, world), job.wall_s)
    echo = _speed(job.agents, _echo_all, _echo_steps, job.wall_s)
    return FloorCost(agents=job.agents, lockstep=lockstep, echo=echo)


def main(arguments: Sequence[str]) -> int:
    """Measure the `FloorJob` in the argument (JSON); the last line on stdout is the cost."""
    try:
        cost = measure(msgspec.json.decode(arguments[0], type=FloorJob))
    except (OSError, LostError) as error:
        sys.stderr.write(f"floor: {error}\n")
        return 2
    sys.stdout.write(msgspec.json.encode(cost).decode() + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
