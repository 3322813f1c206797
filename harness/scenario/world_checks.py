"""Checks of a scenario's own sensors and of faults of the user; errors begin with the field's path."""

from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np
from pymavlink.dialects.v20 import common

from autopilot.parameters.config import Site
from foundation.airframe.description import Airframe
from foundation.extension_failure import ExtensionFailure
from foundation.extensions import ExtensionError
from foundation.types import Array
from harness.world.faults import AnyFault, UserFault
from harness.world.interfaces import Reading, WorldInputs, inputs_of
from harness.world.obstacles import Obstacles
from harness.world.physics.truth import TRUTH, Truth
from harness.world.sensors.config import ExtraSensor, SensorsConfig
from harness.world.user_models import SHIPPED, CheckedSensor, WorldModels

Choice = TypeVar("Choice", ExtraSensor, UserFault)


def check_sensors(sensors: Sequence[ExtraSensor], agents: int) -> None:
    """Check names and vehicles of sensors. Raises ValueError with the field's path."""
    titles: list[str] = []
    for number, sensor in enumerate(sensors):
        field = f"sensors.extra[{number}]"
        if sensor.title in titles:
            other = titles.index(sensor.title)
            raise ValueError(
                f"{field}.name: {sensor.title!r} is also that of sensors.extra[{other}]; expected another one"
            )
        if not sensor.title.isascii():
            raise ValueError(f"{field}.name: missing; expected one, as {sensor.model} is not ASCII")
        titles.append(sensor.title)
        for vehicle in sensor.vehicles(agents):
            if vehicle >= agents:
                raise ValueError(f"{field}.uavs: {vehicle} is none of {agents} vehicles from 0 on")


def with_folder(
    sensors: SensorsConfig, faults: Sequence[AnyFault], folder: Path
) -> tuple[SensorsConfig, tuple[AnyFault, ...]]:
    """Return sensors and faults with the folder of the scenario's file in all that are code of users."""

    def absolute(choice: Choice) -> Choice:
        return msgspec.structs.replace(choice, folder=str((folder / choice.folder).resolve()))

    extra = tuple(each if each.model in SHIPPED else absolute(each) for each in sensors.extra)
    return (
        msgspec.structs.replace(sensors, extra=extra),
        tuple(absolute(each) if isinstance(each, UserFault) else each for each in faults),
    )


def check_models(
    sensors: SensorsConfig, faults: Sequence[AnyFault], *, seed: int, site: Site,
    airframes: Sequence[Airframe], places_ned_m: Array, step_us: int,
    ardupilots: Collection[int],
) -> None:  # fmt: skip
    """Create all sensors and faults of users, and call each once for vehicles at their places.

    ``ardupilots`` are the vehicles that an ArduPilot flies. Raises ExtensionError with one line.
    """
    models = WorldModels(
        seed=seed, stream=0, airframes=airframes, site=site, obstacles=Obstacles(sensors.boxes),
        step_us=step_us,
    )  # fmt: skip
    state = _at_rest(places_ned_m, airframes)
    link = common.MAVLink(None)
    try:
        for sensor in models.sensors(sensors.extra):
            _check_receiver(sensor, ardupilots)
            values = sensor.sample(state(sensor.vehicle))
            if values is not None:
                sensor.frame(Reading(step_us, values), link)
        for number, fault in enumerate(faults):
            if isinstance(fault, UserFault):
                for vehicle in range(len(airframes)) if fault.uav == "all" else (fault.uav,):
                    models.fault(fault, number, vehicle).update(state(vehicle), 0.0)
    except ExtensionFailure as error:
        raise ExtensionError(str(error)) from error


def _check_receiver(sensor: CheckedSensor, ardupilots: Collection[int]) -> None:
    """Check that a sensor's vehicle receives its readings."""
    field, vehicle = f"sensors.extra[{sensor.number}].uavs", sensor.vehicle
    if sensor.is_for_autopilot and vehicle in ardupilots:
        raise ExtensionError(
            f"{field}: {sensor.name} cannot be on UAV {vehicle}, as an ArduPilot takes none but its own"
        )


def _at_rest(places_ned_m: Array, airframes: Sequence[Airframe]) -> Callable[[int], WorldInputs]:
    """Return a function of the vehicle: its state if all hover level and motionless at their places."""
    rows = np.zeros(len(airframes), TRUTH)
    rows["pos_ned_m"] = places_ned_m
    rows["q_ned_frd"][:, 0] = 1.0
    rows["specific_force_frd_m_s2"][:, 2] = -9.8066
    rotors = [len(airframe.rotors) for airframe in airframes]
    truth = Truth(rows, np.zeros((len(rotors), max(rotors))))
    alive = np.ones(len(rotors), dtype=np.bool_)
    return lambda vehicle: inputs_of(0, truth, alive, vehicle, rotors[vehicle])
