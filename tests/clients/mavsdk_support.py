"""What the MAVSDK clients share: a connection, facts that are waited for, and checks that are told as JSON.

The scripts beside this file are processes of their own: MAVSDK's calls block threads, and a hung one would
hold up whoever waits for it. Each prints a line of JSON for every check, so that what was found is known even
if the process has to be killed.
"""

import asyncio
import json
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk

DISCOVERY_S = 30.0


class Checks:
    """Runs checks one after the other; each is told at once, and none that fails ends the others."""

    async def check(self, name: str, finding: Awaitable[Any], *, limit_s: float = 10.0) -> Any:
        """Await a finding: an exception, a time-out or False is a failure. Returns it, or None."""
        wall_begin_s = time.monotonic()
        result, trouble = None, ""
        try:
            result = await asyncio.wait_for(finding, limit_s)
            if result is False:
                trouble = "not so"
        except TimeoutError:
            trouble = f"nothing within {limit_s:g} s"
        except Exception as error:  # noqa: BLE001  whatever a client raises is what is to be told
            trouble = f"{type(error).__name__}: {error}".replace("\n", " ")
        told = {"check": name, "ok": not trouble, "wall_s": round(time.monotonic() - wall_begin_s, 2)}
        sys.stdout.write(json.dumps(told | ({"trouble": trouble} if trouble else {})) + "\n")
        sys.stdout.flush()
        return None if trouble else result


@asynccontextmanager
async def vehicle(port: int) -> AsyncIterator[Any]:
    """The vehicle that calls this UDP port, as MAVSDK's system."""
    configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    async with Mavsdk(configuration) as mavsdk:
        await mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        yield await mavsdk.first_autopilot(timeout_s=DISCOVERY_S)


async def first(stream: AsyncIterator[Any], condition: Callable[[Any], bool] = lambda _: True) -> Any:
    """The first value of a subscription for which the condition holds."""
    async for value in stream:
        if condition(value):
            return value
    raise EOFError("the subscription ended")


async def refusal(call: Awaitable[Any]) -> str:
    """Name of the result with which a call fails; "SUCCESS" if it does not."""
    try:
        await call
    except Exception as error:
        result = getattr(error, "result", None)
        if result is None:
            raise
        return str(result.name)
    return "SUCCESS"


async def refused(call: Awaitable[Any], expected: str) -> bool:
    """Whether a call fails with that result, and no other."""
    result = await refusal(call)
    if result != expected:
        raise AssertionError(f"{result}, expected {expected}")
    return True
