"""Checks across several fields of the radio's settings."""

from collections.abc import Mapping
from typing import Literal

from netsim.ftm.elements import NON_HT_FORMAT, Measurement
from netsim.ftm.negotiation import grant, requested_parameters
from netsim.mac.access_parameters import DCF, EDCA
from netsim.model.config import Mode, RadioConfig
from netsim.phy.frames import ACK_BYTES, DATA_OVERHEAD_BYTES
from netsim.phy.modes import phy_mode, response_mode
from netsim.phy.timing import CENTRES_2_4_GHZ_MHZ, channel_mode, is_2_4_ghz, timing_of


def check(config: RadioConfig, vehicles: int) -> None:
    """Raise ValueError, with the field's path below ``radio``, for inconsistent settings."""
    if config.control_mode.startswith("vht"):
        raise ValueError(f"control_mode: RTS needs a non-HT mode, {config.control_mode} is VHT")
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
            raise ValueError(f"{path}.station: {own.station} is out of range for {stations} stations")
        if own.station in seen:
            raise ValueError(f"{path}.station: duplicate entry of station {own.station}")
        seen.add(own.station)
        modes |= {f"{path}.broadcast_mode": own.broadcast_mode, f"{path}.data_mode": own.data_mode}
    for path, mode in modes.items():
        if mode is not None and mode != "adaptive":
            try:
                phy_mode(mode, config.bandwidth_mhz)
            except ValueError as error:
                raise ValueError(f"{path}: {error}") from None
    if is_2_4_ghz(config.frequency_mhz):
        _check_2_4_ghz(config, modes)
    _check_burst(config)
    names = [guest.name for guest in config.guests]
    for number, name in enumerate(names):
        if name in names[:number]:
            raise ValueError(f"guests[{number}].name: duplicate name {name!r}")


def _check_2_4_ghz(config: RadioConfig, modes: Mapping[str, str | None]) -> None:
    """Raise ValueError if width, frequency or a mode does not exist at 2.4 GHz; ``modes`` by their fields."""
    width_mhz = config.bandwidth_mhz
    centres_mhz = CENTRES_2_4_GHZ_MHZ.get(width_mhz)
    if centres_mhz is None:
        raise ValueError(f"bandwidth_mhz: a channel at 2.4 GHz has 20 or 40 MHz, not {width_mhz}")
    if config.frequency_mhz not in centres_mhz:
        listed = ", ".join(f"{each:g}" for each in centres_mhz)
        raise ValueError(
            f"frequency_mhz: {config.frequency_mhz:g} MHz is not the centre of a channel of {width_mhz} MHz "
            f"at 2.4 GHz; choose from {listed}"
        )
    for path, mode in modes.items():
        if mode is not None and mode.startswith("vht"):
            raise ValueError(f"{path}: {mode} is VHT, which 2.4 GHz does not have; choose ofdm6 to ofdm54")


def _check_burst(config: RadioConfig) -> None:
    """Raise ValueError if a granted burst is too short for the two measurement frames of a round trip.

    The second frame begins at the granted least interval after the first, or as soon as the medium is free
    after the first one's ACK. The ACK of the second frame is part of the burst.
    """
    ftm = config.ftm
    granted = grant(requested_parameters(ftm, NON_HT_FORMAT), ftm, NON_HT_FORMAT, 0)
    timing, mode = timing_of(config), channel_mode(config, ftm.mode)
    response_ns = timing.sifs_ns + response_mode(mode).duration_ns(ACK_BYTES)
    first_ns, second_ns = (
        mode.duration_ns(DATA_OVERHEAD_BYTES + Measurement(token=1, parameters=parameters).size) + response_ns
        for parameters in (granted, None)
    )
    access = DCF if config.access == "dcf" else EDCA[ftm.access_category]
    delta_us, duration_us = granted.min_delta_us or 0, granted.burst_duration_us or 0
    least_us = (max(1_000 * delta_us, first_ns + access.aifs_ns(timing)) + second_ns) // 1_000
    if duration_us < least_us:
        raise ValueError(
            f"ftm.burst_duration_us: {duration_us} us is too short for two measurement frames, which take "
            f"{least_us} us with ftm.min_delta_us = {delta_us}"
        )
