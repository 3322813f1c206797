"""Faults that a scenario injects at a time: what fails, in which vehicle, from when to when.

Pure: the physics server asks `Faults.advance` in every step, which costs next to nothing while nothing begins
or ends; sensors, rotors and the air read what is in force. Faults of one kind that overlap in a vehicle add
up, as independent noises do, by their variances; rotors' effectivenesses multiply.
"""

import math
from collections.abc import Iterable, Mapping
from typing import Annotated, Literal, NamedTuple, get_args

import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from foundation.types import Array
from harness.scenario.validation_errors import explain

ROTORS = 4
MOST_TIME_S = 1e6
"""Eleven days: nothing is scheduled later."""
LEAST_DURATION_S = 0.004
"""One step of the physics: what is shorter might fall between two. Radios know of it when the air next goes
on, at the multiples of ``onboard.loop_period_ms``."""
Vector = tuple[float, float, float]
Start = Annotated[float, Meta(ge=0.0, le=MOST_TIME_S)]
Duration = Annotated[float, Meta(ge=LEAST_DURATION_S, le=MOST_TIME_S)]
Motor = Annotated[int, Meta(ge=0, lt=ROTORS)]

# per axis; far beyond what an autopilot can make sense of, and well within what its messages can say
PositionOffset = Annotated[float, Meta(ge=-10_000.0, le=10_000.0)]
AccelOffset = Annotated[float, Meta(ge=-100.0, le=100.0)]
GyroOffset = Annotated[float, Meta(ge=-35.0, le=35.0)]
MagOffset = Annotated[float, Meta(ge=-10.0, le=10.0)]
RangeOffset = Annotated[float, Meta(ge=-1000.0, le=1000.0)]
MOST_ATTENUATION_DB = 1_000.0
MOST_RANGE_OFFSET_M = 1e6
"""What `netsim.wire.messages.Advance` can say, of whatever adds up to more."""


def _tag(name: str) -> str:
    """``GpsLoss`` is written ``gps_loss``."""
    return "".join(f"_{c.lower()}" if c.isupper() else c for c in name).lstrip("_")


class Fault(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag=_tag):
    """One of the scenario's ``[[faults]]``; its ``kind`` is that of a class below, such as ``gps_loss``."""

    uav: Annotated[int, Meta(ge=0)] | Literal["all"]
    """Number of the vehicle, from 0; "all" for every vehicle."""
    start_s: Start = 0.0
    """Simulated time from the run's start; from now, if it is injected into a run."""
    duration_s: Duration | None = None
    """Without it the fault lasts to the end."""


class GpsLoss(Fault, frozen=True, kw_only=True):
    """The receiver, jammed, goes on reporting, but neither fix nor satellites."""


class GpsBias(Fault, frozen=True, kw_only=True):
    """Fixes lie elsewhere, as a spoofer wants them to."""

    offset_ned_m: tuple[PositionOffset, PositionOffset, PositionOffset]
    """Position error, metres, NED."""
    rate_m_s: Annotated[float, Meta(gt=0.0, le=100.0)] | None = None
    """At which the offset creeps from nothing to its length, and the velocity is then wrong by as much;
    without it the position alone steps."""


class GpsNoise(Fault, frozen=True, kw_only=True):
    """White noise on top of the receiver's own, per axis and fix; its accuracy claims stay."""

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
    """A magnet or a current at the compass."""

    offset_frd_gauss: tuple[MagOffset, MagOffset, MagOffset]
    """Added to the measured field, gauss, FRD."""


class MagYaw(Fault, frozen=True, kw_only=True):
    """The field around the vehicle is turned about the vertical, as over reinforced concrete."""

    heading_error_deg: Annotated[float, Meta(ge=-180.0, le=180.0)]
    """By which a compass reads too much, clockwise."""


class BaroFreeze(Fault, frozen=True, kw_only=True):
    """The barometer goes on reporting, but always its last sample."""


class BaroBias(Fault, frozen=True, kw_only=True):
    """The barometer reads the pressure of another altitude."""

    offset_m: Annotated[float, Meta(ge=-5000.0, le=5000.0)]
    """By which it reads too high."""


class MotorLoss(Fault, frozen=True, kw_only=True, tag="motor"):
    """A rotor has lost part of its thrust and torques, at whatever speed it turns: a broken propeller."""

    motor: Motor
    """In PX4's order: front right, back left, front left, back right."""
    effectiveness: Annotated[float, Meta(ge=0.0, le=1.0)]
    """Thrust and torques over those of the whole rotor: 0 none, 1 all."""


class MotorStop(Fault, frozen=True, kw_only=True):
    """A motor gets no current: its rotor runs down and stands."""

    motor: Motor
    """In PX4's order: front right, back left, front left, back right."""


class RadioAttenuation(Fault, frozen=True, kw_only=True):
    """Every link of the channel is weaker, guests' too; 200 dB cut it. Interferers keep their power."""

    uav: Annotated[int, Meta(ge=0)] | Literal["all"] = "all"
    """Always "all": the channel is common to all stations."""
    attenuation_db: Annotated[float, Meta(ge=0.0, le=300.0)]
    """On top of what the run has on every link already."""

    def __post_init__(self) -> None:
        """Check what no single field can."""
        if self.uav != "all":
            raise ValueError('uav: expected "all", for the channel is everybody\'s')


class RangingBias(Fault, frozen=True, kw_only=True):
    """A radio that is calibrated wrongly: it tells so of all distances that it measures itself."""

    offset_m: RangeOffset
    """By which it measures too far."""


AnyFault = (
    GpsLoss
    | GpsBias
    | GpsNoise
    | AccelBias
    | GyroBias
    | MagBias
    | MagYaw
    | BaroFreeze
    | BaroBias
    | MotorLoss
    | MotorStop
    | RadioAttenuation
    | RangingBias
)


class FaultChange(NamedTuple):
    """A fault that has just begun or ended."""

    fault: AnyFault
    began: bool
    number: int
    """Among the scenario's faults, from 0 on; those that are injected count on from there."""

    @property
    def motor(self) -> int | None:
        """Which motor it is about; None for all other faults."""
        return self.fault.motor if isinstance(self.fault, MotorLoss | MotorStop) else None


def check(fault: AnyFault, vehicles: int, *, path: str) -> None:
    """Check what a fault alone cannot know. Raises ValueError with the field's path."""
    if fault.uav != "all" and fault.uav >= vehicles:
        raise ValueError(f"{path}.uav: {fault.uav} is none of {vehicles} vehicles from 0 on")


def validated(fault: AnyFault, vehicles: int) -> AnyFault:
    """Give a fault back that a program made, whose values nobody has looked at yet. Raises ValueError."""
    try:
        sound: AnyFault = msgspec.convert(msgspec.to_builtins(fault), AnyFault)
    except msgspec.ValidationError as error:
        raise ValueError(explain(error, EXPECTED, root="fault")) from None
    check(sound, vehicles, path="fault")
    return sound


def kind(fault: AnyFault) -> str:
    """Give what the scenario calls it."""
    return _kind(type(fault))


def _kind(of: type[Fault]) -> str:
    return str(of.__struct_config__.tag)


EXPECTED = {
    r"faults?(\[\d+\])?\.kind": f"one of {', '.join(_kind(each) for each in get_args(AnyFault))}",
    r"faults?(\[\d+\])?\.uav": 'a number or "all"',
}
"""What a wrong field of a fault should have been, for `harness.scenario.validation_errors.explain`."""


class _Scheduled(NamedTuple):
    start_us: int
    end_us: float
    number: int
    fault: AnyFault


class Faults:
    """What is in force in n vehicles; None stands for nothing of a kind anywhere.

    A fault is in force at steps whose time is its start or later, and before its end. ``rng`` is for noise
    alone.
    """

    def __init__(self, faults: Iterable[AnyFault], vehicles: int, rng: np.random.Generator) -> None:
        """Take the faults of the scenario. Raises ValueError for a vehicle that there is not."""
        self._vehicles = vehicles
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
        """(n, 4)"""
        self.rotor_stopped: NDArray[np.bool_] | None = None
        """(n, 4)"""
        self.extra_attenuation_db: float | None = None
        """On every link, on top of what there is already."""
        self.range_offsets_m: Mapping[int, float] = {}
        """By vehicle, of those whose radios measure too far."""
        for fault in faults:
            self.add(fault, 0)

    def add(self, fault: AnyFault, now_us: int) -> None:
        """Have a fault begin its ``start_s`` after ``now_us``. Raises ValueError for a wrong vehicle."""
        check(fault, self._vehicles, path="fault")
        start_us = now_us + round(fault.start_s * 1e6)
        end_us = math.inf if fault.duration_s is None else start_us + round(fault.duration_s * 1e6)
        self._waiting.append(_Scheduled(start_us, end_us, self._added, fault))
        self._added += 1
        self._next_change_us = min(self._next_change_us, start_us)

    def advance(self, time_us: int) -> tuple[FaultChange, ...]:
        """Go on to the step at ``time_us``; returns what ends and then what begins there."""
        self._now_us = time_us
        if time_us < self._next_change_us:
            return ()
        ended = [each for each in self._active if each.end_us <= time_us]
        # one that is over at the first step that sees it has never been in force
        began = [each for each in self._waiting if each.start_us <= time_us < each.end_us]
        self._waiting = [each for each in self._waiting if each.start_us > time_us]
        self._active = [each for each in self._active if each.end_us > time_us] + began
        self._next_change_us = min(
            [each.start_us for each in self._waiting] + [each.end_us for each in self._active],
            default=math.inf,
        )
        self._put_in_force()
        return (
            *(FaultChange(each.fault, began=False, number=each.number) for each in ended),
            *(FaultChange(each.fault, began=True, number=each.number) for each in began),
        )

    def gps_errors(self) -> tuple[Array, Array] | None:
        """Errors of the fixes that arrive now: position (n, 3) in metres, velocity (n, 3) in m/s, NED.

        To be asked once per fix: it draws the noise of all vehicles, whatever is in force, so that what one
        suffers changes nothing for another.
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
                errors[:, _who(fault)] += _spoofed(fault, (self._now_us - start_us) * 1e-6)[:, None]
            else:
                stds = np.array((fault.position_std_m, fault.velocity_std_m_s))
                variances[:, _who(fault)] += np.square(stds)[:, None, None]
        if errors is None:
            return None
        errors += np.sqrt(variances) * noise
        return errors[0], errors[1]

    def _put_in_force(self) -> None:
        active = [each.fault for each in self._active]
        self.accel_offset_frd_m_s2 = self._sum(
            (fault, fault.offset_frd_m_s2) for fault in active if isinstance(fault, AccelBias)
        )
        self.gyro_offset_frd_rad_s = self._sum(
            (fault, fault.offset_frd_rad_s) for fault in active if isinstance(fault, GyroBias)
        )
        self.mag_offset_frd_gauss = self._sum(
            (fault, fault.offset_frd_gauss) for fault in active if isinstance(fault, MagBias)
        )
        self.heading_error_rad = self._sum(
            (fault, math.radians(fault.heading_error_deg)) for fault in active if isinstance(fault, MagYaw)
        )
        self.baro_offset_m = self._sum(
            (fault, fault.offset_m) for fault in active if isinstance(fault, BaroBias)
        )
        self.baro_frozen = self._any(fault for fault in active if isinstance(fault, BaroFreeze))
        self.gps_lost = self._any(fault for fault in active if isinstance(fault, GpsLoss))
        self.rotor_effectiveness = self.rotor_stopped = None
        for fault in active:
            if isinstance(fault, MotorLoss):
                if self.rotor_effectiveness is None:
                    self.rotor_effectiveness = np.ones((self._vehicles, ROTORS))
                self.rotor_effectiveness[_who(fault), fault.motor] *= fault.effectiveness
            elif isinstance(fault, MotorStop):
                if self.rotor_stopped is None:
                    self.rotor_stopped = np.zeros((self._vehicles, ROTORS), dtype=np.bool_)
                self.rotor_stopped[_who(fault), fault.motor] = True
        losses_db = [fault.attenuation_db for fault in active if isinstance(fault, RadioAttenuation)]
        self.extra_attenuation_db = min(sum(losses_db), MOST_ATTENUATION_DB) if losses_db else None
        offsets_m = self._sum((fault, fault.offset_m) for fault in active if isinstance(fault, RangingBias))
        self.range_offsets_m = {}
        if offsets_m is not None:
            limited_m = np.clip(offsets_m, -MOST_RANGE_OFFSET_M, MOST_RANGE_OFFSET_M).tolist()
            self.range_offsets_m = {i: offset_m for i, offset_m in enumerate(limited_m) if offset_m}

    def _sum(self, parts: Iterable[tuple[AnyFault, Vector | float]]) -> Array | None:
        """(n, 3) or (n,) sum of vectors or numbers, each for its fault's vehicles; None of nothing."""
        total: Array | None = None
        for fault, part in parts:
            if total is None:
                total = np.zeros((self._vehicles, *np.shape(part)))
            total[_who(fault)] += part
        return total

    def _any(self, faults: Iterable[AnyFault]) -> NDArray[np.bool_] | None:
        """(n,) whose vehicles are affected; None of nothing."""
        flags: NDArray[np.bool_] | None = None
        for fault in faults:
            if flags is None:
                flags = np.zeros(self._vehicles, dtype=np.bool_)
            flags[_who(fault)] = True
        return flags


def _who(fault: AnyFault) -> slice:
    return slice(None) if fault.uav == "all" else slice(fault.uav, fault.uav + 1)


def _spoofed(fault: GpsBias, since_s: float) -> Array:
    """Offset (3,) in metres and its rate (3,) in m/s so long after the start, NED, as two rows."""
    offset_ned_m = np.array(fault.offset_ned_m)
    length_m = float(np.linalg.norm(offset_ned_m))
    if fault.rate_m_s is None or fault.rate_m_s * since_s >= length_m:
        return np.array((offset_ned_m, np.zeros(3)))
    rate_ned_m_s = offset_ned_m * (fault.rate_m_s / length_m)
    return np.array((rate_ned_m_s * since_s, rate_ned_m_s))
