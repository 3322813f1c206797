"""A stand-in for ArduPilot's SITL program for copters with its JSON backend, for tests without an ArduPilot.

It reproduces what a run of ArduPilot 4.8 shows and its public sources say: the motors' pulse widths are sent
by UDP from an ephemeral port, then a state is awaited; after a second of silence the same packet is sent
again; a state that is accepted raises the packet's number, and only states advance the clock. MAVLink links
are clients: UDP, or TCP with three attempts, after which the program ends with status 1. It ends when its
parent process ends. Its command line is that of ``autopilot.ardupilot_command``.

The environment variable ``STAND_IN`` holds deviations (`Deviations`) in JSON, and as "only" the numbers of
the vehicles that they concern.
"""

import argparse
import contextlib
import json
import os
import select
import signal
import socket
import struct
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

from ardupilot_copter import GUIDED, Copter
from ardupilot_scanner import Receiver
from pymavlink.dialects.v20 import ardupilotmega as mavlink

MAGIC = {16: 18_458, 32: 29_569}
ATTEMPTS, ATTEMPT_PERIOD_S = 3, 1.0
LINKS_PERIOD = 4
"""Frames between two readings of the MAVLink links."""
DEFAULTS = {
    "MOT_PWM_MIN": 1000.0, "MOT_PWM_MAX": 2000.0, "MOT_SPIN_ARM": 0.1, "MOT_SPIN_MIN": 0.15,
    "MOT_SPIN_MAX": 0.95, "MOT_THST_EXPO": 0.65, "MOT_THST_HOVER": 0.35, "GPS1_DELAY_MS": 0.0,
    "FRAME_CLASS": 0.0, "FRAME_TYPE": 0.0, "SCHED_LOOP_RATE": 400.0, "GPS1_TYPE": 1.0, "SIM_BARO_RND": 0.2,
    "SIM_MAG_RND": 0.0, "BATT_MONITOR": 0.0, "BATT_CAPACITY": 3300.0, "PSC_NE_POS_P": 1.0,
    "WP_SPD": 10.0, "FS_OPTIONS": 16.0,
}  # fmt: skip
"""All parameters that exist, with defaults of the program."""


@dataclass
class Deviations:
    """Deviations from an undisturbed run."""

    flies: bool = False
    """Otherwise the motors turn at a constant speed after ``armed_from`` frames, without any command."""
    armed_from: int = 100
    silence_s: float = 1.0
    """Wall time without a state after which a packet is repeated."""
    late: dict[int, float] = field(default_factory=dict)
    """Delays in s, by the number of the packet."""
    lost: tuple[int, ...] = ()
    """Packets whose first sending is left out."""
    mute_from: int | None = None
    """Number of the packet from which on nothing is sent, and no state is received."""
    ends_at_start: int | None = None
    """Exit status of an end before the first packet."""
    never_sends: bool = False
    magic: int | None = None
    channels: int = 16
    without_link: bool = False
    """SERIAL2 does not connect."""
    ends_after: int | None = None
    """Number of the packet after which the program ends."""


class Link:
    """One MAVLink link, by UDP or TCP, with its streams: periods in us by message."""

    def __init__(self, connection: socket.socket, system: int) -> None:
        self.connection = connection
        self.mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=1)
        self.mav.robust_parsing = True
        self.due_us = {mavlink.MAVLINK_MSG_ID_HEARTBEAT: 0}
        self.periods_us = {mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1_000_000}

    def send(self, message: mavlink.MAVLink_message) -> None:
        with contextlib.suppress(OSError):
            self.connection.send(message.pack(self.mav))
            self.mav.seq = (self.mav.seq + 1) % 256

    def receive(self) -> list[mavlink.MAVLink_message]:
        messages = []
        with contextlib.suppress(OSError):
            while data := self.connection.recv(65_536, socket.MSG_DONTWAIT):
                messages += self.mav.parse_buffer(data) or []
        return [message for message in messages if message.get_type() != "BAD_DATA"]


def connected(device: str, system: int) -> Link | None:
    """Return the link of a serial port's device; ends the program if its TCP server does not exist."""
    kind, host, port = device.split(":")
    if kind == "udpclient":
        connection = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        with contextlib.suppress(OSError):
            connection.connect((host, int(port)))
        return Link(connection, system)
    for _ in range(ATTEMPTS):
        with contextlib.suppress(OSError):
            connection = socket.create_connection((host, int(port)), timeout=120.0)
            connection.settimeout(None)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.sendall(b"0 0 0 ")  # as the program does, for no known reason
            return Link(connection, system)
        time.sleep(ATTEMPT_PERIOD_S)
    sys.stderr.write(f"connect failed on port {port} - Connection refused\n")
    sys.exit(1)


class Program:
    """The program; `run` does not return."""

    def __init__(self, arguments: argparse.Namespace, parameters: dict[str, float], how: Deviations) -> None:
        lat_deg, lon_deg, alt_m, _ = map(float, arguments.home.split(","))
        self.how = how
        self.system = arguments.sysid
        self.parameters = parameters
        self.copter = Copter(parameters, (lat_deg, lon_deg, alt_m))
        self.receiver = Receiver()
        self._simulator = (arguments.model.partition(":")[2], arguments.sim_port_out)
        self._states = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._devices = (arguments.serial0, arguments.serial1, arguments.serial2)
        self._links: list[Link] = []
        self._pulses_us = [0] * 4
        self._parent = os.getppid()

    def run(self) -> None:
        count = 0
        while True:
            self._send(count)
            if count == 0:
                devices = self._devices[: 2 if self.how.without_link else 3]
                self._links = list(filter(None, (connected(each, self.system) for each in devices)))
            self._await(count)
            if self.how.ends_after is not None and count >= self.how.ends_after:
                sys.exit(0)
            before_us, count = self.copter.time_us, self.receiver.accepted
            self.copter.update(self.receiver.time_us, self.receiver.values)
            if count % LINKS_PERIOD == 0:
                self._serve()
            dt_s = (self.copter.time_us - before_us) * 1e-6
            if self.how.flies:
                self._pulses_us = self.copter.pulses_us(dt_s)
            else:
                self._pulses_us = [1_600 if count > self.how.armed_from else 1_000] * 4

    def _send(self, count: int) -> None:
        """Send the pulse widths; a packet that is left out is sent by the first repetition."""
        how, channels = self.how, self.how.channels
        if how.never_sends or (how.mute_from is not None and count >= how.mute_from):
            self._check_parent_forever()
        time.sleep(how.late.get(count, 0.0))
        if count not in how.lost:
            self._send_now(count, channels)

    def _send_now(self, count: int, channels: int) -> None:
        magic = self.how.magic or MAGIC[channels]
        pulses_us = [*self._pulses_us, *[0] * (channels - 4)]
        packet = struct.pack(f"<HHI{channels}H", magic, 1_200, count, *pulses_us)
        with contextlib.suppress(OSError):
            self._states.sendto(packet, self._simulator)

    def _await(self, count: int) -> None:
        """Receive datagrams, from any source, until one is an accepted state."""
        wall_sent_s = time.monotonic()
        while self.receiver.accepted == count:
            if select.select([self._states], [], [], min(self.how.silence_s, 0.1))[0]:
                self.receiver.receive(self._states.recv(65_000))
            elif time.monotonic() - wall_sent_s >= self.how.silence_s:
                sys.stdout.write("No JSON sensor message received, resending servos\n")
                self._send_now(count, self.how.channels)
                wall_sent_s = time.monotonic()
                self._check_parent()

    def _check_parent(self) -> None:
        if os.getppid() != self._parent:
            sys.exit(1)

    def _check_parent_forever(self) -> None:
        while True:
            time.sleep(0.1)
            self._check_parent()

    # ---- MAVLink

    def _serve(self) -> None:
        for link in self._links:
            for message in link.receive():
                self._on_message(message, link)
            for kind, period_us in link.periods_us.items():
                if self.copter.time_us >= link.due_us[kind]:
                    link.due_us[kind] = self.copter.time_us + period_us
                    made = self._make(kind)
                    if made is not None:
                        link.send(made)

    def _on_message(self, message: mavlink.MAVLink_message, link: Link) -> None:
        copter, kind = self.copter, message.get_type()
        if getattr(message, "target_system", self.system) not in {0, self.system}:
            return
        if kind == "GPS_INPUT" and message.fix_type >= mavlink.GPS_FIX_TYPE_3D_FIX:
            if self.parameters["GPS1_TYPE"] == 14:
                copter.on_fix(message.lat * 1e-7, message.lon * 1e-7)
        elif kind == "SET_POSITION_TARGET_LOCAL_NED":
            copter.follow(
                message.type_mask, (message.x, message.y, message.z), (message.vx, message.vy, message.vz),
                (message.afx, message.afy, message.afz),
            )  # fmt: skip
        elif kind == "PARAM_REQUEST_READ" and message.param_id in self.parameters:
            value = self.parameters[message.param_id]
            name = message.param_id.encode()
            link.send(mavlink.MAVLink_param_value_message(name, value, 9, len(self.parameters), 0))
        elif kind == "COMMAND_LONG":
            result = self._execute(message, link)
            link.send(mavlink.MAVLink_command_ack_message(message.command, result))

    def _execute(self, message: mavlink.MAVLink_message, link: Link) -> int:
        copter, one = self.copter, int(message.param1)
        match message.command:
            case mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                link.due_us[one] = copter.time_us
                link.periods_us[one] = int(message.param2)
                if message.param2 <= 0:
                    del link.periods_us[one]
                return mavlink.MAV_RESULT_ACCEPTED
            case mavlink.MAV_CMD_REQUEST_MESSAGE:
                made = self._make(one)
                if made is not None:
                    link.send(made)
                done = made is not None
            case mavlink.MAV_CMD_DO_SET_MODE:
                done = bool(one & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED) and copter.set_mode(
                    int(message.param2)
                )
            case mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
                done = copter.arm() if one == 1 else copter.disarm()
            case mavlink.MAV_CMD_NAV_TAKEOFF:
                done = copter.take_off(message.param7)
            case _:
                return mavlink.MAV_RESULT_UNSUPPORTED
        return mavlink.MAV_RESULT_ACCEPTED if done else mavlink.MAV_RESULT_FAILED

    def _make(self, kind: int) -> mavlink.MAVLink_message | None:
        """Return a message; None if there is none now."""
        copter = self.copter
        time_ms, values = copter.time_us // 1_000, copter.values
        (north_m, east_m, down_m), home = copter.pos_ned_m, copter.home
        if kind == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            base |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED if copter.armed else 0
            status = mavlink.MAV_STATE_STANDBY if copter.landed else mavlink.MAV_STATE_ACTIVE
            return mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, base, copter.mode, status, 3
            )
        if kind == mavlink.MAVLINK_MSG_ID_SYS_STATUS:
            checked = mavlink.MAV_SYS_STATUS_PREARM_CHECK
            return mavlink.MAVLink_sys_status_message(
                checked, checked, checked if copter.is_ready else 0, 0, 0, -1, -1, 0, 0, 0, 0, 0, 0
            )
        if kind == mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE:
            altitude_m = home[2] - down_m
            hpa = 1013.25 * (1.0 - 6.5e-3 * altitude_m / 288.15) ** 5.255877
            return mavlink.MAVLink_scaled_pressure_message(time_ms, hpa, 0.0, 2_500)
        if kind == mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION:
            return mavlink.MAVLink_attitude_quaternion_message(
                time_ms, *values["quaternion"], *values["gyro"]
            )
        if kind == mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE:
            landed = mavlink.MAV_LANDED_STATE_ON_GROUND if copter.landed else mavlink.MAV_LANDED_STATE_IN_AIR
            return mavlink.MAVLink_extended_sys_state_message(0, landed)
        if copter.fix_us is None:
            return None
        lat_deg = home[0] + north_m / 111_319.5
        place = (round(lat_deg * 1e7), round(home[1] * 1e7 + east_m * 132.6), round((home[2] - down_m) * 1e3))
        match kind:
            case mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED:
                return mavlink.MAVLink_local_position_ned_message(
                    time_ms, north_m, east_m, down_m, *values["velocity"]
                )
            case mavlink.MAVLINK_MSG_ID_GPS_RAW_INT:
                return mavlink.MAVLink_gps_raw_int_message(copter.time_us, 3, *place, 90, 140, 0, 0, 10)
            case mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN if copter.is_ready:
                origin = (round(home[0] * 1e7), round(home[1] * 1e7), round(home[2] * 1e3))
                return mavlink.MAVLink_gps_global_origin_message(*origin, copter.time_us)
            case mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED if copter.mode == GUIDED:
                target_m = copter.target_pos_m or copter.pos_ned_m
                return mavlink.MAVLink_position_target_local_ned_message(
                    time_ms, 1, 0, *target_m, *copter.target_vel_m_s, *copter.target_acc_m_s2, 0.0, 0.0
                )
        return None


def defaults(path: Path) -> dict[str, float]:
    """Return the parameters with the values of a file; names that do not exist are ignored."""
    values = dict(DEFAULTS)
    for line in path.read_text(encoding="ascii").splitlines():
        name, value = line.split()
        if name in values:
            values[name] = float(value)
    return values


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--model", required=True)
    parser.add_argument("--sim-port-out", type=int, default=9002)
    parser.add_argument("-I", dest="instance", type=int, default=0)
    parser.add_argument("--sysid", type=int, default=1)
    parser.add_argument("--rc-in-port", type=int, default=5501)
    parser.add_argument("--home", required=True)
    parser.add_argument("--speedup", type=float, default=1.0)
    parser.add_argument("--defaults", type=Path, required=True)
    for number in range(3):
        parser.add_argument(f"--serial{number}", required=True)
    arguments = parser.parse_args()
    given = json.loads(os.environ.get("STAND_IN", "{}"))
    only = given.pop("only", None)
    if only is not None and arguments.sysid - 1 not in only:
        given = {name: value for name, value in given.items() if name in {"flies", "silence_s"}}
    if "late" in given:
        given["late"] = {int(number): late_s for number, late_s in given["late"].items()}
    how = Deviations(**given)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    sys.stdout.write(f"Starting sketch 'ArduCopter'\nSerial port 0 on {arguments.serial0}\n")
    sys.stdout.flush()
    if how.ends_at_start is not None:
        sys.stderr.write("PANIC: no such frame\n")
        sys.exit(how.ends_at_start)
    Path("eeprom.bin").write_bytes(bytes(16_384))
    Program(arguments, defaults(arguments.defaults), how).run()


if __name__ == "__main__":
    main()
