"""The vehicle's current values, from which telemetry is built.

Written by `autopilot.vehicle.vehicle` and by the parts that own the values: pilot and monitor.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import common

from autopilot.commander.battery import BatteryMonitor, BatteryParams
from autopilot.commander.commander import Commander
from autopilot.estimation.clock import Clock
from autopilot.estimation.estimator import Estimator
from autopilot.mavlink.codec import Message
from foundation.types import AttitudeSetpoint, Course, EstimatorState, TrajectorySetpoint


@dataclass(frozen=True, slots=True, kw_only=True)
class Home:
    """Home position: where the vehicle was armed, or a position set by a station."""

    lat_deg: float
    lon_deg: float
    alt_m: float
    """Above mean sea level."""
    pos_ned_m: tuple[float, float, float]
    """From the estimator's origin, in metres."""
    q_ned_frd: tuple[float, float, float, float]


@dataclass(slots=True, kw_only=True)
class FlightData:
    """Values of one vehicle at the current step: one object for its lifetime, updated in place."""

    estimator: Estimator
    commander: Commander
    state: EstimatorState
    """The estimate at this step."""
    clock: Clock = field(default_factory=Clock)
    mav_type: int = common.MAV_TYPE_QUADROTOR
    conditions: int = 0
    """`autopilot.commander.arming_checks.Condition` bits."""
    causes: int = 0
    """`autopilot.commander.failsafe.Cause` bits."""
    battery: BatteryMonitor = field(default_factory=lambda: BatteryMonitor(BatteryParams()))
    sensor: Message | None = None
    """The last HIL_SENSOR."""
    baro: Message | None = None
    """The last HIL_SENSOR with a pressure."""
    mag: Message | None = None
    """The last HIL_SENSOR with a magnetic field that the estimator uses."""
    gps: Message | None = None
    """The last HIL_GPS."""
    gps_us: int = 0
    """Time of its arrival."""
    distances: dict[int, Message] = field(default_factory=dict)
    """The last DISTANCE_SENSOR of each range finder by its id."""
    truth: Message | None = None
    """The last HIL_STATE_QUATERNION, if the simulator sends the true state."""
    origin_known: bool = False
    """Whether the local frame is georeferenced; true once the position was valid."""
    home: Home | None = None
    time_stands: bool = False
    """Whether simulated time is paused, so that messages arrive between two steps."""
    course: Callable[[], Course] = lambda: Course.OTHER
    """What the current mode is doing; evaluated only when it is reported."""
    setpoint: TrajectorySetpoint | None = None
    """Setpoint of the position controller; None when idle."""
    attitude_setpoint: Callable[[], AttitudeSetpoint | None] = lambda: None
    """Setpoint of the attitude controller; evaluated only when it is reported."""
    motors: Callable[[], Sequence[float]] = lambda: (0.0, 0.0, 0.0, 0.0)
    """(n,) present motor controls, 0..1."""
    armed_us: int = 0
    """Time of the last arming; like the next two, 0 before the first."""
    took_off_us: int = 0
    landed_us: int = 0
    flights: int = 0
    """Number of armings."""

    @property
    def now_us(self) -> int:
        """Time of the current step."""
        return self.clock.now_us
