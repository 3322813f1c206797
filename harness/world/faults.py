"""Faults that a scenario or a program injects: kinds, affected vehicles, start and duration.

No I/O. The physics server calls `Faults.advance` in every step, which is cheap while no fault begins or ends;
sensors, rotors and radio channel read the active faults. Overlapping faults of one kind in a vehicle add up,
noises by their variances; rotors' effectivenesses are multiplied.
"""

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Annotated, Literal, NamedTuple, TypeVar, get_args

import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from foundation.airframe.description import MOST_ROTORS
from foundation.types import Array, Vector
from harness.scenario.validation_errors import explain

MOST_TIME_S = 1e6
"""Eleven days: the latest time of a fault."""
LEAST_DURATION_S = 0.004
"""One step of the physics: a shorter fault might fall between two steps. Faults of the radio take effect at
the next interval of the channel, at multiples of ``onboard.loop_period_ms``."""
Start = Annotated[float, Meta(ge=0.0, le=MOST_TIME_S)]
Duration = Annotated[float, Meta(ge=LEAST_DURATION_S, le=MOST_TIME_S)]
Motor = Annotated[int, Meta(ge=0, lt=MOST_ROTORS)]

# per axis; far beyond plausible values, and well within the ranges of the messages
PositionOffset = Annotated[float, Meta(ge=-10_000.0, le=10_000.0)]
AccelOffset = Annotated[float, Meta(ge=-100.0, le=100.0)]
GyroOffset = Annotated[float, Meta(ge=-35.0, le=35.0)]
MagOffset = Annotated[float, Meta(ge=-10.0, le=10.0)]
RangeOffset = Annotated[float, Meta(ge=-1000.0, le=1000.0)]
MOST_ATTENUATION_DB = 1_000.0
MOST_RANGE_OFFSET_M = 1e6
"""Limit of `netsim.wire.lockstep.Advance`, to which larger sums are clipped."""


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


FaultT = TypeVar("FaultT", bound=Fault)


class GpsLoss(Fault, frozen=True, kw_only=True):
    """The receiver is jammed: it continues to report, but without fix and satellites."""


class GpsBias(Fault, frozen=True, kw_only=True):
    """Fixes have an offset, as under spoofing."""

    offset_ned_m: tuple[PositionOffset, PositionOffset, PositionOffset]
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

    offset_frd_m_s2: tuple[AccelOffset, AccelOffset, AccelOffset]
    """Added to the measured acceleration, m/s^2, FRD."""


class GyroBias(Fault, frozen=True, kw_only=True):
    """The gyroscope's bias jumps."""

    offset_frd_rad_s: tuple[GyroOffset, GyroOffset, GyroOffset]
    """Added to the measured angular rate, rad/s, FRD."""


class MagBias(Fault, frozen=True, kw_only=True):
    """Offset of the magnetometer, as by a magnet or a current."""

    offset_frd_gauss: tuple[MagOffset, MagOffset, MagOffset]
    """Added to the measured field, gauss, FRD."""


class MagYaw(Fault, frozen=True, kw_only=True):
    """The magnetic field at the vehicle is rotated about the vertical, as over reinforced concrete."""

    heading_error_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]
    """Error of the heading that a compass reads, positive clockwise."""


class BaroFreeze(Fault, frozen=True, kw_only=True):
    """The barometer continues to report its last sample."""


class BaroBias(Fault, frozen=True, kw_only=True):
    """The barometer reads the pressure of another altitude."""

    offset_m: Annotated[float, Meta(ge=-5000.0, le=5000.0)]
    """Error of the altitude, positive upwards."""


class MotorLoss(Fault, frozen=True, kw_only=True, tag="motor"):
    """A rotor loses part of its thrust and torques at every speed, as with a broken propeller."""

    motor: Motor
    """Number of the rotor in the airframe's file, from 0. Of the Iris, in PX4's order: front right, back
    left, front left, back right."""
    effectiveness: Annotated[float, Meta(ge=0.0, le=1.0)]
    """Remaining fraction of thrust and torques."""


class MotorStop(Fault, frozen=True, kw_only=True):
    """A motor has no current: its rotor runs down and stops."""

    motor: Motor
    """Number of the rotor in the airframe's file, from 0. Of the Iris, in PX4's order: front right, back
    left, front left, back right."""


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


class RangingBias(Fault, frozen=True, kw_only=True):
    """A wrongly calibrated radio: all distances that it measures have an offset."""

    offset_m: RangeOffset
    """Error of its distances, positive if too long."""


AnyFault = (
    GpsLoss | GpsBias | GpsNoise | AccelBias | GyroBias | MagBias | MagYaw | BaroFreeze | BaroBias | MotorLoss
    | MotorStop | RadioAttenuation | RangingBias
)  # fmt: skip


class FaultChange(NamedTuple):
    """A fault that has just begun or ended."""

    fault: AnyFault
    began: bool
    number: int
    """Index among the scenario's faults, from 0; injected faults continue the numbering."""

    @property
    def motor(self) -> int | None:
        """The affected motor; None for faults of other kinds."""
        return self.fault.motor if isinstance(self.fault, MotorLoss | MotorStop) else None


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


EXPECTED = {
    r"faults?(\[\d+\])?\.kind": f"one of {', '.join(map(kind, get_args(AnyFault)))}",
    r"faults?(\[\d+\])?\.uav": 'a number or "all"',
}
"""Expected values of a fault's fields, for `harness.scenario.validation_errors.explain`."""


class _Scheduled(NamedTuple):
    start_us: int
    end_us: float
    number: int
    fault: AnyFault


class Faults:
    """Active faults of n vehicles; an attribute is None if no vehicle has a fault of its kind.

    A fault is active in steps at or after its start and before its end. ``rng`` is used for noise only.
    """

    def __init__(self, faults: Iterable[AnyFault], rotors: Sequence[int], rng: np.random.Generator) -> None:
        """Schedule the faults of the scenario; ``rotors`` (n,) are the vehicles' numbers of rotors.

        Raises ValueError for a vehicle or motor that does not exist.
        """
        self._vehicles = len(rotors)
        self._rotors = tuple(rotors)
        self._most_rotors = max(rotors)
        self._rng = rng
        self._now_us = 0
        self._waiting: list[_Scheduled] = []
        self._active: list[_Scheduled] = []
        self._added = 0
        self._next_change_us: float = math.inf
        self.accel_offset_frd_m_s2: Array | None = None
        """(n, 3), as the next two"""
        self.gyro_offset_frd_rad_s: Array | None = None
        self.mag_offset_frd_gauss: Array | None = None
        self.heading_error_rad: Array | None = None
        """(n,) clockwise"""
        self.baro_offset_m: Array | None = None
        """(n,)"""
        self.baro_frozen: NDArray[np.bool_] | None = None
        """(n,)"""
        self.gps_lost: NDArray[np.bool_] | None = None
        """(n,)"""
        self.rotor_effectiveness: Array | None = None
        """(n, R), R the greatest number of rotors"""
        self.rotor_stopped: NDArray[np.bool_] | None = None
        """(n, R)"""
        self.extra_attenuation_db = 0.0
        """In addition to the attenuation of every link."""
        self.range_offsets_m: Mapping[int, float] = {}
        """Error of the distances that a vehicle's radio measures, for affected vehicles."""
        for fault in faults:
            self.add(fault, 0)

    def add(self, fault: AnyFault, now_us: int) -> None:
        """Schedule a fault for ``start_s`` after ``now_us``. Raises ValueError for a wrong vehicle."""
        check(fault, self._rotors, path="fault")
        start_us = now_us + round(fault.start_s * 1e6)
        end_us = math.inf if fault.duration_s is None else start_us + round(fault.duration_s * 1e6)
        self._waiting.append(_Scheduled(start_us, end_us, self._added, fault))
        self._added += 1
        self._next_change_us = min(self._next_change_us, start_us)

    def advance(self, time_us: int) -> tuple[FaultChange, ...]:
        """Advance to the step at ``time_us``; returns the faults that end and then those that begin there."""
        self._now_us = time_us
        if time_us < self._next_change_us:
            return ()
        ended = [each for each in self._active if each.end_us <= time_us]
        # a fault that is over at its first step was never active
        began = [each for each in self._waiting if each.start_us <= time_us < each.end_us]
        self._waiting = [each for each in self._waiting if each.start_us > time_us]
        self._active = [each for each in self._active if each.end_us > time_us] + began
        self._next_change_us = min(
            [each.start_us for each in self._waiting] + [each.end_us for each in self._active],
            default=math.inf,
        )
        self._update()
        return (
            *(FaultChange(each.fault, began=False, number=each.number) for each in ended),
            *(FaultChange(each.fault, began=True, number=each.number) for each in began),
        )

    def gps_errors(self) -> tuple[Array, Array] | None:
        """Return errors of the fixes that arrive now: position (n, 3) in m, velocity (n, 3) in m/s, NED.

        Call it once per fix. It draws noise for all vehicles in any case, so that a fault of one vehicle does
        not change the others' random streams. None without faults.
        """
        noise = self._rng.standard_normal((2, self._vehicles, 3))
        variances = np.zeros((2, self._vehicles, 1))
        errors: Array | None = None
        for start_us, _, _, fault in self._active:
            if not isinstance(fault, GpsBias | GpsNoise):
                continue
            if errors is None:
                errors = np.zeros((2, self._vehicles, 3))
            if isinstance(fault, GpsBias):
                errors[:, _affected(fault)] += _spoofed(fault, (self._now_us - start_us) * 1e-6)[:, None]
            else:
                stds = np.array((fault.position_std_m, fault.velocity_std_m_s))
                variances[:, _affected(fault)] += np.square(stds)[:, None, None]
        if errors is None:
            return None
        errors += np.sqrt(variances) * noise
        return errors[0], errors[1]

    def _update(self) -> None:
        active = [each.fault for each in self._active]
        self.accel_offset_frd_m_s2 = self._sum(AccelBias, lambda fault: fault.offset_frd_m_s2)
        self.gyro_offset_frd_rad_s = self._sum(GyroBias, lambda fault: fault.offset_frd_rad_s)
        self.mag_offset_frd_gauss = self._sum(MagBias, lambda fault: fault.offset_frd_gauss)
        self.heading_error_rad = self._sum(MagYaw, lambda fault: math.radians(fault.heading_error_deg))
        self.baro_offset_m = self._sum(BaroBias, lambda fault: fault.offset_m)
        self.baro_frozen, self.gps_lost = self._any(BaroFreeze), self._any(GpsLoss)
        self.rotor_effectiveness = self.rotor_stopped = None
        for fault in active:
            if isinstance(fault, MotorLoss):
                if self.rotor_effectiveness is None:
                    self.rotor_effectiveness = np.ones((self._vehicles, self._most_rotors))
                self.rotor_effectiveness[_affected(fault), fault.motor] *= fault.effectiveness
            elif isinstance(fault, MotorStop):
                if self.rotor_stopped is None:
                    self.rotor_stopped = np.zeros((self._vehicles, self._most_rotors), dtype=np.bool_)
                self.rotor_stopped[_affected(fault), fault.motor] = True
        losses_db = (fault.attenuation_db for fault in active if isinstance(fault, RadioAttenuation))
        self.extra_attenuation_db = min(sum(losses_db, 0.0), MOST_ATTENUATION_DB)
        offsets_m = self._sum(RangingBias, lambda fault: fault.offset_m)
        self.range_offsets_m = {}
        if offsets_m is not None:
            limited_m = np.clip(offsets_m, -MOST_RANGE_OFFSET_M, MOST_RANGE_OFFSET_M).tolist()
            self.range_offsets_m = {i: offset_m for i, offset_m in enumerate(limited_m) if offset_m}

    def _sum(self, of: type[FaultT], part: Callable[[FaultT], Vector | float]) -> Array | None:
        """Return the sum (n, 3) or (n,) of the active faults' vectors or numbers by vehicle; None: none."""
        total: Array | None = None
        for _, _, _, fault in self._active:
            if isinstance(fault, of):
                if total is None:
                    total = np.zeros((self._vehicles, *np.shape(part(fault))))
                total[_affected(fault)] += part(fault)
        return total

    def _any(self, of: type[Fault]) -> NDArray[np.bool_] | None:
        """Return (n,) which vehicles have an active fault of a class; None: none."""
        affected = [_affected(fault) for _, _, _, fault in self._active if isinstance(fault, of)]
        flags = np.zeros(self._vehicles, dtype=np.bool_)
        for vehicles in affected:
            flags[vehicles] = True
        return flags if affected else None


def _affected(fault: Fault) -> slice:
    return slice(None) if fault.uav == "all" else slice(fault.uav, fault.uav + 1)


def _spoofed(fault: GpsBias, since_s: float) -> Array:
    """Return offset (3,) in m and rate (3,) in m/s, NED, as two rows, ``since_s`` after the start."""
    offset_ned_m = np.array(fault.offset_ned_m)
    length_m = float(np.linalg.norm(offset_ned_m))
    if fault.rate_m_s is None or fault.rate_m_s * since_s >= length_m:
        return np.array((offset_ned_m, np.zeros(3)))
    rate_ned_m_s = offset_ned_m * (fault.rate_m_s / length_m)
    return np.array((rate_ned_m_s * since_s, rate_ned_m_s))
