"""Settings of a swarm beside its scenario: speed and ports."""

from typing import Literal

import msgspec

from harness.launch.run_messages import SetupError
from harness.scenario.scenario import Scenario

Speed = float | Literal["max"]
Ports = Literal["free", "scenario"]
PortOffset = int | Literal["auto"]


def speed_factor(speed: Speed) -> float:
    """Return the physics server's speed factor, 0: as fast as possible. Raises ValueError."""
    if speed == "max":
        return 0.0
    if not 0.0 < speed < float("inf"):
        raise ValueError(f"speed {speed}: expected a factor above 0, or 'max'")
    return float(speed)


LEAST_PACED_SPEED = 0.001
"""With it a step takes 4 s of wall time, half of the time within which the emulator must answer."""


def check_speed(scenario: Scenario, factor: float) -> None:
    """Raise SetupError for a factor with which programs cannot live in wall time; 0 is without a pace."""
    if scenario.has_network and factor < LEAST_PACED_SPEED:
        given = f"{factor:g}" if factor else "max"
        raise SetupError(
            f"speed {given}: [[programs]] and [network] need wall time; expected a factor, such as 1 or 0.5"
        )


def with_ports(scenario: Scenario, ports: Ports, offset: PortOffset) -> Scenario:
    """Return the scenario with free ports, or with its own plus a number. Raises SetupError."""
    if ports == "scenario" and offset == "auto":
        return scenario
    try:
        own = scenario.ports
        changed = own.raised(int(offset), scenario.ground_ports) if ports == "scenario" else own.free()
    except ValueError as error:
        raise SetupError(str(error)) from None
    return msgspec.structs.replace(scenario, ports=changed)
