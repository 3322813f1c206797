"""Wind at every vehicle, as a force or as a velocity of the air. No I/O."""

from harness.world.wind.config import GustConfig, WindConfig
from harness.world.wind.force import VERTICAL_GUST_RATIO, GustyWind
from harness.world.wind.wind import Wind, WindNow

__all__ = ["VERTICAL_GUST_RATIO", "GustConfig", "GustyWind", "Wind", "WindConfig", "WindNow"]
