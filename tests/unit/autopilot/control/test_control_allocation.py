"""Allocation against the physical motor curve and a linear programme of the achievable demands."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs
from scipy.optimize import linprog

from autopilot.control.allocation import Allocator
from autopilot.control.mixing import effectiveness, mixer
from autopilot.control.params import AllocationParams
from foundation.airframe.description import Rotor

PARAMS = AllocationParams()
THRUST_N_S2 = 5.84e-6
IDLE_N = THRUST_N_S2 * 100.0**2
RANGE_N = THRUST_N_S2 * 1100.0**2 - IDLE_N

demand = st.floats(-2.0, 2.0)


def rotor_thrust_n(controls):
    return THRUST_N_S2 * (1000.0 * controls + 100.0) ** 2


def body_torque_nm(controls):
    return effectiveness(PARAMS)[1:] @ rotor_thrust_n(controls)


def demanded_torque_nm(torque):
    """Return the torque of a normalised demand: the mixer's share of the thrust range of each rotor."""
    return effectiveness(PARAMS)[1:] @ (mixer(PARAMS).torque @ torque) * RANGE_N


def test_motor_curve_is_inverted_exactly():
    for thrust in np.linspace(0.0, 1.0, 101):
        controls = Allocator(PARAMS).allocate(float(thrust), np.zeros(3), airmode=True)
        np.testing.assert_allclose(rotor_thrust_n(controls), IDLE_N + thrust * RANGE_N, rtol=1e-12)


def test_hover_control_of_the_iris():
    """1.55 kg: 3.80 N per rotor, w = 806.7 rad/s, control 0.707, (806.7^2 - 100^2) / 1.2e6 = 0.534."""
    controls = Allocator(PARAMS).allocate(0.534, np.zeros(3), airmode=True)
    assert controls == pytest.approx(0.707, abs=1e-3)


def test_signs_of_torque():
    """Roll right: more thrust on the left. Pitch up: more in front. Yaw right: more counter-clockwise."""
    for axis, more in ((0, (1, 2)), (1, (0, 2)), (2, (0, 1))):
        torque = np.zeros(3)
        torque[axis] = 0.1
        controls = Allocator(PARAMS).allocate(0.5, torque, airmode=True)
        less = [i for i in range(4) if i not in more]
        assert controls[list(more)].min() > controls[less].max()
        assert body_torque_nm(controls)[axis] > 0.0


@settings(max_examples=300, deadline=None)
@given(st.floats(-0.5, 1.5), demand, demand, demand, st.booleans())
def test_outputs_stay_in_range(thrust, roll, pitch, yaw, airmode):
    controls = Allocator(PARAMS).allocate(thrust, np.array((roll, pitch, yaw)), airmode=airmode)
    assert controls.min() >= 0.0
    assert controls.max() <= 1.0


@settings(max_examples=150, deadline=None)
@given(st.floats(0.0, 1.0), demand, demand, demand)
def test_roll_and_pitch_are_kept_whenever_achievable(thrust, roll, pitch, yaw):
    torque = np.array((roll, pitch, yaw))
    wanted_nm = demanded_torque_nm(torque)[:2]
    rows = effectiveness(PARAMS)[1:3] * RANGE_N
    achievable = linprog(np.zeros(4), A_eq=rows, b_eq=wanted_nm, bounds=[(1e-6, 1.0 - 1e-6)] * 4).success
    allocator = Allocator(PARAMS)
    given_nm = body_torque_nm(allocator.allocate(thrust, torque, airmode=True))[:2]
    if achievable:
        np.testing.assert_allclose(given_nm, wanted_nm, atol=1e-9)
        assert not allocator.record.unallocated[:2].any()
    else:  # less, but in the same direction
        assert given_nm[0] * wanted_nm[1] == pytest.approx(given_nm[1] * wanted_nm[0], abs=1e-9)
        assert np.linalg.norm(given_nm) <= np.linalg.norm(wanted_nm) + 1e-9
        assert given_nm @ wanted_nm >= 0.0


@settings(max_examples=200, deadline=None)
@given(st.floats(0.0, 1.0), demand, demand, demand, st.booleans())
def test_reports_the_achieved_thrust_and_torque(thrust, roll, pitch, yaw, airmode):
    torque = np.array((roll, pitch, yaw))
    allocator = Allocator(PARAMS)
    controls = allocator.allocate(thrust, torque, airmode=airmode)
    given_nm = demanded_torque_nm(torque - allocator.record.unallocated)
    np.testing.assert_allclose(body_torque_nm(controls), given_nm, atol=1e-9)
    achieved = allocator.record
    relative_thrust = achieved.thrust + (mixer(PARAMS).torque @ (torque - achieved.unallocated)).mean()
    assert np.mean(rotor_thrust_n(controls)) == pytest.approx(IDLE_N + RANGE_N * relative_thrust, abs=1e-9)


@settings(max_examples=200, deadline=None)
@given(st.floats(0.3, 0.7), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1))
def test_small_demands_are_achieved_completely(thrust, roll, pitch, yaw):
    allocator = Allocator(PARAMS)
    allocator.allocate(thrust, np.array((roll, pitch, yaw)), airmode=False)
    assert allocator.record.thrust == pytest.approx(thrust, abs=1e-12)
    assert not allocator.record.unallocated.any()


@settings(max_examples=200, deadline=None)
@given(st.floats(0.0, 1.0), demand, demand, demand)
def test_without_airmode_torque_never_adds_thrust(thrust, roll, pitch, yaw):
    allocator = Allocator(PARAMS)
    allocator.allocate(thrust, np.array((roll, pitch, yaw)), airmode=False)
    assert allocator.record.thrust <= thrust + 1e-12


def test_yaw_is_reduced_before_roll_and_thrust_by_at_most_its_margin():
    allocator = Allocator(PARAMS)
    allocator.allocate(1.0, np.array((0.0, 0.0, 1.0)), airmode=True)
    assert allocator.record.thrust == pytest.approx(1.0 - PARAMS.yaw_thrust_margin)
    # the rotors that yaw increases reach 1 when yaw has used the margin: the most used one changes by 1 per
    # unit
    assert allocator.record.unallocated[2] == pytest.approx(1.0 - PARAMS.yaw_thrust_margin)
    allocator.allocate(0.5, np.array((0.7, 0.0, 1.0)), airmode=True)
    assert allocator.record.unallocated[0] == 0.0
    assert allocator.record.unallocated[2] > 0.9


def test_infeasible_airframes_are_rejected():
    in_line = tuple(
        Rotor(position_frd_m=(x, 0.0, 0.0), turns=turns)
        for x, turns in ((1.0, "ccw"), (2.0, "cw"), (-1.0, "ccw"), (-2.0, "cw"))
    )
    with pytest.raises(ValueError, match="independently"):
        Allocator(AllocationParams(rotors=in_line))
    shifted = tuple(
        structs.replace(r, position_frd_m=(r.position_frd_m[0] + 0.14, *r.position_frd_m[1:]))
        for r in PARAMS.rotors
    )
    with pytest.raises(ValueError, match=r"rotors\[[02]\] without thrust"):
        Allocator(AllocationParams(rotors=shifted))
