"""A navigator in closed loop: with the independent 6-DOF Iris, or with a vehicle that tracks exactly."""

import itertools
import math

import numpy as np
from control_fixtures import DT_S, Iris, estimate

from autopilot.commander.land_detector import LandDetector, LandDetectorParams, LandStage
from autopilot.control import ControlParams, FlightController
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation import plan_items
from autopilot.navigation.flight_mode import ModeInputs
from autopilot.navigation.mission import MissionCommand, MissionItem
from autopilot.navigation.params import NavigationParams
from autopilot.navigation.plan_store import Refused
from autopilot.navigation.setpoints import Navigator, down_demand_m_s
from foundation.geometry.geodesy import ned_to_geodetic
from foundation.geometry.rotations import quat_from_euler
from foundation.types import AttitudeSetpoint

CONTROL = ControlParams()
HOME = (0.0, 0.0, 0.0)
ORIGIN = {"origin_lat_deg": 47.0, "origin_lon_deg": 8.0, "origin_alt_m": 488.0}


def at(north_m, east_m, height_m, command=MissionCommand.WAYPOINT, **details):
    return MissionItem(command=command, height_m=height_m, **lat_lon(north_m, east_m), **details)


def lat_lon(north_m, east_m):
    lat, lon, _ = ned_to_geodetic([north_m, east_m, 0.0], **ORIGIN)
    return {"lat_deg": float(lat), "lon_deg": float(lon)}


def refusal(kind, items):
    """Return why a list of items is refused; None if it is not."""
    made = plan_items.make(kind, items)
    return made if isinstance(made, Refused) else None


class Loop:
    """Common parts of both vehicles: a navigator, its mode, and the flown track."""

    def __init__(self, params, control, home_ned_m):
        self.params = params
        self.control = control
        self.navigator = Navigator(params, control.trajectory, control.position)
        self.home_ned_m = home_ned_m
        self.manual = None
        self.track = []
        """Positions (3,), one per step."""
        self.setpoint = None
        self.now_s = 0.0

    def enter(self, mode, *, takeoff_height_m=2.5):
        self.navigator.enter(
            mode, self.state, landed=self.landed, takeoff_down_m=-takeoff_height_m, home_ned_m=self.home_ned_m
        )

    def update(self):
        inputs = ModeInputs(
            state=self.state, dt_s=DT_S, landed=self.landed, touching=self.touching,
            home_ned_m=self.home_ned_m, manual=self.manual, disturbance_ned_m_s2=self.disturbance_ned_m_s2,
        )  # fmt: skip
        self.setpoint = self.navigator.update(inputs)
        return self.setpoint

    @property
    def ends_in_hold(self):
        return self.navigator.next_mode(self.state) is FlightMode.HOLD

    @property
    def return_phase(self):
        return self.navigator.behaviours[FlightMode.RETURN].phase

    @property
    def disturbance_ned_m_s2(self):
        return None

    def run(self, seconds, until=None):
        """Step for some time, or until a condition holds; return whether it did."""
        for _ in range(round(seconds / DT_S)):
            self.step()
            self.now_s += DT_S
            self.track.append(self.state.pos_ned_m.copy())
            if until is not None and until():
                return True
        return False


class Ideal(Loop):
    """A vehicle that is always at the navigator's setpoint, without any error."""

    def __init__(self, pos_ned_m, *, vel_ned_m_s=(0.0, 0.0, 0.0), yaw_rad=0.0, params=None, control=CONTROL,
                 home_ned_m=HOME):  # fmt: skip
        super().__init__(params or NavigationParams(), control, home_ned_m)
        self.state = estimate(
            pos_ned_m=np.array(pos_ned_m, float), vel_ned_m_s=np.array(vel_ned_m_s, float),
            q_ned_frd=quat_from_euler(0.0, 0.0, yaw_rad),
        )  # fmt: skip
        self.landed = self.touching = False

    def step(self):
        setpoint, state = self.update(), self.state
        vel, pos = state.vel_ned_m_s.copy(), state.pos_ned_m.copy()
        for axis in range(3):
            if setpoint.vel_ned_m_s is not None and setpoint.vel_axes[axis]:
                vel[axis] = setpoint.vel_ned_m_s[axis]
            pos[axis] += DT_S * 0.5 * (vel[axis] + state.vel_ned_m_s[axis])
            if setpoint.pos_ned_m is not None and setpoint.pos_axes[axis]:
                pos[axis] = setpoint.pos_ned_m[axis]
        self.landed = pos[2] >= 0.0 and vel[2] >= 0.0
        pos[2] = min(pos[2], 0.0)
        state.pos_ned_m, state.vel_ned_m_s = pos, vel
        state.q_ned_frd = quat_from_euler(0.0, 0.0, setpoint.yaw_rad or 0.0)


class Real(Loop):
    """The Iris with its controllers and land detector; the estimate is the true state."""

    def __init__(self, height_m=0.0, *, params=None, control=CONTROL, home_ned_m=HOME):
        super().__init__(params or NavigationParams(), control, home_ned_m)
        self.iris = Iris(height_m=height_m)
        self.controller = FlightController(control)
        self.detector = LandDetector(LandDetectorParams())
        if height_m > 0.0:
            self.detector.stage = LandStage.AIRBORNE
        self.force_ned_n = np.zeros(3)
        self.state = self.iris.estimate()

    @property
    def landed(self):
        return self.detector.landed

    @property
    def touching(self):
        return self.detector.stage is not LandStage.AIRBORNE

    def step(self):
        self.state = self.iris.estimate()
        setpoint = self.update()
        controls = self.controller.update(self.state, setpoint, dt_s=DT_S, landed=self.landed)
        self.iris.step(np.array(controls), self.force_ned_n)
        self.detector.update(
            self.iris.time_us, self.state, armed=True,
            down_demand_m_s=down_demand_m_s(
                self.state, setpoint, z_p_1_s=self.control.position.z_p,
                hover_thrust=self.controller.hover_thrust,
            ),
            thrust_of_hover=self.controller.thrust / self.controller.hover_thrust,
        )  # fmt: skip

    @property
    def ends_in_hold(self):
        return self.navigator.next_mode(self.state) is FlightMode.HOLD

    @property
    def return_phase(self):
        return self.navigator.behaviours[FlightMode.RETURN].phase

    @property
    def disturbance_ned_m_s2(self):
        return self.controller.disturbance_ned_m_s2

    @property
    def tilt_rad(self):
        _, x, y, _ = self.iris.q_ned_frd
        return math.acos(max(1.0 - 2.0 * (x * x + y * y), -1.0))


def off_path_m(points, corners):
    """Return the distance of each of ``points`` (n, 3) from the polyline through ``corners`` (k, 3)."""
    points, corners = np.asarray(points), np.asarray(corners, float)
    best = np.full(len(points), np.inf)
    for a, b in itertools.pairwise(corners):
        along = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(points - a - along[:, None] * (b - a), axis=1))
    return best


__all__ = ["DT_S", "AttitudeSetpoint", "FlightMode", "Ideal", "Real", "at", "lat_lon", "off_path_m"]
