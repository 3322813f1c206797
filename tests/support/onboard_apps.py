"""The formation application of one UAV with its context, as the factory makes it for a vehicle."""

import numpy as np

from autopilot.onboard.app import OnboardApp
from autopilot.onboard.client.autopilot_client import AutopilotClient
from autopilot.onboard.client.autopilots import PX4
from autopilot.onboard.context import Context, Radio
from autopilot.onboard.formation_plan import FormationPlan
from autopilot.onboard.program import Program
from autopilot.onboard.programs import Programs
from autopilot.onboard.radio.traffic import Traffic
from autopilot.parameters.config import Devices, Site


def formation_app(
    *, station, places_ned_m, config, rng=None, devices=None, site=None, motion=None, autopilot=PX4,
    autopilot_kind="own", loop_us=40_000,
):  # fmt: skip
    """Return the `Programs` of a UAV with the formation application; it is the attribute ``application``."""
    site, devices = site or Site(), devices or Devices()
    client = AutopilotClient(
        system=station + 1, site=site, gps_delay_s=devices.gps_delay_s, interface=autopilot
    )
    context = Context(
        uav=station, plan=FormationPlan(np.array(places_ned_m), 0.0, motion), site=site, devices=devices,
        loop_period_us=loop_us, rng=rng or np.random.default_rng(1),
        radio=Radio(station=station, stations=len(places_ned_m), loop_us=loop_us), autopilot=client,
        autopilot_kind=autopilot_kind,
    )  # fmt: skip
    program = Program(OnboardApp(config), context, title="onboard")
    return Programs([program], client, OnboardApp.reports.layout())


class CollectingTraffic(Traffic):
    """Traffic whose items are returned."""

    def __init__(self, *, station, stations, **settings):
        self.radio = Radio(station=station, stations=stations, loop_us=1_000_000)
        super().__init__(radio=self.radio, **settings)

    def due(self, own, now_us, until_us, **inputs):
        """Return the items that are sent in an interval."""
        self.radio.now_us = now_us
        self.send(own, now_us, until_us, **inputs)
        return self.radio.take()
