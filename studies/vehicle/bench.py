"""Benchmark of one vehicle's step by part: the bytes of a recorded flight are replayed to a new vehicle.

The sequence is that of the vehicle's process: bytes in, a compiled fast step or else messages and a full
step, bytes out; without sockets, radio and log. The vehicle flies to its place autonomously, as in a swarm of
one, so no commands are needed: the same bytes reproduce the flight. No module below this one reads the clock.
"""

import gc
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import msgspec
import numpy as np
from msgspec import Struct

from autopilot.commander.commander import Commander
from autopilot.control.flight import FlightController
from autopilot.estimation.sensor_input import SensorInput
from autopilot.logs.ulog_file import FlightLog
from autopilot.mavlink.codec import Encoder
from autopilot.mavlink.hil import TO_VEHICLE, HilActuatorControls, HilEncoder, HilParser
from autopilot.onboard.app import OnboardApp
from autopilot.parameters.config import LoggingConfig, VehicleConfig
from autopilot.parameters.onboard_config import OnboardConfig
from autopilot.services.service import Services
from autopilot.services.streams import MessageStreams
from autopilot.vehicle.fast_step import FastSteps
from autopilot.vehicle.host import Host
from autopilot.vehicle.monitor import Monitor
from autopilot.vehicle.pilot import Pilot
from harness.world.wind import WindConfig
from studies.vehicle.solo import STEP_S, Solo

LIMIT_US = 60.0
"""Mean of a step, streams off, on an idle machine"""
CHILD_STEPS = 4_000
"""Steps of the slow replay without compiler; the mean has converged after them."""
_PARTS: tuple[tuple[str, type, tuple[str, ...]], ...] = (
    ("steps of an inertial sample", FastSteps, ("step",)),
    ("decode", HilParser, ("push",)),
    ("encode", Encoder, ("encode",)),
    ("encode", HilEncoder, ("encode",)),
    ("estimator, with its input", SensorInput, ("take",)),
    ("monitor and commander", Monitor, ("update",)),
    ("monitor and commander", Commander, ("update",)),
    ("on-board application", OnboardApp, ("on_timer", "on_mavlink", "on_radio")),
    ("setpoints and land detector", Pilot, ("update_land_state", "update")),
    ("control", FlightController, ("update",)),
    ("services", Services, ("on_timer", "on_message")),
    ("streams", MessageStreams, ("on_timer",)),
    ("ULog", FlightLog, ("on_step",)),
)
"""Part, class and methods; the time of a nested part is subtracted from the outer one."""
REST = "the step around them"


class Recording(Struct, frozen=True, kw_only=True):
    """A flight's bytes to the vehicle, step by step, and when it was armed."""

    stream: list[bytes]
    armed_from: int
    """First armed step; costs are measured from it on"""


class StepCost(Struct, frozen=True, kw_only=True):
    """Means over the steps, microseconds."""

    step_us: float
    """Processor time from bytes in to bytes out, without other processes on the machine"""
    floor_us: float
    """Decoding and encoding only"""
    parts_us: dict[str, float]
    """From an instrumented pass, scaled to ``step_us``"""
    longest_us: float
    """99 % quantile of the wall time"""


def record_flight(seconds: float) -> Recording:
    """Record a flight to a position 5 m above the start and its hold, in the article's wind."""
    with Solo(_config(), wind=WindConfig(), seed=np.random.SeedSequence(17), recording=False) as solo:
        solo.stream = []
        armed_from = None
        for step in range(round(seconds / STEP_S)):
            solo.step()
            if armed_from is None and solo.vehicle.commander.armed:
                armed_from = step
        if armed_from is None:
            raise RuntimeError(f"the vehicle did not arm within {seconds:g} s")
        return Recording(stream=solo.stream, armed_from=armed_from)


def measure(recording: Recording, *, streams: bool, repeats: int, ulog: bool = False) -> StepCost:
    """Replay the flight ``repeats`` times and return the fastest: other load only adds time."""
    step_us, longest_us = min(_play(recording, streams=streams, ulog=ulog) for _ in range(repeats))
    passes = [_play_by_part(recording, streams=streams, ulog=ulog) for _ in range(repeats)]
    parts_us = {part: min(spent_us[part] for spent_us in passes) for part in passes[0]}
    scale = step_us / sum(parts_us.values())
    return StepCost(
        step_us=step_us,
        floor_us=min(_play_floor(recording) for _ in range(repeats)),
        parts_us={part: scale * spent_us for part, spent_us in parts_us.items()},
        longest_us=longest_us,
    )


def measure_without_compiler(recording: Recording) -> StepCost:
    """Replay the first airborne steps in a child process with NUMBA_DISABLE_JIT=1, streams off."""
    short = Recording(
        stream=recording.stream[: recording.armed_from + CHILD_STEPS], armed_from=recording.armed_from
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.msgpack"
        path.write_bytes(msgspec.msgpack.encode(short))
        code = f"from studies.vehicle.bench import play_file; play_file({str(path)!r})"
        done = subprocess.run(
            [sys.executable, "-c", code], env=os.environ | {"NUMBA_DISABLE_JIT": "1"}, capture_output=True,
            check=True,
        )  # fmt: skip
    return msgspec.json.decode(done.stderr.splitlines()[-1], type=StepCost)


def play_file(path: str) -> None:
    """Run in the child: replay the recording in the file once; the last line on stderr is the cost."""
    recording = msgspec.msgpack.decode(Path(path).read_bytes(), type=Recording)
    sys.stderr.write(msgspec.json.encode(measure(recording, streams=False, repeats=1)).decode() + "\n")


class _Process:
    """The vehicle's process without its sockets: see ``autopilot.__main__``."""

    def __init__(self, *, streams: bool, log_folder: str | None) -> None:
        config = _config()
        if log_folder is not None:
            config = msgspec.structs.replace(
                config, params_path=f"{log_folder}/uav-0.params", logging=LoggingConfig(ulog=True)
            )
        self.host = Host(config, None)
        self._active = (streams, streams)
        self._link_encoder = Encoder(system=1, component=1)

    def step(self, data: bytes) -> None:
        host = self.host
        size = host.put(data)
        if host.inertial_step(size) is not None:
            return
        for messages in host.push(size):
            _, links = host.step(messages, link_messages=[], link_active=self._active)
            for _, message in links:
                self._link_encoder.encode(message)


@contextmanager
def _process(*, streams: bool, ulog: bool) -> Iterator[_Process]:
    """Yield a process, whose ULog is written to a folder that is deleted."""
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory()) if ulog else None
        process = _Process(streams=streams, log_folder=folder)
        stack.callback(process.host.close)
        yield process


def _play(recording: Recording, *, streams: bool, ulog: bool) -> tuple[float, float]:
    """Return mean processor time and 99 % quantile of the wall time of the steps since arming."""
    wall_us = []
    with _process(streams=streams, ulog=ulog) as process, _no_collection():
        for data in recording.stream[: recording.armed_from]:
            process.step(data)
        start_ns = time.thread_time_ns()
        for data in recording.stream[recording.armed_from :]:
            wall_ns = time.perf_counter_ns()
            process.step(data)
            wall_us.append(1e-3 * (time.perf_counter_ns() - wall_ns))
        spent_ns = time.thread_time_ns() - start_ns
    if not process.host.vehicle.commander.armed:
        raise RuntimeError("the replay did not reproduce the recorded flight: the vehicle is not armed")
    return 1e-3 * spent_ns / len(wall_us), float(np.quantile(wall_us, 0.99))


def _play_floor(recording: Recording) -> float:
    """Return the mean time to decode the input and encode a response, microseconds."""
    parser, encoder = HilParser(*TO_VEHICLE), HilEncoder(system=1, component=1)
    response = HilActuatorControls(1, [0.7] * 4 + [0.0] * 12, 129, 1)
    flown = recording.stream[recording.armed_from :]
    start_ns = time.thread_time_ns()
    for data in flown:
        parser.push(data)
        encoder.encode(response)
    return 1e-3 * (time.thread_time_ns() - start_ns) / len(flown)


def _play_by_part(recording: Recording, *, streams: bool, ulog: bool) -> dict[str, float]:
    """Return the mean time of every part, microseconds, from timers around its methods."""
    watch = _StopWatch()
    with _process(streams=streams, ulog=ulog) as process, ExitStack() as stack:
        for part, owner, names in _PARTS:
            for name in names:
                timed = watch.around(part, getattr(owner, name))
                stack.enter_context(mock.patch.object(owner, name, timed))
        step = watch.around(REST, process.step)
        stack.enter_context(_no_collection())
        for number, data in enumerate(recording.stream):
            if number == recording.armed_from:
                watch.spent_ns = dict.fromkeys(watch.spent_ns, 0)
            step(data)
    steps = len(recording.stream) - recording.armed_from
    return {part: 1e-3 * spent_ns / steps for part, spent_ns in watch.spent_ns.items()}


class _StopWatch:
    """Wall time by part, without the nested parts."""

    def __init__(self) -> None:
        self.spent_ns: dict[str, int] = {}
        self._within_ns = 0
        """Time in parts that the current part has called"""

    def around(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        self.spent_ns.setdefault(part, 0)

        def timed(*args: Any, **kwargs: Any) -> Any:  # noqa: ANN401  # any function
            outer_ns, self._within_ns = self._within_ns, 0
            wall_ns = time.perf_counter_ns()
            try:
                return function(*args, **kwargs)
            finally:
                whole_ns = time.perf_counter_ns() - wall_ns
                self.spent_ns[part] += whole_ns - self._within_ns
                self._within_ns = outer_ns + whole_ns

        return timed


@contextmanager
def _no_collection() -> Iterator[None]:
    """Freeze the existing objects as in the vehicle's process: garbage collection skips them in flight."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def _config() -> VehicleConfig:
    return VehicleConfig(
        run_id="bench", instance=0, seed=7, onboard=OnboardConfig(localisation="gps"),
        places_ned_m=((0.0, 0.0, -5.0),),
    )  # fmt: skip
