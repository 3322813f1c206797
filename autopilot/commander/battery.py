"""Battery: a model of the pack, and PX4's estimator of its charge.

The simulator interface has no battery, so the autopilot simulates the pack itself, as PX4 does in software in
the loop. `BatterySimulator` is the plant, measured at 10 Hz. `BatteryMonitor` uses only the measurements of a
power module and is PX4's estimator (src/lib/battery). Failsafes act on the warnings.
"""

from collections.abc import Sequence
from enum import IntEnum
from math import exp, hypot
from typing import Annotated, NamedTuple

from msgspec import Meta, Struct

from foundation.airframe.description import Airframe
from foundation.airframe.files import IRIS

US_PER_S = 1_000_000
AS_PER_MAH = 3.6
SAMPLE_PERIOD_US = 100_000
"""The model is evaluated at 10 Hz; the steps in between only accumulate the motors' currents."""

Fraction = Annotated[float, Meta(ge=0.0, le=1.0)]
Positive = Annotated[float, Meta(gt=0.0)]
NonNegative = Annotated[float, Meta(ge=0.0)]


class BatteryParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Data sheet of the pack and warning levels."""

    cells: Annotated[int, Meta(ge=1, le=16)] = 3
    """BAT1_N_CELLS: number of cells in series (PX4: unknown)"""
    capacity_mah: Annotated[float, Meta(ge=-1.0, le=100_000.0)] = IRIS.battery.capacity_mah
    """BAT1_CAPACITY: capacity; 0 or less: unknown, the charge is estimated from the voltage only (PX4:
    unknown)"""
    charged_v: Annotated[float, Meta(ge=2.0, le=5.0)] = 4.05
    """BAT1_V_CHARGED: voltage of a full cell without load"""
    empty_v: Annotated[float, Meta(ge=2.0, le=5.0)] = 3.6
    """BAT1_V_EMPTY: voltage of an empty cell without load"""
    internal_resistance_ohm: Annotated[float, Meta(ge=-1.0, le=0.2)] = -1.0
    """BAT1_R_INTERNAL: resistance of one cell; negative: estimated"""
    average_current_a: Annotated[float, Meta(ge=0.0, le=500.0)] = 15.0
    """BAT_AVRG_CURRENT: initial average current for the remaining time"""
    low: Fraction = 0.15
    """BAT_LOW_THR: remaining charge below which the battery is low"""
    critical: Fraction = 0.07
    """BAT_CRIT_THR: remaining charge below which the battery is critical"""
    emergency: Fraction = 0.05
    """BAT_EMERGEN_THR: remaining charge below which the battery is empty"""


class BatterySimParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The simulated pack and its load."""

    enabled: Annotated[int, Meta(ge=0, le=1)] = 1
    """SIM_BAT_ENABLE: 0 simulates no battery"""
    drain_s: Annotated[float, Meta(ge=0.0, le=86_400.0)] = 0.0
    """SIM_BAT_DRAIN: above 0 PX4's simple model, a charge that falls from full to empty in this time while
    armed, is full when disarmed, and has no current; 0 uses the model of the pack (PX4: 60 s)"""
    minimum: Fraction = 0.0
    """SIM_BAT_MIN_PCT (there in percent): the charge never falls below it; raising it charges (PX4: 50 %)"""
    initial: Fraction = 1.0
    """Initial charge"""
    resistance_ohm: Annotated[float, Meta(ge=0.0, le=0.2)] = 0.005
    """Resistance of one cell that is not nearly empty"""
    avionics_current_a: NonNegative = 1.0
    """Current of everything except the motors, armed or not"""
    hover_motor_current_a: NonNegative = 4.0
    """Current of one motor at the rotor speed below"""
    hover_rotor_rad_s: Positive = 806.7
    """Rotor speed of that current; that of the Iris in hover: 1.55 kg on four rotors, 3.80 N each"""


class BatterySample(NamedTuple):
    """One measurement of a power module."""

    time_us: int
    voltage_v: float
    """Pack voltage under load at ``time_us``"""
    current_a: float | None
    """Mean since the previous sample; None: not measured"""


def open_circuit_v(charge: float) -> float:
    """Return the voltage of an unloaded lithium-polymer cell at a charge 0..1.

    Chen and Rincon-Mora, "Accurate electrical battery model capable of predicting runtime and I-V
    performance", IEEE Trans. Energy Conversion 21 (2006), equation 2: 4.10 V full, a plateau near 3.7 V, and
    a steep drop below a charge of 0.1.
    """
    return 3.685 + charge * (0.2156 + charge * (-0.1178 + charge * 0.3201)) - 1.031 * exp(-35.0 * charge)


def resistance_growth(charge: float) -> float:
    """Return a cell's resistance relative to a well charged one (same source, equation 3): 3.1 empty."""
    return 1.0 + 0.1562 / 0.07446 * exp(-24.37 * charge)


class BatterySimulator:
    """Simulated pack of one vehicle; call `update` several times a second.

    The motor current is proportional to rotor power, the cube of the speed, which follows the command u as in
    the physics: idle speed plus u times the range. That a lower voltage requires a greater current is
    neglected.
    """

    def __init__(self, params: BatterySimParams, pack: BatteryParams, airframe: Airframe = IRIS) -> None:
        self.params = params
        self.pack = pack
        self._full_mah = airframe.battery.capacity_mah
        """Charge of the pack if BAT1_CAPACITY is unknown."""
        self._range_rad_s = airframe.propulsion.range_rad_s
        self._idle = airframe.propulsion.idle_rad_s / airframe.propulsion.range_rad_s
        self._drawn_mah = (1.0 - params.initial) * self.capacity_mah
        self._cubes = 0.0
        """Sum over the updates and motors of the cubes of the speed, as a multiple of the range."""
        self._steps = 0
        self._begin_us: int | None = None
        """Begin of the present sample; None before the first step."""
        self._due_us = 0

    @property
    def capacity_mah(self) -> float:
        """Capacity of the full pack."""
        return self.pack.capacity_mah if self.pack.capacity_mah > 0.0 else self._full_mah

    @property
    def charge(self) -> float:
        """True charge, 0..1."""
        return max(1.0 - self._drawn_mah / self.capacity_mah, self.params.minimum)

    def set_params(self, params: BatterySimParams, pack: BatteryParams) -> None:
        """Change the settings; the drawn charge is kept, so a smaller pack is emptier at once."""
        self.params = params
        self.pack = pack

    def update(self, now_us: int, controls: Sequence[float], *, armed: bool) -> BatterySample | None:
        """Draw the current of the motor ``controls`` (n,), 0..1; return a sample if one is due.

        The controls apply to the time since the last update; updates are assumed to be equally spaced.
        """
        if armed:
            for control in controls:
                speed = control + self._idle
                self._cubes += speed * speed * speed
        self._steps += 1
        if now_us < self._due_us:
            return None
        return self._sample(now_us, armed=armed)

    def _sample(self, now_us: int, *, armed: bool) -> BatterySample | None:
        begin_us = now_us if self._begin_us is None else self._begin_us
        elapsed_s = (now_us - begin_us) / US_PER_S
        cubes = self._cubes / self._steps
        self._begin_us, self._due_us = now_us, now_us + SAMPLE_PERIOD_US
        self._cubes, self._steps = 0.0, 0
        params = self.params
        if not params.enabled:
            return None
        if params.drain_s > 0.0:
            return self._drain(now_us, elapsed_s, armed=armed)
        in_hover = params.hover_rotor_rad_s / self._range_rad_s
        current_a = params.avionics_current_a + params.hover_motor_current_a * cubes / in_hover**3
        self._draw(current_a * elapsed_s / AS_PER_MAH)
        charge = self.charge
        drop_v = current_a * params.resistance_ohm * resistance_growth(charge)
        return BatterySample(now_us, self.pack.cells * (open_circuit_v(charge) - drop_v), current_a)

    def _draw(self, charge_mah: float) -> None:
        most_mah = (1.0 - self.params.minimum) * self.capacity_mah
        self._drawn_mah = min(self._drawn_mah + charge_mah, most_mah)

    def _drain(self, now_us: int, elapsed_s: float, *, armed: bool) -> BatterySample:
        """PX4's simple model: the voltage is that which `BatteryMonitor` converts to the same charge."""
        if armed:
            self._draw(self.capacity_mah * elapsed_s / self.params.drain_s)
        else:
            self._drawn_mah = 0.0
        pack = self.pack
        charge = self.charge
        return BatterySample(now_us, pack.cells * (pack.empty_v + charge * _span_v(pack)), None)


class BatteryWarning(IntEnum):
    """Warning levels, in the order of MAV_BATTERY_CHARGE_STATE starting at OK."""

    NONE = 0
    LOW = 1
    CRITICAL = 2
    EMERGENCY = 3


FILTER_S = 1.0
"""Time constant of voltage and current."""
AVERAGE_S = 50.0
"""Time constant of the average current for the remaining time, which is filtered only while armed."""
SETTLING_US = 2 * US_PER_S
"""Time from the first sample during which the coulomb counter is not used."""
GAP_US = US_PER_S
"""A longer time without a sample restarts the monitor; no charge is integrated over it."""
VOLTAGE_RATE_1_S = 3.0
"""Rate at which the estimate follows the voltage, multiplied by the missing share according to the voltage.
PX4: 0.03 per sample at 100 Hz. A lower voltage has a greater weight, to prevent deep discharge."""


class BatteryMonitor:
    """Battery state estimate of one vehicle; call `update` with every sample.

    The remaining charge is initialised from the open-circuit voltage, counts coulombs, is corrected towards
    the charge by voltage, and is limited to what an initially full pack would have left. PX4 assumes a linear
    open-circuit voltage between empty and charged, so the estimate differs by up to 0.08 from the charge of
    `BatterySimulator`. A gap in the samples or a change of the number of cells initialises it again from the
    voltage; the consumed charge is kept.
    """

    def __init__(self, params: BatteryParams) -> None:
        self.params = params
        self.reset()

    def reset(self) -> None:
        """Reset to the state of a fresh battery."""
        self.sampled_us: int | None = None
        """Time of the last sample; None: no battery."""
        self.voltage_v = 0.0
        self.current_a: float | None = None
        """Filtered voltage and current of the pack."""
        self.remaining = 1.0
        """Remaining charge, 0..1."""
        self.consumed_mah = 0.0
        self.warning = BatteryWarning.NONE
        """Never improves while armed."""
        self._first_us = 0
        self._cell_v = 0.0
        """Filtered open-circuit voltage."""
        self._average_a = self.params.average_current_a
        self._resistance = ResistanceEstimate(self.params.cells)
        self._needs_begin = True
        """The next sample initialises the estimate."""

    def set_params(self, params: BatteryParams) -> None:
        """Change the settings, in effect from the next sample."""
        if params.cells != self.params.cells:
            self._resistance = ResistanceEstimate(params.cells)
            self._needs_begin = True
        self.params = params

    @property
    def time_remaining_s(self) -> float | None:
        """Return how long the charge lasts at the average current; None if capacity or current is unknown."""
        if self.params.capacity_mah <= 0.0 or self.current_a is None:
            return None
        return self.remaining * self.params.capacity_mah * AS_PER_MAH / max(self._average_a, 0.01)

    @property
    def cell_resistance_ohm(self) -> float:
        """Return the internal resistance of one cell: BAT1_R_INTERNAL if set, else the estimate."""
        given = self.params.internal_resistance_ohm
        return given if given >= 0.0 else self._resistance.cell_ohm

    def update(self, sample: BatterySample, *, armed: bool) -> None:
        """Update with a measurement that is later than the last one."""
        params = self.params
        elapsed_s = 0.0
        if self._needs_begin or self.sampled_us is None or sample.time_us - self.sampled_us > GAP_US:
            self._begin(sample)
        else:
            elapsed_s = (sample.time_us - self.sampled_us) / US_PER_S
        self.sampled_us = sample.time_us
        cell_v = sample.voltage_v / params.cells
        if sample.current_a is not None and sample.current_a > 0.0:
            self._resistance.update(sample.voltage_v, sample.current_a)
            cell_v += self.cell_resistance_ohm * sample.current_a
        self._filter(sample, cell_v, elapsed_s, armed=armed)
        by_voltage = min(max((self._cell_v - params.empty_v) / _span_v(params), 0.0), 1.0)
        drawn_mah = 0.0 if sample.current_a is None else sample.current_a * elapsed_s / AS_PER_MAH
        self.consumed_mah += drawn_mah
        settled = sample.time_us - self._first_us >= SETTLING_US
        if settled and params.capacity_mah > 0.0 and sample.current_a is not None:
            weight = min(VOLTAGE_RATE_1_S * elapsed_s * (1.0 - by_voltage), 1.0)
            fused = (1.0 - weight) * self.remaining + weight * by_voltage - drawn_mah / params.capacity_mah
            most = min(1.0 - self.consumed_mah / params.capacity_mah, 1.0)
            self.remaining = max(min(fused, most), 0.0)
        else:
            self.remaining = by_voltage
        if settled:
            level = self._level()
            self.warning = max(level, self.warning) if armed else level

    def _begin(self, sample: BatterySample) -> None:
        self._needs_begin = False
        self._first_us = sample.time_us
        self.voltage_v, self.current_a = sample.voltage_v, sample.current_a
        current_a = sample.current_a or 0.0
        self._cell_v = sample.voltage_v / self.params.cells + self.cell_resistance_ohm * current_a
        self._resistance.begin(sample.voltage_v, current_a)

    def _filter(self, sample: BatterySample, cell_v: float, elapsed_s: float, *, armed: bool) -> None:
        share = elapsed_s / (FILTER_S + elapsed_s)
        self.voltage_v += share * (sample.voltage_v - self.voltage_v)
        self._cell_v += share * (cell_v - self._cell_v)
        if sample.current_a is None or self.current_a is None:
            self.current_a = sample.current_a
        else:
            self.current_a += share * (sample.current_a - self.current_a)
        if armed and sample.current_a is not None:
            self._average_a += elapsed_s / (AVERAGE_S + elapsed_s) * (sample.current_a - self._average_a)

    def _level(self) -> BatteryWarning:
        params = self.params
        if self.remaining < params.emergency:
            return BatteryWarning.EMERGENCY
        if self.remaining < params.critical:
            return BatteryWarning.CRITICAL
        return BatteryWarning.LOW if self.remaining < params.low else BatteryWarning.NONE


def _span_v(pack: BatteryParams) -> float:
    """Return the voltage between an empty and a full cell, at least 0.05 V."""
    return max(pack.charged_v - pack.empty_v, 0.05)


class ResistanceEstimate:
    """Estimate of open-circuit voltage and resistance by recursive least squares with forgetting.

    As in PX4: V = (1, -I) (V0, R). A sample is used only if it reduces the covariance, because a steady
    current does not make the resistance observable and forgetting would let the estimate drift.
    """

    FORGETTING = 0.95
    FIRST_CELL_OHM = 0.005

    def __init__(self, cells: int) -> None:
        self._cells = cells
        self._pack_ohm = self.FIRST_CELL_OHM * cells
        self._pack_v = 0.0
        self._v_v, self._v_r, self._r_r = 1.5 * cells, 0.0, 0.1 * cells
        """Covariance of voltage and resistance, V^2, V Ohm and Ohm^2."""
        self._norm = self._size(self._v_v, self._v_r, self._r_r)

    @property
    def cell_ohm(self) -> float:
        """Estimated resistance of one cell, not negative."""
        return max(self._pack_ohm / self._cells, 0.0)

    def begin(self, voltage_v: float, current_a: float) -> None:
        """Initialise the open-circuit voltage from the first measurement of the pack."""
        self._pack_v = voltage_v + self._pack_ohm * current_a

    def update(self, voltage_v: float, current_a: float) -> None:
        """Update with a measurement of the pack."""
        to_v = self._v_v - self._v_r * current_a
        to_r = self._v_r - self._r_r * current_a
        scale = 1.0 / (self.FORGETTING + to_v - to_r * current_a)
        v_v = (self._v_v - scale * to_v * to_v) / self.FORGETTING
        v_r = (self._v_r - scale * to_v * to_r) / self.FORGETTING
        r_r = (self._r_r - scale * to_r * to_r) / self.FORGETTING
        norm = self._size(v_v, v_r, r_r)
        if norm < self._norm:
            error_v = voltage_v - (self._pack_v - self._pack_ohm * current_a)
            self._pack_v += scale * to_v * error_v
            self._pack_ohm += scale * to_r * error_v
            self._v_v, self._v_r, self._r_r, self._norm = v_v, v_r, r_r, norm
        else:
            self._pack_v = voltage_v + self._pack_ohm * current_a

    @staticmethod
    def _size(v_v: float, v_r: float, r_r: float) -> float:
        return hypot(v_v, v_r, v_r, r_r)
