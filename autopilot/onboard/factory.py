"""Factory of the on-board application, for the autopilot's process or a companion process."""

import numpy as np
from msgspec.structs import replace

from autopilot.mavlink.components import APPLICATION_COMPONENT
from autopilot.onboard.app import OnboardApp
from autopilot.onboard.application import Application
from autopilot.onboard.client.autopilots import ARDUPILOT, PX4
from autopilot.parameters.config import VehicleConfig


def make_application(config: VehicleConfig) -> Application:
    """Return the application for these settings.

    Its random numbers depend on the seed and the instance only, not on the process it runs in.
    """
    seed = np.random.SeedSequence([config.seed, config.instance, APPLICATION_COMPONENT])
    return OnboardApp(
        station=config.instance, places_ned_m=config.places_ned_m, heading_deg=config.heading_deg,
        motion=config.motion, site=config.site, devices=config.devices,
        config=replace(config.onboard, wind_feed_forward=config.feeds_wind_forward),
        rng=np.random.default_rng(seed),
        autopilot=ARDUPILOT if config.autopilot.kind_of(config.instance) == "ardupilot" else PX4,
    )  # fmt: skip
