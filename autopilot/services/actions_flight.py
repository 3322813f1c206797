"""Flight commands: arming, modes, take-off, landing, repositioning, home, mission progress.

Results are those of PX4 v1.17's commander where it implements the command.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

from pymavlink.dialects.v20 import common

from autopilot.commander.arming_checks import Condition, Reason
from autopilot.mavlink.modes import FlightMode, mode_from_main_sub
from autopilot.services.command import (
    ACCEPTED,
    AMSL_FRAMES,
    DENIED,
    RELATIVE_FRAMES,
    UNSUPPORTED,
    Action,
    Answer,
    CommandRequest,
    Place,
    TakeoffAltitude,
    answer_for,
    given,
    refusal_text,
    whole,
)
from autopilot.services.flight_data import FlightData
from autopilot.services.service import APPLICATION, Partner
from autopilot.services.status import status_text

FORCE_MAGIC = 21196.0
"""Second parameter of MAV_CMD_COMPONENT_ARM_DISARM that skips the checks."""
ALTITUDE_MAX_M = 100_000.0
"""Largest distance above or below sea level of a valid target altitude."""
_REPORT_RAISED_M = 0.1
"""Least raise of a take-off altitude that is reported to stations."""
_GROUND_SPEED, _AIR_SPEED = 1, 0
_FRAMES = AMSL_FRAMES | RELATIVE_FRAMES
"""Accepted frames: global, with altitudes above sea level or home. Terrain heights are not available."""
_OUTSIDE_FENCE = "Reposition is outside geofence"

Spot = tuple[float | None, float | None, float | None]
"""Latitude and longitude, both or neither, in degrees; altitude in metres above mean sea level."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightActions:
    """What the commands call in pilot and mission; a call that is refused returns the reason."""

    ask_offboard: Callable[[Partner, int], None]
    """Request that a partner's setpoints be used if they are fresh at a time, in us."""
    reposition: Callable[
        [float | None, float | None, float | None, float | None, float | None], Reason | None
    ]
    """Hold at latitude, longitude, altitude AMSL, yaw in radians; fly there at a speed."""
    orbit: Callable[
        [float | None, float | None, float | None, float | None, float | None, float | None], Reason | None
    ]
    """Circle with radius (negative: anticlockwise), speed and ORBIT_YAW_BEHAVIOUR about a position."""
    change_speed: Callable[[float | None], None]
    """Set the speed until the mode ends; None: the default speed."""
    set_home: Callable[[float, float, float], Reason | None]
    set_home_here: Callable[[], Reason | None]
    has_mission_item: Callable[[int], bool]
    set_mission_current: Callable[[int], bool]
    """Continue with an item of the mission; False if there is no such item."""
    takeoff_height_m: Callable[[], float]
    """MIS_TAKEOFF_ALT."""


class FlightCommands:
    """Actions that go through the commander; ``table`` holds them by MAV_CMD."""

    def __init__(self, flight: FlightData, takeoff_altitude: TakeoffAltitude, actions: FlightActions) -> None:
        self._flight = flight
        self._commander = flight.commander
        self._takeoff_altitude = takeoff_altitude
        self._do = actions
        self.table: dict[int, Action] = {
            common.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_or_disarm,
            common.MAV_CMD_DO_SET_MODE: self._set_mode,
            common.MAV_CMD_DO_SET_STANDARD_MODE: self._set_standard_mode,
            common.MAV_CMD_NAV_TAKEOFF: self._take_off,
            common.MAV_CMD_NAV_LAND: lambda request: self._enter(FlightMode.LAND, "Landing", request),
            common.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda request: self._enter(
                FlightMode.RETURN, "Return", request
            ),
            common.MAV_CMD_DO_REPOSITION: self._reposition,
            common.MAV_CMD_DO_CHANGE_ALTITUDE: self._change_altitude,
            common.MAV_CMD_DO_ORBIT: self._orbit,
            common.MAV_CMD_DO_CHANGE_SPEED: self._change_speed,
            common.MAV_CMD_DO_SET_HOME: self._set_home,
            common.MAV_CMD_MISSION_START: self._start_mission,
            common.MAV_CMD_DO_SET_MISSION_CURRENT: self._set_mission_current,
            common.MAV_CMD_DO_PAUSE_CONTINUE: self._pause_or_continue,
            common.MAV_CMD_DO_FLIGHTTERMINATION: self._terminate,
            common.MAV_CMD_RUN_PREARM_CHECKS: self._check,
        }

    # ---- arming and modes

    def _arm_or_disarm(self, request: CommandRequest) -> Answer:
        forced = request.params[1] == FORCE_MAGIC
        if request.params[0] == 1.0:
            return answer_for("Arming", self._commander.arm(request.now_us, forced=forced))
        if request.params[0] == 0.0:
            return answer_for("Disarming", self._commander.disarm(forced=forced))
        return answer_for("Arming", Reason.BAD_ARGUMENT)

    def _set_mode(self, request: CommandRequest) -> Answer:
        base_mode, main, sub = request.params[:3]
        if not (0.0 <= base_mode < 256.0 and int(base_mode) & common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED):
            return answer_for("Mode", Reason.BAD_ARGUMENT)
        return self._enter(mode_from_main_sub(main, sub), "Mode", request)

    def _set_standard_mode(self, request: CommandRequest) -> Answer:
        requested = whole(request.params[0])
        modes = self._commander.modes
        mode = next((each for each in modes.offered if requested and modes.standard(each) == requested), None)
        return Answer(UNSUPPORTED) if mode is None else self._enter(mode, "Mode", request)

    def _take_off(self, request: CommandRequest) -> Answer:
        """Climb to the given altitude, at least MIS_TAKEOFF_ALT above home, as PX4 does.

        The minimum does not apply to the on-board application: it has the height of the ground, and its
        place may be lower.
        """
        home, place = self._flight.home, request.place
        if place.frame not in _FRAMES:
            return Answer(UNSUPPORTED)
        altitude_m = given(request.params[6])
        if altitude_m is not None and place.frame in RELATIVE_FRAMES:
            altitude_m = None if home is None else altitude_m + home.alt_m
        if altitude_m is None or abs(altitude_m) > ALTITUDE_MAX_M:
            return self._enter(FlightMode.TAKEOFF, "Takeoff", request)
        raised: str | None = None
        if home is not None and request.partner.link != APPLICATION:
            height_m = self._do.takeoff_height_m()
            if altitude_m < home.alt_m + height_m - _REPORT_RAISED_M:
                raised = f"Using minimum takeoff altitude: {height_m:.2f} m"
            altitude_m = max(altitude_m, home.alt_m + height_m)
        answer = self._enter(FlightMode.TAKEOFF, "Takeoff", request, amsl_m=altitude_m)
        if raised is None or answer.messages:
            return answer
        return Answer(answer.result, (status_text(common.MAV_SEVERITY_WARNING, raised),))

    def _enter(
        self, mode: FlightMode | None, what: str, request: CommandRequest, *, amsl_m: float | None = None
    ) -> Answer:
        if mode is FlightMode.OFFBOARD:
            self._do.ask_offboard(request.partner, request.now_us)
        refusal = self._commander.set_mode(mode)
        if refusal is None:
            self._takeoff_altitude.amsl_m = amsl_m
        return answer_for(what, refusal)

    # ---- places and speeds

    def _reposition(self, request: CommandRequest) -> Answer:
        """Hold at another position; as in PX4, only with the flag that permits a mode change."""
        speed_m_s, flags, _, yaw_rad = request.params[:4]
        if whole(flags) != common.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE:
            return Answer(UNSUPPORTED)
        return self._hold_at(request.place, yaw_rad=given(yaw_rad), speed_m_s=_positive(speed_m_s))

    def _change_altitude(self, request: CommandRequest) -> Answer:
        """Hold at another altitude, in the frame of the second parameter."""
        altitude_m, frame = given(request.params[0]), whole(request.params[1])
        if altitude_m is None:
            return answer_for("Altitude", Reason.BAD_ARGUMENT)
        return self._hold_at(Place(frame, None, None, altitude_m), yaw_rad=None, speed_m_s=None)

    def _hold_at(self, place: Place, *, yaw_rad: float | None, speed_m_s: float | None) -> Answer:
        spot = self._spot(place)
        if isinstance(spot, Answer):
            return spot
        refusal = self._do.reposition(*spot, yaw_rad, speed_m_s)
        if refusal is Reason.OUTSIDE_GEOFENCE:  # accepted but not flown, as in PX4's commander
            return Answer(messages=(status_text(common.MAV_SEVERITY_CRITICAL, _OUTSIDE_FENCE),))
        return answer_for("Reposition", refusal)

    def _orbit(self, request: CommandRequest) -> Answer:
        spot = self._spot(_above_the_sea(request.place))
        if isinstance(spot, Answer):
            return spot
        radius_m, speed_m_s, yaw_behaviour = map(given, request.params[:3])
        return answer_for("Orbit", self._do.orbit(radius_m, speed_m_s, yaw_behaviour, *spot))

    def _change_speed(self, request: CommandRequest) -> Answer:
        """Set the speed from now on; an invalid one restores the default, as in PX4."""
        kind, speed_m_s = whole(request.params[0]), request.params[1]
        if kind not in {_AIR_SPEED, _GROUND_SPEED}:
            return Answer(UNSUPPORTED)
        self._do.change_speed(_positive(speed_m_s))
        return Answer()

    def _set_home(self, request: CommandRequest) -> Answer:
        if request.params[0] > 0.5:
            return answer_for("Home", self._do.set_home_here())
        spot = self._spot(_above_the_sea(request.place))
        if isinstance(spot, Answer):
            return spot
        lat_deg, lon_deg, alt_m = spot
        if lat_deg is None or lon_deg is None or alt_m is None:
            return answer_for("Home", Reason.BAD_ARGUMENT)
        return answer_for("Home", self._do.set_home(lat_deg, lon_deg, alt_m))

    def _spot(self, place: Place) -> Spot | Answer:
        """Convert a command's altitude to one above mean sea level, or refuse the command."""
        lat_deg, lon_deg, alt_m = place[1:]
        if place.frame not in _FRAMES:
            return Answer(UNSUPPORTED)
        is_half = (lat_deg is None) is not (lon_deg is None)
        if is_half or abs(lat_deg or 0.0) > 90.0 or abs(lon_deg or 0.0) > 180.0:
            return answer_for("Place", Reason.BAD_ARGUMENT)
        if alt_m is not None and place.frame in RELATIVE_FRAMES:
            if self._flight.home is None:
                return answer_for("Place", Reason.NO_HOME)
            alt_m += self._flight.home.alt_m
        if alt_m is not None and abs(alt_m) > ALTITUDE_MAX_M:
            return answer_for("Place", Reason.BAD_ARGUMENT)
        return lat_deg, lon_deg, alt_m

    # ---- the mission

    def _start_mission(self, request: CommandRequest) -> Answer:
        """Enter mission mode at an item (-1: the current one) and arm; DENIED without a mission, as PX4."""
        if not self._flight.conditions & Condition.MISSION:
            return Answer(DENIED, (refusal_text("Mission start", Reason.NO_MISSION),))
        first = request.params[0]
        if not math.isfinite(first) or first < -1.0:
            return answer_for("Mission start", Reason.BAD_ARGUMENT)
        if first >= 0.0 and not self._do.has_mission_item(int(first)):
            return answer_for("Mission start", Reason.BAD_ARGUMENT)
        answer = self._enter(FlightMode.MISSION, "Mission", request)
        if not answer.result:
            answer = answer_for("Arming", self._commander.arm(request.now_us))
        if not answer.result and first >= 0.0:
            self._do.set_mission_current(int(first))
        return answer

    def _set_mission_current(self, request: CommandRequest) -> Answer:
        """Continue with an item and reset its jump counters; -1 leaves the item unchanged."""
        seq, resets_jumps = request.params[0], request.params[1]
        if resets_jumps not in {0.0, 1.0}:
            return answer_for("Mission item", Reason.BAD_ARGUMENT)
        if seq == -1.0:
            return Answer(UNSUPPORTED if resets_jumps else ACCEPTED)
        if whole(seq) < 0 or not self._do.set_mission_current(whole(seq)):
            return answer_for("Mission item", Reason.BAD_ARGUMENT)
        return Answer()

    def _pause_or_continue(self, request: CommandRequest) -> Answer:
        """Hold in the middle of a mission (0), or resume the mission (1)."""
        resume = whole(request.params[0])
        if resume == 1:
            return self._enter(FlightMode.MISSION, "Mission", request)
        if resume != 0:
            return answer_for("Pause", Reason.BAD_ARGUMENT)
        if self._commander.mode is FlightMode.MISSION:
            return self._enter(FlightMode.HOLD, "Pause", request)
        return answer_for(
            "Pause", None if self._commander.mode is FlightMode.HOLD else Reason.MODE_UNAVAILABLE
        )

    # ---- the end

    def _terminate(self, request: CommandRequest) -> Answer:
        """Stop the motors permanently. DENIED while disarmed; there is no way back to flight."""
        if not request.params[0] >= 0.5:
            return answer_for("Termination", Reason.BAD_ARGUMENT)
        if not self._commander.armed:
            return Answer(DENIED)
        self._commander.terminate()
        text = status_text(common.MAV_SEVERITY_EMERGENCY, "Flight terminated by command")
        return Answer(messages=(text,))

    def _check(self, request: CommandRequest) -> Answer:  # noqa: ARG002  # same signature as other actions
        if self._commander.armed:
            return Answer(common.MAV_RESULT_TEMPORARILY_REJECTED)
        refusals = self._commander.arming_refusals()
        return Answer(messages=tuple(refusal_text("Arming", refusal) for refusal in refusals))


def _above_the_sea(place: Place) -> Place:
    """Read an altitude as above mean sea level whatever its frame, as PX4 does.

    MAVSDK's do_orbit and set_home require this: they send altitudes above sea level in a relative frame.
    """
    return place._replace(frame=common.MAV_FRAME_GLOBAL) if place.frame in RELATIVE_FRAMES else place


def _positive(value: float) -> float | None:
    """Read a speed; MAVLink marks one that is not given by -1 or NaN."""
    return value if math.isfinite(value) and value > 0.0 else None
