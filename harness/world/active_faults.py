"""The faults of a run in flight: which are active, and what they change together.

No I/O. The physics server calls `Faults.advance` in every step, which is cheap while no fault begins or ends
and none is of the user; sensors, rotors and radio channel read the sums. Overlapping faults of one kind in a
vehicle add up, noises by their variances; rotors' effectivenesses are multiplied.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.types import Array
from harness.world.faults import (
    UNCHANGED,
    AnyFault,
    Fault,
    GpsBias,
    GpsNoise,
    MotorLoss,
    MotorStop,
    UserFault,
    check,
)
from harness.world.interfaces import Effects, WorldInputs
from harness.world.user_models import CheckedFault

MOST_ATTENUATION_DB = 1_000.0
MOST_RANGE_OFFSET_M = 1e6
"""Limit of `netsim.wire.lockstep.Advance`, to which larger sums are clipped."""

MakeFault = Callable[[UserFault, int, int], CheckedFault]
"""Creates the object of a user's fault by the fault, its number and the vehicle."""
InputsOf = Callable[[int], WorldInputs]
"""Returns the true state for a vehicle at the present step."""


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


class _Scheduled(NamedTuple):
    start_us: int
    end_us: float
    number: int
    fault: AnyFault
    models: Mapping[int, CheckedFault]
    """The objects of a user's fault by vehicle; none of other faults."""


class Faults:
    """Active faults of n vehicles; an attribute is None if no vehicle has a fault of its kind.

    A fault is active in steps at or after its start and before its end. ``rng`` is used for noise only,
    ``make`` for faults of the user.
    """

    def __init__(
        self,
        faults: Iterable[AnyFault],
        rotors: Sequence[int],
        rng: np.random.Generator,
        make: MakeFault | None = None,
    ) -> None:
        """Schedule the faults of the scenario; ``rotors`` (n,) are the vehicles' numbers of rotors.

        Raises ValueError for a vehicle or motor that does not exist, and the errors of ``make``.
        """
        self._vehicles = len(rotors)
        self._rotors = tuple(rotors)
        self._most_rotors = max(rotors)
        self._rng = rng
        self._make = make
        self._now_us = 0
        self._waiting: list[_Scheduled] = []
        self._active: list[_Scheduled] = []
        self._has_models = False
        """Whether a fault of the user is active."""
        self._added = 0
        self._next_change_us: float = math.inf
        self._reset()
        for fault in faults:
            self.add(fault, 0)

    def _reset(self) -> None:
        """Set the sums of no faults."""
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
        self.gps_offset_ned_m: Array | None = None
        """(n, 3) without `GpsBias`, as the next"""
        self.gps_velocity_offset_ned_m_s: Array | None = None
        self.rotor_effectiveness: Array | None = None
        """(n, R), R the greatest number of rotors"""
        self.rotor_stopped: NDArray[np.bool_] | None = None
        """(n, R)"""
        self.force_ned_n: Array | None = None
        """(n, 3)"""
        self.extra_attenuation_db = 0.0
        """In addition to the attenuation of every link."""
        self.range_offset_m: Array | None = None
        """(n,)"""

    def add(self, fault: AnyFault, now_us: int) -> None:
        """Schedule a fault for ``start_s`` after ``now_us``.

        Raises ValueError for a wrong vehicle, and the errors of code of the user.
        """
        check(fault, self._rotors, path="fault")
        start_us = now_us + round(fault.start_s * 1e6)
        end_us = math.inf if fault.duration_s is None else start_us + round(fault.duration_s * 1e6)
        models: dict[int, CheckedFault] = {}
        if isinstance(fault, UserFault):
            if self._make is None:
                raise TypeError("a fault of the user requires `make`")
            models = {i: self._make(fault, self._added, i) for i in range(self._vehicles)[_affected(fault)]}
        self._waiting.append(_Scheduled(start_us, end_us, self._added, fault, models))
        self._added += 1
        self._next_change_us = min(self._next_change_us, start_us)

    def advance(self, time_us: int, inputs_of: InputsOf | None = None) -> tuple[FaultChange, ...]:
        """Advance to the step at ``time_us``; returns the faults that end and then those that begin there.

        ``inputs_of`` is required by faults of the user. Raises ExtensionFailure if one fails.
        """
        self._now_us = time_us
        changes: tuple[FaultChange, ...] = ()
        if time_us >= self._next_change_us:
            changes = self._change(time_us)
            self._has_models = any(each.models for each in self._active)
        elif not self._has_models:
            return ()
        self._sum(inputs_of)
        return changes

    def _change(self, time_us: int) -> tuple[FaultChange, ...]:
        """End and begin faults; return those that end and those that begin."""
        ended = [each for each in self._active if each.end_us <= time_us]
        # a fault that is over at its first step was never active
        began = [each for each in self._waiting if each.start_us <= time_us < each.end_us]
        self._waiting = [each for each in self._waiting if each.start_us > time_us]
        self._active = [each for each in self._active if each.end_us > time_us] + began
        self._next_change_us = min(
            [each.start_us for each in self._waiting] + [each.end_us for each in self._active],
            default=math.inf,
        )
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
        errors = np.zeros((2, self._vehicles, 3))
        has_errors = False
        for start_us, _, _, fault, _ in self._active:
            if isinstance(fault, GpsBias):
                errors[:, _affected(fault)] += _spoofed(fault, (self._now_us - start_us) * 1e-6)[:, None]
            elif isinstance(fault, GpsNoise):
                stds = np.array((fault.position_std_m, fault.velocity_std_m_s))
                variances[:, _affected(fault)] += np.square(stds)[:, None, None]
            else:
                continue
            has_errors = True
        for k, offset in enumerate((self.gps_offset_ned_m, self.gps_velocity_offset_ned_m_s)):
            if offset is not None:
                errors[k] += offset
                has_errors = True
        if not has_errors:
            return None
        errors += np.sqrt(variances) * noise
        return errors[0], errors[1]

    @property
    def range_offsets_m(self) -> dict[int, float]:
        """Return the error of the distances that a vehicle's radio measures, for affected vehicles."""
        if self.range_offset_m is None:
            return {}
        limited_m = np.clip(self.range_offset_m, -MOST_RANGE_OFFSET_M, MOST_RANGE_OFFSET_M).tolist()
        return {i: offset_m for i, offset_m in enumerate(limited_m) if offset_m}

    def reading(self, vehicle: int, sensor: str, values: Sequence[float]) -> Sequence[float] | None:
        """Return a sample of one of the scenario's own sensors, changed by faults of the user; None: dropped.

        Raises ExtensionFailure if a fault fails.
        """
        changed: Sequence[float] | None = values
        for each in self._active if self._has_models else ():
            model = each.models.get(vehicle)
            if model is not None and changed is not None:
                changed = model.reading(sensor, changed)
        return changed

    def _sum(self, inputs_of: InputsOf | None) -> None:
        """Add up the effects of all active faults."""
        self._reset()
        for start_us, _, _, fault, models in self._active:
            if not models:
                self._add(_affected(fault), fault.effects())
                self.extra_attenuation_db += fault.effects().attenuation_db
                continue
            if inputs_of is None:
                raise TypeError("faults of the user require the state of the vehicles")
            since_s, attenuations_db = (self._now_us - start_us) * 1e-6, [0.0]
            for vehicle, model in models.items():
                effects = model.update(inputs_of(vehicle), since_s)
                self._add(slice(vehicle, vehicle + 1), effects)
                attenuations_db.append(effects.attenuation_db)
            self.extra_attenuation_db += max(attenuations_db)
        self.extra_attenuation_db = min(self.extra_attenuation_db, MOST_ATTENUATION_DB)

    def _add(self, affected: slice, effects: Effects) -> None:
        """Add the effects on vehicles, without the attenuation."""
        for name in _OFFSETS:
            offset = getattr(effects, name)
            if offset != getattr(UNCHANGED, name):
                total = getattr(self, name)
                if total is None:
                    total = np.zeros((self._vehicles, *np.shape(offset)))
                    setattr(self, name, total)
                total[affected] += offset
        for name in _FLAGS:
            if getattr(effects, name):
                flags = getattr(self, name)
                if flags is None:
                    flags = np.zeros(self._vehicles, dtype=np.bool_)
                    setattr(self, name, flags)
                flags[affected] = True
        for rotor, effectiveness in effects.rotor_effectiveness.items():
            if self.rotor_effectiveness is None:
                self.rotor_effectiveness = np.ones((self._vehicles, self._most_rotors))
            self.rotor_effectiveness[affected, rotor] *= effectiveness
        if effects.rotors_stopped:
            if self.rotor_stopped is None:
                self.rotor_stopped = np.zeros((self._vehicles, self._most_rotors), dtype=np.bool_)
            self.rotor_stopped[affected, list(effects.rotors_stopped)] = True


_FLAGS = ("baro_frozen", "gps_lost")
_OFFSETS = (
    "accel_offset_frd_m_s2", "gyro_offset_frd_rad_s", "mag_offset_frd_gauss", "heading_error_rad",
    "baro_offset_m", "gps_offset_ned_m", "gps_velocity_offset_ned_m_s", "force_ned_n", "range_offset_m",
)  # fmt: skip
"""Fields of `Effects` that add up, which are also attributes of `Faults`."""


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
