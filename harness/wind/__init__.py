"""Wind: what the air does to every vehicle, as a force or as a velocity. No I/O."""

from harness.wind.config import GustConfig, WindConfig
from harness.wind.force import VERTICAL_GUST_RATIO, GustyWind
from harness.wind.wind import Wind, WindNow

__all__ = ["VERTICAL_GUST_RATIO", "GustConfig", "GustyWind", "Wind", "WindConfig", "WindNow"]
