"""Wind at every vehicle, as a force or as a velocity of the air. No I/O.

Import `Wind`, which composes mean, gusts and turbulence, and `WindConfig`; `GustyWind` is the force alone.
What the wind does to a vehicle is left to `harness.world.physics`.
"""

from harness.world.wind.config import GustConfig, WindConfig
from harness.world.wind.force import VERTICAL_GUST_RATIO, GustyWind
from harness.world.wind.wind import Wind, WindNow

__all__ = ["VERTICAL_GUST_RATIO", "GustConfig", "GustyWind", "Wind", "WindConfig", "WindNow"]
