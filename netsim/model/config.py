"""Settings of the emulated radio: what a scenario's ``[radio]`` table may say.

Frozen, keyword-only and range-checked by msgspec when a scenario is decoded. Only data: the models that read
it are in `netsim.phy`, `netsim.mac` and `netsim.ftm`.
"""

from typing import Annotated, Literal

from msgspec import Meta, Struct

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


class FtmConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Fine Time Measurement (IEEE 802.11-2016, 11.24.6) as every radio of the run performs it."""

    ftms_per_burst: Annotated[int, Meta(ge=2, le=31)] = 8
    """Measurement frames in a burst; N frames give N - 1 round trips."""
    min_delta_us: Annotated[int, Meta(ge=100, le=25_500)] = 200
    """Least time between two measurement frames of a burst (protocol unit 100 us)."""
    burst_duration_us: Literal[250, 500, 1_000, 2_000, 4_000, 8_000, 16_000, 32_000, 64_000, 128_000] = 16_000
    """Longest time a burst may take before its remaining frames are given up."""
    mode: Mode = "vht_mcs0"
    """Transmission mode of the measurement frames; their time stamps have the bandwidth of the channel."""
    access_category: AccessCategory = "vo"
    """EDCA access category of the frames of a session."""
    bursts_exponent: Annotated[int, Meta(ge=0, le=6)] = 0
    """The initiator asks for 2^this bursts in a session."""
    burst_period_ms: Annotated[int, Meta(ge=100, le=6_553_500, multiple_of=100)] = 100
    """From the beginning of one burst to the next (protocol unit 100 ms); of no effect with one burst."""
    asap: bool = True
    """Ask for the first burst as soon as possible. A responder that is not capable of it measures from the
    time on that it names in its first frame."""
    responder_asap_capable: bool = True
    """Whether a responder can send the first burst as soon as it is requested."""
    responder_ftms_per_burst: Annotated[int, Meta(ge=2, le=31)] = 31
    """Most measurement frames in a burst that a responder grants."""
    responder_min_delta_us: Annotated[int, Meta(ge=100, le=25_500)] = 100
    """Least time between two measurement frames that a responder keeps up with."""
    request_timeout_us: Annotated[int, Meta(ge=1_000, le=1_500_000)] = 100_000
    """From the application's request to the time-out result, if nothing else ended the session."""
    clock_ppm: Annotated[float, Meta(ge=0.0, le=100.0)] = 20.0
    """Largest crystal error of a radio; each radio's is drawn uniformly in +- this."""
    round_trip_std_ps: NonNegative | None = None
    """Standard deviation of one round trip at high SNR; None takes the measured figure of the bandwidth."""
    responder_sessions: Annotated[int, Meta(ge=1, le=64)] = 8
    """Sessions that a radio answers at the same time; a further request is rejected."""
    calibration_bias_m: Annotated[float, Meta(ge=-1_000.0, le=1_000.0)] = 0.0
    """Constant range offset of every pair of devices, metres."""
    calibration_bias_std_m: NonNegative = 0.0
    """Standard deviation over device pairs of the constant range offset that calibration left, metres."""
    nlos_bias_mean_m: NonNegative = 3.0
    """Mean of the extra range, exponentially distributed, of a session whose line of sight is blocked."""


class InterfererConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Somebody else's transmitter on the channel: energy that comes and goes and listens to nobody."""

    pos_ned_m: tuple[Metres, Metres, Metres]
    """Position in the site's NED frame, metres."""
    eirp_dbm: PowerDbm = 20.0
    """Power of its bursts in the channel, antenna gain included."""
    duty_cycle: Annotated[float, Meta(ge=0.0, le=1.0)]
    """Share of the time for which it sends."""
    burst_us: Annotated[float, Meta(ge=10.0, le=1e7)] = 1_000.0
    """Mean length of a burst; bursts and pauses are exponentially distributed."""


class StationConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is different at one station; None is as everywhere."""

    station: Annotated[int, Meta(ge=0, le=65_535)]
    """Number of the station: vehicles from 0, then guests."""
    tx_power_dbm: PowerDbm | None = None
    """Transmit power, dBm."""
    data_mode: Mode | Literal["adaptive"] | None = None
    """Mode of datagrams to one station."""
    broadcast_mode: Mode | None = None
    """Mode of group-addressed frames."""


class GuestConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A station that is no vehicle: it stands still, and another program is its host.

    Guests are numbered after the vehicles, in the order of their tables. See docs/reference/radio-api.md.
    """

    name: Annotated[str, Meta(min_length=1, max_length=40)]
    """Name of the station; each guest has its own."""
    pos_ned_m: tuple[Metres, Metres, Metres]
    """Position in the site's NED frame, metres."""


class RadioConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The 802.11 channel and the radios on it, all alike."""

    channel: Literal["emulated", "ideal"] = "emulated"
    """``ideal`` is what the emulation is measured against: whatever is sent arrives, after its own time on
    the air, at everybody in range; nothing contends, collides or fades. Errors of time stamps remain."""
    drop_fraction: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0
    """Share of received datagrams and of ranging results that the hosts lose, on top of the channel."""
    frequency_mhz: Annotated[float, Meta(ge=100.0, le=100_000.0)] = 5210.0
    """Centre frequency of the channel, MHz."""
    bandwidth_mhz: BandwidthMhz = 80
    """Bandwidth of the channel, MHz."""
    tx_power_dbm: PowerDbm = 16.0
    """Transmit power of each radio at its antenna port, dBm."""
    antenna: Literal["isotropic", "dipole"] = "isotropic"
    """``dipole`` is a half-wave dipole along the body's vertical axis, which tilts with the vehicle."""
    antenna_gain_dbi: Annotated[float, Meta(ge=-50.0, le=50.0)] = 0.0
    """Gain in the strongest direction."""
    noise_figure_db: Annotated[float, Meta(ge=0.0, le=50.0)] = 7.0
    """Noise figure of each receiver, dB."""
    path_loss: Literal["friis", "log_distance", "two_ray"] = "log_distance"
    """``log_distance`` takes ``path_loss_exponent``; ``two_ray`` adds the ray that the ground reflects."""
    path_loss_exponent: Annotated[float, Meta(ge=1.0, le=8.0)] = 2.0
    """Log-distance exponent beyond 1 m, where the loss is Friis's."""
    shadowing_std_db: NonNegative = 0.0
    """Log-normal shadowing of a link, a function of where its two ends are."""
    shadowing_distance_m: Positive = 20.0
    """Way over which the correlation of the shadowing falls to 1/e."""
    rician_k_db: Annotated[float, Meta(ge=-20.0, le=60.0)] | None = 12.0
    """Rician K factor of the small-scale fading; None switches fading off."""
    fading_doppler_hz: NonNegative = 5.0
    """Doppler spread of a link between stations at rest, from what moves around them; the relative speed of
    the stations adds its own."""
    nlos_fraction: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0
    """Share of the time for which a link's line of sight is blocked."""
    nlos_duration_s: Annotated[float, Meta(ge=0.01, le=1e6)] = 2.0
    """Mean time for which it is."""
    nlos_loss_db: NonNegative = 10.0
    """Extra loss while it is."""
    extra_attenuation_db: Annotated[float, Meta(ge=0.0, le=1_000.0)] = 0.0
    """Attenuation added to every link: degrades the channel (20 dB), or cuts it (200 dB)."""
    cca_energy_dbm: Annotated[float, Meta(ge=-100.0, le=0.0)] = -62.0
    """Power from which on the medium is sensed busy, whatever sends: of all signals, in the whole channel."""
    cca_preamble_dbm: Annotated[float, Meta(ge=-100.0, le=0.0)] = -82.0
    """Power in the whole channel from which on a frame is sensed and its preamble can be found, if that is at
    least 4 dB over the noise."""
    access: Literal["edca", "dcf"] = "edca"
    """``dcf`` is one queue that waits DIFS, as before 802.11e, whatever the category."""
    control_mode: Mode = "ofdm24"
    """Mode of RTS. A CTS or ACK has the highest of 6, 12, 24 Mbit/s not above the frame it answers."""
    broadcast_mode: Mode = "ofdm24"
    """Mode of group-addressed frames."""
    broadcast_access_category: AccessCategory = "be"
    """EDCA access category of group-addressed frames."""
    broadcast_rts: bool = True
    """Send RTS to a neighbour and wait for its CTS before a group-addressed frame, as the article does.
    The standard does not; False sends the frame after contention alone."""
    rts_retry_limit: Annotated[int, Meta(ge=0, le=255)] = 7
    """RTS in vain after which the next gives up a group-addressed frame."""
    data_mode: Mode | Literal["adaptive"] = "ofdm24"
    """Mode of datagrams to one station; ``adaptive`` learns it from what is acknowledged."""
    data_access_category: AccessCategory = "be"
    """EDCA access category of datagrams to one station."""
    rts_threshold_bytes: Annotated[int, Meta(ge=0, le=65_535)] = 65_535
    """Datagrams to one station whose frames are longer are sent after RTS and CTS."""
    retry_limit: Annotated[int, Meta(ge=0, le=2**31)] = 6
    """Repetitions of a frame to one station before it is given up."""
    queue_frames: Annotated[int, Meta(ge=1, le=10_000)] = 64
    """Frames that a radio holds for transmission; a further one is dropped and counted."""
    queue_lifetime_us: Annotated[int, Meta(ge=1_000, le=60_000_000)] = 500_000
    """Age in microseconds at which a frame that is still queued is dropped and counted."""
    host_latency_us: Annotated[int, Meta(ge=0, le=100_000)] = 50
    """Least time from the application's call to the radio's queue."""
    host_jitter_us: Annotated[int, Meta(ge=0, le=100_000)] = 100
    """Uniform extra of the same, drawn per frame."""
    ftm: FtmConfig = FtmConfig()
    """Fine Time Measurement: the table ``[radio.ftm]``."""
    interferers: tuple[InterfererConfig, ...] = ()
    """Other transmitters on the channel: tables ``[[radio.interferers]]``."""
    stations: tuple[StationConfig, ...] = ()
    """Settings of single stations: tables ``[[radio.stations]]``."""
    guests: tuple[GuestConfig, ...] = ()
    """Stations of other programs: tables ``[[radio.guests]]``."""
    capture: bool = False
    """Write every frame to radio.pcapng, with radiotap headers, for Wireshark."""


class ServerConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the launcher tells the emulator's process."""

    run_id: str
    host: str = "127.0.0.1"
    port: Annotated[int, Meta(ge=0, le=65_535)] = 0
    stations: Annotated[int, Meta(ge=0)]
    """Vehicles; the guests of ``radio`` are numbered after them."""
    companions: tuple[Annotated[int, Meta(ge=0, le=65_535)], ...] = ()
    """Those of the vehicles whose radio's host is in no lockstep: an application beside a PX4."""
    seed: Annotated[int, Meta(ge=0)]
    radio: RadioConfig = RadioConfig()
    frame_log_path: str | None = None
    session_log_path: str | None = None
    capture_path: str | None = None
    profile_from_us: Annotated[int, Meta(ge=0)] | None = None
    """Simulated time from which the process looks where its processor time goes; None: never."""
