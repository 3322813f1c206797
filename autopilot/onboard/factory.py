"""Factory of a UAV's applications, for the autopilot's process or a companion process."""

import numpy as np

from autopilot.mavlink.components import APPLICATION_COMPONENT
from autopilot.onboard.app import OnboardApp
from autopilot.onboard.application import Application
from autopilot.onboard.client.autopilot_client import AutopilotClient
from autopilot.onboard.client.autopilots import ARDUPILOT, PX4
from autopilot.onboard.context import Context
from autopilot.onboard.programs import Programs
from autopilot.parameters.config import OnboardConfig, VehicleConfig
from foundation.extension_failure import failure
from foundation.extensions import ExtensionError, convert, is_path, load, registered

APPLICATIONS = "coflight.applications"
"""Group of entry points."""
BUILT_IN = "formation"
_FIELD = "onboard.application"
_METHODS = ("start", "on_mavlink", "on_request", "on_radio", "on_timer", "status", "estimate", "troubles")


def load_application(config: OnboardConfig) -> tuple[type[Application], tuple[object, ...]]:
    """Return the class of the application that the settings name, and its converted settings, none or one.

    Raises ExtensionError, a line that begins with the field.
    """
    if config.application == BUILT_IN:
        if config.settings:
            raise ExtensionError("onboard.settings: the formation's settings are fields of [onboard] itself")
        return OnboardApp, (config,)
    path = config.application
    if not is_path(path):
        installed = registered(APPLICATIONS)
        if path not in installed:
            names = ", ".join([BUILT_IN, *installed])
            raise ExtensionError(
                f"{_FIELD}: {path!r} is not installed; expected package.module:Class or one of {names}"
            )
        path = installed[path]
    kind = load(path, field=_FIELD)
    missing = [name for name in _METHODS if not callable(getattr(kind, name, None))]
    if not isinstance(kind, type) or missing:
        what = f"has no method {missing[0]}" if missing else "is no class"
        raise ExtensionError(f"{_FIELD}: {path} {what}; expected a subclass of coflight.Application")
    settings_kind = getattr(kind, "Settings", None)
    if settings_kind is None:
        if config.settings:
            raise ExtensionError(f"onboard.settings: {path} has no class attribute Settings")
        return kind, ()
    return kind, (convert(config.settings, settings_kind, field="onboard.settings"),)


def make_application(config: VehicleConfig) -> Programs:
    """Return the application for these settings.

    Its random numbers depend on the seed and the instance only, not on the process it runs in. Raises
    ExtensionError or ExtensionFailure for code of the user that cannot be used.
    """
    kind, settings = load_application(config.onboard)
    title = f"{_FIELD} {config.onboard.application}"
    autopilot_kind = config.autopilot.kind_of(config.instance)
    seed = np.random.SeedSequence([config.seed, config.instance, APPLICATION_COMPONENT])
    context = Context(
        uav=config.instance, places_ned_m=config.places_ned_m, heading_deg=config.heading_deg,
        motion=config.motion, site=config.site, devices=config.devices,
        loop_period_us=config.onboard.loop_period_us, rng=np.random.default_rng(seed),
        autopilot=AutopilotClient(
            system=config.instance + 1, site=config.site, gps_delay_s=config.devices.gps_delay_s,
            interface=ARDUPILOT if autopilot_kind == "ardupilot" else PX4,
        ),
        autopilot_kind=autopilot_kind,
    )  # fmt: skip
    try:
        application = kind(*settings)
    except Exception as error:
        raise failure(title, error) from error
    return Programs(application, context, title=title)
