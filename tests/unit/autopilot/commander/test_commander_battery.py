"""The pack against integrals of its currents, the monitor against the pack's true charge. About 4 s."""

from math import sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs
from scipy.optimize import brentq

from autopilot.commander.battery import (
    SAMPLE_PERIOD_US,
    SETTLING_US,
    BatteryMonitor,
    BatteryParams,
    BatterySample,
    BatterySimParams,
    BatterySimulator,
    BatteryWarning,
    ResistanceEstimate,
    open_circuit_v,
    resistance_growth,
)
from foundation.airframe.files import IRIS, load

STEP = 4_000
PACK = BatteryParams()
SIM = BatterySimParams()
FULL_THRUST_N = 5.84e-6 * 1100.0**2
HOVER_N = 1.55 * 9.8066 / 4.0
HOVER = np.full(4, (1100.0 * sqrt(HOVER_N / FULL_THRUST_N) - 100.0) / 1000.0)
"""Controls of the Iris in hover, from thrust k w^2 at w = 1000 u + 100 rad/s."""
STANDING = np.zeros(4)
HOVER_A = 4 * 4.0 + SIM.avionics_current_a
DURATION_S = IRIS.battery.capacity_mah * 3.6 / HOVER_A
"""Charge over current: 18 min."""


class Flight:
    """A pack and its monitor, stepped together."""

    def __init__(self, sim=SIM, pack=PACK, step_us=STEP):
        self.pack = BatterySimulator(sim, pack)
        self.monitor = BatteryMonitor(pack)
        self.now_us = 0
        self.step_us = step_us
        self.samples = []

    def run(self, duration_s, controls=HOVER, *, armed=True):
        end_us = self.now_us + round(duration_s * 1e6)
        while self.now_us < end_us:
            self.now_us += self.step_us
            sample = self.pack.update(self.now_us, controls, armed=armed)
            if sample is not None:
                self.samples.append(sample)
                self.monitor.update(sample, armed=armed)
        return self

    def set_pack(self, **changes):
        pack = structs.replace(self.monitor.params, **changes)
        self.pack.set_params(self.pack.params, pack)
        self.monitor.set_params(pack)


def long_flight(**kwargs):
    """Return a flight with long steps: under constant controls the samples are the same."""
    return Flight(step_us=SAMPLE_PERIOD_US, **kwargs)


# ---- the pack


def test_hover_of_the_iris_draws_four_amperes_from_each_motor_and_lasts_eighteen_minutes():
    assert HOVER[0] == pytest.approx(0.707, abs=1e-3)
    assert 17.0 * 60.0 < DURATION_S <= 18.0 * 60.0
    flight = long_flight().run(DURATION_S - 1.0)
    assert flight.samples[-1].current_a == pytest.approx(HOVER_A, rel=1e-3)
    assert flight.pack.charge == pytest.approx(1.0 / DURATION_S, rel=0.5)
    assert flight.run(2.0).pack.charge == 0.0


@settings(max_examples=100, deadline=None)
@given(st.floats(0.0, 1.0))
def test_current_is_thrust_to_the_power_of_three_halves(thrust):
    """Power of a rotor in still air: T^1.5; 4 A at the hover thrust gives 4 (T / 3.80 N)^1.5."""
    thrust_n = max(thrust * FULL_THRUST_N, 5.84e-6 * 100.0**2)  # the least speed of an armed motor's rotor
    controls = np.full(4, (sqrt(thrust_n / 5.84e-6) - 100.0) / 1000.0)
    flight = Flight().run(0.1, controls)
    motors_a = flight.samples[-1].current_a - SIM.avionics_current_a
    assert motors_a == pytest.approx(16.0 * (thrust_n / HOVER_N) ** 1.5, rel=1e-3)


def test_the_drawn_charge_is_the_integral_of_the_current_over_changing_controls():
    """Against a sum over all steps: sampling at 10 Hz must include everything in between."""
    rng = np.random.default_rng(1)
    flight = Flight().run(STEP / 1e6, STANDING)  # the first sample starts the count
    charge_as = 0.0
    for _ in range(5_000):
        controls = rng.uniform(0.0, 1.0, 4)
        flight.run(STEP / 1e6, controls)
        current_a = SIM.avionics_current_a + 4.0 * (((controls + 0.1) / 0.8067) ** 3).sum()
        charge_as += current_a * STEP / 1e6
    drawn_as = (1.0 - flight.pack.charge) * IRIS.battery.capacity_mah * 3.6
    assert drawn_as == pytest.approx(charge_as, rel=1e-9)
    assert flight.monitor.consumed_mah == pytest.approx(charge_as / 3.6, rel=1e-9)


def test_a_disarmed_vehicle_draws_the_avionics_current():
    flight = Flight().run(10.0, HOVER, armed=False)
    assert flight.samples[-1].current_a == SIM.avionics_current_a


def test_voltage_falls_with_charge_and_with_current():
    charges = np.linspace(0.0, 1.0, 1001)
    voltages = [open_circuit_v(charge) for charge in charges]
    assert (np.diff(voltages) > 0.0).all()
    assert 2.6 < voltages[0] < 2.8
    assert 4.05 < voltages[-1] < 4.2
    for charge in (0.05, 0.3, 0.9):
        flight = Flight(structs.replace(SIM, initial=charge)).run(0.5, STANDING, armed=False)
        resting = flight.samples[-1]
        loaded = flight.run(0.1).samples[-1]
        # V0 - I R falls by R times the rise of the current, with R of three cells in series
        ohm = 3.0 * 0.005 * resistance_growth(charge)
        drop_v = resting.voltage_v - loaded.voltage_v
        assert drop_v == pytest.approx(ohm * (loaded.current_a - resting.current_a), rel=0.02)


def test_the_first_sample_is_at_the_first_step_and_then_every_20_ms():
    times = [sample.time_us for sample in Flight().run(1.0).samples]
    assert times[0] == STEP
    assert set(np.diff(times)) == {SAMPLE_PERIOD_US}


def test_a_floor_holds_the_charge_and_raising_it_charges():
    flight = long_flight(sim=structs.replace(SIM, minimum=0.5)).run(DURATION_S)
    assert flight.pack.charge == 0.5
    flight.pack.set_params(structs.replace(SIM, minimum=0.8), PACK)
    assert flight.run(1.0).pack.charge == 0.8
    flight.pack.set_params(SIM, PACK)
    assert flight.run(DURATION_S / 10.0).pack.charge == pytest.approx(0.7, abs=0.002)


def test_a_smaller_pack_is_at_once_emptier():
    flight = long_flight().run(DURATION_S / 4.0)
    flight.set_pack(capacity_mah=IRIS.battery.capacity_mah / 2.0)
    assert flight.pack.charge == pytest.approx(0.5, abs=0.001)
    flight.run(SAMPLE_PERIOD_US / 1e6)
    assert flight.monitor.remaining <= 0.501


def test_a_pack_of_unknown_capacity_is_that_of_the_airframe():
    unknown = BatteryParams(capacity_mah=-1.0)
    assert BatterySimulator(SIM, unknown, load("crazyflie")).capacity_mah == 240.0
    assert BatterySimulator(SIM, PACK, load("crazyflie")).capacity_mah == PACK.capacity_mah


def test_without_a_battery_there_is_no_sample():
    flight = Flight(structs.replace(SIM, enabled=0)).run(1.0)
    assert not flight.samples
    assert flight.monitor.sampled_us is None


def test_px4s_drain_is_linear_and_reset_by_disarming():
    flight = Flight(structs.replace(SIM, drain_s=60.0)).run(0.5, armed=False).run(30.0)
    assert flight.pack.charge == pytest.approx(0.5, abs=1e-3)
    # the monitor's filter lags by its time constant of 1 s, in which the charge falls by 1/60
    assert flight.monitor.remaining == pytest.approx(0.5 + 1.0 / 60.0, abs=2e-3)
    assert flight.monitor.current_a is None
    assert flight.monitor.time_remaining_s is None
    assert flight.run(0.1, armed=False).pack.charge == 1.0


# ---- the monitor


def test_the_estimates_error_is_bounded_by_that_of_the_linear_voltage_curve():
    """The error is at most the largest difference between charge and (V - 3.6) / 0.45, clamped to 0..1.

    V is the open-circuit voltage minus the drop at the resistance in excess of the estimate near empty. If V
    corresponds to more charge than is left, the coulomb counter limits the estimate. 0.5 % is for filter lag.
    """
    charges = np.linspace(0.0, 1.0, 2001)
    seen_v = [open_circuit_v(c) - HOVER_A * 0.005 * (resistance_growth(c) - 1.0) for c in charges]
    linear = np.clip((np.array(seen_v) - 3.6) / 0.45, 0.0, 1.0)
    largest = (charges - linear).max()
    assert 0.07 < largest < 0.08
    flight = long_flight()
    while flight.pack.charge > 0.0:
        flight.run(5.0)
        error = flight.pack.charge - flight.monitor.remaining
        assert -0.005 < error < largest + 0.005


def test_the_initial_charge_is_that_of_the_open_circuit_voltage():
    """A pack starting at 30 % has 3.748 V per cell, 0.33 by the line, with or without load."""
    for armed in (False, True):
        flight = Flight(structs.replace(SIM, initial=0.3)).run(1.0, armed=armed)
        assert flight.monitor.remaining == pytest.approx((open_circuit_v(0.3) - 3.6) / 0.45, abs=0.01)


def test_warnings_occur_in_order_at_their_thresholds():
    flight = long_flight()
    at = {}
    while flight.pack.charge > 0.0:
        flight.run(1.0)
        at.setdefault(flight.monitor.warning, flight.monitor.remaining)
    assert list(at) == list(BatteryWarning)
    # in one second 1 / 1080 is drawn; nearly empty the voltage falls faster
    for warning, threshold in (("LOW", 0.15), ("CRITICAL", 0.07), ("EMERGENCY", 0.05)):
        assert threshold - 0.02 < at[BatteryWarning[warning]] < threshold


def test_a_warning_never_improves_in_flight_and_follows_the_charge_on_the_ground():
    flight = Flight(structs.replace(SIM, initial=0.5)).run(3.0)
    assert flight.monitor.warning is BatteryWarning.NONE
    flight.set_pack(low=0.9)
    assert flight.run(0.1).monitor.warning is BatteryWarning.LOW
    flight.set_pack(critical=0.9)
    assert flight.run(0.1).monitor.warning is BatteryWarning.CRITICAL
    flight.set_pack(low=0.15, critical=0.07)
    assert flight.run(1.0).monitor.warning is BatteryWarning.CRITICAL
    assert flight.run(1.0, armed=False).monitor.warning is BatteryWarning.NONE


def test_no_warning_before_the_measurements_have_settled():
    flight = Flight(structs.replace(SIM, initial=0.01)).run((SETTLING_US - STEP) / 1e6)
    assert flight.monitor.warning is BatteryWarning.NONE
    assert flight.run(0.1).monitor.warning is BatteryWarning.EMERGENCY


def test_an_emptied_pack_is_an_emergency_within_three_seconds():
    """The voltage filter needs 1 s; below half charge the estimate follows the voltage faster than that."""
    flight = Flight().run(5.0)
    pack, whole = flight.pack, flight.pack.pack
    pack.set_params(pack.params, structs.replace(whole, capacity_mah=1.0))  # more than that has been drawn
    assert flight.run(3.0).monitor.warning is BatteryWarning.EMERGENCY
    pack.set_params(pack.params, whole)
    assert flight.run(5.0).monitor.warning is BatteryWarning.EMERGENCY


def test_time_remaining_is_charge_over_the_average_current():
    """The average starts at BAT_AVRG_CURRENT, changes only while armed, and settles in 5 time constants."""
    flight = Flight().run(3.0, STANDING, armed=False)
    assert flight.monitor.time_remaining_s == pytest.approx(flight.monitor.remaining * 5.1 * 3600.0 / 15.0)
    flight = long_flight().run(250.0)
    expected_s = flight.monitor.remaining * 5.1 * 3600.0 / HOVER_A
    assert flight.monitor.time_remaining_s == pytest.approx(expected_s, rel=0.002)


def test_without_a_capacity_the_charge_is_from_the_voltage_only():
    pack = structs.replace(PACK, capacity_mah=-1.0)
    flight = Flight(structs.replace(SIM, initial=0.6), pack).run(5.0)
    assert flight.monitor.remaining == pytest.approx((open_circuit_v(0.6) - 3.6) / 0.45, abs=0.01)
    assert flight.monitor.time_remaining_s is None


def test_changed_cells_and_resistance_change_the_estimate():
    flight = Flight(structs.replace(SIM, initial=0.3)).run(3.0)
    flight.monitor.set_params(structs.replace(PACK, internal_resistance_ohm=0.02))
    assert flight.monitor.cell_resistance_ohm == 0.02
    low = flight.monitor.remaining
    flight.run(5.0)  # 17 A times an error of 15 mOhm is 0.26 V per cell
    assert flight.monitor.remaining > low + 0.2
    flight.monitor.set_params(structs.replace(PACK, cells=4))
    flight.run(5.0)  # three cells' voltage divided by four is 2.8 V each
    assert flight.monitor.remaining == 0.0


def test_a_corrected_number_of_cells_acts_without_filter_delay():
    voltage_only = structs.replace(PACK, capacity_mah=-1.0)
    flight = Flight(structs.replace(SIM, initial=0.5), voltage_only).run(3.0)
    right = flight.monitor.remaining
    flight.monitor.set_params(structs.replace(voltage_only, cells=4))
    assert flight.run(SAMPLE_PERIOD_US / 1e6).monitor.remaining == 0.0
    flight.monitor.set_params(voltage_only)
    assert flight.run(SAMPLE_PERIOD_US / 1e6).monitor.remaining == pytest.approx(right, abs=0.01)


def test_nothing_is_integrated_over_a_gap_in_the_samples():
    """Five minutes without a battery at 17 A would be 1.4 Ah of 5.1, but nothing was drawn."""
    flight = Flight(structs.replace(SIM, initial=0.7)).run(30.0)
    consumed_mah, charge = flight.monitor.consumed_mah, flight.pack.charge
    flight.pack.set_params(structs.replace(SIM, enabled=0), PACK)
    flight.run(300.0)
    flight.pack.set_params(SIM, PACK)
    assert flight.pack.charge == charge
    flight.run(SAMPLE_PERIOD_US / 1e6)
    assert flight.monitor.consumed_mah == pytest.approx(consumed_mah, abs=HOVER_A * 0.02 / 3.6)
    assert flight.monitor.remaining == pytest.approx((open_circuit_v(charge) - 3.6) / 0.45, abs=0.02)
    flight.run(10.0)
    assert flight.monitor.consumed_mah == pytest.approx(consumed_mah + HOVER_A * 10.0 / 3.6, rel=0.01)
    assert flight.pack.charge - 0.08 < flight.monitor.remaining < flight.pack.charge + 0.005


def test_a_gap_of_a_second_is_integrated_and_a_longer_one_is_not():
    """10 A for one second are 2.78 mAh."""
    for gap_us, counted_mah in ((1_000_000, 10.0 / 3.6), (1_000_001, 0.0)):
        monitor = BatteryMonitor(PACK)
        monitor.update(BatterySample(0, 12.0, 10.0), armed=True)
        monitor.update(BatterySample(gap_us, 12.0, 10.0), armed=True)
        assert monitor.consumed_mah == pytest.approx(counted_mah)


@pytest.mark.parametrize("cells", [2, 4])
def test_a_new_number_of_cells_in_flight_causes_no_jump_and_no_warning(cells):
    """The pack changes too: voltage and charge of a cell stay the same; 2 % for the drop under load."""
    flight = Flight(structs.replace(SIM, initial=0.5)).run(10.0)
    consumed_mah = flight.monitor.consumed_mah
    flight.set_pack(cells=cells)
    by_voltage = (open_circuit_v(flight.pack.charge) - 3.6) / 0.45
    for _ in range(10_000_000 // SAMPLE_PERIOD_US):
        flight.run(SAMPLE_PERIOD_US / 1e6)
        assert flight.monitor.remaining == pytest.approx(by_voltage, abs=0.02)
        assert flight.monitor.warning is BatteryWarning.NONE
    assert flight.monitor.voltage_v == pytest.approx(flight.samples[-1].voltage_v, rel=1e-3)
    assert flight.monitor.cell_resistance_ohm == pytest.approx(0.005, rel=0.1)
    assert flight.monitor.consumed_mah == pytest.approx(consumed_mah + HOVER_A * 10.0 / 3.6, rel=0.01)


@settings(max_examples=100, deadline=None)
@given(st.floats(0.001, 0.03), st.integers(1, 12), st.integers(0, 2**32 - 1))
def test_resistance_is_found_from_changing_currents(cell_ohm, cells, seed):
    """V = V0 - I R without noise: the initial error is reduced to a tenth at least."""
    rng = np.random.default_rng(seed)
    estimate = ResistanceEstimate(cells)
    estimate.begin(cells * (3.8 - cell_ohm), 1.0)
    for current_a in rng.uniform(1.0, 40.0, 200):
        estimate.update(cells * (3.8 - cell_ohm * current_a), current_a)
    missed_ohm = abs(cell_ohm - ResistanceEstimate.FIRST_CELL_OHM)
    assert estimate.cell_ohm == pytest.approx(cell_ohm, abs=0.1 * missed_ohm + 1e-9)


def test_a_steady_current_does_not_make_the_resistance_drift():
    """The open-circuit voltage falls by 0.4 V per cell meanwhile, which must not affect the resistance."""
    flight = long_flight().run(5.0, STANDING, armed=False).run(30.0)
    early_ohm = flight.monitor.cell_resistance_ohm
    assert early_ohm == pytest.approx(0.005, rel=0.1)
    flight.run(0.8 * DURATION_S)
    assert flight.monitor.cell_resistance_ohm == pytest.approx(early_ohm, rel=0.1)


@settings(max_examples=50, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.floats(0.0, 60.0), st.floats(-50.0, 200.0) | st.none(), st.integers(1, 10**8), st.booleans()
        ),
        max_size=40,
    ),
    st.floats(2.0, 5.0),
    st.floats(2.0, 5.0),
)
def test_the_remaining_charge_is_a_fraction_for_all_measurements(measurements, charged_v, empty_v):
    monitor = BatteryMonitor(structs.replace(PACK, charged_v=charged_v, empty_v=empty_v))
    now_us, worst = 0, BatteryWarning.NONE
    for voltage_v, current_a, after_us, armed in measurements:
        now_us += after_us
        monitor.update(BatterySample(now_us, voltage_v, current_a), armed=armed)
        assert 0.0 <= monitor.remaining <= 1.0
        worst = max(worst, monitor.warning) if armed else monitor.warning
        assert monitor.warning is worst


def test_the_estimate_is_low_near_the_point_where_the_true_charge_is_low():
    """COM_LOW_BAT_ACT must not act at half charge: the estimate is low only if the pack is."""
    at = brentq(lambda charge: (open_circuit_v(charge) - 3.6) / 0.45 - PACK.low, 0.01, 0.5)
    assert at < PACK.low  # by voltage it would be later, so the coulomb counter decides
    flight = long_flight()
    while flight.monitor.warning is BatteryWarning.NONE:
        flight.run(1.0)
    assert flight.pack.charge == pytest.approx(PACK.low, abs=0.005)
