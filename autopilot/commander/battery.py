"""The battery: a model of the pack, and what the autopilot makes of its voltage and current.

The simulator interface has no battery, so the autopilot carries the pack's model itself, as PX4 does in
software in the loop. `BatterySimulator` is that plant, measured ten times a second; `BatteryMonitor` knows
only the measurements, as a power module gives them, and is PX4's estimator (src/lib/battery). What follows
from a warning is left to the failsafes.
"""

from collections.abc import Sequence
from enum import IntEnum
from math import exp, hypot
from typing import Annotated, NamedTuple

from msgspec import Meta, Struct

US_PER_S = 1_000_000
AS_PER_MAH = 3.6
SAMPLE_PERIOD_US = 100_000
"""The model is evaluated at 10 Hz; the steps between only add up the motors' currents."""
IRIS_CAPACITY_MAH = 5_100.0
"""The pack's charge where BAT1_CAPACITY leaves it unknown."""

Fraction = Annotated[float, Meta(ge=0.0, le=1.0)]
Positive = Annotated[float, Meta(gt=0.0)]
NonNegative = Annotated[float, Meta(ge=0.0)]


class BatteryParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The pack's data sheet and the levels that warn."""

    cells: Annotated[int, Meta(ge=1, le=16)] = 3
    """BAT1_N_CELLS, in series (PX4: unknown)"""
    capacity_mah: Annotated[float, Meta(ge=-1.0, le=100_000.0)] = IRIS_CAPACITY_MAH
    """BAT1_CAPACITY; zero or less is unknown: the voltage alone decides (PX4: unknown)"""
    charged_v: Annotated[float, Meta(ge=2.0, le=5.0)] = 4.05
    """BAT1_V_CHARGED: of a full cell, without load"""
    empty_v: Annotated[float, Meta(ge=2.0, le=5.0)] = 3.6
    """BAT1_V_EMPTY: of a cell that counts as empty, without load"""
    internal_resistance_ohm: Annotated[float, Meta(ge=-1.0, le=0.2)] = -1.0
    """BAT1_R_INTERNAL: of one cell; negative lets it be estimated"""
    average_current_a: Annotated[float, Meta(ge=0.0, le=500.0)] = 15.0
    """BAT_AVRG_CURRENT: what the remaining time is reckoned with at the beginning"""
    low: Fraction = 0.15
    """BAT_LOW_THR"""
    critical: Fraction = 0.07
    """BAT_CRIT_THR"""
    emergency: Fraction = 0.05
    """BAT_EMERGEN_THR"""


class BatterySimParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The pack as it is, and what draws on it."""

    enabled: Annotated[int, Meta(ge=0, le=1)] = 1
    """SIM_BAT_ENABLE: 0 leaves the vehicle without a battery to measure"""
    drain_s: Annotated[float, Meta(ge=0.0, le=86_400.0)] = 0.0
    """SIM_BAT_DRAIN: above 0 PX4's substitute for a model, a charge that falls from full to empty in this
    time while armed, is full again when disarmed, and has no current; 0 is the model (PX4: 60 s)"""
    minimum: Fraction = 0.0
    """SIM_BAT_MIN_PCT (there in percent): the charge never falls below; raising it charges (PX4: 50 %)"""
    initial: Fraction = 1.0
    """Charge at the beginning"""
    resistance_ohm: Annotated[float, Meta(ge=0.0, le=0.2)] = 0.005
    """Of one cell that is not near empty"""
    avionics_current_a: NonNegative = 1.0
    """All but the motors, armed or not"""
    hover_motor_current_a: NonNegative = 4.0
    """Of one motor at the rotor speed below"""
    hover_rotor_rad_s: Positive = 806.7
    """The Iris: 1.55 kg on four rotors of 5.84e-6 N s^2 is 3.80 N each"""


class BatterySample(NamedTuple):
    """One measurement of a power module."""

    time_us: int
    voltage_v: float
    """Of the pack under its load, at ``time_us``"""
    current_a: float | None
    """Mean since the sample before; None is not measured"""


def open_circuit_v(charge: float) -> float:
    """Voltage of an unloaded lithium-polymer cell at a charge 0..1.

    Chen and Rincon-Mora, "Accurate electrical battery model capable of predicting runtime and I-V
    performance", IEEE Trans. Energy Conversion 21 (2006), equation 2: 4.10 V full, a plain about 3.7 V, and
    a cliff below a tenth.
    """
    return 3.685 + charge * (0.2156 + charge * (-0.1178 + charge * 0.3201)) - 1.031 * exp(-35.0 * charge)


def resistance_growth(charge: float) -> float:
    """Resistance of a cell over that of a well charged one (the same, equation 3): 3.1 when empty."""
    return 1.0 + 0.1562 / 0.07446 * exp(-24.37 * charge)


class BatterySimulator:
    """The pack of one vehicle; `update` it several times a second.

    A motor draws what its rotor's power needs: the cube of the speed, which is thrust to the power of 1.5.
    The speed follows the command u as that of the physics' rotors, 1000 u + 100 rad/s. That a lower voltage
    needs more current for the same power is left out.
    """

    def __init__(self, params: BatterySimParams, pack: BatteryParams) -> None:
        self.params = params
        self.pack = pack
        self._drawn_mah = (1.0 - params.initial) * self.capacity_mah
        self._cubes = 0.0
        """Sum over the updates and motors of (u + 0.1)^3."""
        self._steps = 0
        self._begin_us: int | None = None
        """Of the present sample; None before the first step."""
        self._due_us = 0

    @property
    def capacity_mah(self) -> float:
        """Charge of the full pack."""
        return self.pack.capacity_mah if self.pack.capacity_mah > 0.0 else IRIS_CAPACITY_MAH

    @property
    def charge(self) -> float:
        """True charge, 0..1."""
        return max(1.0 - self._drawn_mah / self.capacity_mah, self.params.minimum)

    def set_params(self, params: BatterySimParams, pack: BatteryParams) -> None:
        """Change the settings; what was drawn stays drawn, so a smaller pack is at once emptier."""
        self.params = params
        self.pack = pack

    def update(self, now_us: int, controls: Sequence[float], *, armed: bool) -> BatterySample | None:
        """Draw what the motor ``controls`` (4,), 0..1, ask for; give a sample when one is due.

        The controls count for the time since the last update; these are taken to be equally far apart.
        """
        if armed:
            for control in controls:
                speed = control + 0.1
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
        in_hover = params.hover_rotor_rad_s / 1000.0
        current_a = params.avionics_current_a + params.hover_motor_current_a * cubes / in_hover**3
        self._draw(current_a * elapsed_s / AS_PER_MAH)
        charge = self.charge
        drop_v = current_a * params.resistance_ohm * resistance_growth(charge)
        return BatterySample(now_us, self.pack.cells * (open_circuit_v(charge) - drop_v), current_a)

    def _draw(self, charge_mah: float) -> None:
        most_mah = (1.0 - self.params.minimum) * self.capacity_mah
        self._drawn_mah = min(self._drawn_mah + charge_mah, most_mah)

    def _drain(self, now_us: int, elapsed_s: float, *, armed: bool) -> BatterySample:
        """PX4's own: the voltage is the one that the monitor takes for the charge."""
        if armed:
            self._draw(self.capacity_mah * elapsed_s / self.params.drain_s)
        else:
            self._drawn_mah = 0.0
        pack = self.pack
        charge = self.charge
        return BatterySample(now_us, pack.cells * (pack.empty_v + charge * _span_v(pack)), None)


class BatteryWarning(IntEnum):
    """How urgent it is, in the order of MAV_BATTERY_CHARGE_STATE from OK on."""

    NONE = 0
    LOW = 1
    CRITICAL = 2
    EMERGENCY = 3


FILTER_S = 1.0
"""Time constant of voltage and current."""
AVERAGE_S = 50.0
"""Time constant of the current that the remaining time is reckoned with; it moves only while armed."""
SETTLING_US = 2 * US_PER_S
"""From the beginning until the coulombs count."""
GAP_US = US_PER_S
"""Nothing is reckoned over a longer time without a sample, nor filtered: the monitor begins again."""
VOLTAGE_RATE_1_S = 3.0
"""How fast the estimate follows the voltage, times the share that is missing by the voltage: PX4's 0.03 at
each sample of its 100 Hz. The lower the voltage, the more it is trusted, against deep discharge."""


class BatteryMonitor:
    """What one vehicle knows of its battery; `update` with every sample.

    The remaining charge begins with that of the open-circuit voltage, counts coulombs, is drawn towards what
    the voltage says, and is at most what a pack that was full would have left. PX4 takes the open-circuit
    voltage as linear between empty and charged, so the estimate is up to 0.08 off the charge of a pack like
    `BatterySimulator`'s. After a gap in the samples and for another number of cells it begins again with the
    voltage; what was consumed stays consumed.
    """

    def __init__(self, params: BatteryParams) -> None:
        self.params = params
        self.reset()

    def reset(self) -> None:
        """Forget the battery, as for a fresh one."""
        self.sampled_us: int | None = None
        """Time of the last sample; None: there is no battery."""
        self.voltage_v = 0.0
        self.current_a: float | None = None
        """Both of the pack, filtered."""
        self.remaining = 1.0
        """0..1"""
        self.consumed_mah = 0.0
        self.warning = BatteryWarning.NONE
        """Only gets worse while armed."""
        self._first_us = 0
        self._cell_v = 0.0
        """Filtered open-circuit voltage."""
        self._average_a = self.params.average_current_a
        self._resistance = ResistanceEstimate(self.params.cells)
        self._begins = True
        """With the next sample."""

    def set_params(self, params: BatteryParams) -> None:
        """Change the settings; they count from the next sample on."""
        if params.cells != self.params.cells:
            self._resistance = ResistanceEstimate(params.cells)
            self._begins = True
        self.params = params

    @property
    def time_remaining_s(self) -> float | None:
        """How long the charge lasts at the average current; None: no capacity or no current is known."""
        if self.params.capacity_mah <= 0.0 or self.current_a is None:
            return None
        return self.remaining * self.params.capacity_mah * AS_PER_MAH / max(self._average_a, 0.01)

    @property
    def cell_resistance_ohm(self) -> float:
        """Internal resistance of one cell: BAT1_R_INTERNAL, else the estimate."""
        given = self.params.internal_resistance_ohm
        return given if given >= 0.0 else self._resistance.cell_ohm

    def update(self, sample: BatterySample, *, armed: bool) -> None:
        """Take a measurement, later than the last."""
        params = self.params
        elapsed_s = 0.0
        if self._begins or self.sampled_us is None or sample.time_us - self.sampled_us > GAP_US:
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
        self._begins = False
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
    """Voltage between an empty and a full cell; never zero, however the two are set."""
    return max(pack.charged_v - pack.empty_v, 0.05)


class ResistanceEstimate:
    """Open-circuit voltage and resistance from voltage and current: recursive least squares with forgetting.

    PX4's: V = (1, -I) (V0, R), and a sample counts only if it makes the covariance smaller, for a steady
    current says nothing of the resistance and forgetting would let the estimate drift.
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
        """Take the first measurement of the pack for the open-circuit voltage."""
        self._pack_v = voltage_v + self._pack_ohm * current_a

    def update(self, voltage_v: float, current_a: float) -> None:
        """Take a measurement of the pack."""
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
        """Frobenius norm."""
        return hypot(v_v, v_r, v_r, r_r)
