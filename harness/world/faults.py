"""Faults that a scenario or a program injects: kinds, affected vehicles, start, duration, effects.

No I/O. `harness.world.active_faults` applies them in flight. A kind is a class below and a member of
`AnyFault`; `UserFault` stands for code of the user.
"""

import math
from collections.abc import Collection, Sequence
from typing import Annotated, Any, Literal, get_args

import msgspec
from msgspec import Meta, Struct

from harness.scenario.validation_errors import explain
from harness.world.interfaces import Accels, Distance, Effects, Fields, Gyros, Height, Positions, Rotor
from netsim.model.config import ModelName

MOST_TIME_S = 1e6
"""Eleven days: the latest time of a fault."""
LEAST_DURATION_S = 0.004
"""One step of the physics: a shorter fault might fall between two steps. Faults of the radio take effect at
the next interval of the channel, at multiples of ``onboard.loop_period_ms``."""
Start = Annotated[float, Meta(ge=0.0, le=MOST_TIME_S)]
Duration = Annotated[float, Meta(ge=LEAST_DURATION_S, le=MOST_TIME_S)]
UNCHANGED = Effects()


def _tag(name: str) -> str:
    """Return the tag of a class: ``gps_loss`` for ``GpsLoss``."""
    return "".join(f"_{c.lower()}" if c.isupper() else c for c in name).lstrip("_")


class Fault(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag=_tag):
    """One of the scenario's ``[[faults]]``; its ``kind`` is that of a class below, such as ``gps_loss``."""

    uav: Annotated[int, Meta(ge=0)] | Literal["all"]
    """Number of the vehicle, from 0; "all" for every vehicle."""
    start_s: Start = 0.0
    """Simulated time since the run's start, or since the injection into a run."""
    duration_s: Duration | None = None
    """None: the fault lasts to the end."""

    def effects(self) -> Effects:
        """Return what the fault changes, if that is the same in all its steps."""
        return UNCHANGED


class GpsLoss(Fault, frozen=True, kw_only=True):
    """The receiver is jammed: it continues to report, but without fix and satellites."""

    def effects(self) -> Effects:
        """See `Fault.effects`."""
        return Effects(gps_lost=True)


class GpsBias(Fault, frozen=True, kw_only=True):
    """Fixes have an offset, as under spoofing."""

    offset_ned_m: Positions
    """Position error, metres, NED."""
    rate_m_s: Annotated[float, Meta(gt=0.0, le=100.0)] | None = None
    """Rate at which the offset grows from zero to its length; the velocity has this error meanwhile. None:
    the position steps, and the velocity has no error."""


class GpsNoise(Fault, frozen=True, kw_only=True):
    """White noise in addition to the receiver's own, per axis and fix; the reported accuracy is unchanged."""

    position_std_m: Annotated[float, Meta(ge=0.0, le=1000.0)] = 0.0
    """Standard deviation of the position, metres."""
    velocity_std_m_s: Annotated[float, Meta(ge=0.0, le=50.0)] = 0.0
    """Standard deviation of the velocity, m/s."""

    def __post_init__(self) -> None:
        """Check what no single field can."""
        if self.position_std_m == 0.0 and self.velocity_std_m_s == 0.0:
            raise ValueError("position_std_m, velocity_std_m_s: expected one of them above 0")


class AccelBias(Fault, frozen=True, kw_only=True):
    """The accelerometer's bias jumps."""

    offset_frd_m_s2: Accels
    """Added to the measured acceleration, m/s^2, FRD."""

    def effects(self) -> Effects:
        """See `Fault.effects`."""
        return Effects(accel_offset_frd_m_s2=self.offset_frd_m_s2)


class GyroBias(Fault, frozen=True, kw_only=True):
    """The gyroscope's bias jumps."""

    offset_frd_rad_s: Gyros
    """Added to the measured angular rate, rad/s, FRD."""

    def effects(self) -> Effects:
        """See `Fault.effects`."""
        return Effects(gyro_offset_frd_rad_s=self.offset_frd_rad_s)


class MagBias(Fault, frozen=True, kw_only=True):
    """Offset of the magnetometer, as by a magnet or a current."""

    offset_frd_gauss: Fields
    """Added to the measured field, gauss, FRD."""

    def effects(self) -> Effects:
        """See `Fault.effects`."""
        return Effects(mag_offset_frd_gauss=self.offset_frd_gauss)


class MagYaw(Fault, frozen=True, kw_only=True):
    """The magnetic field at the vehicle is rotated about the vertical, as over reinforced concrete."""

    heading_error_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]
    """Error of the heading that a compass reads, positive clockwise."""

    def effects(self) -> Effects:
        """See `Fault.effects`."""
        return Effects(heading_error_rad=math.radians(self.heading_error_deg))


class BaroFreeze(Fault, frozen=True, kw_only=True):
    """The barometer continues to report its last sample."""

    def effects(self) -> Effects:
        """See `Fault.effects`."""
        return Effects(baro_frozen=True)


class BaroBias(Fault, frozen=True, kw_only=True):
    """The barometer reads the pressure of another altitude."""

    offset_m: Height
    """Error of the altitude, positive upwards."""

    def effects(self) -> Effects:
        """See `Fault.effects`."""
        return Effects(baro_offset_m=self.offset_m)


class MotorLoss(Fault, frozen=True, kw_only=True, tag="motor"):
    """A rotor loses part of its thrust and torques at every speed, as with a broken propeller."""

    motor: Rotor
    """Number of the rotor in the airframe's file, from 0. Of the Iris, in PX4's order: front right, back
    left, front left, back right."""
    effectiveness: Annotated[float, Meta(ge=0.0, le=1.0)]
    """Remaining fraction of thrust and torques."""

    def effects(self) -> Effects:
        """See `Fault.effects`."""
        return Effects(rotor_effectiveness={self.motor: self.effectiveness})


class MotorStop(Fault, frozen=True, kw_only=True):
    """A motor has no current: its rotor runs down and stops."""

    motor: Rotor
    """Number of the rotor in the airframe's file, from 0. Of the Iris, in PX4's order: front right, back
    left, front left, back right."""

    def effects(self) -> Effects:
        """See `Fault.effects`."""
        return Effects(rotors_stopped=(self.motor,))


class RadioAttenuation(Fault, frozen=True, kw_only=True):
    """All links, also guests', are attenuated; 200 dB block them. Interferers keep their power."""

    uav: Annotated[int, Meta(ge=0)] | Literal["all"] = "all"
    """Always "all": the channel is common to all stations."""
    attenuation_db: Annotated[float, Meta(ge=0.0, le=300.0)]
    """In addition to the run's attenuation of every link."""

    def __post_init__(self) -> None:
        """Check what no single field can."""
        if self.uav != "all":
            raise ValueError('uav: expected "all", because all vehicles share the channel')

    def effects(self) -> Effects:
        """See `Fault.effects`."""
        return Effects(attenuation_db=self.attenuation_db)


class RangingBias(Fault, frozen=True, kw_only=True):
    """A wrongly calibrated radio: all distances that it measures have an offset."""

    offset_m: Distance
    """Error of its distances, positive if too long."""

    def effects(self) -> Effects:
        """See `Fault.effects`."""
        return Effects(range_offset_m=self.offset_m)


class UserFault(Fault, frozen=True, kw_only=True, tag="user"):
    """Code of one's own, with an object for each of its vehicles (docs/how-to/sensors-and-faults.md)."""

    model: ModelName
    """``package.module:Class``, or the name of an entry point of the group ``coflight.faults``."""
    settings: dict[str, Any] = {}
    """Settings of the class, checked against its own type."""
    folder: str = ""
    """Folder where the module is looked up first and to which paths in the settings are relative; "": that of
    the scenario's file."""


AnyFault = (
    GpsLoss | GpsBias | GpsNoise | AccelBias | GyroBias | MagBias | MagYaw | BaroFreeze | BaroBias | MotorLoss
    | MotorStop | RadioAttenuation | RangingBias | UserFault
)  # fmt: skip


def check(
    fault: AnyFault, rotors: Sequence[int], *, path: str, other_compasses: Collection[int] = frozenset()
) -> None:
    """Check that a fault's vehicle exists and can have it. Raises ValueError with the field's path.

    ``rotors`` are the numbers of rotors of all vehicles, ``other_compasses`` the vehicles whose autopilot
    simulates its compass itself.
    """
    vehicles = len(rotors)
    if fault.uav != "all" and fault.uav >= vehicles:
        raise ValueError(f"{path}.uav: {fault.uav} is none of {vehicles} vehicles from 0 on")
    if isinstance(fault, MotorLoss | MotorStop):
        for vehicle in range(vehicles) if fault.uav == "all" else (fault.uav,):
            if fault.motor >= rotors[vehicle]:
                raise ValueError(
                    f"{path}.motor: {fault.motor} is none of the {rotors[vehicle]} motors of UAV {vehicle} "
                    "from 0 on"
                )
    if isinstance(fault, MagBias | MagYaw):
        for vehicle in other_compasses:
            if fault.uav in ("all", vehicle):
                raise ValueError(
                    f"{path}.kind: {kind(fault)} cannot act on UAV {vehicle}, as an ArduPilot simulates its "
                    "compass itself"
                )


def validated(
    fault: AnyFault, rotors: Sequence[int], *, other_compasses: Collection[int] = frozenset()
) -> AnyFault:
    """Return a fault that a program constructed after checking all its values. Raises as `check`."""
    try:
        valid: AnyFault = msgspec.convert(msgspec.to_builtins(fault), AnyFault)
    except msgspec.ValidationError as error:
        raise ValueError(explain(error, EXPECTED, root="fault")) from None
    check(valid, rotors, path="fault", other_compasses=other_compasses)
    return valid


def kind(fault: Fault | type[Fault]) -> str:
    """Return the ``kind`` of a fault, or of a class of faults, in a scenario."""
    return str(fault.__struct_config__.tag)


def title(fault: AnyFault) -> str:
    """Return the ``kind`` of a fault; of a user's fault, its model."""
    return fault.model if isinstance(fault, UserFault) else kind(fault)


EXPECTED = {
    r"faults?(\[\d+\])?\.kind": f"one of {', '.join(map(kind, get_args(AnyFault)))}",
    r"faults?(\[\d+\])?\.uav": 'a number or "all"',
}
"""Expected values of a fault's fields, for `harness.scenario.validation_errors.explain`."""
