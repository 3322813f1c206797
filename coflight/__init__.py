"""The public face of coflight: flies a UAV swarm together with its radio.

    from coflight import Swarm

    with Swarm("article", agents=3, overrides=["formation.columns=2"]) as swarm:
        swarm.run_until_formed(timeout_s=60)

`Swarm`, `OneProcessSwarm`, `Scenario`, `load_scenario`, the errors that they raise and the protocols of parts
that can be replaced (`Application`, `Controller` and others), with the types that they exchange, are loaded
on first use, as is the module `coflight.env` with environments for learning. What they do is left to
`harness` and the packages below; the ``coflight`` command is `coflight.command`.
"""

import os
from importlib import import_module
from pkgutil import resolve_name
from typing import TYPE_CHECKING

from foundation.kernels import cache_folder

if TYPE_CHECKING:
    from autopilot.commander.arming_checks import Condition
    from autopilot.commander.mode_table import ModeTraits
    from autopilot.control.controller import Controller, ControllerContext, ControllerInputs, ThrustTorque
    from autopilot.mavlink.modes import FlightMode
    from autopilot.navigation.flight_mode import (
        FlightModeBehaviour,
        ModeContext,
        ModeEntry,
        ModeInputs,
        StopMode,
    )
    from autopilot.onboard.application import Application, Estimate, Reports, Status
    from autopilot.onboard.client.autopilot_client import AutopilotClient, FlightState
    from autopilot.onboard.context import Context, Radio
    from autopilot.services.service import MavlinkService
    from autopilot.services.user_service import ServiceContext
    from foundation.types import (
        AttitudeSetpoint,
        Course,
        EstimatorState,
        RateSetpoint,
        TrajectorySetpoint,
    )
    from harness.campaign import Campaign
    from harness.env.policy import PolicyApplication
    from harness.env.settings import EnvSettings
    from harness.launch.one_process import OneProcessSwarm
    from harness.launch.run_messages import SetupError, SwarmError, SwarmTimeoutError
    from harness.launch.swarm import Swarm
    from harness.launch.truth import SwarmTruth
    from harness.scenario.scenario import Scenario, ScenarioError
    from harness.scenario.scenario_file import load as load_scenario
    from harness.world.faults import UserFault
    from harness.world.interfaces import (
        AutopilotSensor,
        Effects,
        FaultModel,
        Reading,
        Sensor,
        SensorFaultModel,
        WorldContext,
        WorldInputs,
    )
    from harness.world.obstacles import Obstacles
    from harness.world.physics.interface import Physics
    from netsim.emulator.interface import NetworkEmulator
    from netsim.phy.interfaces import AntennaPattern, ErrorModel, Fading, PathLoss, RadioContext, Shadowing
    from netsim.transport.guest import Guest
    from netsim.wire.messages import Delivery, FtmResult, Sent, Survey

__all__ = [
    "AntennaPattern", "Application", "AttitudeSetpoint", "AutopilotClient", "AutopilotSensor", "Campaign",
    "Condition", "Context", "Controller", "ControllerContext", "ControllerInputs", "Course", "Delivery",
    "Effects", "EnvSettings", "ErrorModel", "Estimate", "EstimatorState", "Fading", "FaultModel",
    "FlightMode", "FlightModeBehaviour", "FlightState", "FtmResult", "Guest", "MavlinkService",
    "ModeContext", "ModeEntry", "ModeInputs", "ModeTraits", "NetworkEmulator", "Obstacles",
    "OneProcessSwarm", "PathLoss", "Physics", "PolicyApplication", "Radio", "RadioContext",
    "RateSetpoint", "Reading", "Reports", "Scenario", "ScenarioError", "Sensor", "SensorFaultModel",
    "Sent", "ServiceContext", "SetupError", "Shadowing", "Status", "StopMode", "Survey", "Swarm",
    "SwarmError", "SwarmTimeoutError", "SwarmTruth", "ThrustTorque", "TrajectorySetpoint", "UserFault",
    "WorldContext", "WorldInputs", "load_scenario",
]  # fmt: skip

_PLACES = {
    "AntennaPattern": "netsim.phy.interfaces:AntennaPattern",
    "Application": "autopilot.onboard.application:Application",
    "AttitudeSetpoint": "foundation.types:AttitudeSetpoint",
    "AutopilotClient": "autopilot.onboard.client.autopilot_client:AutopilotClient",
    "AutopilotSensor": "harness.world.interfaces:AutopilotSensor",
    "Campaign": "harness.campaign:Campaign",
    "Condition": "autopilot.commander.arming_checks:Condition",
    "Context": "autopilot.onboard.context:Context",
    "Controller": "autopilot.control.controller:Controller",
    "ControllerContext": "autopilot.control.controller:ControllerContext",
    "ControllerInputs": "autopilot.control.controller:ControllerInputs",
    "Course": "foundation.types:Course",
    "Delivery": "netsim.wire.messages:Delivery",
    "Effects": "harness.world.interfaces:Effects",
    "EnvSettings": "harness.env.settings:EnvSettings",
    "ErrorModel": "netsim.phy.interfaces:ErrorModel",
    "Estimate": "autopilot.onboard.application:Estimate",
    "EstimatorState": "foundation.types:EstimatorState",
    "Fading": "netsim.phy.interfaces:Fading",
    "FaultModel": "harness.world.interfaces:FaultModel",
    "FlightMode": "autopilot.mavlink.modes:FlightMode",
    "FlightModeBehaviour": "autopilot.navigation.flight_mode:FlightModeBehaviour",
    "FlightState": "autopilot.onboard.client.autopilot_client:FlightState",
    "FtmResult": "netsim.wire.messages:FtmResult",
    "Guest": "netsim.transport.guest:Guest",
    "MavlinkService": "autopilot.services.service:MavlinkService",
    "ModeContext": "autopilot.navigation.flight_mode:ModeContext",
    "ModeEntry": "autopilot.navigation.flight_mode:ModeEntry",
    "ModeInputs": "autopilot.navigation.flight_mode:ModeInputs",
    "ModeTraits": "autopilot.commander.mode_table:ModeTraits",
    "NetworkEmulator": "netsim.emulator.interface:NetworkEmulator",
    "Obstacles": "harness.world.obstacles:Obstacles",
    "OneProcessSwarm": "harness.launch.one_process:OneProcessSwarm",
    "PathLoss": "netsim.phy.interfaces:PathLoss",
    "Physics": "harness.world.physics.interface:Physics",
    "PolicyApplication": "harness.env.policy:PolicyApplication",
    "Radio": "autopilot.onboard.context:Radio",
    "RadioContext": "netsim.phy.interfaces:RadioContext",
    "RateSetpoint": "foundation.types:RateSetpoint",
    "Reading": "harness.world.interfaces:Reading",
    "Reports": "autopilot.onboard.application:Reports",
    "Scenario": "harness.scenario.scenario:Scenario",
    "ScenarioError": "harness.scenario.scenario:ScenarioError",
    "Sensor": "harness.world.interfaces:Sensor",
    "SensorFaultModel": "harness.world.interfaces:SensorFaultModel",
    "Sent": "netsim.wire.messages:Sent",
    "ServiceContext": "autopilot.services.user_service:ServiceContext",
    "SetupError": "harness.launch.run_messages:SetupError",
    "Shadowing": "netsim.phy.interfaces:Shadowing",
    "Status": "autopilot.onboard.application:Status",
    "StopMode": "autopilot.navigation.flight_mode:StopMode",
    "Survey": "netsim.wire.messages:Survey",
    "Swarm": "harness.launch.swarm:Swarm",
    "SwarmError": "harness.launch.run_messages:SwarmError",
    "SwarmTimeoutError": "harness.launch.run_messages:SwarmTimeoutError",
    "SwarmTruth": "harness.launch.truth:SwarmTruth",
    "ThrustTorque": "autopilot.control.controller:ThrustTorque",
    "TrajectorySetpoint": "foundation.types:TrajectorySetpoint",
    "UserFault": "harness.world.faults:UserFault",
    "WorldContext": "harness.world.interfaces:WorldContext",
    "WorldInputs": "harness.world.interfaces:WorldInputs",
    "load_scenario": "harness.scenario.scenario_file:load",
}


def __getattr__(name: str) -> object:
    """Load a public name from its module; raises AttributeError for any other."""
    if name == "env":
        return import_module("coflight.env")
    if name not in _PLACES:
        raise AttributeError(f"module 'coflight' has no attribute {name!r}")
    # read when numba is imported, which the module does
    os.environ.update(cache_folder.environment())
    value: object = resolve_name(_PLACES[name])
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
