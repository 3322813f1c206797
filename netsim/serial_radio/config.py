"""Settings of the serial telemetry radios: the fields of a scenario's ``[serial_radio]`` table.

Frozen, keyword-only and range-checked by msgspec when a scenario is decoded. Names in capitals are the
parameters of the firmware SiK (Firmware/radio/parameters.c of ArduPilot/SiK, revision 50189f2). Path loss,
shadowing, antenna pattern, fading and blockage are those of ``[radio]``, at the frequency of ``band_mhz``.
"""

from typing import Annotated, Literal

from msgspec import Meta, Struct

AirRateKbps = Literal[4, 8, 16, 19, 24, 32, 48, 64, 96, 128, 192, 250]
SerialRateBaud = Literal[1200, 2400, 4800, 9600, 19_200, 38_400, 57_600, 115_200, 230_400]


class SerialRadioConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of all modems; each pair of modems differs in its network only."""

    band_mhz: Literal[433, 868, 915] = 915
    """Band of the channels: 433.05-434.79 MHz and 868-870 MHz with 10, 915-928 MHz with 50."""
    channels: Annotated[int, Meta(ge=1, le=50)] | None = None
    """NUM_CHANNELS: number of channels in the hopping sequence; None: that of the band."""
    air_rate_kbps: AirRateKbps = 64
    """AIR_SPEED: bit rate on the air, kbit/s. At the firmware's 2 kbit/s no packet fits into its windows."""
    serial_rate_baud: SerialRateBaud = 57_600
    """SERIAL_SPEED: rate of the serial ports of both modems; a byte has ten bits."""
    tx_power_dbm: Annotated[float, Meta(ge=0.0, le=30.0)] = 20.0
    """TXPOWER: transmit power at the antenna port, dBm. Modems with a Si1000 have at most 20 dBm."""
    antenna_gain_dbi: Annotated[float, Meta(ge=-50.0, le=50.0)] = 0.0
    """Peak gain of each antenna; ``stations.antenna_gain_dbi`` replaces that of the ground station."""
    noise_figure_db: Annotated[float, Meta(ge=0.0, le=50.0)] = 7.0
    """Noise figure of each receiver, dB; it determines the reported noise."""
    implementation_loss_db: Annotated[float, Meta(ge=0.0, le=50.0)] = 2.0
    """Loss of the demodulator against ideal non-coherent FSK, dB; 2 dB more apply above 100 kbit/s. With the
    noise figure it determines the sensitivity: 9 dB in all give that of the Si1000's data sheet."""
    first_net_id: Annotated[int, Meta(ge=0, le=65_000)] = 25
    """NETID of the first pair; the following pairs have the following numbers."""
    ecc: bool = False
    """ECC: Golay code, which corrects 3 of 23 bits and doubles the bytes on the air. Firmware built without
    INCLUDE_GOLAY accepts the parameter, but neither encodes nor checks packets."""
    mavlink_framing: bool = True
    """MAVLINK: send whole MAVLink frames where they fit, and report RADIO_STATUS after each HEARTBEAT of the
    host. False: send bytes as they are, without reports."""
    opportunistic_resend: bool = False
    """OPPRESEND: send the last packet a second time if less than 32 bytes wait. Firmware before May 2016 did
    so by default; later firmware does not have it."""
    max_window_ms: Annotated[int, Meta(ge=10, le=131)] = 131
    """MAX_WINDOW: upper limit of a transmit window, in units of 62 ticks (0.97 ms). Less is less latency, and
    less throughput."""
    duty_cycle_percent: Annotated[int, Meta(ge=10, le=100)] = 100
    """DUTY_CYCLE: limit of the mean share of time for which a modem sends."""
    host_buffer_bytes: Annotated[int, Meta(ge=300, le=1_000_000)] = 3_000
    """Transmit buffer of each host's serial port. What does not fit into it is dropped as a whole."""


class SerialPairsConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Pairs of modems of a run: one for each vehicle, whose other modem is at the ground station."""

    settings: SerialRadioConfig
    ground_station: Annotated[int, Meta(ge=0, le=65_535)]
    """Its station number."""
