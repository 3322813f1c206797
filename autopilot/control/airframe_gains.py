"""Settings of the controller that follow from an airframe.

Gains that the file does not give are those of the Iris, scaled. The loop gain of a rate is the angular
acceleration per normalised torque times the gain, so MC_*RATE_K is inversely proportional to that
acceleration; roll and pitch get the mean loop gain of the Iris's. Motors that are slower than the Iris's
limit the bandwidth: gains of rate and attitude fall with the mean of the motors' time constants.
"""

import numpy as np
from msgspec.structs import replace

from autopilot.control.mixing import effectiveness, mixer
from autopilot.control.params import AllocationParams, ControlParams
from foundation.airframe.description import Airframe
from foundation.airframe.files import IRIS
from foundation.types import Array

MOST_RATE_K, LEAST_RATE_K = 5.0, 0.01
"""Range of MC_ROLLRATE_K and the others."""
LEAST_HOVER = 0.1
"""Least value of MPC_THR_HOVER."""


def control_params(airframe: Airframe) -> ControlParams:
    """Return the settings of an airframe; those of the Iris are the defaults.

    Raises ValueError for an airframe that cannot control thrust, roll, pitch and yaw.
    """
    base, given, propulsion = ControlParams(), airframe.gains, airframe.propulsion
    roll, pitch, yaw = acceleration_rad_s2(IRIS).tolist()
    tilt = 0.5 * (roll + pitch)
    ratio = np.array((tilt, tilt, yaw)) / acceleration_rad_s2(airframe)
    slower = min(IRIS.propulsion.lag_s / propulsion.lag_s, 1.0)
    roll_k, pitch_k, yaw_k = (
        min(max(k * float(share) * slower, LEAST_RATE_K), MOST_RATE_K)
        for k, share in zip((base.rate.roll_k, base.rate.pitch_k, base.rate.yaw_k), ratio, strict=True)
    )
    return replace(
        base,
        allocation=allocation_params(airframe),
        position=replace(
            base.position, thr_hover=_or(given.hover_thrust, max(airframe.hover_share, LEAST_HOVER))
        ),
        disturbance=replace(base.disturbance, thrust_lag_s=_or(given.thrust_lag_s, propulsion.lag_s)),
        attitude=replace(
            base.attitude,
            roll_p=_or(given.roll_p, slower * base.attitude.roll_p),
            pitch_p=_or(given.pitch_p, slower * base.attitude.pitch_p),
            yaw_p=_or(given.yaw_p, slower * base.attitude.yaw_p),
        ),
        rate=replace(
            base.rate,
            roll_k=_or(given.roll_rate_k, roll_k),
            pitch_k=_or(given.pitch_rate_k, pitch_k),
            yaw_k=_or(given.yaw_rate_k, yaw_k),
        ),
    )


def allocation_params(airframe: Airframe) -> AllocationParams:
    """Return the settings of control allocation."""
    return AllocationParams(
        rotors=airframe.rotors,
        moment_m=airframe.propulsion.moment_m,
        hover_share=airframe.hover_share,
        thrust_model_factor=airframe.propulsion.thrust_model_factor,
    )


def acceleration_rad_s2(airframe: Airframe) -> Array:
    """Return the angular acceleration (3,) about FRD axes for a normalised torque of 1 about each."""
    params = allocation_params(airframe)
    torque_n_m = (effectiveness(params)[1:] @ mixer(params).torque).diagonal() * airframe.propulsion.range_n
    return torque_n_m / airframe.inertia_kg_m2


def _or(given: float | None, derived: float) -> float:
    return derived if given is None else given
