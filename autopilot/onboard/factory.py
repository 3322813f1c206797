"""Factory of a UAV's programs, for the autopilot's process or a companion process."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from autopilot.mavlink.components import APPLICATION_COMPONENT
from autopilot.onboard.application import NO_APPLICATION, Application, Layout
from autopilot.onboard.client.autopilot_client import AutopilotClient
from autopilot.onboard.client.autopilots import ARDUPILOT, PX4
from autopilot.onboard.context import Context, Radio
from autopilot.onboard.formation_plan import FormationPlan
from autopilot.onboard.program import Program, layout
from autopilot.onboard.programs import Programs
from autopilot.parameters.config import VehicleConfig
from autopilot.parameters.onboard_config import OnboardConfig, ProgramConfig
from foundation.extension_call import ExtensionCall
from foundation.extensions import ExtensionError, convert, is_path, load, registered

APPLICATIONS = "coflight.applications"
"""Group of entry points."""
BUILT_IN = {"formation": "autopilot.onboard.app:OnboardApp"}
"""Places of the applications by name; imported when they are used."""
_METHODS = (
    "start", "on_mavlink", "on_request", "on_radio", "on_timer", "status", "estimate", "troubles", "warm_up",
    "dissectors",
)  # fmt: skip


class Loaded(NamedTuple):
    """The class of a program and its settings."""

    kind: type[Application]
    settings: tuple[object, ...]
    """None or one."""
    title: str
    """Beginning of its failures."""

    def make(self) -> Application:
        """Return a new application. Raises ExtensionFailure."""
        with ExtensionCall(self.title):
            self.kind.warm_up()
            return self.kind(*self.settings)

    def dissectors(self, port: int) -> dict[str, str]:
        """Return Wireshark's dissectors by the names of their files. Raises ExtensionFailure."""
        with ExtensionCall(self.title):
            found = self.kind.dissectors(port)
            return {Path(name).name: str(text) for name, text in found.items()}


def load_application(config: OnboardConfig) -> Loaded:
    """Return the application that flies the UAVs.

    Raises ExtensionError, a line that begins with the field.
    """
    if config.application in BUILT_IN:
        kind = _class_of(BUILT_IN[config.application], field="onboard.application", search=None)
        return Loaded(kind, (config,), "onboard")
    return _load(config, config, table="onboard")


def load_programs(config: OnboardConfig) -> dict[str, Loaded]:
    """Return the other programs of all UAVs by name; raises as `load_application`."""
    return {
        each.name: _load(config, each, table=f"onboard.programs[{number}]")
        for number, each in enumerate(config.programs)
    }


def named(config: OnboardConfig) -> dict[str, tuple[str, str]]:
    """Return the names of all code of users, and its group of entry points, by field."""
    fields = {"onboard.application": config.application} if config.application not in BUILT_IN else {}
    for number, program in enumerate(config.programs):
        fields[f"onboard.programs[{number}].application"] = program.application
    return {field: (name, APPLICATIONS) for field, name in fields.items()}


def layout_of(config: OnboardConfig) -> Layout:
    """Return what the programs of a UAV with these settings report; raises as `load_application`."""
    if not config.enabled:
        return NO_APPLICATION
    return _layout(load_application(config), load_programs(config))


def dissectors_of(config: OnboardConfig) -> dict[str, str]:
    """Return Wireshark's dissectors of all programs by the names of their files; raises as `layout_of`.

    Raises ExtensionFailure for an exception of the user's code.
    """
    if not config.enabled:
        return {}
    found = load_application(config).dissectors(config.port)
    programs = zip(config.programs, load_programs(config).values(), strict=True)
    for program, loaded in programs:
        found |= loaded.dissectors(program.port)
    return found


def make_programs(config: VehicleConfig) -> Programs:
    """Return the programs of a UAV.

    Their random numbers depend on the seed, the instance and the program's place in the scenario only, not on
    the process they run in. Raises ExtensionError or ExtensionFailure for code of the user that cannot be
    used.
    """
    onboard, autopilot_kind = config.onboard, config.autopilot.kind_of(config.instance)
    autopilot = AutopilotClient(
        system=config.instance + 1, site=config.site, gps_delay_s=config.devices.gps_delay_s,
        interface=ARDUPILOT if autopilot_kind == "ardupilot" else PX4,
    )  # fmt: skip
    first, others = load_application(onboard), load_programs(onboard)
    loaded = {"": first, **others}
    ports = {"": onboard.port, **{each.name: each.port for each in onboard.programs}}
    programs = []
    for number, (name, each) in enumerate(loaded.items()):
        if number and not onboard.programs[number - 1].runs_on(config.instance):
            continue
        seed = [config.seed, config.instance, APPLICATION_COMPONENT, number][: 4 if number else 3]
        context = Context(
            uav=config.instance,
            plan=FormationPlan(np.array(config.places_ned_m), config.heading_deg, config.motion),
            site=config.site, devices=config.devices,
            loop_period_us=onboard.loop_period_us, rng=np.random.default_rng(np.random.SeedSequence(seed)),
            radio=Radio(
                station=config.instance, stations=len(config.places_ned_m), loop_us=onboard.loop_period_us,
                port=ports[name], program=number, programs=len(loaded),
            ),
            autopilot=autopilot, autopilot_kind=autopilot_kind,
        )  # fmt: skip
        programs.append(Program(each.make(), context, title=each.title, name=name))
    return Programs(programs, autopilot, _layout(first, others))


def _layout(first: Loaded, others: Mapping[str, Loaded]) -> Layout:
    """Return what a UAV's programs report. Raises ExtensionError."""
    try:
        return layout(first.kind.reports, {name: each.kind.reports for name, each in others.items()})
    except ValueError as error:
        raise ExtensionError(f"onboard.programs: {error}") from None


def _load(config: OnboardConfig, program: OnboardConfig | ProgramConfig, *, table: str) -> Loaded:
    """Return a user's program and its converted settings; ``table`` is that of the scenario."""
    field, path, settings = f"{table}.application", program.application, program.settings
    if not is_path(path):
        installed = registered(APPLICATIONS)
        if path not in installed:
            names = ", ".join([*BUILT_IN, *installed])
            raise ExtensionError(
                f"{field}: {path!r} is not installed; expected package.module:Class or one of {names}"
            )
        path = installed[path]
    kind = _class_of(path, field=field, search=Path(config.folder))
    title = f"{field} {program.application}"
    settings_kind = getattr(kind, "Settings", None)
    if settings_kind is None:
        if settings:
            raise ExtensionError(f"{table}.settings: {path} has no class attribute Settings")
        return Loaded(kind, (), title)
    return Loaded(kind, (convert(settings, settings_kind, field=f"{table}.settings"),), title)


def _class_of(path: str, *, field: str, search: Path | None) -> type[Application]:
    kind = load(path, field=field, search=search)
    missing = [name for name in _METHODS if not callable(getattr(kind, name, None))]
    missing += sorted(getattr(kind, "__abstractmethods__", ()))
    if not isinstance(kind, type) or missing:
        what = f"has no method {missing[0]}" if missing else "is no class"
        raise ExtensionError(f"{field}: {path} {what}; expected a subclass of coflight.Application")
    return kind
