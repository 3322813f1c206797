"""What telemetry can speak of: the vehicle's present values.

Written by `autopilot.vehicle.vehicle` and by those of its parts whose values they are: pilot and monitor.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from autopilot.commander.battery import BatteryMonitor, BatteryParams
from autopilot.commander.commander import Commander
from autopilot.estimation.estimator import Estimator
from autopilot.mavlink.codec import Message
from foundation.types import AttitudeSetpoint, Course, EstimatorState, TrajectorySetpoint


@dataclass(frozen=True, slots=True, kw_only=True)
class Home:
    """Where the vehicle was armed."""

    lat_deg: float
    lon_deg: float
    alt_m: float
    """Above mean sea level."""
    pos_ned_m: tuple[float, float, float]
    """From the estimator's origin."""
    q_ned_frd: tuple[float, float, float, float]


@dataclass(slots=True, kw_only=True)
class FlightData:
    """One vehicle at the present step: one object for its life, since nothing is copied per step."""

    estimator: Estimator
    commander: Commander
    state: EstimatorState
    """The estimator's at this step."""
    now_us: int = 0
    conditions: int = 0
    """`autopilot.commander.conditions.Condition` bits."""
    causes: int = 0
    """`autopilot.commander.failsafe.Cause` bits."""
    battery: BatteryMonitor = field(default_factory=lambda: BatteryMonitor(BatteryParams()))
    sensor: Message | None = None
    """The last HIL_SENSOR."""
    baro: Message | None = None
    """The last HIL_SENSOR with a pressure."""
    gps: Message | None = None
    """The last HIL_GPS."""
    gps_us: int = 0
    """When it came."""
    truth: Message | None = None
    """The last HIL_STATE_QUATERNION, where the simulator tells the truth."""
    origin_known: bool = False
    """The local frame's place on the globe is known, since the position was valid once."""
    home: Home | None = None
    time_stands: bool = False
    """What comes now comes between two steps, while simulated time stands."""
    course: Callable[[], Course] = lambda: Course.OTHER
    """What the present mode is about; asked only when it is told."""
    setpoint: TrajectorySetpoint | None = None
    """What the controller follows; None when idle."""
    attitude_setpoint: Callable[[], AttitudeSetpoint | None] = lambda: None
    """What the attitude controller follows; asked only when it is told."""
    motors: Sequence[float] = (0.0, 0.0, 0.0, 0.0)
    """(4,) controls in 0..1."""
    armed_us: int = 0
    """When it was armed last; like the next two, 0 before the first time."""
    took_off_us: int = 0
    landed_us: int = 0
    flights: int = 0
    """How often it was armed."""
