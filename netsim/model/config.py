"""Settings of the emulated radio: the fields of a scenario's ``[radio]`` table.

Frozen, keyword-only and range-checked by msgspec when a scenario is decoded. The models that
use them are in `netsim.phy`, `netsim.mac` and `netsim.ftm`.
"""

from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

from foundation.records.record_log import BLOCK_ROWS
from netsim.serial_radio.config import SerialPairsConfig
from netsim.uwb.config import UwbConfig

NonNegative = Annotated[float, Meta(ge=0.0, le=1e6)]
Positive = Annotated[float, Meta(gt=0.0, le=1e6)]
BandwidthMhz = Literal[20, 40, 80]
Mode = Literal[
    "ofdm6", "ofdm9", "ofdm12", "ofdm18", "ofdm24", "ofdm36", "ofdm48", "ofdm54",
    "vht_mcs0", "vht_mcs1", "vht_mcs2", "vht_mcs3", "vht_mcs4",
    "vht_mcs5", "vht_mcs6", "vht_mcs7", "vht_mcs8", "vht_mcs9",
]  # fmt: skip
AccessCategory = Literal["vo", "vi", "be", "bk"]
Metres = Annotated[float, Meta(ge=-1e5, le=1e5)]
PowerDbm = Annotated[float, Meta(ge=-50.0, le=50.0)]
GainDbi = Annotated[float, Meta(ge=-50.0, le=50.0)]
ModelName = Annotated[str, Meta(min_length=1, max_length=200)]


class FtmConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of Fine Time Measurement (IEEE 802.11-2016, 11.24.6), the same for all radios."""

    ftms_per_burst: Annotated[int, Meta(ge=2, le=31)] = 8
    """Measurement frames in a burst; N frames give N - 1 round trips."""
    min_delta_us: Annotated[int, Meta(ge=100, le=25_500)] = 200
    """Least time between two measurement frames of a burst (protocol unit 100 us)."""
    burst_duration_us: Literal[250, 500, 1_000, 2_000, 4_000, 8_000, 16_000, 32_000, 64_000, 128_000] = 16_000
    """Longest duration of a burst, after which its remaining frames are not sent."""
    mode: Mode = "vht_mcs0"
    """Mode of the measurement frames. Time stamps have the precision of its format: that of the channel's
    bandwidth with a VHT mode, that of 20 MHz with a non-HT mode on a channel of any bandwidth."""
    access_category: AccessCategory = "vo"
    """EDCA access category of the frames of a session."""
    bursts_exponent: Annotated[int, Meta(ge=0, le=6)] = 0
    """The initiator requests 2^(this value) bursts in a session."""
    burst_period_ms: Annotated[int, Meta(ge=100, le=6_553_500, multiple_of=100)] = 100
    """Time from the beginning of one burst to the next (protocol unit 100 ms); unused with one burst."""
    asap: bool = True
    """Request the first burst as soon as possible (ASAP). A responder without ASAP capability starts at the
    time stated in its first frame."""
    responder_asap_capable: bool = True
    """Whether a responder can send the first burst as soon as it is requested."""
    responder_ftms_per_burst: Annotated[int, Meta(ge=2, le=31)] = 31
    """Most measurement frames per burst that a responder grants."""
    responder_min_delta_us: Annotated[int, Meta(ge=100, le=25_500)] = 100
    """Least time between two measurement frames that a responder grants."""
    request_timeout_us: Annotated[int, Meta(ge=1_000, le=1_500_000)] = 100_000
    """Time from the application's request to the time-out of the session."""
    clock_ppm: Annotated[float, Meta(ge=0.0, le=100.0)] = 20.0
    """Largest clock error; each radio's error is drawn uniformly from +- this value."""
    round_trip_std_ps: NonNegative | None = None
    """Standard deviation of one round trip at high SNR; None: the measured value for the bandwidth of the
    format of ``mode``."""
    responder_sessions: Annotated[int, Meta(ge=1, le=64)] = 8
    """Concurrent sessions of a radio as responder; further requests are rejected."""
    calibration_bias_m: Annotated[float, Meta(ge=-1_000.0, le=1_000.0)] = 0.0
    """Constant range offset of all device pairs, metres."""
    calibration_bias_std_m: NonNegative = 0.0
    """Standard deviation of the residual constant range offset over device pairs, metres."""
    nlos_bias_mean_m: NonNegative = 3.0
    """Mean of the exponentially distributed excess range of a session with a blocked path, metres."""


class InterfererConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An external transmitter that sends bursts of energy on the channel without carrier sense."""

    pos_ned_m: tuple[Metres, Metres, Metres]
    """Position in the site's NED frame, metres."""
    eirp_dbm: PowerDbm = 20.0
    """EIRP of its bursts in the channel."""
    duty_cycle: Annotated[float, Meta(ge=0.0, le=1.0)]
    """Fraction of the time for which it sends."""
    burst_us: Annotated[float, Meta(ge=10.0, le=1e7)] = 1_000.0
    """Mean length of a burst; bursts and pauses are exponentially distributed."""


class RadioModel(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A model of the radio with its settings, such as the table ``[radio.path_loss]``."""

    model: ModelName
    """A built-in name, a name of an installed package's entry points, or ``package.module:Class``."""
    settings: dict[str, Any] = {}
    """Settings of the model, checked against its own type."""
    folder: str = ""
    """Folder where the module is looked up first and to which paths in the settings are relative; "": that of
    the scenario's file."""


class StationConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of one station that override the common ones; None: no override."""

    station: Annotated[int, Meta(ge=0, le=65_535)]
    """Number of the station: vehicles from 0, then guests, then ground stations."""
    tx_power_dbm: PowerDbm | None = None
    """Transmit power, dBm."""
    antenna: ModelName | RadioModel | None = None
    """Antenna pattern, as that of ``[radio]``."""
    antenna_gain_dbi: GainDbi | None = None
    """Peak gain."""
    data_mode: Mode | Literal["adaptive"] | None = None
    """Mode of datagrams to one station."""
    broadcast_mode: Mode | None = None
    """Mode of group-addressed frames."""


class GuestConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A station at a fixed position whose host is an external program.

    Guests are numbered after the vehicles, in the order of their tables. See docs/reference/radio-api.md.
    """

    name: Annotated[str, Meta(min_length=1, max_length=40)]
    """Name of the station; each guest has its own."""
    pos_ned_m: tuple[Metres, Metres, Metres]
    """Position in the site's NED frame, metres."""


class RadioConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the 802.11 channel and of all radios."""

    channel: Literal["emulated", "ideal"] = "emulated"
    """``ideal`` is a reference channel: every frame is sent at once and reaches all stations in range,
    without contention, collisions and fading. Time stamps keep their errors."""
    drop_fraction: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0
    """Fraction of received datagrams and of ranging results that the hosts lose, besides the channel."""
    frequency_mhz: Annotated[float, Meta(ge=100.0, le=100_000.0)] = 5210.0
    """Centre frequency of the channel, MHz. From 2400 to 2500 MHz it is that of a channel of the 2.4 GHz
    band, with its timing (ERP-OFDM) and without VHT; any other frequency has the timing of 5 GHz."""
    bandwidth_mhz: BandwidthMhz = 80
    """Bandwidth of the channel, MHz; at 2.4 GHz 20 or 40."""
    coverage_class: Annotated[int, Meta(ge=0, le=31)] = 0
    """Coverage class (IEEE 802.11-2016, 9.4.2.9): each adds 3 us to the slot time, and so 450 m to the
    distance up to which responses are in time."""
    short_slot: bool = False
    """Slot time at 2.4 GHz: 9 us, or 20 us as in an ad-hoc network (18.4.5). 5 GHz always has 9 us."""
    tx_power_dbm: PowerDbm = 16.0
    """Transmit power of each radio at its antenna port, dBm."""
    antenna: ModelName | RadioModel = "isotropic"
    """Antenna pattern: ``isotropic``; ``dipole``, a half-wave dipole along the body's z axis, which tilts
    with the vehicle; or a model of one's own."""
    antenna_gain_dbi: GainDbi = 0.0
    """Peak gain."""
    noise_figure_db: Annotated[float, Meta(ge=0.0, le=50.0)] = 7.0
    """Noise figure of each receiver, dB."""
    path_loss: ModelName | RadioModel = "log_distance"
    """``friis``; ``log_distance`` with ``path_loss_exponent``; ``two_ray`` with the ground-reflected ray;
    ``table`` or ``grid`` from a file; or a model of one's own (docs/how-to/radio-models.md)."""
    path_loss_exponent: Annotated[float, Meta(ge=1.0, le=8.0)] = 2.0
    """Log-distance exponent beyond 1 m; at 1 m the loss is Friis."""
    shadowing: ModelName | RadioModel = "log_normal"
    """``log_normal`` with ``shadowing_std_db``, ``none``, or a model of one's own."""
    shadowing_std_db: NonNegative = 0.0
    """Standard deviation of log-normal shadowing, a function of the positions of both ends."""
    shadowing_distance_m: Positive = 20.0
    """Distance over which the correlation of the shadowing falls to 1/e."""
    fading: ModelName | RadioModel = "rician"
    """Small-scale fading: ``rician`` with ``rician_k_db``, ``none``, or a model of one's own."""
    rician_k_db: Annotated[float, Meta(ge=-20.0, le=60.0)] | None = 12.0
    """Rician K factor of small-scale fading; None: no fading."""
    fading_doppler_hz: NonNegative = 5.0
    """Doppler spread of a link between stations at rest, from moving surroundings; the relative speed of
    the stations adds to it."""
    nlos_fraction: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0
    """Fraction of the time for which a link's line of sight is blocked."""
    nlos_duration_s: Annotated[float, Meta(ge=0.01, le=1e6)] = 2.0
    """Mean duration of a blockage."""
    nlos_loss_db: NonNegative = 10.0
    """Extra loss while the line of sight is blocked."""
    error_model: ModelName | RadioModel = "published"
    """Packet errors by noise: ``published``, or a model of one's own."""
    extra_attenuation_db: Annotated[float, Meta(ge=0.0, le=1_000.0)] = 0.0
    """Attenuation added to every link: 20 dB degrades the channel, 200 dB cuts it."""
    cca_energy_dbm: Annotated[float, Meta(ge=-100.0, le=0.0)] = -62.0
    """Energy detection threshold: total power of all signals in the channel from which the medium is busy."""
    cca_preamble_dbm: Annotated[float, Meta(ge=-100.0, le=0.0)] = -82.0
    """Preamble detection threshold: power in the channel from which a frame is sensed and can be received, if
    it is also at least 4 dB above the noise."""
    cca_missed_dbm: Annotated[float, Meta(ge=-100.0, le=0.0)] = -82.0
    """Power in the channel from which a frame is sensed whose preamble was missed: while the station was
    sending or receiving another frame, or because several frames began at once. -82 dBm as in ns-3; the
    standard requires -62 dBm. At most ``cca_energy_dbm`` and at least ``cca_preamble_dbm`` count."""
    access: Literal["edca", "dcf"] = "edca"
    """``dcf``: one queue with DIFS for all access categories, as before 802.11e."""
    edca_edition: Literal[2016, 2020] = 2016
    """Edition of IEEE 802.11 whose default EDCA parameters apply. 2020 has longer TXOP limits, and limits of
    2.528 ms for best effort and background, which have one exchange in 2016."""
    control_mode: Mode = "ofdm24"
    """Mode of RTS. A CTS or ACK uses the highest of 6, 12, 24 Mbit/s not above the frame it responds to."""
    broadcast_mode: Mode = "ofdm24"
    """Mode of group-addressed frames."""
    broadcast_access_category: AccessCategory = "be"
    """EDCA access category of group-addressed frames."""
    broadcast_rts: bool = True
    """Exchange RTS and CTS with a neighbour before a group-addressed frame, as the article does.
    False: send after contention alone, as the standard."""
    rts_retry_limit: Annotated[int, Meta(ge=0, le=255)] = 7
    """Failed RTS after which the next failure drops a group-addressed frame."""
    data_mode: Mode | Literal["adaptive"] = "ofdm24"
    """Mode of unicast datagrams; ``adaptive`` selects it from acknowledgements (Minstrel)."""
    data_access_category: AccessCategory = "be"
    """EDCA access category of datagrams to one station."""
    rts_threshold_bytes: Annotated[int, Meta(ge=0, le=65_535)] = 65_535
    """Unicast datagrams with longer frames are sent after RTS and CTS."""
    retry_limit: Annotated[int, Meta(ge=0, le=2**31)] = 6
    """Retries of a unicast frame before it is dropped."""
    queue_frames: Annotated[int, Meta(ge=1, le=10_000)] = 64
    """Transmit queue length of a radio in frames; further frames are dropped and counted."""
    queue_lifetime_us: Annotated[int, Meta(ge=1_000, le=60_000_000)] = 500_000
    """Age in microseconds at which a frame that is still queued is dropped and counted."""
    host_latency_us: Annotated[int, Meta(ge=0, le=100_000)] = 50
    """Minimum time from the application's call to the radio's queue."""
    host_jitter_us: Annotated[int, Meta(ge=0, le=100_000)] = 100
    """Additional uniform latency, drawn per frame."""
    ftm: FtmConfig = FtmConfig()
    """Fine Time Measurement: the table ``[radio.ftm]``."""
    interferers: tuple[InterfererConfig, ...] = ()
    """Other transmitters on the channel: tables ``[[radio.interferers]]``."""
    stations: tuple[StationConfig, ...] = ()
    """Settings of single stations: tables ``[[radio.stations]]``."""
    guests: tuple[GuestConfig, ...] = ()
    """Stations of other programs: tables ``[[radio.guests]]``."""
    capture: Literal["medium", "receivers"] | bool = False
    """Write all frames with radiotap headers to radio.pcapng, for Wireshark. True or "medium": every frame
    once, as sent. "receivers": an interface per station with the frames that it sent and received, with their
    signal strength there."""
    log_receptions: bool = False
    """Write every frame's reception at every station to receptions.parquet."""

    @property
    def reports_receptions(self) -> bool:
        """Whether each frame's reception at each station is needed: for the log, or for a capture."""
        return self.log_receptions or self.capture == "receivers"


class RadioPasswords(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Passwords of a run's radio, random for each run."""

    vehicles: str
    guests: tuple[str, ...] = ()
    """One for each guest, in their order."""
    packets: str | None = None
    """Of the host of network interfaces; None: there is none."""


class ServerConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the emulator process, written by the launcher."""

    run_id: str
    socket_path: str | None = None
    """Unix socket to listen at; None: TCP, at ``host`` and ``port``."""
    host: str = "127.0.0.1"
    port: Annotated[int, Meta(ge=0, le=65_535)] = 0
    passwords: RadioPasswords | None = None
    """Of the users that may connect; None: an emulator without connections."""
    stations: Annotated[int, Meta(ge=0)]
    """Number of vehicles; the guests of ``radio`` are numbered after them."""
    seed: Annotated[int, Meta(ge=0)]
    packets: bool = False
    """Accept packets of network interfaces; requires ``passwords.packets``."""
    radio: RadioConfig = RadioConfig()
    serial: SerialPairsConfig | None = None
    """Serial modems of the vehicles and their ground station, which is a guest of ``radio``; None: none."""
    uwb: UwbConfig | None = None
    """UWB radios of all stations, to which requests of ranging go; None: they go to ``radio``."""
    frame_log_path: str | None = None
    session_log_path: str | None = None
    reception_log_path: str | None = None
    """Used with ``radio.log_receptions``."""
    log_block_rows: Annotated[int, Meta(ge=1)] = BLOCK_ROWS
    """Rows that are written at once to the logs of frames and sessions; 1 for logs read in flight."""
    capture_path: str | None = None
    epoch_unix_us: Annotated[int, Meta(ge=0, lt=16_725_225_600_000_000)] = 0
    """Date of simulated time 0 in captures, before 2500: 64 bits of nanoseconds end in 2554."""
    profile_from_us: Annotated[int, Meta(ge=0)] | None = None
    """Simulated time from which the process profiles its CPU time; None: never."""
