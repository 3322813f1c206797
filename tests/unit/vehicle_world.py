"""One whole `Vehicle` over the real physics, sensors and simulator messages, in one process, no sockets."""

from typing import Self

import numpy as np
from pymavlink.dialects.v20 import common

from autopilot.config import AutopilotConfig, OnboardConfig, VehicleConfig
from autopilot.mavlink.hil import HilActuatorControls, HilEncoder, HilParser, HilSensor
from autopilot.mavlink.modes import mode_from_custom
from autopilot.vehicle import GROUND_STATION, StepOutput, Vehicle
from harness.hil import SensorEncoder, is_armed
from harness.physics.model import IRIS
from harness.physics.world import World
from harness.sensors.config import SensorsConfig
from harness.sensors.suite import SensorSuite

STEP_US = 4_000


def vehicle_config(*, onboard: bool = False, params: dict[str, float] | None = None) -> VehicleConfig:
    return VehicleConfig(
        run_id="test",
        instance=0,
        seed=7,
        onboard=OnboardConfig(enabled=onboard, localisation="gps"),
        autopilot=AutopilotConfig(params=params or {}),
        places_ned_m=((0.0, 0.0, -5.0),),
    )


class Flight:
    """Steps world and vehicle in lockstep and keeps what the vehicle said to the ground station."""

    def __init__(self, config: VehicleConfig, *, gps: bool = True) -> None:
        self.vehicle = Vehicle(config)
        self.world = World(
            model=IRIS,
            spawn_pos_ned_m=[[0.0, 0.0, -IRIS.standing_height_m]],
            spawn_yaw_rad=0.5,
            step_us=STEP_US,
        )
        self._sensors = SensorSuite(
            config=SensorsConfig(),
            site=config.site,
            vehicles=1,
            step_us=STEP_US,
            seed=np.random.SeedSequence(3),
        )
        self._hil = SensorEncoder()
        self._parser = HilParser(HilSensor)
        self._from_vehicle = HilParser(HilActuatorControls)
        self._encoder = HilEncoder(system=config.instance + 1, component=1)
        self.gps = gps
        self.now_us = 0
        self.heard: list[tuple[int, common.MAVLink_message]] = []
        """(time_us, message) to the ground station, less streams."""
        self.modes: list[tuple[int, str, bool]] = []
        """(time_us, mode, armed) of heartbeats to the simulator, at each change."""
        self._to_send: list[common.MAVLink_message] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.world.close()

    @property
    def height_m(self) -> float:
        return -float(self.world.truth.pos_ned_m[0, 2]) - IRIS.standing_height_m

    def send(self, *messages: common.MAVLink_message) -> None:
        """From the ground station, with the next step."""
        self._to_send += messages

    def command(self, command: int, *params: float) -> int:
        """Send a command, step once and return the result of its acknowledgement."""
        padded = (*params, *[0.0] * (7 - len(params)))
        self.send(common.MAVLink_command_long_message(1, 1, command, 0, *padded))
        self.step()
        acks = [m for t, m in self.heard if t == self.now_us and m.get_type() == "COMMAND_ACK"]
        assert [ack.command for ack in acks] == [command]
        return acks[0].result

    def texts(self) -> list[str]:
        return [message.text for _, message in self.heard if message.get_type() == "STATUSTEXT"]

    def step(self, *, streams: bool = False) -> StepOutput:
        self.now_us += STEP_US
        frame = self._sensors.sample(self.now_us, self.world.truth)
        messages = self._parser.push(next(self._hil.encode(self.now_us, frame)))
        if not self.gps:
            messages = [m for m in messages if m.get_msgId() != common.MAVLINK_MSG_ID_HIL_GPS]
        sent, self._to_send = self._to_send, []
        output = self.vehicle.step(
            sim_messages=messages,
            link_messages=[(GROUND_STATION, message) for message in sent],
            link_active=(streams, streams),
        )
        self.heard += [
            (self.now_us, message)
            for link, message in output.links
            if link == GROUND_STATION and message.get_type() != "HEARTBEAT"
        ]
        for message in output.simulator:
            if message.get_type() == "HEARTBEAT" and message.autopilot == common.MAV_AUTOPILOT_PX4:
                mode = mode_from_custom(message.custom_mode)
                seen = (mode.label, bool(message.base_mode & common.MAV_MODE_FLAG_SAFETY_ARMED))
                if not self.modes or self.modes[-1][1:] != seen:
                    self.modes.append((self.now_us, *seen))
        # through the bytes, so that what cannot be packed fails here
        (answer,) = self._from_vehicle.push(self._encoder.encode(output.actuators))
        self.world.step(
            np.array([answer.controls[:4]]),
            np.array([is_armed(answer)]),
            np.zeros((1, 3)),
            rotors_stopped=np.zeros(1, dtype=np.bool_),
        )
        return output

    def run(self, seconds: float, *, until=None) -> bool:
        """Step for some time, or until a condition holds; returns whether it did."""
        for _ in range(round(seconds * 1e6 / STEP_US)):
            self.step()
            if until is not None and until():
                return True
        return False
