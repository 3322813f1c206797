"""The on-board application of one UAV: beacons, ranging, localisation and formation control.

Sans-IO. MAVLink messages from the own autopilot and items from the own radio go in, `OnboardOutput` comes
out once per step. All times are on one clock that the formation shares.

Take-off is the autopilot's own, for its spool-up and its landed-state logic are made for leaving the ground;
but it holds the uncorrected position, which drifts with the GPS bias, so at `HAND_OVER_HEIGHT_M`, while it
still climbs, the application takes over in offboard with a setpoint that goes on climbing at the same speed
over the corrected position. Nobody takes off before the shape of the formation on the ground is known to
`SHAPE_STD_M`, or the wait for that has been in vain for `LOCALISE_TIMEOUT_US`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common

from autopilot.config import Devices, OnboardConfig, Site
from autopilot.onboard.commands import ARM, OFFBOARD, CommandSender, take_off
from autopilot.onboard.formation import Correction, Reference, separation_radius_limit_m
from autopilot.onboard.localisation import CooperativeLocalisation, LocalisationModel
from autopilot.onboard.own_state import OwnState
from autopilot.onboard.phases import Phase
from autopilot.onboard.traffic import SILENCE_US, Traffic
from netsim.wire.messages import Delivery, FtmResult, RxItem, Sent, TxItem

Array = NDArray[np.float64]

SETPOINT_PERIOD_US = 50_000
HEARTBEAT_PERIOD_US = 1_000_000
SHAPE_STD_M = 0.35
LOCALISE_TIMEOUT_US = 10_000_000
TAKE_OFF_HEIGHT_M = 2.5
HAND_OVER_HEIGHT_M = 1.2
FLOWN_HEIGHT_M = 0.5
"""From here on a vehicle that is disarmed has landed, and is not sent up again."""
HEARTBEAT_LAG_US = 1_500_000
"""A HEARTBEAT (1 Hz) shows a change that a COMMAND_ACK announced after this at the latest."""
OFFBOARD_MAIN_MODE = 6
_SETPOINT_MASK = (
    common.POSITION_TARGET_TYPEMASK_AX_IGNORE
    | common.POSITION_TARGET_TYPEMASK_AY_IGNORE
    | common.POSITION_TARGET_TYPEMASK_AZ_IGNORE
    | common.POSITION_TARGET_TYPEMASK_YAW_IGNORE
    | common.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
)


class OnboardOutput(Struct, frozen=True):
    """What the application sends in one step."""

    mavlink: Sequence[common.MAVLink_message]
    """To the own autopilot."""
    radio: tuple[TxItem, ...]


NOTHING = OnboardOutput((), ())
"""What most steps give."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """Where the application believes itself to be; arrays are site NED, metres."""

    pos_ned_m: Array
    """(3,) the autopilot's position less the correction."""
    std_ned_m: Array
    """(3,) one sigma, the error of the formation as a whole included."""
    correction_ned_m: Array
    """(3,)"""
    odometry_offset_ned_m: Array
    """(3,) the part of it that comes over the radio: the true position less the odometry, as localisation
    knows it. NaN before it does; frozen while no distances come."""


class OnboardApp:
    """One UAV's application.

    Args:
        station: this UAV's index in the formation and number on the radio; its MAVLink system id is one more.
        places_ned_m: N places (3,) of the formation, site NED; the UAVs start on level ground below them.
        site: origin of the places' frame.
        config: settings.
        devices: what the UAV knows of its own.
        rng: source of the phases and jitters of beacons and requests.

    Attributes:
        phase: where in the flight it is.
        localisation: the filter, or None when flying on GPS alone.

    """

    def __init__(
        self,
        *,
        station: int,
        places_ned_m: Sequence[Sequence[float]],
        site: Site,
        config: OnboardConfig,
        devices: Devices,
        rng: np.random.Generator,
    ) -> None:
        places = np.array(places_ned_m, float).reshape(-1, 3)
        self.phase = Phase.WAITING
        self.localisation: CooperativeLocalisation | None = None
        self._station = station
        self._count = len(places)
        self._place_ned_m = places[station]
        self._config = config
        self._model = LocalisationModel(
            gps_bias_std_m=config.gps_bias_std_m,
            gps_bias_time_constant_s=config.gps_bias_time_constant_s,
            odometry_drift_m_sqrt_s=config.odometry_drift_m_sqrt_s,
            range_floor_std_m=config.range_floor_std_m,
            gather_s=2.0 * config.ftm_period_s + 0.5,
        )
        if config.localisation == "ftm" and self._count > 1:
            self.localisation = CooperativeLocalisation(own=station, places_ned_m=places, model=self._model)
        self._traffic = Traffic(
            station=station, stations=self._count, config=config, devices=devices, rng=rng
        )
        self._separation_limit_m = separation_radius_limit_m(places, station)
        self._commands = CommandSender(target_system=station + 1)
        self._correction = Correction()
        self._reference = Reference(climb_speed_m_s=config.climb_speed_m_s)
        self._own = OwnState(site=site, gps_delay_s=devices.gps_delay_s)
        # What this application is doing.
        self._now_us = -1
        self._phase_since_us = 0
        self._arrived_us: int | None = None
        self._offboard_seen = False
        self._has_flown = False
        self._supported = False
        self._setpoint_us = 0
        self._heartbeat_out_us = 0
        self._heartbeat_phase: Phase | None = None
        self._texts: list[common.MAVLink_message] = []
        self._due_us = 0
        """Nothing is to be done in a step that ends before this."""

    # ---- inputs

    def on_mavlink(self, msg: common.MAVLink_message, now_us: int) -> None:
        """Take a message of the own autopilot; those of no use here are ignored."""
        match msg.get_type():
            case "LOCAL_POSITION_NED":
                if self._own.time_us < 0:
                    self._due_us = 0
                if self._own.on_local_position(msg, now_us) and self.localisation is not None:
                    odometry_ned_m, vel_ned_m_s = self._own.odometry_ned_m, self._own.vel_ned_m_s
                    self.localisation.on_odometry(
                        self._station, self._own.time_us, odometry_ned_m.tolist(), vel_ned_m_s.tolist()
                    )
            case "GPS_RAW_INT":
                if self._own.on_gps(msg) and self.localisation is not None and self._own.fix is not None:
                    self.localisation.on_fix(
                        self._station, self._own.fix.time_ms * 1_000, self._own.fix.pos_ned_m
                    )
            case "GPS_GLOBAL_ORIGIN":
                self._own.on_origin(msg)
            case "HEARTBEAT":
                self._own.on_heartbeat(msg, now_us)
            case "COMMAND_ACK":
                self._commands.on_ack(msg, now_us)
                self._due_us = 0

    def on_radio(self, item: RxItem, now_us: int) -> None:
        """Take what the radio received or measured."""
        match item:
            case Delivery():
                self._on_beacon(item, now_us)
            case FtmResult():
                self._on_ranged(item, now_us)
            case Sent():  # of a datagram to one station, and this application sends none
                pass

    def _on_ranged(self, item: FtmResult, now_us: int) -> None:
        distance = self._traffic.measured(item)
        if distance is not None and self.localisation is not None:
            self.localisation.on_range(
                self._station,
                distance.peer,
                distance.time_ms * 1_000,
                distance.distance_m,
                distance.std_m,
                now_us=now_us,
            )

    def _on_beacon(self, item: Delivery, now_us: int) -> None:
        beacon = self._traffic.hear(item, now_us)
        if beacon is None or self.localisation is None:
            return
        self.localisation.on_odometry(
            beacon.station, beacon.time_us, beacon.odometry_ned_m, beacon.vel_ned_m_s
        )
        if beacon.fix is not None and beacon.fix.time_ms * 1_000 <= now_us:
            self.localisation.on_fix(beacon.station, beacon.fix.time_ms * 1_000, beacon.fix.pos_ned_m)
        for distance in beacon.distances:
            self.localisation.on_range(
                beacon.station,
                distance.peer,
                distance.time_ms * 1_000,
                distance.distance_m,
                distance.std_m,
                now_us=now_us,
            )

    # ---- output

    def on_timer(self, now_us: int) -> OnboardOutput:
        """Return all to send in the step that begins at ``now_us``; called once per step."""
        # The coming step is taken to be as long as the last, and the first as short as steps can be.
        step_us = min(max(now_us - self._now_us, 1_000), 20_000) if self._now_us >= 0 else 1_000
        self._now_us = now_us
        if now_us + step_us <= self._due_us:
            return NOTHING
        if now_us >= self._setpoint_us and self._own.time_us >= 0:
            self._correct(now_us)
            phase = self._next_phase(now_us)
            if phase is not self.phase:
                self.phase, self._phase_since_us = phase, now_us
            mavlink = self._setpoint(now_us)
            # On a grid, unless that has fallen behind.
            self._setpoint_us = max(self._setpoint_us + SETPOINT_PERIOD_US, now_us + 1)
        else:
            mavlink = []
        mavlink += self._commands.on_timer(now_us)
        if self.phase is not self._heartbeat_phase or now_us >= self._heartbeat_out_us:
            self._heartbeat_phase = self.phase
            self._heartbeat_out_us = now_us + HEARTBEAT_PERIOD_US
            mavlink.append(
                common.MAVLink_heartbeat_message(
                    common.MAV_TYPE_ONBOARD_CONTROLLER, common.MAV_AUTOPILOT_INVALID, 0, int(self.phase),
                    common.MAV_STATE_ACTIVE, 3,
                )
            )  # fmt: skip
        if self._texts:
            mavlink += self._texts
            self._texts = []
        radio: tuple[TxItem, ...] = ()
        if self._own.time_us >= 0:
            radio = self._traffic.due(self._own, now_us, now_us + step_us, ranging=self._ranges)
        self._due_us = self.next_deadline_us()
        return OnboardOutput(mavlink, radio) if mavlink or radio else NOTHING

    def next_deadline_us(self) -> int:
        """When `on_timer` next has something to do, if no message comes before; 0 until positions come."""
        if self._own.time_us < 0:
            return 0
        commands_us = self._commands.next_deadline_us()
        radio_us = self._traffic.next_deadline_us(ranging=self._ranges)
        return min(self._setpoint_us, commands_us, self._heartbeat_out_us, radio_us)

    @property
    def _ranges(self) -> bool:
        return self.localisation is not None and self.phase is not Phase.WAITING

    @property
    def bad_beacons(self) -> int:
        """Datagrams that were no beacon, or one that contradicts itself."""
        return self._traffic.bad_beacons

    def troubles(self) -> dict[str, int]:
        """Counts of what went wrong so far and was coped with."""
        counts = {"bad_beacons": self.bad_beacons, "commands_refused": self._commands.refusals}
        if self.localisation is not None:
            counts["localisation_restarts"] = self.localisation.restarts
            counts["ranges_downweighted"] = self.localisation.ranges_downweighted
        return counts

    @property
    def estimate(self) -> Estimate:
        """The present estimate; arrays are the caller's."""
        correction_ned_m = np.zeros(3)
        correction_ned_m[:2] = self._correction.ne_m
        offset_ned_m = np.full(3, np.nan)
        if self._correction.offset_ne_m is not None:
            offset_ned_m[:] = (*self._correction.offset_ne_m.tolist(), 0.0)
        if self.localisation is not None and self._supported:
            std_ned_m = self.localisation.std_ned_m()
        else:
            model = self._model
            std_ned_m = np.array((model.gps_bias_std_m, model.gps_bias_std_m, model.height_std_m))
        return Estimate(
            self._own.autopilot_ned_m - correction_ned_m, std_ned_m, correction_ned_m, offset_ned_m
        )

    @property
    def shape_std_m(self) -> float:
        """Expected rms error of the formation's horizontal shape; inf when distances do not support one."""
        if self.localisation is None or not self._supported:
            return float("inf")
        return self.localisation.shape_std_m(self._now_us)

    # ---- flight

    def _correct(self, now_us: int) -> None:
        """Bring the correction up to date with what localisation knows."""
        if self.localisation is None:
            return
        self.localisation.update(now_us)
        range_us = self.localisation.own_range_us
        supported = (
            bool(self.localisation.located[self._station])
            and range_us is not None
            and now_us - range_us < self._traffic.range_silence_us
        )
        in_air = self.phase >= Phase.TAKE_OFF
        if supported is not self._supported:
            self._supported = supported
            if in_air:
                self._say("ranging is back" if supported else "ranging lost: correction frozen, then fading")
        drift_ne_m = self._own.autopilot_ned_m[:2] - self._own.odometry_ned_m[:2]
        offset_ne_m = self.localisation.offset_ne_m() if supported else None
        self._correction.update(drift_ne_m, offset_ne_m, SETPOINT_PERIOD_US * 1e-6, at_once=not in_air)

    def _next_phase(self, now_us: int) -> Phase:
        """Decide the phase that the facts of now lead to, and want the command that it needs."""
        known_us = self._phase_since_us + HEARTBEAT_LAG_US
        disarmed = not self._own.armed and self._own.heartbeat_us > known_us
        height_m = -float(self._own.local_ned_m[2])
        match self.phase:
            case Phase.WAITING if self._own.origin_ned_m is not None and self._own.fix is not None:
                return Phase.ARMING if self.localisation is None else Phase.LOCALISING
            case Phase.LOCALISING if self.localisation is not None:
                if self.localisation.located.all() and self.localisation.shape_std_m(now_us) < SHAPE_STD_M:
                    return Phase.ARMING
                if now_us - self._phase_since_us > LOCALISE_TIMEOUT_US:
                    self._say("formation not localised: taking off all the same")
                    return Phase.ARMING
            case Phase.ARMING:
                self._commands.want(ARM, now_us)
                if self._commands.accepted:
                    return Phase.TAKE_OFF
            case Phase.TAKE_OFF:
                return self._taking_off(height_m, now_us, disarmed=disarmed)
            case Phase.JOINING | Phase.ON_STATION:
                return self._in_formation(now_us, disarmed=disarmed)
            case Phase.YIELDED:
                self._commands.want(None, now_us)
                if self._own.main_mode == OFFBOARD_MAIN_MODE and not self._own.failsafe:
                    return Phase.JOINING
                return Phase.LANDED if disarmed else self.phase
            case Phase.LANDED:
                self._commands.want(None, now_us)
        return self.phase

    def _taking_off(self, height_m: float, now_us: int, *, disarmed: bool) -> Phase:
        place_height_m = -float(self._place_ned_m[2])
        take_off_height_m = min(TAKE_OFF_HEIGHT_M, place_height_m)
        if disarmed:
            return Phase.LANDED if self._has_flown else Phase.ARMING
        if self._own.failsafe:
            return self._yield("failsafe")
        self._has_flown |= height_m > FLOWN_HEIGHT_M
        if height_m < min(HAND_OVER_HEIGHT_M, 0.5 * take_off_height_m) and not self._commands.wants(OFFBOARD):
            self._commands.want(take_off(self._own.origin_alt_m + take_off_height_m), now_us)
            return Phase.TAKE_OFF
        self._commands.want(OFFBOARD, now_us)
        self._offboard_seen = False
        return Phase.JOINING if self._commands.accepted else Phase.TAKE_OFF

    def _in_formation(self, now_us: int, *, disarmed: bool) -> Phase:
        if disarmed:
            return Phase.LANDED
        if self._own.failsafe:
            return self._yield("failsafe")
        if self._own.main_mode == OFFBOARD_MAIN_MODE:
            self._offboard_seen = True
        elif self._offboard_seen:
            return self._yield("offboard left")
        miss_m = math.dist(self._own_ned_m().tolist(), self._place_ned_m.tolist())
        if miss_m > self._config.on_station_tolerance_m:
            self._arrived_us = None
        elif self._arrived_us is None:
            self._arrived_us = now_us
        elif now_us - self._arrived_us >= self._config.on_station_hold_s * 1e6:
            return Phase.ON_STATION
        return self.phase

    def _yield(self, why: str) -> Phase:
        """Leave the flying to whoever has it now, and ask for nothing more."""
        self._offboard_seen = False
        self._commands.want(None, self._now_us)
        self._say(f"{why}: yielding")
        return Phase.YIELDED

    def _own_ned_m(self) -> Array:
        """(3,) where the UAV believes itself to be, site NED."""
        position_ned_m = self._own.autopilot_ned_m
        position_ned_m[:2] -= self._correction.ne_m
        return position_ned_m

    def _setpoint(self, now_us: int) -> list[common.MAVLink_message]:
        """Form the offboard setpoint; before offboard it is where the UAV is, for a smooth start."""
        if self._own.origin_ned_m is None or not Phase.ARMING <= self.phase <= Phase.YIELDED:
            return []
        target_ne_m = np.zeros(2)
        if self.phase in {Phase.JOINING, Phase.ON_STATION}:
            self._reference.advance(self._place_ned_m, SETPOINT_PERIOD_US * 1e-6)
            if self.localisation is not None and self._supported:
                target_ne_m = self.localisation.separation_push_ne_m(
                    now_us, radius_m=self._config.safety_radius_m, radius_limit_m=self._separation_limit_m,
                    silence_us=SILENCE_US,
                )  # fmt: skip
        else:
            climb_ned_m_s = np.array((0.0, 0.0, self._own.vel_ned_m_s[2]))
            self._reference.reset(self._own_ned_m(), climb_ned_m_s)
        target_ne_m = (
            target_ne_m + self._reference.pos_ned_m[:2] + self._correction.ne_m - self._own.origin_ned_m[:2]
        )
        return [
            common.MAVLink_set_position_target_local_ned_message(
                now_us // 1_000, self._station + 1, 1, common.MAV_FRAME_LOCAL_NED, _SETPOINT_MASK,
                float(target_ne_m[0]), float(target_ne_m[1]), float(self._reference.pos_ned_m[2]),
                *self._reference.vel_ned_m_s.tolist(), 0.0, 0.0, 0.0, 0.0, 0.0,
            )
        ]  # fmt: skip

    def _say(self, text: str) -> None:
        self._texts.append(
            common.MAVLink_statustext_message(common.MAV_SEVERITY_WARNING, text.encode("ascii"))
        )
