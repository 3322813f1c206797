"""Mixers of any airframe: inverse of the effectiveness matrix, hover, failures of motors."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from autopilot.control.airframe_gains import acceleration_rad_s2, allocation_params, control_params
from autopilot.control.allocation import Allocator
from autopilot.control.mixing import effectiveness, mixer, mixer_without
from autopilot.control.params import AllocationParams, ControlParams
from autopilot.parameters.airframe_settings import settings_of
from autopilot.parameters.table import Settings
from foundation.airframe.description import Rotor
from foundation.airframe.files import IRIS, load, names

demand = st.floats(-2.0, 2.0)


def params_of(name):
    return allocation_params(load(name))


@st.composite
def ring(draw):
    """Return rotors on a ring with perturbed positions and axes, directions in turn."""
    count = draw(st.integers(4, 12))
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    angles = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False) + rng.uniform(-0.1, 0.1, count) + 0.3
    return AllocationParams(
        rotors=tuple(
            Rotor(
                position_frd_m=(0.3 * np.cos(angle), 0.3 * np.sin(angle), rng.uniform(-0.05, 0.05)),
                turns="ccw" if k % 2 else "cw",
                axis_frd=(rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1), -1.0),
            )
            for k, angle in enumerate(angles)
        )
    )


@settings(max_examples=100, deadline=None)
@given(ring())
def test_the_mixer_inverts_the_effectiveness(params):
    """Each column causes its own torque alone and no thrust; the lift causes thrust alone."""
    matrix = effectiveness(params)
    try:
        mixed = mixer(params)
    except ValueError:
        return  # an odd number of rotors in a ring may not balance the torque about the vertical
    caused = matrix @ mixed.torque
    assert (np.diag(caused[1:]) > 0.0).all()
    np.testing.assert_allclose(caused[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(caused[1:], np.diag(np.diag(caused[1:])), atol=1e-12)
    lifted = matrix @ mixed.lift
    np.testing.assert_allclose(lifted[1:], 0.0, atol=1e-9)
    assert mixed.lift.min() > 0.0
    assert mixed.lift.mean() == pytest.approx(1.0)


@pytest.mark.parametrize("name", names())
def test_hover_thrust_balances_the_weight(name):
    """The control of the hover share turns each rotor at the speed at which all of them carry the weight."""
    airframe = load(name)
    unit = airframe.propulsion
    controls = Allocator(params_of(name)).allocate(airframe.hover_share, np.zeros(3), airmode=True)
    thrust_n = unit.thrust_n_s2 * (unit.idle_rad_s + unit.range_rad_s * controls) ** 2
    assert thrust_n.sum() == pytest.approx(airframe.mass_kg * 9.8066, rel=1e-9)
    np.testing.assert_allclose(effectiveness(params_of(name))[1:] @ thrust_n, 0.0, atol=1e-6)


CASES = [(name, ()) for name in names()] + [
    ("hexacopter", (0,)), ("hexacopter", (3,)), ("octocopter", (2,)), ("octocopter", (1, 5)),
]  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(st.floats(0.0, 1.0), demand, demand, demand, st.booleans())
@pytest.mark.parametrize(("name", "failed"), CASES)
def test_reports_the_achieved_thrust_and_torque(name, failed, thrust, roll, pitch, yaw, airmode):
    """Within 0..1 of each control, and the same torque for a demand as with all motors; yaw if controlled."""
    params = params_of(name)
    allocator = Allocator(params)
    allocator.remove(failed)
    torque = np.array((roll, pitch, yaw))
    controls = allocator.allocate(thrust, torque, airmode=airmode)
    assert controls.min() >= 0.0
    assert controls.max() <= 1.0
    assert not controls[list(failed)].any()
    factor = params.thrust_model_factor
    relative = factor * controls**2 + (1.0 - factor) * controls
    record = allocator.record
    matrix, intact = effectiveness(params), mixer(params)
    expected = matrix[1:] @ intact.torque @ (torque - record.unallocated)
    axes = slice(None) if allocator.controls_yaw else slice(2)
    np.testing.assert_allclose((matrix[1:] @ relative)[axes], expected[axes], atol=1e-9)
    assert relative.sum() == pytest.approx(len(controls) * record.thrust, abs=1e-9)
    if not airmode:
        assert record.thrust <= thrust + 1e-12


@settings(max_examples=60, deadline=None)
@given(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05), st.floats(-0.05, 0.05))
@pytest.mark.parametrize(("name", "failed"), CASES)
def test_small_demands_in_hover_are_achieved_completely(name, failed, roll, pitch, yaw):
    allocator = Allocator(params_of(name))
    allocator.remove(failed)
    allocator.allocate(load(name).hover_share, np.array((roll, pitch, yaw)), airmode=False)
    assert allocator.record.thrust == pytest.approx(load(name).hover_share, abs=1e-12)
    assert not allocator.record.unallocated[: 3 if allocator.controls_yaw else 2].any()


@pytest.mark.parametrize("failed", range(6))
def test_a_hexacopter_flies_on_with_four_rotors_and_without_yaw(failed):
    """The rotor opposite to the failed one stands still too, the others carry 6/4 each."""
    mixed = mixer_without(params_of("hexacopter"), {failed})
    assert set(mixed.rotors) == set(range(6)) - {failed, (failed + 3) % 6}
    np.testing.assert_allclose(mixed.lift, 1.5)
    assert not mixed.controls_yaw
    assert not mixed.torque[:, 2].any()
    matrix = effectiveness(params_of("hexacopter"))[:, mixed.rotors]
    np.testing.assert_allclose(matrix @ mixed.lift, (6.0, 0.0, 0.0, 0.0), atol=1e-9)


def test_an_octocopter_keeps_yaw_and_a_quadrotor_cannot_fly_on():
    mixed = mixer_without(params_of("octocopter"), {2})
    assert mixed.controls_yaw
    assert set(mixed.rotors) == set(range(8)) - {2}
    for name in ("iris", "x500", "crazyflie"):
        assert mixer_without(params_of(name), {1}) is None


def imperfect(name, rng, *, tilt_deg=0.0, offset_m=0.0, centre_m=0.0):
    """Return an airframe with tilted rotors, wrong positions and its centre of mass off the middle."""
    params = params_of(name)
    centre = rng.uniform(-centre_m, centre_m, 3)
    rotors = []
    for rotor in params.rotors:
        tilt = rng.uniform(-1.0, 1.0, 2) * np.tan(np.radians(tilt_deg))
        position = np.array(rotor.position_frd_m) + rng.uniform(-offset_m, offset_m, 3) - centre
        rotors.append(
            replace(rotor, axis_frd=(*tilt.tolist(), -1.0), position_frd_m=tuple(position.tolist()))
        )
    return replace(params, rotors=tuple(rotors))


IMPERFECT = [{"tilt_deg": 2.0}, {"offset_m": 0.01}, {"centre_m": 0.02}, {"tilt_deg": 1.0, "offset_m": 0.01}]


@pytest.mark.parametrize("name", ["hexacopter", "octocopter"])
@pytest.mark.parametrize("imperfections", IMPERFECT, ids=str)
def test_an_imperfect_airframe_flies_on_as_well_as_an_ideal_one(name, imperfections):
    """Its hover is balanced, and no torque takes much more thrust than with all rotors.

    A yaw torque that is left is at most half of what one rotor of the same thrust causes.
    """
    rng = np.random.default_rng(1)
    for _ in range(20):
        params = imperfect(name, rng, **imperfections)
        matrix, intact = effectiveness(params), mixer(params)
        count = len(params.rotors)
        for failed in range(count):
            mixed = mixer_without(params, {failed})
            assert mixed is not None
            assert failed not in mixed.rotors
            assert mixed.lift.min() >= 0.05
            columns = matrix[:, mixed.rotors]
            hover = columns @ mixed.lift
            assert hover[0] == pytest.approx(matrix[0] @ intact.lift, rel=0.01)  # tilted axes lift less
            assert mixed.lift.max() * params.hover_share <= 0.9
            np.testing.assert_allclose(hover[1:3], 0.0, atol=1e-9 * count)
            typical_m = np.sqrt(np.mean(matrix[3] ** 2))
            assert abs(hover[3]) <= 0.5 * typical_m * hover[0] * (1.0 + 1e-9)
            axes = 3 if mixed.controls_yaw else 2
            caused = columns[1 : 1 + axes] @ mixed.torque[:, :axes]
            np.testing.assert_allclose(caused, matrix[1 : 1 + axes] @ intact.torque[:, :axes], atol=1e-9)
            np.testing.assert_allclose(columns[0] @ mixed.torque, 0.0, atol=1e-9)
            assert np.abs(mixed.torque[:, :2]).max() <= 8.0 * np.abs(intact.torque[:, :2]).max()


def test_rotors_that_would_reach_their_limits_in_hover_do_not_fly_on():
    """Four rotors of six carry 1.5 times their share each; without two of them there is no such hover."""
    params = params_of("hexacopter")
    assert mixer_without(replace(params, hover_share=0.59), {0}) is not None
    assert mixer_without(replace(params, hover_share=0.61), {0}) is None
    assert mixer_without(params, {0, 2}) is None


def test_small_errors_of_a_hexacopter_change_its_mixer_little():
    """An error of 0.1 mm and 0.01 degrees: the exact airframe was the only one that flew on."""
    rng, ideal = np.random.default_rng(2), mixer_without(params_of("hexacopter"), {1})
    for _ in range(50):
        mixed = mixer_without(imperfect("hexacopter", rng, tilt_deg=0.01, offset_m=1e-4, centre_m=1e-4), {1})
        assert mixed.rotors == ideal.rotors
        assert not mixed.controls_yaw
        np.testing.assert_allclose(mixed.lift, ideal.lift, atol=0.02)
        np.testing.assert_allclose(mixed.torque, ideal.torque, atol=0.1)  # of 1.5


def test_the_order_of_directions_decides_whether_a_hexacopter_keeps_yaw():
    """PNPNPN loses it with any rotor, PPNNPN only with rotors 5 and 6.

    G.-X. Du, Q. Quan, B. Yang, K.-Y. Cai, "Controllability Analysis for Multirotor Helicopter Rotor
    Degradation and Failure", Journal of Guidance, Control, and Dynamics 38(5), 2015. P and N turn clockwise
    and counter-clockwise, in the order of the arms.
    """
    params = params_of("hexacopter")
    arms = sorted(range(6), key=lambda k: np.arctan2(*params.rotors[k].position_frd_m[1::-1]))
    for order, keeping in (("PNPNPN", set()), ("PPNNPN", {1, 2, 3, 4})):
        rotors = list(params.rotors)
        for arm, turns in zip(arms, order, strict=True):
            rotors[arm] = replace(rotors[arm], turns="cw" if turns == "P" else "ccw")
        changed = replace(params, rotors=tuple(rotors))
        mixed = [mixer_without(changed, {arm}) for arm in arms]
        assert {number for number, each in enumerate(mixed, 1) if each.controls_yaw} == keeping


def test_motors_are_used_again_after_the_failure_and_if_the_failure_mode_is_off():
    params = params_of("hexacopter")
    allocator = Allocator(params)
    whole = allocator.allocate(0.4, np.zeros(3), airmode=True)
    allocator.remove({2})
    assert not allocator.allocate(0.4, np.zeros(3), airmode=True)[[2, 5]].any()
    allocator.remove(())
    np.testing.assert_array_equal(allocator.allocate(0.4, np.zeros(3), airmode=True), whole)
    ignoring = Allocator(AllocationParams(rotors=params.rotors, moment_m=params.moment_m, failure_mode=0))
    ignoring.remove({2})
    assert ignoring.allocate(0.4, np.zeros(3), airmode=True).min() > 0.0


def test_the_settings_of_the_iris_are_the_defaults():
    assert settings_of(IRIS) == Settings()
    assert control_params(IRIS) == ControlParams()


@pytest.mark.parametrize("name", ["x500", "octocopter", "crazyflie"])
def test_derived_rate_loops_have_the_gain_of_the_iris(name):
    """Angular acceleration per torque times gain: for roll and pitch the mean of the Iris's two."""
    rate, of_iris = control_params(load(name)).rate, ControlParams().rate
    gains = acceleration_rad_s2(load(name)) * (rate.roll_k, rate.pitch_k, rate.yaw_k)
    iris = acceleration_rad_s2(IRIS) * (of_iris.roll_k, of_iris.pitch_k, of_iris.yaw_k)
    np.testing.assert_allclose(gains, (iris[:2].mean(), iris[:2].mean(), iris[2]), rtol=1e-9)
