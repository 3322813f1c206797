"""Common parts of the MAVSDK clients: a connection, conditions with a deadline, and checks reported as JSON.

The client scripts in this folder run as separate processes: MAVSDK's calls block threads, and a hanging one
would block its caller. Each prints a line of JSON per check, so that results are available even if the
process has to be killed.
"""

import asyncio
import json
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync

DISCOVERY_S = 30.0
LOOK_S = 0.1
PATIENCE = 4.0


class Checks:
    """Runs checks one after the other; each is reported at once, and a failure does not end the run.

    Limits are in the vehicle's time, which is slower than the wall clock on a busy machine. Without messages
    from the vehicle a check ends after `PATIENCE` times its limit of wall time.
    """

    def __init__(self) -> None:
        self.vehicle_s: float | None = None
        """The vehicle's time, from its last odometry."""

    async def follow(self, system: Any) -> None:
        """Update the vehicle's time until cancelled."""
        async for odometry in TelemetryAsync(system).subscribe_odometry():
            self.vehicle_s = 1e-6 * odometry.time_usec

    async def check(self, name: str, finding: Awaitable[Any], *, limit_s: float = 10.0) -> Any:
        """Await a finding and return it, or None for a failure: an exception, a time-out or False."""
        wall_begin_s, begin_s = time.monotonic(), self.vehicle_s
        task = asyncio.ensure_future(finding)
        over = False
        while not task.done() and not over:
            await asyncio.wait({task}, timeout=LOOK_S)
            wall_s = time.monotonic() - wall_begin_s
            begin_s = self.vehicle_s if begin_s is None else begin_s  # from its first message
            over = self._since(begin_s) > limit_s or wall_s > PATIENCE * limit_s
        result, trouble = None, ""
        if not task.done():
            trouble = f"nothing within {limit_s:g} s"
            task.cancel()
            await asyncio.wait({task}, timeout=LOOK_S)
        elif (error := task.exception()) is not None:  # any exception of a client is reported
            trouble = f"{type(error).__name__}: {error}".replace("\n", " ")
        elif (result := task.result()) is False:
            trouble = "the condition is false"
        report = {
            "check": name,
            "ok": not trouble,
            "wall_s": round(time.monotonic() - wall_begin_s, 2),
            "vehicle_s": round(self._since(begin_s), 2),
        }
        sys.stdout.write(json.dumps(report | ({"trouble": trouble} if trouble else {})) + "\n")
        sys.stdout.flush()
        return None if trouble else result

    def _since(self, begin_s: float | None) -> float:
        return 0.0 if begin_s is None or self.vehicle_s is None else self.vehicle_s - begin_s


@asynccontextmanager
async def vehicle(port: int) -> AsyncIterator[tuple[Any, Checks]]:
    """Connect to the vehicle that sends to this UDP port; yield MAVSDK's system and the checks."""
    configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    async with Mavsdk(configuration) as mavsdk:
        await mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        system = await mavsdk.first_autopilot(timeout_s=DISCOVERY_S)
        checks = Checks()
        clock = asyncio.create_task(checks.follow(system))
        try:
            yield system, checks
        finally:
            clock.cancel()
            await asyncio.wait({clock}, timeout=LOOK_S)


async def first(stream: AsyncIterator[Any], condition: Callable[[Any], bool] = lambda _: True) -> Any:
    """Return the first value of a subscription for which the condition holds."""
    async for value in stream:
        if condition(value):
            return value
    raise EOFError("the subscription ended")


async def refusal(call: Awaitable[Any]) -> str:
    """Return the name of the result with which a call fails; "SUCCESS" if it does not."""
    try:
        await call
    except Exception as error:
        result = getattr(error, "result", None)
        if result is None:
            raise
        return str(result.name)
    return "SUCCESS"


async def refused(call: Awaitable[Any], expected: str) -> bool:
    """Return True if a call fails with that result, else raise AssertionError."""
    result = await refusal(call)
    if result != expected:
        raise AssertionError(f"{result}, expected {expected}")
    return True
