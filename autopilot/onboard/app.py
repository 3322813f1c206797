"""The on-board application of one UAV: beacons, ranging, localisation and formation control. No I/O.

`Traffic` exchanges beacons and distances with the other UAVs. `CooperativeLocalisation` estimates positions
from both, `Guidance` computes setpoints from the positions, and `FlightSequence` selects the flight phase
and the commands.
"""

import math
from collections.abc import Iterable, Sequence
from typing import ClassVar

from msgspec.structs import replace
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.onboard.application import Application, Estimate, Reports, Status
from autopilot.onboard.client.own_state import Fix
from autopilot.onboard.context import Context
from autopilot.onboard.formation import messages
from autopilot.onboard.formation.avoidance import FRESH_US
from autopilot.onboard.formation.flight_phases import FlightSequence, Situation
from autopilot.onboard.formation.formation_control import Level
from autopilot.onboard.formation.guidance import SETPOINT_PERIOD_US, Guidance
from autopilot.onboard.formation.motion import STAYS_AWAY
from autopilot.onboard.formation.phases import FlightPhase
from autopilot.onboard.formation.warm_up import warm_up
from autopilot.onboard.localisation.common_frame import CommonFrame
from autopilot.onboard.localisation.localisation import CooperativeLocalisation
from autopilot.onboard.localisation.model import LocalisationModel
from autopilot.onboard.localisation.ranging_health import Support
from autopilot.onboard.localisation.uncertainty import Others
from autopilot.onboard.predicted_shape import LOCALISE_TIMEOUT_US, SHAPE_STD_M
from autopilot.onboard.radio.beacon import GpsError
from autopilot.onboard.radio.beacon_dissector import FILE_NAME, dissector
from autopilot.onboard.radio.neighbourhood import Neighbourhood
from autopilot.onboard.radio.traffic import Traffic
from autopilot.parameters.onboard_config import OnboardConfig
from foundation.types import Vector
from netsim.wire.messages import Delivery, FtmResult, RxItem, Sent, Survey

LONGEST_GAP_US = 200_000
"""Longest time between two setpoints by which the reference is advanced; a longer gap is cut to this."""
GAIN_PERIOD_US = 1_000_000
"""Period of the requests of the autopilot's gain."""
SHORTEST_LOOP_US, LONGEST_LOOP_US = 1_000, 40_000
"""Range of the period at which `OnboardApp.on_timer` is called."""
TELEMETRY_GAP_US = 500_000
"""Velocities farther apart in time than this are not integrated: odometry restarts."""
TRUTH_STD_M = 0.01
"""Standard deviation of the simulator's true position: its message has a resolution of 1e-7 degrees."""
GATHER_MAX_S = 0.8e-6 * LOCALISE_TIMEOUT_US
"""Longest time for which distances are gathered: the others must be located before take-off times out."""
_BACK, _LOST = "ranging is back", "ranging lost: correction frozen, then fading"
_UNKNOWN: Vector = (math.nan, math.nan, math.nan)


class OnboardApp(Application):
    """One UAV's part of the formation; see `autopilot.onboard.application.Application`."""

    Settings: ClassVar = OnboardConfig
    reports = Reports(
        phases=FlightPhase,
        formed=(FlightPhase.ON_STATION,),
        absent=tuple(STAYS_AWAY),
        placed=(FlightPhase.JOINING, FlightPhase.ON_STATION),
    )

    def __init__(self, settings: OnboardConfig) -> None:
        self._config = settings

    @classmethod
    def warm_up(cls) -> None:
        """Call the kernels that two UAVs near each other do not use."""
        warm_up()

    @classmethod
    def dissectors(cls, port: int) -> dict[str, str]:
        """Return the dissector of beacons."""
        return {FILE_NAME: dissector(port)}

    def start(self, context: Context) -> None:
        """Create the parts."""
        feeds = self._config.wind_feed_forward
        if feeds is None:
            feeds = context.autopilot_kind == "px4"
        self._config = config = replace(self._config, wind_feed_forward=feeds)
        places = context.places_ned_m
        self.localisation: CooperativeLocalisation | None = None
        """The filter of the neighbourhood; None if the UAV flies on GPS alone or on the truth."""
        self._context = context
        self._station = context.uav
        self._autopilot = context.autopilot.interface
        self._gain_names = self._autopilot.gain_names
        """Names by which the gain is requested: all, until it has been received by one."""
        self._near = Neighbourhood(context.uav, places, config.neighbours)
        self._traffic = Traffic(
            radio=context.radio, config=config, devices=context.devices, rng=context.rng, near=self._near
        )
        self._table = self._traffic.table
        self._model = LocalisationModel(
            gps_bias_std_m=config.gps_bias_std_m, gps_bias_time_constant_s=config.gps_bias_time_constant_s,
            odometry_drift_m_sqrt_s=config.odometry_drift_m_sqrt_s,
            range_floor_std_m=config.range_floor_std_m,
            gather_s=min(self._traffic.ranging.gather_s, GATHER_MAX_S),
        )  # fmt: skip
        if config.localisation == "ftm" and len(places) > 1:
            self.localisation = CooperativeLocalisation(
                own=self._near.own, places_ned_m=places[self._near.members], model=self._model
            )
        elif config.localisation == "truth":
            context.request_truth()
        self._frame: CommonFrame | None = None
        """None if the neighbourhood is the whole formation: all UAVs then share one frame anyway."""
        if self.localisation is not None and not self._near.whole:
            self._frame = CommonFrame(self._near.members, self._table)
        self._guidance = Guidance(
            station=context.uav, plan=context.plan,
            config=config, near=self._near,
        )  # fmt: skip
        self._flight = FlightSequence(
            commands=context.autopilot.commands, on_station_tolerance_m=config.on_station_tolerance_m,
            on_station_hold_s=config.on_station_hold_s, held=config.hold, shortfall=self._shortfall,
            autopilot=self._autopilot,
        )  # fmt: skip
        self._own = context.autopilot.own
        self._support = Support(
            self.localisation, self._table, watched=self._guidance.layers.watched,
            range_silence_us=self._traffic.ranging.silence_us,
            beacon_period_us=config.beacon_period_ms * 1_000,
        )  # fmt: skip
        self._now_us = -1
        self._flown_us = -1
        self._setpoint_us = 0
        self._odometry_us = -1
        """Time of the newest odometry that localisation has used."""
        self._fix_taken: Fix | None = None
        """The newest fix that localisation has used."""
        self._gain_us = 0
        """Time of the next request of the gain."""
        self._status = Status(FlightPhase.WAITING)
        self._due_us = 0
        """An iteration that ends before this time has nothing to do."""

    # ---- inputs

    def on_mavlink(self, message: Message, now_us: int) -> None:  # noqa: ARG002  the client has used it
        """Process a message of the autopilot; message types that are not used are ignored."""
        match message.get_type():
            case "LOCAL_POSITION_NED":
                self._on_local_position(message)
            case "GPS_RAW_INT":
                self._take_fix()
            case "ATTITUDE_QUATERNION":
                if self._guidance.wind is not None:
                    self._guidance.wind.on_attitude((message.q1, message.q2, message.q3, message.q4))
            case "PARAM_VALUE":
                if message.param_id in self._gain_names and 0.0 <= message.param_value < math.inf:
                    self._guidance.position_gain_1_s = message.param_value
                    self._gain_names = (message.param_id,)
            case "COMMAND_ACK":
                self._due_us = 0
            case "HIL_STATE_QUATERNION":
                self._own.on_truth(message)

    def on_request(self, message: Message) -> Sequence[Message]:
        """Return the acknowledgement of a command; MAV_CMD_USER_1 releases a flight that is held."""
        if message.get_msgId() not in messages.COMMANDS:
            return []
        known = self._config.hold and message.command == common.MAV_CMD_USER_1
        if known and self._flight.held:
            self._flight.held = False
            self._flight.texts.append("released: flying to its place")
        return [messages.acknowledgement(message, accepted=known)]

    def _on_local_position(self, message: Message) -> None:
        own, wind, before_us = self._own, self._guidance.wind, self._odometry_us
        if own.time_us <= before_us:
            return
        self._odometry_us = own.time_us
        if before_us < 0:
            self._due_us = 0
        elif before_us < own.time_us - TELEMETRY_GAP_US:
            self._restart_odometry()
        if self.localisation is not None:
            self.localisation.on_odometry(self._near.own, own.time_us, own.odometry_ned_m, own.vel_ned_m_s)
            self._take_fix()  # a fix newer than the odometry had to wait for it
        if wind is not None:
            velocity_m_s = (message.vx, message.vy, message.vz)
            wind.on_velocity(own.time_us, velocity_m_s, flying=self._flight.in_formation)

    def _restart_odometry(self) -> None:
        """Make all UAVs discard this UAV's odometry, which misses the motion during a telemetry gap."""
        self._traffic.signal_restart()
        self._guidance.correction.lose_odometry()
        if self.localisation is not None:
            self.localisation.restart(self._near.own)

    def _take_fix(self) -> None:
        """Pass the newest fix to localisation, unless it has been used."""
        fix = self._own.fix
        if fix is not self._fix_taken and fix is not None and self.localisation is not None:
            taken = self.localisation.on_fix(
                self._near.own, fix.time_ms * 1_000, fix.pos_ned_m, fix.std_h_m, fix.std_v_m
            )
            if taken:
                self._fix_taken = fix

    def on_radio(self, items: Iterable[RxItem], now_us: int) -> None:
        """Process the items that the radio received and measured, in their order."""
        pages = self._table.pages
        for item in items:
            match item:
                case Delivery():
                    if pages.put(item.source, item.payload):
                        self._read(now_us)
                case FtmResult():
                    self._read(now_us)
                    self._on_ranged(item, now_us)
                case Survey():
                    self._traffic.ranging.on_survey(item.ended_ns, item.busy_ns)
                case Sent():  # reports a unicast datagram; this application sends none
                    pass
        self._read(now_us)

    def _read(self, now_us: int) -> None:
        """Process the beacons that have been received."""
        if self._table.pages.count == 0:
            return
        if self.localisation is None:
            self._table.read(now_us)
        else:
            self.localisation.read(self._table, now_us)

    def _on_ranged(self, item: FtmResult, now_us: int) -> None:
        distance = self._traffic.measured(item)
        if distance is None or self.localisation is None:
            return
        row = self._near.rows[distance.peer]
        if row is not None:
            self.localisation.on_range(
                self._near.own, row, distance.time_ms * 1_000, distance.distance_m, distance.std_m,
                now_us=now_us,
            )  # fmt: skip

    # ---- output

    def on_timer(self, now_us: int) -> None:
        """Run the iteration that begins at ``now_us``."""
        # The iteration is assumed as long as the previous one, and the first one as short as possible.
        loop_us = now_us - self._now_us if self._now_us >= 0 else SHORTEST_LOOP_US
        self._now_us = now_us
        if not SHORTEST_LOOP_US <= loop_us <= LONGEST_LOOP_US:
            loop_us = SHORTEST_LOOP_US if loop_us < SHORTEST_LOOP_US else LONGEST_LOOP_US
        if now_us + loop_us <= self._due_us:
            return
        if now_us >= self._setpoint_us and self._own.time_us >= 0:
            self._fly(now_us)
            self._setpoint_us = now_us - now_us % SETPOINT_PERIOD_US + SETPOINT_PERIOD_US
        if now_us >= self._gain_us:
            self._gain_us = now_us + GAIN_PERIOD_US
            # Requested each time, because a ground station may change it in flight.
            for request in messages.gain_requests(self._gain_names, self._station + 1):
                self._context.autopilot.send(request)
        for text in self._flight.texts:
            self._context.warn(text)
        self._flight.texts.clear()
        phase, start_us = self._flight.phase, self._guidance.start.start_us
        ranges = self.localisation is not None and phase is not FlightPhase.WAITING
        radio_us = self._traffic.next_deadline_us(ranging=ranges)
        if self._own.time_us >= 0 and radio_us < now_us + loop_us:
            self._traffic.send(
                self._own, now_us, now_us + loop_us,
                ranging=ranges, variance_m2=self._distance_variance_m2,
                phase=phase, motion_start_ms=None if start_us is None else start_us // 1_000,
                gps_error=self._reported_gps_error,
            )  # fmt: skip
            radio_us = self._traffic.next_deadline_us(ranging=ranges)
        self._due_us = 0  # until there is a position
        if self._own.time_us >= 0:
            commands_us = self._context.autopilot.commands.next_deadline_us()
            self._due_us = min(self._setpoint_us, commands_us, self._gain_us, radio_us)

    def status(self) -> Status:
        """Return phase and start of the motion."""
        phase, start_us = self._flight.phase, self._guidance.start.start_us
        if phase is not self._status.phase or start_us != self._status.motion_start_us:
            self._status = Status(phase, motion_start_us=start_us)
        return self._status

    def troubles(self) -> dict[str, int]:
        """Return counts of the faults that occurred so far and were handled."""
        counts = {
            "bad_beacons": self._table.bad_beacons,
            "beacons_missed": self._table.beacons_missed,
            "commands_refused": self._context.autopilot.commands.refusals,
            "height_steps": self._own.height.steps,
        }
        if self.localisation is not None:
            counts["localisation_restarts"] = self.localisation.restarts
            counts["ranges_downweighted"] = self.localisation.count_of("ranges_downweighted")
            counts["gps_steps"] = self.localisation.gps_steps
            counts["odometry_jumps"] = self.localisation.odometry_jumps
            counts["ranges_too_late"] = self.localisation.count_of("ranges_too_late")
        return counts

    def estimate(self, now_us: int) -> Estimate:
        """Return the position estimate at ``now_us``, which may be after the last loop iteration."""
        correction = self._guidance.correction
        if self.localisation is not None and self._support.holds:
            std_ned_m = self.localisation.std_ned_m()
        elif self._own.truth_ned_m is not None:
            std_ned_m = (TRUTH_STD_M, TRUTH_STD_M, TRUTH_STD_M)
        else:
            model = self._model
            std_ned_m = (model.gps_bias_std_m, model.gps_bias_std_m, model.height_std_m)
        offset_ned_m = _UNKNOWN if correction.offset_ne_m is None else (*correction.offset_ne_m, 0.0)
        correction_ned_m = (
            *correction.ne_m, self._guidance.down_error_m + self._own.height.autopilot_down_m
        )  # fmt: skip
        return Estimate(
            self._guidance.believed_ned_m(self._own, now_us), std_ned_m, correction_ned_m, offset_ned_m
        )

    # ---- flight

    def _fly(self, now_us: int) -> None:
        """Update localisation, phase and motion start; send the setpoint, if the phase needs one."""
        guidance, flight, own = self._guidance, self._flight, self._own
        since_us = now_us - self._flown_us if self._flown_us >= 0 else SETPOINT_PERIOD_US
        self._flown_us = now_us
        dt_s = min(since_us, LONGEST_GAP_US) * 1e-6
        self._correct(now_us, dt_s)
        place_ned_m, believed_ned_m = guidance.place_ned_m(now_us), guidance.believed_ned_m(own, now_us)
        situation = Situation(
            shape_std_m=self._shape_std_before_flight_m(now_us),
            miss_m=math.dist(believed_ned_m, place_ned_m),
            place_height_m=-place_ned_m[2],
        )
        flight.update(own, situation, now_us)
        phase = flight.phase
        guidance.agree(now_us, on_station=phase is FlightPhase.ON_STATION, table=self._table)
        if own.origin_ned_m is None or not flight.needs_setpoint:
            return
        if flight.in_formation:
            setpoint = guidance.follow(own, believed_ned_m, self._known_others(now_us), now_us, dt_s)
        else:
            setpoint = guidance.wait(own, now_us)
        self._context.autopilot.send(messages.offboard_setpoint(setpoint, self._station + 1, now_us))

    def _correct(self, now_us: int, dt_s: float) -> None:
        """Update the correction from the estimated true position."""
        own, guidance = self._own, self._guidance
        offset_ne_m: Level | None = None
        if self.localisation is not None:
            self.localisation.update(now_us)
            if self._support.update(now_us) and self._flight.in_air:
                self._flight.texts.append(_BACK if self._support.holds else _LOST)
            if self._support.holds:
                offset_ne_m = self.localisation.offset_ne_m()
                if self._frame is not None:
                    self._frame.update(now_us, self.localisation)
                    shift_n_m, shift_e_m = self._frame.shift_ne_m
                    offset_ne_m = (offset_ne_m[0] + shift_n_m, offset_ne_m[1] + shift_e_m)
        elif own.truth_ned_m is not None:
            (true_n_m, true_e_m, true_d_m), then_ned_m = own.truth_ned_m, own.odometry_at(own.truth_us)
            offset_ne_m = (true_n_m - then_ned_m[0], true_e_m - then_ned_m[1])
            guidance.down_error_m = then_ned_m[2] - true_d_m
        else:
            return
        in_air = self._flight.in_air
        (there_n_m, there_e_m, _), (gone_n_m, gone_e_m, _) = own.autopilot_ned_m, own.odometry_ned_m
        drift_ne_m = (there_n_m - gone_n_m, there_e_m - gone_e_m)
        guidance.correction.update(drift_ne_m, offset_ne_m, dt_s, at_once=not in_air)
        guidance.layers.update(now_us, supported=not in_air or self._support.holds_all(now_us))

    def _known_others(self, now_us: int) -> Others | None:
        """Return the neighbourhood while the own position in it is known, else None.

        Without distances odometry bridges the gap for `COAST_S`; after that height layers separate the UAVs.
        """
        localisation = self.localisation
        if localisation is None or not (self._support.holds or self._guidance.correction.holds):
            return None
        if not localisation.located[localisation.own]:
            return None
        shift_ne_m = (0.0, 0.0) if self._frame is None else self._frame.shift_ne_m
        return localisation.others(now_us, fresh_us=FRESH_US, shift_ne_m=shift_ne_m)

    def _shape_std_before_flight_m(self, now_us: int) -> float:
        """Shape error that take-off waits for; see `Situation`."""
        if self.localisation is None:
            return 0.0
        if self._flight.phase is not FlightPhase.LOCALISING or not self.localisation.located.all():
            return math.inf
        return self.localisation.shape_std_m(now_us)

    def _shortfall(self, now_us: int) -> str:
        """Why the formation is not localised, for the message at the time-out of take-off."""
        return "" if self.localisation is None else self.localisation.shortfall(now_us, SHAPE_STD_M)

    def _distance_variance_m2(self, peer: int) -> float | None:
        row = self._near.rows[peer]
        if self.localisation is None or row is None:
            return None
        return self.localisation.distance_variance_m2(row, self._now_us)

    def _reported_gps_error(self) -> GpsError | None:
        """Return the estimated GPS error for the beacon; None while no distances support the own position."""
        if self.localisation is None or not self._support.holds:
            return None
        if self._frame is not None and self._own.fix is not None:
            return self._frame.report_error(self._station, self._own.fix, self.localisation, self._now_us)
        return GpsError(*self.localisation.gps_error(self.localisation.own))
