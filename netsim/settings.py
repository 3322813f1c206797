"""What no single field of a radio's settings can tell: that they go together."""

from typing import Literal

from netsim.config import Mode, RadioConfig
from netsim.phy.modes import phy_mode


def check(config: RadioConfig, vehicles: int) -> None:
    """Raise ValueError, with the field's path below ``radio``, for settings that contradict each other."""
    if config.control_mode.startswith("vht"):
        raise ValueError(f"control_mode: RTS is a non-HT frame, {config.control_mode} is none")
    modes: dict[str, Mode | Literal["adaptive"] | None] = {
        "broadcast_mode": config.broadcast_mode,
        "data_mode": config.data_mode,
        "ftm.mode": config.ftm.mode,
    }
    stations = vehicles + len(config.guests)
    seen: set[int] = set()
    for number, own in enumerate(config.stations):
        path = f"stations[{number}]"
        if own.station >= stations:
            raise ValueError(f"{path}.station: {own.station} is not on a channel of {stations} stations")
        if own.station in seen:
            raise ValueError(f"{path}.station: {own.station} has a table already")
        seen.add(own.station)
        modes |= {f"{path}.broadcast_mode": own.broadcast_mode, f"{path}.data_mode": own.data_mode}
    for path, mode in modes.items():
        if mode is not None and mode != "adaptive":
            try:
                phy_mode(mode, config.bandwidth_mhz)
            except ValueError as error:
                raise ValueError(f"{path}: {error}") from None
    names = [guest.name for guest in config.guests]
    for number, name in enumerate(names):
        if name in names[:number]:
            raise ValueError(f"guests[{number}].name: {name!r} is there already")
