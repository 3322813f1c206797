"""``python mavsdk_flight.py PORT``: a PX4 user's session with MAVSDK, in the order of a flight.

It flies vehicle 0 of a swarm with --hold; the expected results are those of PX4 v1.17.
"""

import asyncio
import math
import sys
from typing import Any

from mavsdk.asyncio.plugins.action import ActionAsync, OrbitYawBehavior
from mavsdk.asyncio.plugins.component_metadata import ComponentMetadataAsync, MetadataType
from mavsdk.asyncio.plugins.ftp import FtpAsync
from mavsdk.asyncio.plugins.geofence import FenceType, GeofenceAsync, GeofenceData, Point, Polygon
from mavsdk.asyncio.plugins.info import InfoAsync
from mavsdk.asyncio.plugins.mission import MissionAsync, MissionItem, MissionPlan
from mavsdk.asyncio.plugins.offboard import (
    Attitude,
    OffboardAsync,
    PositionGlobalYaw,
    PositionNedYaw,
    VelocityBodyYawspeed,
    VelocityNedYaw,
)
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import FixType, FlightMode, LandedState, TelemetryAsync
from mavsdk.autopilot import Autopilot
from mavsdk_support import Checks, first, refusal, refused, vehicle

STREAMS = (
    "altitude", "armed", "attitude_angular_velocity_body", "attitude_euler", "attitude_quaternion",
    "battery", "fixedwing_metrics", "flight_mode", "gps_info", "heading", "health", "imu", "in_air",
    "landed_state", "odometry", "position", "position_velocity_ned", "raw_gps", "rc_status",
    "unix_epoch_time", "velocity_ned", "vtol_state",
)  # fmt: skip
"""Streams that PX4 sends to a companion by default."""
EARTH_M_DEG = 111_319.5
"""Length of a degree of latitude."""
NEAR_M = 1.0


class Flight:
    """The checks, which share one vehicle and its state."""

    def __init__(self, system: Any, checks: Checks) -> None:
        self.system = system
        self.checks = checks
        self.action, self.telemetry = ActionAsync(system), TelemetryAsync(system)
        self.param, self.info, self.offboard = ParamAsync(system), InfoAsync(system), OffboardAsync(system)
        self.mission, self.geofence = MissionAsync(system), GeofenceAsync(system)

    async def run(self) -> None:
        await self.identify()
        await self.streams()
        await self.parameters()
        await self.files()
        await self.refusals_on_the_ground()
        await self.take_off()
        await self.go_to()
        await self.fly_offboard()
        await self.fly_mission()
        await self.fence()
        await self.return_and_land()

    async def identify(self) -> None:
        check, info = self.checks.check, self.info
        await check("system id", self._is(self.system.get_system_id(), 1))
        await check("is a PX4", self._is(self.system.autopilot_type(), Autopilot.PX4))
        version = await check("version", info.get_version())
        await check("version 1.17", self._holds(version is not None and version.flight_sw_minor == 17))
        await check("identification", info.get_identification())
        await check("speed factor is 1", self._runs_at(1.0))

    async def streams(self) -> None:
        check, telemetry = self.checks.check, self.telemetry
        await check(
            "global position, home and arming become healthy",
            first(telemetry.subscribe_health(), lambda h: h.is_global_position_ok and h.is_armable),
            limit_s=40.0,
        )
        for name in STREAMS:  # 22
            await check(f"stream {name}", self._receives(name), limit_s=5.0)
        await check("everything is healthy", first(telemetry.subscribe_health_all_ok(), bool))
        await check("home", first(telemetry.subscribe_home()), limit_s=5.0)
        await check("3-D fix", first(telemetry.subscribe_gps_info(), lambda g: g.fix_type == FixType.FIX_3D))
        await check("rate of positions", telemetry.set_rate_position(20.0))
        await check("global origin", telemetry.get_gps_global_origin())

    async def parameters(self) -> None:
        check, param = self.checks.check, self.param
        everything = await check("all parameters", param.get_all_params(), limit_s=20.0)
        names = {p.name for p in (*everything.int_params, *everything.float_params)} if everything else set()
        await check("which has those of a PX4", self._holds({"MPC_XY_VEL_MAX", "COM_RC_IN_MODE"} <= names))
        await check("an integer parameter", param.get_param_int("COM_RC_IN_MODE"))
        await check("set a parameter", self._set_and_read("MPC_XY_CRUISE", 4.0))
        await check("an unknown one", refused(param.get_param_int("NO_SUCH_ONE"), "DOES_NOT_EXIST"))
        await check("one of the wrong type", refused(param.get_param_int("MPC_XY_CRUISE"), "WRONG_TYPE"))
        await check("take-off altitude", self._takeoff_altitude(4.0))
        await check("return altitude", self._return_altitude(8.0))

    async def files(self) -> None:
        check, metadata = self.checks.check, ComponentMetadataAsync(self.system)
        await check("a folder by FTP", FtpAsync(self.system).list_directory("/"))
        await check("request the metadata", metadata.request_autopilot_component())
        await check("the parameters'", self._parameter_metadata(metadata), limit_s=20.0)

    async def refusals_on_the_ground(self) -> None:
        check, offboard = self.checks.check, self.offboard
        await check("offboard without setpoint", refused(offboard.start(), "NO_SETPOINT_SET"))
        await check("mission mode without a mission", self.mission.start_mission())
        await check("which is its mode", self._mode(FlightMode.MISSION))
        # of the modes that do not arm: from mission and return MAVSDK itself changes to hold before it arms
        await check("land mode on the ground", self.action.land())
        await check("which is its mode", self._mode(FlightMode.LAND))
        await check("in which it does not arm", refused(self.action.arm(), "COMMAND_DENIED"))
        await check("back to hold", self.action.hold())
        await check("which is its mode", self._mode(FlightMode.HOLD))

    async def take_off(self) -> None:
        check, action, telemetry = self.checks.check, self.action, self.telemetry
        await check("arm", action.arm())
        await check("armed", first(telemetry.subscribe_armed(), bool))
        await check("take off", action.takeoff())
        await check(
            "in the air",
            first(telemetry.subscribe_landed_state(), lambda s: s == LandedState.IN_AIR),
            limit_s=20.0,
        )
        await check("at take-off altitude", self._height(4.0), limit_s=20.0)
        await check("and holds", self._mode(FlightMode.HOLD), limit_s=30.0)
        await check("disarming in the air", refused(action.disarm(), "COMMAND_DENIED"))

    async def go_to(self) -> None:
        check, action = self.checks.check, self.action
        here = await first(self.telemetry.subscribe_position())
        latitude_deg = here.latitude_deg + 6.0 / EARTH_M_DEG
        await check(
            "go to a place",
            action.goto_location(latitude_deg, here.longitude_deg, here.absolute_altitude_m + 1.0, 0.0),
        )
        await check(
            "which is reached",
            first(
                self.telemetry.subscribe_position(),
                lambda p: abs(p.latitude_deg - latitude_deg) * EARTH_M_DEG < NEAR_M,
            ),
            limit_s=20.0,
        )
        await check("another speed", action.set_current_speed(3.0))
        centre = (latitude_deg, here.longitude_deg, here.absolute_altitude_m + 1.0)
        await check("fly a circle", action.do_orbit(5.0, 2.0, OrbitYawBehavior.UNCONTROLLED, *centre))
        await check("which moves", first(self.telemetry.subscribe_velocity_ned(), _moves))

    async def fly_offboard(self) -> None:
        check, offboard = self.checks.check, self.offboard
        await offboard.set_position_ned(PositionNedYaw(0.0, 0.0, -5.0, 90.0))
        await check("offboard", offboard.start())
        await check("which is its mode", self._mode(FlightMode.OFFBOARD))
        await check("offboard place is reached", self._at(0.0, 0.0, -5.0), limit_s=25.0)
        await check("offboard velocity", self._velocity(VelocityNedYaw(0.0, 1.5, 0.0, 90.0)), limit_s=30.0)
        await check("velocity of the body", self._body_velocity(), limit_s=30.0)
        await check("global place", self._global_place(), limit_s=30.0)
        await check("attitude", self._attitude(), limit_s=30.0)
        await check("offboard ends", offboard.stop())
        await check("in hold", self._mode(FlightMode.HOLD))

    async def fly_mission(self) -> None:
        check, mission, here = (
            self.checks.check,
            self.mission,
            await first(self.telemetry.subscribe_position()),
        )
        places_m = ((6.0, 0.0), (6.0, 8.0), (0.0, 8.0))
        items = [
            _item(here.latitude_deg + north_m / EARTH_M_DEG, here.longitude_deg, east_m, height_m=6.0)
            for north_m, east_m in places_m
        ]
        await check("upload a mission", mission.upload_mission(MissionPlan(items)))
        await check("download it", self._downloads(items))
        await check("start it", mission.start_mission())
        await check("progress", self._progress(1), limit_s=30.0)
        await check("pause", mission.pause_mission())
        await check("which holds", self._mode(FlightMode.HOLD))
        await check("go on", mission.start_mission())
        await check("to its end", self._progress(len(items)), limit_s=60.0)
        await check("and is finished", self._finished())

    async def fence(self) -> None:
        check, geofence = self.checks.check, self.geofence
        home = await first(self.telemetry.subscribe_home())
        corners = [
            Point(home.latitude_deg + n * 100.0 / EARTH_M_DEG, home.longitude_deg + e * 200.0 / EARTH_M_DEG)
            for n, e in ((1, 1), (1, -1), (-1, -1), (-1, 1))
        ]
        data = GeofenceData([Polygon(corners, FenceType.INCLUSION)], [])
        await check("upload a geofence", geofence.upload_geofence(data))

    async def return_and_land(self) -> None:
        check, action, telemetry = self.checks.check, self.action, self.telemetry
        await check("return", action.return_to_launch())
        await check("which is its mode", self._mode(FlightMode.RETURN_TO_LAUNCH))
        await check("land", action.land())
        await check(
            "on the ground",
            first(telemetry.subscribe_landed_state(), lambda s: s == LandedState.ON_GROUND),
            limit_s=40.0,
        )
        await check("disarmed by itself", self._disarmed(), limit_s=30.0)

    # ---- facts

    async def _is(self, call: Any, expected: Any) -> bool:
        return bool(await call == expected)

    async def _runs_at(self, factor: float) -> bool:
        while await refusal(self.info.get_speed_factor()) == "INFORMATION_NOT_RECEIVED_YET":
            await first(self.telemetry.subscribe_position())
        return bool(abs(await self.info.get_speed_factor() - factor) <= 0.2)

    async def _receives(self, stream: str) -> tuple[Any]:
        return (await first(getattr(self.telemetry, f"subscribe_{stream}")()),)

    async def _holds(self, fact: bool) -> bool:  # noqa: FBT001
        return fact

    async def _disarmed(self) -> bool:
        return not await first(self.telemetry.subscribe_armed(), lambda armed: not armed)

    async def _mode(self, mode: FlightMode) -> Any:
        return await first(self.telemetry.subscribe_flight_mode(), lambda m: m == mode)

    async def _height(self, height_m: float) -> Any:
        stream = self.telemetry.subscribe_position()
        return await first(stream, lambda p: abs(p.relative_altitude_m - height_m) < NEAR_M)

    async def _at(self, north_m: float, east_m: float, down_m: float) -> Any:
        def near(here: Any) -> bool:
            p = here.position
            return math.dist((p.north_m, p.east_m, p.down_m), (north_m, east_m, down_m)) < NEAR_M

        return await first(self.telemetry.subscribe_position_velocity_ned(), near)

    async def _parameter_metadata(self, metadata: ComponentMetadataAsync) -> bool:
        update = await first(
            metadata.subscribe_metadata_available(), lambda one: one.type == MetadataType.PARAMETER
        )
        return "MPC_XY_CRUISE" in update.json_metadata

    async def _set_and_read(self, name: str, value: float) -> bool:
        before = await self.param.get_param_float(name)
        await self.param.set_param_float(name, value)
        there = await self.param.get_param_float(name)
        await self.param.set_param_float(name, before)
        return bool(there == value)

    async def _takeoff_altitude(self, height_m: float) -> bool:
        await self.action.set_takeoff_altitude(height_m)
        return bool(await self.action.get_takeoff_altitude() == height_m)

    async def _return_altitude(self, height_m: float) -> bool:
        await self.action.set_return_to_launch_altitude(height_m)
        return bool(await self.action.get_return_to_launch_altitude() == height_m)

    async def _velocity(self, target: VelocityNedYaw) -> Any:
        await self.offboard.set_velocity_ned(target)
        stream = self.telemetry.subscribe_velocity_ned()
        return await first(stream, lambda v: abs(v.east_m_s - target.east_m_s) < 0.3)

    async def _body_velocity(self) -> Any:
        await self.offboard.set_velocity_body(
            VelocityBodyYawspeed(-1.5, 0.0, 0.0, 0.0)
        )  # its heading is east
        return await first(self.telemetry.subscribe_velocity_ned(), lambda v: abs(v.east_m_s + 1.5) < 0.4)

    async def _global_place(self) -> Any:
        here = await first(self.telemetry.subscribe_position())
        kind = PositionGlobalYaw.AltitudeType.REL_HOME
        place = PositionGlobalYaw(here.latitude_deg + 3.0 / EARTH_M_DEG, here.longitude_deg, 5.0, 0.0, kind)
        await self.offboard.set_position_global(place)
        return await first(
            self.telemetry.subscribe_position(),
            lambda p: abs(p.latitude_deg - place.lat_deg) * EARTH_M_DEG < NEAR_M,
        )

    async def _attitude(self) -> Any:
        await self.offboard.set_attitude(Attitude(0.0, -8.0, 0.0, 0.72))  # pitch down
        return await first(self.telemetry.subscribe_attitude_euler(), lambda a: abs(a.pitch_deg + 8.0) < 2.0)

    async def _downloads(self, items: list[MissionItem]) -> bool:
        there = (await self.mission.download_mission()).mission_items
        same = [
            math.isclose(a.latitude_deg, b.latitude_deg, abs_tol=2e-7)
            and math.isclose(a.longitude_deg, b.longitude_deg, abs_tol=2e-7)
            and math.isclose(a.relative_altitude_m, b.relative_altitude_m, abs_tol=1e-3)
            for a, b in zip(there, items, strict=True)
        ]
        return all(same)

    async def _progress(self, current: int) -> Any:
        return await first(self.mission.subscribe_mission_progress(), lambda p: p.current >= current)

    async def _finished(self) -> bool:
        while not await self.mission.is_mission_finished():
            await first(self.telemetry.subscribe_position())
        return True


def _moves(velocity: Any) -> bool:
    return math.hypot(velocity.north_m_s, velocity.east_m_s) > 1.0


def _item(latitude_deg: float, longitude_deg: float, east_m: float, *, height_m: float) -> MissionItem:
    """A waypoint that is flown through at 4 m/s, with defaults for everything else."""
    east_deg = east_m / (EARTH_M_DEG * math.cos(math.radians(latitude_deg)))
    return MissionItem(
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg + east_deg,
        relative_altitude_m=height_m,
        speed_m_s=4.0,
        is_fly_through=True,
        acceptance_radius_m=1.0,
    )


async def main() -> None:
    async with vehicle(int(sys.argv[1])) as (system, checks):
        await Flight(system, checks).run()


if __name__ == "__main__":
    asyncio.run(main())
