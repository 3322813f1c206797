"""Simulation for tests of the on-board application: N apps with scripted autopilots on a lossy radio.

The true motion is that of a position and velocity loop disturbed by gusts. Each autopilot's position follows
its GPS bias with a lag, its velocity has a coloured error, its height a slow one. These are the errors of the
real estimator at a fraction of its cost.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from onboard_apps import formation_app
from pymavlink.dialects.v20 import common

from autopilot.onboard.formation.phases import FlightPhase
from autopilot.onboard.programs import NOTHING
from autopilot.parameters.config import Devices, Site
from autopilot.parameters.onboard_config import OnboardConfig
from foundation.geometry.geodesy import ned_to_geodetic
from netsim.wire.messages import Broadcast, Delivery, FtmRequest, FtmResult

PAIR = ((-3.0, 0.0, -8.0), (3.0, 0.0, -8.0))
ALONE = ((0.0, 0.0, -8.0),)
STEP_US = 4_000
CALIBRATION_S = 14.0
SHARE_OF_VELOCITY = 0.5
"""Share of a drift of the autopilot's height that its vertical velocity shows."""
SITE = Site()
MODE_TAKE_OFF, MODE_LOITER, MODE_LAND, MODE_OFFBOARD = (
    4 << 16 | 2 << 24,
    4 << 16 | 3 << 24,
    4 << 16 | 6 << 24,
    6 << 16,
)


def article_places_ned_m(spacing_east_m=8.5, spacing_north_m=2.5, height_m=10.0):
    """Return (8, 3) places: 4 broadside (east) x 2 end-fire (north), centred on the site's origin."""
    return np.array(
        [
            ((row - 0.5) * spacing_north_m, (column - 1.5) * spacing_east_m, -height_m)
            for row in range(2)
            for column in range(4)
        ]
    )


def shape_errors_m(found_m, expected_m):
    """Return (N,) horizontal errors after the best rigid alignment (Kabsch, no reflection)."""
    found = found_m[:, :2] - found_m[:, :2].mean(0)
    expected = expected_m[:, :2] - expected_m[:, :2].mean(0)
    u, _, vt = np.linalg.svd(found.T @ expected)
    turn = u @ np.diag((1.0, np.sign(np.linalg.det(u @ vt)))) @ vt
    return np.linalg.norm(found @ turn - expected, axis=1)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@dataclass
class Errors:
    """Errors of the simulation; standard deviations are one sigma."""

    gps_bias_std_m: float = 1.5
    gps_bias_tau_s: float = 60.0
    gps_white_std_m: float = 0.1
    estimator_lag_s: float = 3.0
    velocity_std_m_s: float = 0.06
    velocity_tau_s: float = 1.0
    height_std_m: float = 0.15
    gps_height_std_m: float = 0.0
    """Above 0 the autopilot's height follows the GPS receiver's instead of the barometer's."""
    barometer_steps_m: float = 0.0
    """Above 0 ALTITUDE is sent, and each barometer is calibrated again at `CALIBRATION_S`, by this."""
    gust_std_m_s2: float = 0.35
    gust_tau_s: float = 2.0
    range_std_m: float = 0.1
    radio_loss: float = 0.0


@dataclass
class ScriptedAutopilot:
    """Arms, takes off, follows offboard setpoints and lands like PX4, as observed on its companion link."""

    system: int
    refuse: dict = field(default_factory=dict)
    """Number of denials of each MAV_CMD before it is accepted."""
    armed: bool = False
    mode: int = MODE_LOITER
    target_height_m: float = 0.0
    setpoint: object = None
    setpoint_us: int = -1
    commands: list = field(default_factory=list)
    texts: list = field(default_factory=list)

    def on_message(self, msg, now_us):
        match msg.get_type():
            case "COMMAND_LONG":
                self.commands.append((now_us, msg.command, msg.confirmation))
                return [common.MAVLink_command_ack_message(msg.command, self._command(msg, now_us))]
            case "SET_POSITION_TARGET_LOCAL_NED":
                self.setpoint, self.setpoint_us = msg, now_us
            case "STATUSTEXT":
                self.texts.append((now_us, msg.text))
        return []

    def _command(self, msg, now_us):
        assert (msg.target_system, msg.target_component) == (self.system, 1)
        if self.refuse.get(msg.command, 0) > 0:
            self.refuse[msg.command] -= 1
            return common.MAV_RESULT_DENIED
        if msg.command == common.MAV_CMD_COMPONENT_ARM_DISARM:
            self.armed = True
        elif not self.armed:
            return common.MAV_RESULT_DENIED
        elif msg.command == common.MAV_CMD_NAV_TAKEOFF:
            self.mode, self.target_height_m = MODE_TAKE_OFF, msg.param7 - SITE.altitude_m
        elif msg.command == common.MAV_CMD_NAV_LAND:
            self.mode = MODE_LAND
        elif msg.command == common.MAV_CMD_DO_SET_MODE:
            if (msg.param1, msg.param2, msg.param3) != (1.0, 6.0, 0.0) or now_us - self.setpoint_us > 500_000:
                return common.MAV_RESULT_DENIED
            self.mode = MODE_OFFBOARD
        return common.MAV_RESULT_ACCEPTED

    def heartbeat(self):
        base_mode = common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (
            common.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0
        )
        return common.MAVLink_heartbeat_message(
            common.MAV_TYPE_QUADROTOR,
            common.MAV_AUTOPILOT_PX4,
            base_mode,
            self.mode,
            common.MAV_STATE_ACTIVE,
            3,
        )


class SwarmWorld:
    """N applications in lockstep; `log` holds (time_s, truth (N, 3), estimates (N, 3)) at 10 Hz.

    Inputs are passed to them at once, and their outputs are requested at the multiples of ``loop_us``.
    """

    def __init__(
        self, *, places_ned_m, seed, errors=None, config=None, boot_offset_us=0, loop_us=STEP_US, motion=None
    ):
        self.loop_us = loop_us
        self.places = np.asarray(places_ned_m, float)
        self.n = len(self.places)
        self.errors = errors or Errors()
        self.boot_offset_us = boot_offset_us
        streams = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(self.n + 2)]
        self.rng, self.radio_rng = streams[0], streams[1]
        self.apps = [
            formation_app(
                station=i,
                places_ned_m=self.places,
                site=SITE,
                config=config or OnboardConfig(),
                devices=Devices(),
                rng=streams[2 + i],
                motion=motion,
            )
            for i in range(self.n)
        ]
        self.autopilots = [ScriptedAutopilot(i + 1) for i in range(self.n)]
        self.now_us = 0
        self.pos = self.places * (1.0, 1.0, 0.0)
        self.vel = np.zeros((self.n, 3))
        draw = self.rng.standard_normal
        self.bias = draw((self.n, 2)) * self.errors.gps_bias_std_m
        self.estimate_error = np.column_stack((self.bias, np.zeros(self.n)))
        self.origin = np.column_stack(((self.pos[:, :2] + self.bias), np.zeros(self.n)))
        self.height_error = draw(self.n) * self.errors.height_std_m
        self.height_zero = self.height_error.copy()
        self.vel_error = draw((self.n, 3)) * self.errors.velocity_std_m_s
        self.gps_height = np.zeros(self.n)
        self.gps_height_vel = np.zeros(self.n)
        if self.errors.gps_height_std_m:
            self.gps_height += draw(self.n) * self.errors.gps_height_std_m
        self.barometer_zero = np.full(self.n, 488.0)
        self.gust = draw((self.n, 3)) * self.errors.gust_std_m_s2
        self.past = []
        self.in_flight = []
        self.radio_cut = False
        self.range_error_m = np.zeros(self.n)
        self.dead = set()
        self.sent = {Broadcast: 0, FtmRequest: 0}
        self.log = []
        self.least_distance_m = np.inf

    def run(self, seconds):
        for _ in range(round(seconds * 1e6 / STEP_US)):
            self._step()

    def run_until(self, condition, *, limit_s):
        end_us = self.now_us + limit_s * 1e6
        while not condition(self):
            assert self.now_us < end_us, f"not within {limit_s} s: {[app.phase.name for app in self.apps]}"
            self._step()

    def flown(self, *, since_s=0.0):
        """Return truth (T, N, 3) and estimates (T, N, 3) of the log from a time on."""
        rows = [row for row in self.log if row[0] >= since_s]
        return np.array([row[1] for row in rows]), np.array([row[2] for row in rows])

    def phases(self):
        return [app.phase for app in self.apps]

    def formed(self):
        return all(
            app.phase is FlightPhase.ON_STATION for i, app in enumerate(self.apps) if i not in self.dead
        )

    def _step(self):
        self.now_us += STEP_US
        now_us, dt_s, step = self.now_us, STEP_US * 1e-6, self.now_us // STEP_US
        self._move(dt_s)
        self.past.append((self.pos.copy(), self.bias.copy()))
        del self.past[:-31]
        arrived = [item for item in self.in_flight if item[0] <= now_us]
        self.in_flight = [item for item in self.in_flight if item[0] > now_us]
        for _, station, item in arrived:
            if station not in self.dead:
                self.apps[station].on_radio((item,), now_us)
        for i, app in enumerate(self.apps):
            if i in self.dead:
                continue
            for msg in self._telemetry(i, step):
                app.on_mavlink(msg, now_us)
            out = app.on_timer(now_us) if now_us % self.loop_us == 0 else NOTHING
            for msg in out.mavlink:
                for answer in self.autopilots[i].on_message(msg, now_us):
                    app.on_mavlink(answer, now_us)
            for item in out.radio:
                assert now_us <= item.at_us < now_us + self.loop_us
                self._transmit(i, item)
        if step % 25 == 0:
            estimates = np.array([app.estimate(now_us).pos_ned_m for app in self.apps])
            self.log.append((now_us * 1e-6, self.pos.copy(), estimates))
            flying = [i for i in range(self.n) if self.pos[i, 2] < -0.5]
            for k, i in enumerate(flying):
                for j in flying[k + 1 :]:
                    self.least_distance_m = min(
                        self.least_distance_m, np.linalg.norm(self.pos[i] - self.pos[j])
                    )

    def _move(self, dt_s):
        errors, draw = self.errors, self.rng.standard_normal

        def wander(value, std, tau_s):
            keep = np.exp(-dt_s / tau_s)
            value *= keep
            value += std * np.sqrt(1.0 - keep**2) * draw(value.shape)

        wander(self.bias, errors.gps_bias_std_m, errors.gps_bias_tau_s)
        wander(self.vel_error, errors.velocity_std_m_s, errors.velocity_tau_s)
        wander(self.height_error, errors.height_std_m, 100.0)
        wander(self.gust, errors.gust_std_m_s2, errors.gust_tau_s)
        self.estimate_error[:, :2] += (self.bias - self.estimate_error[:, :2]) * (
            dt_s / errors.estimator_lag_s
        )
        self.estimate_error[:, 2] = self.height_error - self.height_zero
        if errors.gps_height_std_m:
            # follows the receiver smoothly, as the estimator's lag for positions
            pull = draw(self.n) * errors.gps_height_std_m * np.sqrt(2.0 * dt_s / errors.gps_bias_tau_s)
            self.gps_height_vel += pull / errors.estimator_lag_s
            self.gps_height_vel -= self.gps_height_vel * (dt_s / errors.estimator_lag_s)
            self.gps_height += self.gps_height_vel * dt_s
            self.estimate_error[:, 2] = self.gps_height
        local = self.pos + self.estimate_error - self.origin
        for i, autopilot in enumerate(self.autopilots):
            if not autopilot.armed or i in self.dead:
                self.vel[i] = 0.0
                continue
            target_vel = np.zeros(3)
            if autopilot.mode == MODE_OFFBOARD:
                s = autopilot.setpoint
                target_vel = 0.95 * (np.array((s.x, s.y, s.z)) - local[i]) + (s.vx, s.vy, s.vz)
            elif autopilot.mode == MODE_TAKE_OFF:
                target_vel[2] = -np.clip(autopilot.target_height_m + local[i, 2], -1.0, 1.5)
            elif autopilot.mode == MODE_LAND:
                target_vel[2] = 0.7
            acceleration = 2.5 * (target_vel - self.vel[i] - self.vel_error[i]) + self.gust[i]
            self.vel[i] += np.clip(acceleration, -4.0, 4.0) * dt_s
        self.pos += self.vel * dt_s
        landed = self.pos[:, 2] >= 0.0
        self.pos[landed, 2] = 0.0
        self.vel[landed] = np.minimum(self.vel[landed], (0.0, 0.0, 0.0)) * (0.0, 0.0, 1.0)
        for i in np.flatnonzero(landed):
            if self.autopilots[i].mode == MODE_LAND:
                self.autopilots[i].armed = False

    def _telemetry(self, i, step):
        boot_us = self.now_us - self.boot_offset_us
        messages = []
        if step % 250 == 1:
            messages.append(self.autopilots[i].heartbeat())
        if step % 250 == 2:
            lat, lon, _ = ned_to_geodetic(
                self.origin[i],
                origin_lat_deg=SITE.latitude_deg,
                origin_lon_deg=SITE.longitude_deg,
                origin_alt_m=SITE.altitude_m,
            )
            messages.append(
                common.MAVLink_gps_global_origin_message(
                    round(float(lat) * 1e7), round(float(lon) * 1e7), round(SITE.altitude_m * 1e3)
                )
            )
        if step % 8 == i % 8:
            x, y, z = self.pos[i] + self.estimate_error[i] - self.origin[i]
            vx, vy, vz = self.vel[i] + self.vel_error[i]
            vz += SHARE_OF_VELOCITY * self.gps_height_vel[i]
            messages.append(common.MAVLink_local_position_ned_message(boot_us // 1_000, x, y, z, vx, vy, vz))
        if step % 25 == i % 25 and self.errors.barometer_steps_m:
            if CALIBRATION_S - 0.05 <= self.now_us * 1e-6 < CALIBRATION_S + 0.05:
                self.barometer_zero[i] += self.errors.barometer_steps_m * self.rng.standard_normal()
            altitude_m = self.barometer_zero[i] - self.pos[i, 2] - self.height_error[i]
            altitude_m += 0.05 * self.rng.standard_normal()
            messages.append(common.MAVLink_altitude_message(boot_us, altitude_m, *[math.nan] * 5))
        if step % 50 == i and len(self.past) == 31:
            pos, bias = self.past[0]
            seen = pos[i].copy()
            seen[:2] += bias[i] + self.errors.gps_white_std_m * self.rng.standard_normal(2)
            lat, lon, alt = ned_to_geodetic(
                seen,
                origin_lat_deg=SITE.latitude_deg,
                origin_lon_deg=SITE.longitude_deg,
                origin_alt_m=SITE.altitude_m,
            )
            messages.append(
                common.MAVLink_gps_raw_int_message(
                    boot_us,
                    3,
                    round(float(lat) * 1e7),
                    round(float(lon) * 1e7),
                    round(float(alt) * 1e3),
                    150,
                    250,
                    0,
                    0,
                    10,
                )
            )
        return messages

    def _transmit(self, i, item):
        self.sent[type(item)] += 1
        lost = self.radio_cut or self.radio_rng.random() < self.errors.radio_loss
        if isinstance(item, Broadcast):
            for j in range(self.n):
                if j != i and not (self.radio_cut or self.radio_rng.random() < self.errors.radio_loss):
                    delivery = Delivery(
                        source=i,
                        seq=item.seq,
                        received_ns=item.at_us * 1_000,
                        rssi_dbm=-60.0,
                        payload=item.payload,
                    )
                    self.in_flight.append((item.at_us + 2 * STEP_US, j, delivery))
            return
        if lost or item.peer in self.dead:
            result = FtmResult(
                peer=item.peer, seq=item.seq, status="timeout", measured_ns=(item.at_us + 100_000) * 1_000,
                ended_ns=(item.at_us + 100_000) * 1_000,
                distance_m=0.0, distance_std_m=0.0, rssi_dbm=0.0, round_trips=0, measurements=0,
            )  # fmt: skip
            self.in_flight.append((item.at_us + 100_000, i, result))
            return
        noise_m = self.errors.range_std_m * self.radio_rng.standard_normal()
        noise_m += self.range_error_m[i] + self.range_error_m[item.peer]
        distance_m = float(np.linalg.norm(self.pos[i] - self.pos[item.peer])) + noise_m
        result = FtmResult(
            peer=item.peer, seq=item.seq, status="ok", measured_ns=item.at_us * 1_000,
            ended_ns=item.at_us * 1_000, distance_m=distance_m,
            distance_std_m=0.15, rssi_dbm=-60.0, round_trips=7, measurements=8,
        )  # fmt: skip
        self.in_flight.append((item.at_us + 12_000, i, result))


def world(places=PAIR, *, seed=1, **kwargs):
    return SwarmWorld(places_ned_m=places, seed=seed, **kwargs)


def phase_is(phase):
    return lambda w: all(app.phase is phase for app in w.apps)
