"""Warm-up: runs every numerical kernel of a vehicle, so that all are compiled, cached on disk and loaded.

Two vehicles are lifted once they are armed, with perfect sensors and a perfect radio between them, until both
are on their way to their places. Their results are discarded.
"""

from collections.abc import Iterable

import numpy as np
from pymavlink.dialects.v20 import common

from autopilot.control.controller import ControllerContext, ControllerInputs, ThrustTorque
from autopilot.control.user_control import UserFlightController
from autopilot.estimation.atmosphere import pressure_pa
from autopilot.estimation.sensor_input import BARO_FIELDS, IMU_FIELDS, MAG_FIELDS
from autopilot.mavlink.hil import HilActuatorControls, HilSensor, pack
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.flight_mode import ManualInput, ModeInputs
from autopilot.navigation.setpoints import Navigator
from autopilot.parameters.config import Site, VehicleConfig
from autopilot.services.service import NEVER_US
from autopilot.vehicle.fast_step import FastSteps
from autopilot.vehicle.vehicle import Vehicle
from foundation.geometry.geodesy import ned_to_geodetic
from foundation.kernels.warm_up import WarmUpError
from foundation.types import Array, EstimatorState, RateSetpoint
from netsim.wire.messages import Broadcast, Delivery, FtmRequest, FtmResult, RxItem, TxItem

LIMIT_US = 40_000_000
JOINING_STEPS = 250
DISTANCE_M = 0.9
LIFT_SPEED_M_S = 1.0
_GPS_PERIOD_US = 200_000
_GRAVITY_M_S2 = 9.8066


def warm_up() -> None:
    """Run two vehicles until both have been on their way for a while. Raises WarmUpError."""
    places_ned_m = ((0.0, 0.0, -10.0), (0.0, 8.5, -10.0))
    configs = [
        VehicleConfig(run_id="rehearsal", instance=i, seed=0, places_ned_m=places_ned_m) for i in range(2)
    ]
    vehicles = [Vehicle(config) for config in configs]
    inboxes: list[list[RxItem]] = [[], []]
    step_us = configs[0].step_us
    height_m, joining_steps = 0.0, 0
    for time_us in range(step_us, LIMIT_US, step_us):
        lifted = all(vehicle.commander.armed for vehicle in vehicles)
        climb_m_s = LIFT_SPEED_M_S if lifted else 0.0
        height_m += climb_m_s * step_us * 1e-6
        sent: list[tuple[TxItem, ...]] = []
        for i, vehicle in enumerate(vehicles):
            pos_ned_m = np.array((0.0, i * DISTANCE_M, -height_m))
            sensors = _sensors(configs[i].site, time_us, pos_ned_m, climb_m_s)
            sent.append(vehicle.step(sim_messages=sensors, radio_items=inboxes[i]).radio)
        inboxes = [_arrivals(sent[1 - i], sent[i], other=1 - i, time_us=time_us) for i in range(2)]
        joining_steps += all(
            vehicle.app is not None and vehicle.app.phase in vehicle.app.layout.placed for vehicle in vehicles
        )
        if joining_steps > JOINING_STEPS and _warm_up_inertial_step(vehicles[0], time_us):
            _warm_up_modes(vehicles[0])
            return
    raise WarmUpError("the vehicles of the warm-up were not on their way in time")


def _warm_up_modes(vehicle: Vehicle) -> None:
    """Compute the setpoints of the modes that the flight does not enter."""
    state = vehicle.flight.state
    settings = vehicle.parameters.settings
    navigator = Navigator(settings.navigation, settings.control.trajectory, settings.control.position)
    sticks = ManualInput(time_us=vehicle.flight.now_us, roll=0.5, pitch=0.5, yaw=0.5, throttle=0.8)
    home_ned_m = (0.0, 0.0, 0.0)
    for mode in (
        FlightMode.POSITION, FlightMode.ALTITUDE, FlightMode.STABILIZED, FlightMode.RETURN, FlightMode.LAND,
        FlightMode.ORBIT,
    ):  # fmt: skip
        navigator.enter(mode, state, landed=False, takeoff_down_m=0.0, home_ned_m=home_ned_m)
        for _ in range(2):
            inputs = ModeInputs(
                state=state, dt_s=0.004, landed=False, touching=False, home_ned_m=home_ned_m, manual=sticks
            )
            setpoint = navigator.update(inputs)
        vehicle.pilot.controller.update(state, setpoint, dt_s=0.004, landed=False)
    rates = RateSetpoint(rate_frd_rad_s=np.zeros(3), thrust=0.5)
    vehicle.pilot.controller.update(state, rates, dt_s=0.004, landed=False)
    replaced = UserFlightController(settings.control, make=_Hover, title="warm-up", instance=0)
    replaced.update(state, rates, dt_s=0.004, landed=False)


class _Hover:
    """A controller that holds the thrust of the hover."""

    def __init__(self, _context: ControllerContext) -> None:
        pass

    def reset(self, _state: EstimatorState) -> None:
        """Do nothing."""

    def update(self, inputs: ControllerInputs) -> ThrustTorque:
        """Return the hover thrust."""
        return ThrustTorque(inputs.hover_thrust, (0.0, 0.0, 0.0))


def _warm_up_inertial_step(vehicle: Vehicle, now_us: int) -> bool:
    """Run a fast step as `autopilot.vehicle.host` does; False if not possible now. Raises WarmUpError."""
    steps = FastSteps()
    answer = pack(HilActuatorControls(now_us, [0.0] * 16, 1, 0), sequence=0, system=1, component=1)
    if not vehicle.begin_fast_steps(steps, answer, NEVER_US):
        return False
    nothing = (0.0, 0.0, 0.0)
    accel = (0.0, 0.0, -_GRAVITY_M_S2)
    at_rest = HilSensor(now_us + 1, *accel, *nothing, *nothing, 0.0, 0.0, 0.0, 0.0, IMU_FIELDS)
    frame = pack(at_rest, sequence=0, system=0, component=1)
    steps.incoming[: len(frame)] = frame
    if steps.step(len(frame)) is None:
        raise WarmUpError("an inertial sample was rejected")
    return True


def _sensors(site: Site, time_us: int, pos_ned_m: Array, climb_m_s: float) -> list[common.MAVLink_message]:
    """Sensor messages of a vehicle that is held level, heading north, and lifted."""
    lat_deg, lon_deg, alt_m = map(float, ned_to_geodetic(
        pos_ned_m, origin_lat_deg=site.latitude_deg, origin_lon_deg=site.longitude_deg,
        origin_alt_m=site.altitude_m,
    ))  # fmt: skip
    baro = (pressure_pa(alt_m) / 100.0, 0.0, alt_m, 15.0)
    accel, gyro = (0.0, 0.0, -_GRAVITY_M_S2), (0.0, 0.0, 0.0)
    fields = IMU_FIELDS | MAG_FIELDS | BARO_FIELDS
    sensor = common.MAVLink_hil_sensor_message(
        time_us, *accel, *gyro, *site.magnetic_field_ned_gauss, *baro, fields, 0
    )
    if time_us % _GPS_PERIOD_US:
        return [sensor]
    speed_cm_s = round(100 * climb_m_s)
    gps = common.MAVLink_hil_gps_message(
        time_us, common.GPS_FIX_TYPE_3D_FIX, round(lat_deg * 1e7), round(lon_deg * 1e7), round(alt_m * 1e3),
        100, 100, speed_cm_s, 0, 0, -speed_cm_s, 65_535, 10,
    )  # fmt: skip
    return [gps, sensor]


def _arrivals(theirs: Iterable[TxItem], own: Iterable[TxItem], *, other: int, time_us: int) -> list[RxItem]:
    """Deliver the other's broadcasts and answer the own ranging requests, at once and without error."""
    at_ns = time_us * 1000
    arrivals: list[RxItem] = [
        Delivery(source=other, seq=item.seq, received_ns=at_ns, rssi_dbm=-60.0, payload=item.payload)
        for item in theirs
        if isinstance(item, Broadcast)
    ]
    arrivals += [
        FtmResult(
            peer=item.peer, seq=item.seq, status="ok", measured_ns=at_ns, ended_ns=at_ns,
            distance_m=DISTANCE_M, distance_std_m=0.1, rssi_dbm=-60.0, round_trips=7, measurements=8,
        )
        for item in own
        if isinstance(item, FtmRequest)
    ]  # fmt: skip
    return arrivals
