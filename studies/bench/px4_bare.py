"""Cost of N PX4s with a bare lockstep simulator: ``python -m studies.bench.px4_bare``.

It is the least that any simulator of PX4s does: it sends each of them HIL_SENSOR of a level vehicle, HIL_GPS
five times a second, and waits for all answers. There is no world, wind, radio, application or log. The PX4s
either stand disarmed, or hold a height in offboard mode: then the mean of the motor controls moves the
vehicle, which stays level, along the vertical, and setpoints are sent at 25 Hz, by a companion that reads
nothing. In flight a PX4 controls, and so costs more than at rest.

The PX4s have the command, parameters and ports of a swarm of the same scenario.
"""

import contextlib
import gc
import json
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from socket import AF_INET, SOCK_DGRAM, socket

import msgspec
import numpy as np
import psutil
from pymavlink.dialects.v20 import common

from autopilot.estimation.atmosphere import pressure_pa
from autopilot.estimation.sensor_input import BARO_FIELDS, IMU_FIELDS, MAG_FIELDS
from autopilot.mavlink.codec import Message
from autopilot.mavlink.components import APPLICATION_COMPONENT, AUTOPILOT_COMPONENT
from autopilot.mavlink.hil_schema import HIL_GPS, HIL_SENSOR
from autopilot.mavlink.local_messages import PositionTarget
from autopilot.mavlink.telemetry import CompanionEncoder
from autopilot.onboard.client.autopilots import PX4 as PX4_INTERFACE
from autopilot.onboard.client.commands import ARM
from foundation.processes.child_protocol import Stop
from foundation.types import Array
from harness.launch import ports, px4, px4_instances
from harness.launch.external_process import AutopilotError
from harness.launch.process_commands import python_module
from harness.launch.resources import ResourceError
from harness.scenario.scenario import Scenario, ScenarioError
from harness.scenario.scenario_file import load
from harness.simulator.hil import fill_sensors
from harness.simulator.hil_frames import encode_rows
from harness.simulator.lockstep import PX4, Lockstep
from harness.simulator.response_watchdog import ResponseWatchdog
from harness.simulator.slot_guard import SlotGuard
from studies.bench.px4_job import BareCost, BareJob

STEP_US = 4_000
SLOW_SENSORS_STEPS, GPS_STEPS, SETPOINT_STEPS, COMMAND_STEPS = 5, 50, 10, 250
"""Periods in steps: magnetometer and barometer 50 Hz, fixes 5 Hz, setpoints 25 Hz, commands 1 Hz."""
OFFBOARD_S, SETTLED_S = 12.0, 25.0
"""Simulated time from which setpoints are sent, and from which costs are measured."""
HEIGHT_M, LEAST_HEIGHT_M = 3.0, 1.0
GRAVITY_M_S2 = 9.8066
HOVER_CONTROL = 0.5
"""Motor control that carries the weight; PX4's default of MPC_THR_HOVER."""
NOISES = 251
"""Number of noise samples that are repeated: PX4 rejects sensors that do not change at all."""
_ACCEL_NOISE_M_S2, _GYRO_NOISE_RAD_S, _PRESSURE_NOISE_HPA = 0.1, 0.01, 0.01
_MAG_GAUSS = (0.215, 0.01, 0.42)
_POSITION_ONLY = 0b1101_1111_1000
"""Type mask of a setpoint with a position."""
_CONNECT_LIMIT_S = 60.0
END_LIMIT_S = 15.0
"""Wall time in which a PX4 ends after its wrapper was asked to end it."""
_SILENCE_LIMIT_S = 60.0


class BareError(Exception):
    """The PX4s do not start or fly; the text is one line."""


class BareVehicles:
    """N level vehicles that move along the vertical only, and the frames of their sensors.

    Attributes:
        height_m: (n,) above the ground.

    """

    def __init__(self, scenario: Scenario, rng: np.random.Generator) -> None:
        n = scenario.agents
        self.height_m = np.zeros(n)
        self._climb_m_s = np.zeros(n)
        self._felt_m_s2 = np.full(n, GRAVITY_M_S2)
        """(n,) specific force upwards."""
        self._site, self._epoch_us = scenario.site, scenario.run.epoch_unix_us
        self._accels = rng.normal(0.0, _ACCEL_NOISE_M_S2, (NOISES, n, 3))
        self._gyros = rng.normal(0.0, _GYRO_NOISE_RAD_S, (NOISES, n, 3))
        self._pressures_hpa = rng.normal(0.0, _PRESSURE_NOISE_HPA, (NOISES, n))
        self._mag_gauss = np.tile(_MAG_GAUSS, (n, 1))

    def advance(self, controls: Array) -> None:
        """Move by one step with the motor controls (n, 4), 0..1."""
        dt_s = STEP_US * 1e-6
        thrust_m_s2 = GRAVITY_M_S2 / HOVER_CONTROL * controls.mean(axis=1)
        self._climb_m_s += dt_s * (thrust_m_s2 - GRAVITY_M_S2)
        self.height_m += dt_s * self._climb_m_s
        stands = self.height_m <= 0.0
        self.height_m[stands] = self._climb_m_s[stands] = 0.0
        self._felt_m_s2 = np.where(stands, GRAVITY_M_S2, thrust_m_s2)

    def frames(self, step: int) -> list[bytes]:
        """Return the frames to each vehicle in a step."""
        n, k = len(self.height_m), step % NOISES
        rows = np.zeros(n, HIL_SENSOR.dtype)
        fields, pressure_hpa = IMU_FIELDS, np.zeros(n)
        if step % SLOW_SENSORS_STEPS == 0:
            fields |= MAG_FIELDS | BARO_FIELDS
            pascals = [pressure_pa(self._site.altitude_m + height_m) for height_m in self.height_m.tolist()]
            pressure_hpa = np.array(pascals) * 1e-2 + self._pressures_hpa[k]
        accel_frd_m_s2 = self._accels[k].copy()
        accel_frd_m_s2[:, 2] -= self._felt_m_s2
        fill_sensors(
            rows, step * STEP_US, fields, accel_frd_m_s2, self._gyros[k], self._mag_gauss, pressure_hpa,
            np.full(n, 20.0),
        )  # fmt: skip
        sensors = encode_rows(HIL_SENSOR, rows, step % 256)
        if step % GPS_STEPS:
            return sensors
        fixes = encode_rows(HIL_GPS, self._fixes(step * STEP_US), step % 256)
        return [fix + sensor for fix, sensor in zip(fixes, sensors, strict=True)]

    def _fixes(self, time_us: int) -> np.ndarray[tuple[int], np.dtype[np.void]]:
        rows = np.zeros(len(self.height_m), HIL_GPS.dtype)
        rows["time_usec"] = self._epoch_us + time_us
        rows["fix_type"], rows["satellites_visible"] = common.GPS_FIX_TYPE_3D_FIX, 10
        rows["lat"] = round(self._site.latitude_deg * 1e7)
        rows["lon"] = round(self._site.longitude_deg * 1e7)
        rows["alt"] = np.rint((self._site.altitude_m + self.height_m) * 1e3)
        rows["eph"] = rows["epv"] = 100
        rows["vd"] = np.rint(-self._climb_m_s * 100)
        rows["cog"] = 65_535
        return rows


class BareCompanion:
    """Sends one PX4 a setpoint `HEIGHT_M` above its start, and commands until it has armed."""

    def __init__(self, scenario: Scenario, instance: int) -> None:
        addresses = scenario.vehicle_ports(instance)
        self._socket = socket(AF_INET, SOCK_DGRAM)
        self._socket.bind((addresses.host, addresses.companion_remote_udp))
        self._peer = (addresses.host, addresses.companion_local_udp)
        self._system = instance + 1
        self._encoder = CompanionEncoder(system=self._system, component=APPLICATION_COMPONENT)

    def send(self, step: int, *, armed: bool) -> None:
        """Send what is due in a step that is a multiple of `SETPOINT_STEPS`."""
        messages: list[Message | PositionTarget] = [
            PositionTarget(
                step * STEP_US // 1_000, self._system, AUTOPILOT_COMPONENT, common.MAV_FRAME_LOCAL_NED,
                _POSITION_ONLY, 0.0, 0.0, -HEIGHT_M, 0.0, 0.0, 0.0,
            )
        ]  # fmt: skip
        if not armed and step % COMMAND_STEPS == 0:
            messages += (
                common.MAVLink_command_long_message(
                    self._system, AUTOPILOT_COMPONENT, command.number, 0, *command.params
                )
                for command in (PX4_INTERFACE.follow, ARM)
            )
        with contextlib.suppress(ConnectionRefusedError):  # PX4 does not listen yet
            self._socket.sendto(b"".join(map(self._encoder.encode, messages)), self._peer)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class BareSimulator:
    """The PX4s in lockstep with `BareVehicles`."""

    def __init__(self, scenario: Scenario, lockstep: Lockstep, companions: Sequence[BareCompanion]) -> None:
        self.vehicles = BareVehicles(scenario, np.random.default_rng(scenario.run.seed))
        self.step = 0
        """Number of the last step."""
        self._lockstep = lockstep
        self._companions = companions

    def run(self, until_s: float) -> None:
        """Step until a simulated time. Raises BareError if a PX4 is lost."""
        first_step = OFFBOARD_S / (STEP_US * 1e-6)
        while self.step * STEP_US < until_s * 1e6:
            self.step += 1
            self._lockstep.send(self.vehicles.frames(self.step))
            inbox = self._lockstep.receive(self.step * STEP_US)
            if self._companions and self.step >= first_step:
                self.vehicles.advance(inbox.controls)
                if self.step % SETPOINT_STEPS == 0:
                    for companion, armed in zip(self._companions, inbox.armed.tolist(), strict=True):
                        companion.send(self.step, armed=armed)


@contextlib.contextmanager
def _px4s(scenario: Scenario, job: BareJob, simulator_ports: Sequence[int]) -> Iterator[list[int]]:
    """Start the PX4s, each with a wrapper that ends it with this process; yield their process ids."""
    with contextlib.ExitStack() as stack:
        wrappers = []
        for i in range(scenario.agents):
            config = px4.process_config(
                scenario, i, run_folder=Path(job.folder), simulator_port=simulator_ports[i]
            )
            path = Path(job.folder, f"px4-{i}.json")
            path.write_bytes(msgspec.json.encode(msgspec.structs.replace(config, yields=job.yields)))
            console = stack.enter_context(Path(job.folder, f"px4-{i}.log").open("wb"))
            command = python_module("harness.launch.external_process", "--config", str(path))
            wrapper = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=console)
            wrappers.append(stack.enter_context(wrapper))
            stack.callback(_request_end, wrapper)
        yield [json.loads(_first_line(wrapper))["pid"] for wrapper in wrappers]


def _request_end(wrapper: "subprocess.Popen[bytes]") -> None:
    """End a PX4 and its wrapper, and wait for it; at the end of its stdin a wrapper would not wait."""
    if wrapper.stdin is not None:
        with contextlib.suppress(BrokenPipeError):
            wrapper.stdin.write(msgspec.json.encode(Stop()) + b"\n")
            wrapper.stdin.flush()
    try:
        wrapper.wait(END_LIMIT_S)
    except subprocess.TimeoutExpired:
        wrapper.kill()


def _first_line(wrapper: "subprocess.Popen[bytes]") -> bytes:
    line = wrapper.stdout.readline() if wrapper.stdout is not None else b""
    if not line:
        raise BareError("a PX4 could not be started")
    return line


def measure(job: BareJob) -> BareCost:
    """Measure. Raises ScenarioError, AutopilotError, ResourceError, OSError or BareError."""
    scenario = load(Path(job.scenario), [f"agents={job.agents}", *job.settings])
    px4.check_start(scenario)
    scenario, listeners, *_ = ports.claim(scenario, search=True)
    numbers = px4.numbers(scenario)

    def on_lost(instance: int, reason: str) -> None:
        raise BareError(f"uav {instance} was lost: {reason}")

    with contextlib.ExitStack() as stack:
        stack.callback(px4_instances.remove_files, numbers)
        for listener in listeners.values():
            stack.callback(listener.close)
        simulator_ports = [listener.getsockname()[1] for listener in listeners.values()]
        companions = [
            stack.enter_context(contextlib.closing(BareCompanion(scenario, i)))
            for i in range(scenario.agents if job.flies else 0)
        ]
        pids, guard = stack.enter_context(_px4s(scenario, job, simulator_ports)), SlotGuard()
        for i, pid in enumerate(pids):
            guard.set_pid(i, pid)
        lockstep = Lockstep(
            listeners,
            watchdog=ResponseWatchdog(_SILENCE_LIMIT_S),
            on_message=lambda _instance, _message: None,
            on_silent=lambda _instance, _wall_silence_s: None,
            on_lost=on_lost,
            policies=[PX4] * scenario.agents,
            guard=guard,
        )
        stack.enter_context(contextlib.closing(lockstep))
        lockstep.connect(_CONNECT_LIMIT_S, keep_waiting=lambda: True)
        simulator = BareSimulator(scenario, lockstep, companions)
        simulator.run(SETTLED_S)
        gc.collect()
        gc.freeze()
        own_s, px4_s, wall_s = time.process_time(), sum(map(_cpu_s, pids)), time.monotonic()
        simulator.run(SETTLED_S + job.duration_s)
        wall_s = time.monotonic() - wall_s
        own_s, px4_s = time.process_time() - own_s, sum(map(_cpu_s, pids)) - px4_s
        height_m = float(simulator.vehicles.height_m.min())
        if job.flies and height_m < LEAST_HEIGHT_M:
            raise BareError(f"a PX4 with the bare simulator is at {height_m:.1f} m instead of {HEIGHT_M:g} m")
        return BareCost(
            real_time_factor=job.duration_s / wall_s,
            px4_cpu_s_per_simulated_s=px4_s / job.duration_s,
            simulator_cpu_s_per_simulated_s=own_s / job.duration_s,
            late_answers=sum(lockstep.late_answers.values()),
            height_m=height_m,
        )


def _cpu_s(pid: int) -> float:
    times = psutil.Process(pid).cpu_times()
    return float(times.user + times.system)


def main(arguments: Sequence[str]) -> int:
    """Measure the `BareJob` in the argument (JSON); the last line on stdout is the cost."""
    try:
        cost = measure(msgspec.json.decode(arguments[0], type=BareJob))
    except (ScenarioError, AutopilotError, ResourceError, BareError, psutil.NoSuchProcess, OSError) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    sys.stdout.write(msgspec.json.encode(cost).decode() + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
