"""A whole flight in one thread: simulation, vehicles and 802.11 emulator, composed by calls.

`harness.launch.one_process` executes a run's commands on it; `harness.env` steps it for learning.
"""

import contextlib
from collections.abc import Callable, Sequence
from functools import partial

import msgspec

from autopilot.parameters.config import VehicleConfig
from foundation.extension_failure import ExtensionFailure
from harness.launch.process_commands import PHYSICS
from harness.records.run_folder import PhysicsConfig
from harness.simulator.emulator_client import EmulatorClient
from harness.simulator.in_process_links import InProcessEmulatorLine, InProcessLink, InProcessRadio
from harness.simulator.lockstep import Lockstep
from harness.simulator.response_watchdog import ResponseWatchdog
from harness.simulator.simulation import Simulation
from netsim.emulator.service import make_emulator
from netsim.model.config import ServerConfig


class InProcessFlight:
    """The composed simulation, constructed and used in one thread, and closed at the end.

    ``emit(name, event)`` receives the events of physics server and vehicles, ``on_failure(name, failure)``
    the failure of user code on a vehicle.

    Attributes:
        simulation: the simulation, whose `Simulation.step` advances everything.
        emulator: the 802.11 emulator.
        links: the vehicles, by their numbers.

    """

    def __init__(
        self,
        physics: PhysicsConfig,
        radio: ServerConfig,
        vehicles: Sequence[VehicleConfig],
        *,
        emit: Callable[[str, msgspec.Struct], None],
        on_failure: Callable[[str, ExtensionFailure], None],
    ) -> None:
        with contextlib.ExitStack() as stack:  # closes everything if a part cannot be opened
            self.emulator = stack.enter_context(contextlib.closing(make_emulator(radio)))
            self.emulator.open_logs()
            radios = [InProcessRadio(self.emulator, config.instance) for config in vehicles]
            line = InProcessEmulatorLine(self.emulator, radios)
            period_us = physics.scenario.onboard.loop_period_us
            emulator = EmulatorClient(line, period_us=period_us, asynchronous=bool(radio.radio.guests))
            self.links = [
                stack.enter_context(
                    contextlib.closing(InProcessLink(config, radio, emit=emit, on_failure=on_failure))
                )
                for config, radio in zip(vehicles, radios, strict=True)
            ]

            def make_lockstep(simulation: Simulation) -> Lockstep:
                return Lockstep(
                    links=dict(enumerate(self.links)),
                    watchdog=ResponseWatchdog(physics.scenario.run.silence_limit_s),
                    on_message=simulation.on_message,
                    on_silent=simulation.reports.on_silent,
                    on_lost=simulation.reports.on_lost,
                    rotors=physics.scenario.most_rotors,
                )

            self.simulation = stack.enter_context(
                contextlib.closing(
                    Simulation(
                        physics, make_lockstep=make_lockstep, emulator=emulator, emit=partial(emit, PHYSICS)
                    )
                )
            )
            self._open = stack.pop_all()

    def kill(self, name: str) -> None:
        """End a vehicle at once; the simulation reports it as lost in the next step."""
        for link in self.links:
            link.killed |= link.host.name == name

    def close(self) -> None:
        """Close vehicles, logs and world; harmless when repeated."""
        self._open.close()
