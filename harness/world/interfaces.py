"""Interfaces of sensors and faults of one's own, and what they exchange with the simulator.

`harness.world.world_models` creates them by the names in ``[[sensors.extra]]`` and ``[[faults]]``;
docs/how-to/sensors-and-faults.md has complete examples. Both belong to the physics server, which has the
truth. They have no clock, no I/O and no global random generator: time and state are arguments, and
`WorldContext.rng` is their only randomness, so equal runs give equal bytes, in one process and in many.
Frames: NED from the site's origin, in which the ground is down = 0; FRD of the body.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Protocol, TypeAlias

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from autopilot.mavlink.codec import Message
from autopilot.parameters.config import Site
from foundation.airframe.description import MOST_ROTORS, Airframe
from foundation.types import Array, Vector
from harness.world.obstacles import Obstacles
from harness.world.physics.truth import Truth

# per axis; far beyond plausible values, and well within the ranges of the messages
Position = Annotated[float, Meta(ge=-10_000.0, le=10_000.0)]
Velocity = Annotated[float, Meta(ge=-300.0, le=300.0)]
Accel = Annotated[float, Meta(ge=-100.0, le=100.0)]
Gyro = Annotated[float, Meta(ge=-35.0, le=35.0)]
Field = Annotated[float, Meta(ge=-10.0, le=10.0)]
Force = Annotated[float, Meta(ge=-1000.0, le=1000.0)]
Height = Annotated[float, Meta(ge=-5000.0, le=5000.0)]
Distance = Annotated[float, Meta(ge=-1000.0, le=1000.0)]
Angle = Annotated[float, Meta(ge=-math.pi, le=math.pi)]
Fraction = Annotated[float, Meta(ge=0.0, le=1.0)]
Attenuation = Annotated[float, Meta(ge=0.0, le=300.0)]
Rotor = Annotated[int, Meta(ge=0, lt=MOST_ROTORS)]
Positions: TypeAlias = tuple[Position, Position, Position]
Velocities: TypeAlias = tuple[Velocity, Velocity, Velocity]
Accels: TypeAlias = tuple[Accel, Accel, Accel]
Gyros: TypeAlias = tuple[Gyro, Gyro, Gyro]
Fields: TypeAlias = tuple[Field, Field, Field]
Forces: TypeAlias = tuple[Force, Force, Force]
ZERO: Vector = (0.0, 0.0, 0.0)


class WorldContext(Struct, frozen=True, kw_only=True):
    """What a sensor or fault receives when it is created for a vehicle, as ``Class(context)``.

    With an attribute ``Settings``, a msgspec Struct or a dataclass, it is ``Class(context, settings)``.
    """

    uav: int
    """Number of the vehicle, from 0."""
    vehicles: int
    """Number of vehicles, the n of `WorldInputs`."""
    number: int
    """Number of the sensor among ``[[sensors.extra]]``, or of the fault among ``[[faults]]``, from 0."""
    name: str
    """Name of the sensor, or of the fault's model."""
    airframe: Airframe
    """The vehicle's airframe."""
    site: Site
    """Geographic position of the origin, magnetic field."""
    obstacles: Obstacles
    """The ground and the scenario's boxes, for rays and lines of sight."""
    step_us: int
    """Step of the physics."""
    folder: Path
    """Folder of the scenario's file, to which paths in settings are relative."""
    rng: np.random.Generator
    """Generator of this object alone: it depends on the run's seed, the vehicle, and the sensor's name or the
    fault's number. So no other sensor or fault changes its draws."""


class WorldInputs(Struct, frozen=True, kw_only=True):
    """True state at the end of a step; arrays are read-only."""

    time_us: int
    """Simulated time."""
    pos_ned_m: Array
    """(3,) centre of mass."""
    vel_ned_m_s: Array
    """(3,) over ground."""
    q_ned_frd: Array
    """(4,) wxyz."""
    omega_frd_rad_s: Array
    """(3,)"""
    acc_ned_m_s2: Array
    """(3,) mean of the step, with contact forces."""
    specific_force_frd_m_s2: Array
    """(3,) mean of the step, as an accelerometer measures it."""
    rotor_speed_rad_s: Array
    """(R,) of the vehicle's rotors."""
    all_pos_ned_m: Array
    """(n, 3) positions of all vehicles."""
    all_vel_ned_m_s: Array
    """(n, 3) velocities of all vehicles."""
    alive: NDArray[np.bool_]
    """(n,) whether each vehicle is still in the run."""


def inputs_of(time_us: int, truth: Truth, alive: NDArray[np.bool_], vehicle: int, rotors: int) -> WorldInputs:
    """Return the true state for one vehicle, which has that number of rotors."""
    rows, speeds_rad_s, alive = truth.rows.view(), truth.rotor_speed_rad_s.view(), alive.view()
    rows.flags.writeable = speeds_rad_s.flags.writeable = alive.flags.writeable = False
    own = rows[vehicle]
    return WorldInputs(
        time_us=time_us,
        pos_ned_m=own["pos_ned_m"],
        vel_ned_m_s=own["vel_ned_m_s"],
        q_ned_frd=own["q_ned_frd"],
        omega_frd_rad_s=own["omega_frd_rad_s"],
        acc_ned_m_s2=own["acc_ned_m_s2"],
        specific_force_frd_m_s2=own["specific_force_frd_m_s2"],
        rotor_speed_rad_s=speeds_rad_s[vehicle, :rotors],
        all_pos_ned_m=rows["pos_ned_m"],
        all_vel_ned_m_s=rows["vel_ned_m_s"],
        alive=alive,
    )


class Reading(Struct, frozen=True):
    """A reading of a sensor."""

    measured_us: int
    """Simulated time of the sample; it arrives `Sensor.delay_us` later."""
    values: Sequence[float]
    """One for each of `Sensor.columns`; NaN: the sensor had no value."""


class Sensor(Protocol):
    """A sensor of one vehicle whose readings its on-board application receives.

    They arrive as DEBUG_FLOAT_ARRAY: ``name`` is the sensor's name cut to 10 characters, ``array_id`` its
    number among ``[[sensors.extra]]``, ``time_usec`` the time of the sample, ``data`` the values. A sensor
    that also has the method of `AutopilotSensor` sends that message instead. All readings are rows of
    ``sensors.parquet``.

    Three attributes are read once. ``columns`` are the names of a reading's values, with units, such as
    ``distance_m``: 1 to 58 (the capacity of the message), of 32 ASCII characters at most. ``period_us`` is
    the time between two samples, at least one step; they are taken at the first step at or after each
    multiple of it. ``delay_us`` is the time from a sample to its arrival, at least 0, rounded up to steps.
    """

    columns: Sequence[str]
    period_us: int
    delay_us: int

    def sample(self, inputs: WorldInputs) -> Sequence[float | None] | None:
        """Return finite values in the order of `columns`, or None for no reading.

        None instead of a value: the sensor has none.
        """


class AutopilotSensor(Sensor, Protocol):
    """A sensor whose readings its autopilot receives over the simulator's link, as PX4 takes them there.

    PX4 v1.17 takes DISTANCE_SENSOR, HIL_OPTICAL_FLOW, LANDING_TARGET, ODOMETRY, VISION_POSITION_ESTIMATE,
    RAW_RPM, and HIL_GPS of further receivers. coflight's autopilot streams DISTANCE_SENSOR to ground stations
    and companions, and passes it, HIL_OPTICAL_FLOW and LANDING_TARGET to its on-board application.
    """

    def message(self, reading: Reading) -> Message:
        """Return the MAVLink message (`pymavlink.dialects.v20.common`) of a reading, but not HIL_SENSOR.

        It is called once for each reading, when it arrives.
        """


class Effects(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a fault changes on a vehicle during a step; the defaults change nothing.

    Offsets of several faults add up, and the effectivenesses of a rotor are multiplied. Of a user's fault,
    vectors may also be NumPy arrays (3,).
    """

    accel_offset_frd_m_s2: Accels = ZERO
    """Added to the measured acceleration, at most 100 per axis."""
    gyro_offset_frd_rad_s: Gyros = ZERO
    """Added to the measured angular rate, at most 35 per axis."""
    mag_offset_frd_gauss: Fields = ZERO
    """Added to the measured field, at most 10 per axis."""
    heading_error_rad: Angle = 0.0
    """Rotation of the magnetic field about the vertical, clockwise, at most pi."""
    baro_offset_m: Height = 0.0
    """Error of the barometer's altitude, upwards, at most 5000."""
    baro_frozen: bool = False
    """The barometer repeats its last sample."""
    gps_offset_ned_m: Positions = ZERO
    """Added to the position of a fix that arrives in this step, at most 10 000 per axis."""
    gps_velocity_offset_ned_m_s: Velocities = ZERO
    """Added to its velocity, at most 300 per axis."""
    gps_lost: bool = False
    """The receiver has no fix."""
    rotor_effectiveness: dict[Rotor, Fraction] = {}
    """Remaining fraction of thrust and torques, 0 to 1, by the number of the rotor."""
    rotors_stopped: tuple[Rotor, ...] = ()
    """Numbers of rotors without current, which run down."""
    force_ned_n: Forces = ZERO
    """Force on the centre of mass, at most 1000 per axis."""
    attenuation_db: Attenuation = 0.0
    """Attenuation of all radio links, 0 to 300, from the next interval of the channel on. Of the vehicles of
    one fault the greatest counts."""
    range_offset_m: Distance = 0.0
    """Error of the distances that the radio measures, at most 1000."""


class FaultModel(Protocol):
    """A fault of one vehicle, with ``kind = "user"`` in a scenario.

    One that also changes readings of the scenario's own sensors is a `SensorFaultModel`.
    """

    def update(self, inputs: WorldInputs, since_s: float) -> Effects:
        """Return the effects in the step that begins at ``inputs.time_us``.

        It is called in each step at or after the fault's start and before its end; ``since_s`` is the time
        since the start.
        """


class SensorFaultModel(FaultModel, Protocol):
    """A fault that also changes readings of the scenario's own sensors (``[[sensors.extra]]``)."""

    def reading(self, sensor: str, values: Sequence[float]) -> Sequence[float] | None:
        """Return the values instead of those of a sample taken now; None: the sample is dropped.

        ``sensor`` is the name of the sensor, ``values`` have NaN where it had no value, which the result may
        have too. It is called after `update`.
        """
