"""The page of the Python interface: signatures and docstrings of what programs and tests use."""

import ast
import inspect
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator
from types import FunctionType
from typing import Any

import coflight.env
import harness.campaign
import harness.launch.swarm
from autopilot.commander.mode_table import ModeTraits
from autopilot.control.controller import Controller, ControllerContext, ControllerInputs, ThrustTorque
from autopilot.navigation.flight_mode import FlightModeBehaviour
from autopilot.onboard.application import Application, Estimate, Reports, Status
from autopilot.onboard.client.autopilot_client import AutopilotClient
from autopilot.onboard.context import Context, Radio
from autopilot.services.service import MavlinkService
from autopilot.services.user_service import ServiceContext
from foundation.docstrings import field_docstrings
from harness.campaign import CampaignError, ClusterError
from harness.env.settings import EnvSettings
from harness.launch import pytest_plugin
from harness.launch.one_process import OneProcessSwarm
from harness.launch.swarm import SetupError, Swarm, SwarmError, SwarmTimeoutError, SwarmTruth
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
from netsim.wire.messages import Delivery, FtmResult, Sent, Survey
from reference.markdown import UndocumentedError, one_line, paragraphs, table

INTRODUCTION = """# Python API

What programs, notebooks and tests import: a swarm that flies while a program runs it, the fixture for
pytest, campaigns, and the protocols of parts that can be replaced. This page is generated from the
docstrings by `scripts/write_reference.py`.
"""

PROTOCOLS = (
    Application, Controller, FlightModeBehaviour, MavlinkService, PathLoss, Shadowing, AntennaPattern, Fading,
    ErrorModel, Sensor, AutopilotSensor, FaultModel, SensorFaultModel, NetworkEmulator, Physics,
)  # fmt: skip
EXCHANGED: dict[type, tuple[type, ...]] = {
    Application: (
        Context,
        Radio,
        AutopilotClient,
        Reports,
        Status,
        Estimate,
        Delivery,
        Sent,
        FtmResult,
        Survey,
    ),
    Controller: (ControllerContext, ControllerInputs, ThrustTorque),
    FlightModeBehaviour: (ModeTraits,),
    MavlinkService: (ServiceContext,),
    PathLoss: (RadioContext,),
    Sensor: (WorldContext, WorldInputs, Reading, Obstacles),
    FaultModel: (Effects,),
}
"""Types that the members of a protocol exchange, all of them names of `coflight`."""
OF_HOST: dict[type, frozenset[str]] = {
    AutopilotClient: frozenset(("__init__", "on_message", "begin", "take")),
    Context: frozenset(("__init__", "take_warnings")),
    Radio: frozenset(("__init__", "is_for", "take")),
    Reports: frozenset(("layout",)),
}
"""Methods that only the host of applications calls, which the page leaves out."""
PROTOCOLS_INTRODUCTION = """The built-in parts are reached through these protocols of `typing`, so that
another object with the same methods can take their place. None of them does I/O, reads a clock or draws
random numbers of its own: time, state and randomness are arguments, or come from the factory."""

_FIELDS = ("__struct_fields__", "__dataclass_fields__", "_fields")
"""Attributes with the names of fields: of a Struct, a dataclass and a NamedTuple."""
WIDTH = 88
"""Columns of a signature that stands on one line."""


def python_page() -> str:
    """Return the page; raises UndocumentedError for a public method without a docstring."""
    parts = [INTRODUCTION, "## Swarm\n", "`from coflight import Swarm`\n"]
    parts.append(_module_text(harness.launch.swarm))
    for kind in (Swarm, SwarmTruth, OneProcessSwarm):
        parts += _class(kind, "###")
    parts += ["### Errors\n", table(("error", "meaning"), _errors())]
    parts += ["## The fixture swarm of pytest\n", _module_text(pytest_plugin)]
    fixture = inspect.unwrap(getattr(pytest_plugin.swarm, "__wrapped__", pytest_plugin.swarm))
    parts.append(paragraphs(_doc(fixture, "swarm")) + "\n")
    parts += ["## Campaigns\n", "`from coflight import Campaign`, `from harness.campaign import load, run`\n"]
    parts.append(_module_text(harness.campaign))
    for name in ("load", "run"):
        parts += _function(name, getattr(harness.campaign, name), "###")
    for name in ("Campaign", "Case", "Landed", "Table"):
        parts += _class(getattr(harness.campaign, name), "###")
    parts += ["## Environments for learning\n", "`import coflight.env`\n", _module_text(coflight.env)]
    for function in (coflight.env.parallel_env, coflight.env.single_env, coflight.env.hold_place):
        parts += _function(function.__name__, function, "###")
    for struct in (coflight.env.EnvState, EnvSettings):
        parts += _class(struct, "###")
    parts += ["## Protocols of replaceable parts\n", paragraphs(PROTOCOLS_INTRODUCTION) + "\n"]
    for protocol in PROTOCOLS:
        name = protocol.__name__
        parts += [f"### {name}\n", f"`from coflight import {name}`\n"]
        parts += [paragraphs(_doc(protocol, name)) + "\n", *_members(protocol, "####")]
        for exchanged in EXCHANGED.get(protocol, ()):
            parts += _class(exchanged, "####")
    return "\n".join(parts)


def _errors() -> Iterator[tuple[str, str]]:
    for kind in (SwarmError, SwarmTimeoutError, SetupError, CampaignError, ClusterError):
        yield f"`{kind.__name__}`", one_line(_doc(kind, kind.__name__))


def _module_text(module: Any) -> str:  # noqa: ANN401
    """Return the docstring of a module without its first line, which says that it is one."""
    text = inspect.getdoc(module) or ""
    _, _, rest = text.partition("\n")
    return paragraphs(rest) + "\n" if rest.strip() else ""


def _class(kind: type, level: str) -> Iterator[str]:
    yield f"{level} {kind.__name__}\n"
    fields = field_docstrings(kind)
    kept = [getattr(kind, each, None) for each in _FIELDS]
    names: Iterable[str] | None = next((each for each in kept if each is not None), None)
    if names is not None:
        yield paragraphs(_doc(kind, kind.__name__)) + "\n"
        notes = inspect.get_annotations(kind)
        rows = [(f"`{name}`", f"`{_name(notes[name])}`", one_line(fields.get(name, ""))) for name in names]
        yield table(("field", "type", "meaning"), rows)
    else:
        if "__init__" not in OF_HOST.get(kind, ()):
            constructor = vars(kind)["__init__"]
            yield f"```python\n{_signature(kind.__name__, constructor)}\n```\n"
        yield paragraphs(_doc(kind, kind.__name__)) + "\n"
    yield from _members(kind, f"{level}#")


def _members(kind: type, level: str) -> Iterator[str]:
    """Return the public methods and properties that a class defines."""
    for name, member in vars(kind).items():
        if name.startswith("_") or name in OF_HOST.get(kind, ()):
            continue
        if isinstance(member, property):
            yield from _property(f"{kind.__name__}.{name}", member, level)
        elif isinstance(member, FunctionType | classmethod):
            function = member.__func__ if isinstance(member, classmethod) else member
            yield from _function(f"{kind.__name__}.{name}", function, level)


def _property(name: str, member: property, level: str) -> Iterator[str]:
    getter = member.fget
    if getter is None:
        return
    yield f"{level} {name}\n"
    yield f"```python\n{name}: {_returned(getter)}\n```\n"
    yield paragraphs(_doc(getter, name)) + "\n"


def _function(name: str, function: Callable[..., Any], level: str) -> Iterator[str]:
    yield f"{level} {name}\n"
    yield f"```python\n{_signature(name, function)}\n```\n"
    yield paragraphs(_doc(function, name)) + "\n"


def _signature(name: str, function: Callable[..., Any]) -> str:
    """Return a signature with the annotations of the source, in lines of a width that fits a page."""
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(function))).body
    if not isinstance(definition, ast.FunctionDef):
        raise TypeError(f"{name}: expected a function")
    given = definition.args
    arguments = [each for each in [*given.posonlyargs, *given.args] if each.arg not in {"self", "cls"}]
    required = len(arguments) - len(given.defaults)
    texts = list(map(_argument, arguments, [*[None] * required, *given.defaults]))
    if given.vararg:
        texts.append(f"*{_argument(given.vararg, None)}")
    elif given.kwonlyargs:
        texts.append("*")
    texts += map(_argument, given.kwonlyargs, given.kw_defaults)
    returns = definition.returns
    result = "" if returns is None or definition.name == "__init__" else f" -> {ast.unparse(returns)}"
    line = f"{name}({', '.join(texts)}){result}"
    if len(line) <= WIDTH:
        return line
    body = "".join(f"    {text},\n" for text in texts)
    return f"{name}(\n{body}){result}"


def _argument(argument: ast.arg, default: ast.expr | None) -> str:
    text = ast.unparse(argument)  # with its annotation
    return text if default is None else f"{text} = {ast.unparse(default)}"


def _returned(getter: Callable[..., Any]) -> str:
    _, _, returned = _signature("property", getter).partition(" -> ")
    return returned


def _name(annotation: object) -> str:
    """Return an annotation as it is written, without the modules of its names and without ranges."""
    text = annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)
    text = re.sub(r"\b(?:[a-z_0-9]+\.)+(?=[A-Za-z])", "", text)
    return re.sub(r"Annotated\[(\w+), Meta\([^()]*\)\]", r"\1", text)  # the meaning states the range


def _doc(what: object, name: str) -> str:
    text = inspect.getdoc(what)
    if not text:
        raise UndocumentedError(f"{name}: public, and without a docstring")
    return text
