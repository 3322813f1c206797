"""``python mavsdk_hop.py PORT SYSTEM``: MAVSDK flies its own vehicle up, sideways, and down."""

import asyncio
import sys

from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync, PositionNedYaw
from mavsdk.asyncio.plugins.telemetry import LandedState, TelemetryAsync
from mavsdk_support import first, vehicle

HEIGHT_M = 3.0
SIDE_M = 3.0
NEAR_M = 0.7


async def main(port: int, system_id: int) -> None:
    async with vehicle(port) as (system, checks):
        action, telemetry, offboard = ActionAsync(system), TelemetryAsync(system), OffboardAsync(system)

        async def is_mine() -> bool:
            return bool(await system.get_system_id() == system_id)

        async def is_disarmed() -> bool:
            return not await first(telemetry.subscribe_armed(), lambda armed: not armed)

        await checks.check("its own vehicle", is_mine())
        await checks.check("healthy", first(telemetry.subscribe_health_all_ok(), bool), limit_s=40.0)
        await checks.check("altitude", action.set_takeoff_altitude(HEIGHT_M))
        await checks.check("arm", action.arm())
        await checks.check("take off", action.takeoff())
        await checks.check(
            "up",
            first(telemetry.subscribe_position(), lambda p: abs(p.relative_altitude_m - HEIGHT_M) < NEAR_M),
            limit_s=20.0,
        )
        here = (await first(telemetry.subscribe_position_velocity_ned())).position
        await offboard.set_position_ned(PositionNedYaw(here.north_m + SIDE_M, here.east_m, -HEIGHT_M, 0.0))
        await checks.check("offboard", offboard.start())
        await checks.check(
            "there",
            first(
                telemetry.subscribe_position_velocity_ned(),
                lambda p: abs(p.position.north_m - here.north_m - SIDE_M) < NEAR_M,
            ),
            limit_s=20.0,
        )
        await checks.check("land", action.land())
        await checks.check(
            "down",
            first(telemetry.subscribe_landed_state(), lambda s: s == LandedState.ON_GROUND),
            limit_s=30.0,
        )
        await checks.check("disarmed", is_disarmed(), limit_s=15.0)


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), int(sys.argv[2])))
