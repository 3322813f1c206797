"""Settings of the ranging radios: the fields of a scenario's ``[uwb]`` table.

Frozen, keyword-only and range-checked by msgspec when a scenario is decoded. Path loss, shadowing, antenna
pattern and blockage are those of ``[radio]``, at the frequency of ``channel``. Defaults are those of a DW3000
with the maker's examples of two-way ranging.
"""

from typing import Annotated, Literal

from msgspec import Meta, Struct

DataRateKbps = Literal[850, 6810]
PrfMhz = Literal[16, 64]
UwbMethod = Literal["ss", "ds"]


class UwbConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of all ranging radios."""

    channel: Literal[5, 9] = 5
    """Channel of the HRP UWB PHY, 499.2 MHz wide: 5 at 6489.6 MHz, 9 at 7987.2 MHz."""
    prf_mhz: PrfMhz = 64
    """Mean pulse repetition frequency, nominal, MHz."""
    data_rate_kbps: DataRateKbps = 6810
    """Bit rate of the payload, kbit/s."""
    preamble_symbols: Literal[32, 64, 128, 256, 512, 1024, 2048, 4096] = 128
    """Repetitions of the preamble symbol."""
    eirp_dbm_mhz: Annotated[float, Meta(ge=-80.0, le=0.0)] = -41.3
    """Mean EIRP density, dBm/MHz; -41.3 is the limit of FCC part 15.517 and ETSI EN 302 065."""
    antenna_gain_dbi: Annotated[float, Meta(ge=-50.0, le=50.0)] = 0.0
    """Peak gain of the receiving antenna; that of the transmitting one is part of the EIRP."""
    noise_figure_db: Annotated[float, Meta(ge=0.0, le=50.0)] = 6.0
    """Noise figure of each receiver, dB."""
    implementation_loss_db: Annotated[float, Meta(ge=0.0, le=50.0)] = 3.5
    """Loss of the receiver against coherent detection, dB. With the noise figure it determines the
    sensitivity: 9.5 dB in all give the -94 dBm of the DWM1000's data sheet (6.8 Mbit/s, 20 bytes, 10 % packet
    errors)."""
    capture_db: Annotated[float, Meta(ge=-20.0, le=100.0)] = 6.0
    """Ratio of a frame's power to the sum of overlapping frames from which it is received, dB."""
    method: UwbMethod = "ds"
    """ss: single-sided two-way ranging, two frames. ds: double-sided, four frames with the report."""
    carrier_correction: bool = True
    """With ``ss``: correct the responder's reply time by the clock ratio from the carrier's offset."""
    carrier_offset_std_ppm: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.1
    """Standard deviation of the clock ratio that a receiver estimates from a frame's carrier, ppm."""
    reply_time_us: Annotated[int, Meta(ge=1, le=20_000)] = 650
    """Time from the marker of a received frame to that of the reply, in the replying radio's clock."""
    access: Literal["aloha", "slots"] = "slots"
    """aloha: an exchange begins after a random delay. slots: at the beginning of the next slot of the
    station; the slots of all stations repeat in turn."""
    aloha_delay_us: Annotated[int, Meta(ge=0, le=1_000_000)] = 2_000
    """With ``aloha``: greatest delay of an exchange, uniformly distributed from 0."""
    slot_us: Annotated[int, Meta(ge=1, le=1_000_000)] | None = None
    """With ``slots``: length of a slot; None: that of an exchange and ``slot_guard_us``."""
    slot_guard_us: Annotated[int, Meta(ge=0, le=100_000)] = 50
    """With ``slots``: time of a slot before its exchange begins."""
    slot_sync_std_us: Annotated[float, Meta(ge=0.0, le=10_000.0)] = 1.0
    """With ``slots``: standard deviation of the error of a station's slot time, constant in a run."""
    retry_limit: Annotated[int, Meta(ge=0, le=20)] = 2
    """Repetitions of an exchange that has failed, before the request's time-out."""
    request_timeout_us: Annotated[int, Meta(ge=1_000, le=1_500_000)] = 500_000
    """Time from the application's request by which its last exchange has ended."""
    clock_ppm: Annotated[float, Meta(ge=0.0, le=100.0)] = 10.0
    """Largest clock error; each radio's error is drawn uniformly from +- this value."""
    clock_drift_ppm_s: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.005
    """Largest rate of change of a clock error, by temperature, ppm per second."""
    time_stamp_std_ps: Annotated[float, Meta(ge=0.0, le=1e6)] = 130.0
    """Standard deviation of a frame's time of arrival at high signal-to-noise ratio, ps."""
    antenna_delay_std_ps: Annotated[float, Meta(ge=0.0, le=1e6)] = 150.0
    """Standard deviation over radios of what calibration leaves of the sum of transmit and receive antenna
    delays, ps. A pair's distance is off by c/4 times the sum of both: 3.2 cm with 150 ps."""
    nlos_bias_mean_m: Annotated[float, Meta(ge=0.0, le=1e3)] = 0.5
    """Mean of the exponentially distributed excess range of an exchange with a blocked path, metres."""
