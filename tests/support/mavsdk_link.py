"""``python mavsdk_link.py PORT``: MAVSDK at a ground station on the radio; its link is lost and returns."""

import asyncio
import sys

from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk_support import first, vehicle


async def main(port: int) -> None:
    async with vehicle(port) as (system, checks):
        action, param, telemetry = ActionAsync(system), ParamAsync(system), TelemetryAsync(system)

        async def is_set() -> bool:
            await param.set_param_float("MPC_XY_CRUISE", 4.0)
            return bool(await param.get_param_float("MPC_XY_CRUISE") == 4.0)

        async def is_lost() -> bool:
            return not await first(system.is_connected_state(), lambda there: not there)

        await checks.check("a parameter", is_set())
        await checks.check("healthy", first(telemetry.subscribe_health_all_ok(), bool), limit_s=40.0)
        await checks.check("lost", is_lost(), limit_s=60.0)
        await checks.check("back", first(system.is_connected_state(), bool), limit_s=40.0)
        await checks.check("arm", action.arm())
        await checks.check("disarm", action.disarm())


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1])))
