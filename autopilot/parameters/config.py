"""Settings of one vehicle.

What the launcher hands to ``python -m autopilot``, and what scenarios may say of it.
"""

from ipaddress import IPv4Address
from typing import Annotated, Literal

from msgspec import Meta, Struct, field
from msgspec.structs import replace

REMEMBERED_S = 2.0
"""For so long the application knows where its vehicle was; distances that come later are of no use."""
SESSION_S = 0.5
"""From a ranging request to when the formation knows the distance: a queue, one burst, and beacons."""

Port = Annotated[int, Meta(ge=0, le=65_535)]
Vector = tuple[float, float, float]
Position = Annotated[float, Meta(ge=-1e6, le=1e6)]
"""Metres from the site's origin; beacons tell no more."""
Gauss = Annotated[float, Meta(ge=-2.0, le=2.0)]
"""The Earth's field has at most 0.7."""
Angle = Annotated[float, Meta(ge=-360.0, le=360.0)]
"""Degrees."""
Seconds = Annotated[float, Meta(ge=0.0, le=1e5)]
ErrorStd = Annotated[float, Meta(ge=0.001, le=1_000.0)]
"""Metres: a filter that squares and inverts it neither overflows nor takes anything for exact."""


class Site(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The place of the flight: the origin of the formation's NED frame, and its magnetic field."""

    latitude_deg: Annotated[float, Meta(ge=-90.0, le=90.0)] = 47.397742
    """Geodetic latitude (WGS 84), degrees."""
    longitude_deg: Annotated[float, Meta(ge=-180.0, le=180.0)] = 8.545594
    """Geodetic longitude (WGS 84), degrees."""
    altitude_m: Annotated[float, Meta(ge=-500.0, le=9_000.0)] = 488.0
    """Of the ground, above mean sea level."""
    magnetic_field_ned_gauss: tuple[Gauss, Gauss, Gauss] = (0.21523, 0.00771, 0.42741)
    """The Earth's magnetic field, gauss, NED."""


class CircleConfig(
    Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="shape", tag="circle"
):
    """A circle of the geofence, in metres from the site's origin."""

    north_m: Position = 0.0
    """Centre, metres north of the origin."""
    east_m: Position = 0.0
    """Centre, metres east of the origin."""
    radius_m: Annotated[float, Meta(gt=0.0, le=1e5)]
    """Radius, metres."""
    inclusion: bool = True
    """To stay inside of; false: outside."""


class PolygonConfig(
    Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="shape", tag="polygon"
):
    """A polygon of the geofence."""

    vertices_m: Annotated[tuple[tuple[Position, Position], ...], Meta(min_length=3)]
    """North and east from the site's origin."""
    inclusion: bool = True
    """To stay inside of; false: outside."""


class MissionItemConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One item of a mission; see `autopilot.navigation.mission.MissionItem`."""

    command: Literal[
        "takeoff", "waypoint", "loiter_time", "loiter_unlimited", "delay", "change_speed", "jump", "return",
        "land",
    ]  # fmt: skip
    """What the vehicle does."""
    north_m: Position | None = None
    """From the site's origin, with ``east_m``; neither: where the vehicle is."""
    east_m: Position | None = None
    """From the site's origin, with ``north_m``."""
    height_m: Annotated[float, Meta(ge=-10_000.0, le=10_000.0)] = 0.0
    """Above home."""
    acceptance_m: Annotated[float, Meta(ge=0.0, le=1e5)] = 0.0
    """Distance at which a waypoint counts as reached, metres; 0: NAV_ACC_RAD."""
    hold_s: Seconds = 0.0
    """Time to hold at a waypoint, to loiter or to delay, seconds."""
    yaw_deg: Angle | None = None
    """Heading at the item, degrees clockwise from north; without it as MPC_YAW_MODE says."""
    speed_m_s: Annotated[float, Meta(ge=-100.0, le=100.0)] | None = None
    """Of change_speed: speed over ground from here on, m/s; without it that of MPC_XY_CRUISE."""
    jump_to: Annotated[int, Meta(ge=0)] = 0
    """Of jump: index of the item that follows, from 0."""
    jump_count: Annotated[int, Meta(ge=-1)] = 1
    """Of jump: number of jumps; -1: no limit."""


class RallyPointConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A place to return to where it is nearer than home."""

    north_m: Position
    """From the site's origin."""
    east_m: Position
    """From the site's origin."""
    height_m: Annotated[float, Meta(ge=-10_000.0, le=10_000.0)] = 0.0
    """Above home: what the return's heights count from; it lands on the ground."""


class AutopilotConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The scenario's ``[autopilot]`` table."""

    params: dict[str, float] = {}
    """Parameters by PX4's names that differ from their defaults."""
    params_file: str | None = None
    """Parameter file as ground stations save it, beside the scenario; ``params`` go before what it says."""
    per_uav: dict[str, dict[str, float]] = {}
    """Parameters of single vehicles by their number, which go before all others."""
    fence: tuple[CircleConfig | PolygonConfig, ...] = ()
    """Geofence: tables ``[[autopilot.fence]]``."""
    mission: tuple[MissionItemConfig, ...] = ()
    """Mission: tables ``[[autopilot.mission]]``."""
    rally: Annotated[tuple[RallyPointConfig, ...], Meta(max_length=80)] = ()
    """Rally points: tables ``[[autopilot.rally]]``."""
    plan_file: str | None = None
    """Mission, geofence and rally points as QGroundControl saves them (.plan), beside the scenario."""
    plan: str | None = None
    """The contents of such a file."""
    kind: Literal["own", "px4"] = "own"
    """px4: processes of a PX4 SITL build fly, each with coflight's on-board application beside it."""
    px4_vehicles: tuple[Annotated[int, Meta(ge=0, le=253)], ...] | None = None
    """Numbers of the vehicles that a PX4 flies, if not all: the others are coflight's own."""
    px4_build: str | None = None
    """Folder of the build, with bin/px4 and etc/."""
    px4_command: Annotated[tuple[str, ...], Meta(min_length=1)] = (
        "{build}/bin/px4", "-i", "{i}", "-d", "{build}/etc", "-w", "{work}",
    )  # fmt: skip
    """What starts one; see `harness.launch.px4` for what stands in braces."""
    px4_env: dict[str, str] = field(default_factory=lambda: {"PX4_SIM_MODEL": "none_iris"})
    """Its environment besides what the launcher has; the same may stand in braces."""
    px4_rc: bool = False
    """Tell each PX4 of a radio control whose sticks are centred."""

    def is_px4(self, instance: int) -> bool:
        """Whether a PX4 flies that vehicle."""
        return self.kind == "px4" and (self.px4_vehicles is None or instance in self.px4_vehicles)

    def for_uav(self, instance: int) -> "AutopilotConfig":
        """Settings of one vehicle: all its parameters in ``params``."""
        params = {**self.params, **self.per_uav.get(str(instance), {})}
        return replace(self, params=params, params_file=None, per_uav={}, plan_file=None)


class LinksConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The scenario's ``[links]`` table: the vehicles' MAVLink to ground stations and companions.

    Nothing but this table lets other machines speak to a vehicle, or makes it speak to them.
    """

    host: str = "127.0.0.1"
    """Address of this machine that the links are bound to; 0.0.0.0 is all that it has. All are IPv4."""
    ground_station_host: str = "127.0.0.1"
    """Where ``ports.gcs_remote_udp`` is called before anybody has spoken."""
    companion_host: str = "127.0.0.1"
    """Where ``ports.companion_remote_udp`` is called."""
    bandwidth_bytes_s: Annotated[int, Meta(ge=0, le=1_000_000_000)] = 0
    """Of MAVLink, in a second of simulated time, to whoever hears all that a link says; 0: no limit."""
    signing_key_file: str | None = None
    """File with a passphrase or a key, beside the scenario. With it the links act only on what it has signed,
    and sign what they send."""

    def __post_init__(self) -> None:
        """Check the addresses; names are none, for looking one up may take long."""
        here = _ipv4("host", self.host)
        for name in ("ground_station_host", "companion_host"):
            if here.is_loopback and not _ipv4(name, getattr(self, name)).is_loopback:
                raise ValueError(
                    f"{name}: other machines cannot be reached from {self.host}; "
                    "expected host to be 0.0.0.0 or an address of this machine's network"
                )


def _ipv4(field: str, text: str) -> IPv4Address:
    try:
        return IPv4Address(text)
    except ValueError:
        raise ValueError(f"{field}: {text!r} is no IPv4 address, such as 127.0.0.1 or 0.0.0.0") from None


class OnboardConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The scenario's ``[onboard]`` table: the application beside each autopilot."""

    enabled: bool = True
    """False leaves the autopilots to the ground station."""
    hold: bool = False
    """Beacons and ranging alone, no take-off, until a ground station sends component 191 MAV_CMD_USER_1."""
    localisation: Literal["gps", "ftm", "truth"] = "ftm"
    """Correct the own position by everyone's GPS and the FTM distances, trust the own GPS alone, or be told
    by the simulator: the last two are what the first is measured against."""
    loop_period_ms: Annotated[int, Meta(ge=4, le=40)] = 40
    """How often the application works, and deals with autopilot and radio: at the multiples of this, a whole
    number of steps. The channel goes on in intervals as long. Beside a PX4 it works when PX4 speaks."""
    beacon_period_ms: Annotated[int, Meta(ge=10, le=1_000)] = 100
    """Period of a UAV's beacons, milliseconds."""
    neighbours: Annotated[int, Meta(ge=0, le=254)] = 0
    """Localise, range to and keep clear of so many UAVs alone, those with the nearest places, and who has
    this one among its own; 0: all. With ``ftm``, neighbourhoods agree on a common frame by beacons."""
    ranging: Literal["all_pairs", "scheduled"] = "all_pairs"
    """Everybody to everybody in every period, or each pair by one of its ends, in a slot of its own, when the
    distance is worth its time on the air."""
    ftm_period_s: Annotated[float, Meta(ge=0.02, le=3600.0)] = 1.0
    """With ``all_pairs`` each UAV ranges to every other once in this time."""
    ranging_slot_ms: Annotated[int, Meta(ge=2, le=1_000)] = 4
    """With ``scheduled`` each pair's slot is this long, and comes again when all pairs have had theirs."""
    ranging_airtime: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.1
    """With ``scheduled``: occupancy of the channel, as the own radio measures it and by whatever causes it,
    above which only the more valuable distances are measured."""
    wind_feed_forward: bool = False
    """Lean against the wind that the application has learned; for autopilots that do not do so themselves."""
    climb_speed_m_s: Annotated[float, Meta(gt=0.0, le=5.0)] = 1.5
    """Speed of the climb to the height of the formation, m/s."""
    on_station_tolerance_m: Annotated[float, Meta(gt=0.0, le=1_000.0)] = 0.7
    """Own estimated distance from the own place that counts as being there."""
    on_station_hold_s: Seconds = 2.0
    """Time within ``on_station_tolerance_m`` after which the UAV reports that it is on its place."""
    gps_bias_std_m: ErrorStd = 1.5
    """Horizontal, per axis: what the localisation filter assumes of GPS errors."""
    gps_bias_time_constant_s: Annotated[float, Meta(ge=0.1, le=1e6)] = 60.0
    """Correlation time of the GPS errors that the localisation filter assumes, seconds."""
    odometry_drift_m_sqrt_s: Annotated[float, Meta(ge=1e-4, le=10.0)] = 0.1
    """Horizontal, per axis: error of the integrated velocity after one second.

    Grows with the root of time.
    """
    range_floor_std_m: ErrorStd = 0.05
    """What averaging within an FTM session does not reduce."""
    safety_radius_m: Annotated[float, Meta(ge=0.0, le=1_000.0)] = 1.2
    """A neighbour nearer than this, plus two sigma, is kept clear of.

    By a UAV in its place at most 0.6 of the distance between the two's places; one that is away from its
    place keeps more, by half of the way that it has to it.
    """

    @property
    def loop_period_us(self) -> int:
        """Period of the application's loop in microseconds."""
        return 1_000 * self.loop_period_ms


class TrackMotion(
    Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="track"
):
    """The formation flies straight on, and stops after ``length_m``."""

    speed_m_s: Annotated[float, Meta(ge=0.01, le=12.0)] = 3.0
    """Speed of the formation, m/s."""
    acceleration_m_s2: Annotated[float, Meta(ge=0.001, le=3.0)] = 0.5
    """Along the track, at its beginning and end."""
    length_m: Annotated[float, Meta(ge=0.1, le=1e5)] = 100.0
    """Length of the track, metres."""
    course_deg: Angle = 0.0
    """Compass direction of flight; the formation keeps its heading."""


class RacetrackMotion(
    Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="racetrack"
):
    """The formation flies round after round: two straights joined by half turns."""

    speed_m_s: Annotated[float, Meta(ge=0.01, le=12.0)] = 3.0
    """Speed of the formation, m/s."""
    acceleration_m_s2: Annotated[float, Meta(ge=0.001, le=3.0)] = 0.5
    """Acceleration along the track, at its beginning."""
    length_m: Annotated[float, Meta(ge=0.0, le=1e5)] = 60.0
    """Of a straight."""
    radius_m: Annotated[float, Meta(ge=0.1, le=1e5)] = 25.0
    """Tightest in a turn."""
    course_deg: Angle = 0.0
    """Of the first straight, which begins where the formation has formed."""
    side: Literal["left", "right"] = "right"
    """Side to which the formation turns."""
    heading: Literal["fixed", "track"] = "track"
    """Whether the formation turns with the track or keeps its heading."""


AnyMotion = TrackMotion | RacetrackMotion


class Devices(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a vehicle knows of its GPS receiver and its radio, as from their data sheets."""

    gps_delay_s: Annotated[float, Meta(ge=0.0, le=0.3)] = 0.12
    """How far in the past the moment lies that a fix describes; the default of EKF2_GPS_DELAY."""
    ftm_trip_std_m: Annotated[float, Meta(ge=0.0, le=1_000.0)] = 0.08
    """Error of the distance of a single round trip, at the radio's bandwidth and good reception."""


class VehiclePorts(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where one vehicle listens and speaks.

    Port 0: any free one (local) or none (remote).
    """

    host: str = "127.0.0.1"
    """The simulator's; that of the links is `LinksConfig`'s."""
    simulator_tcp: Port = 4560
    simulator_unix: str | None = None
    """Name of a Unix socket of the simulator in Linux's abstract namespace, used instead of its TCP port."""
    gcs_local_udp: Port = 18570
    gcs_remote_udp: Port = 14550
    companion_local_udp: Port = 14580
    companion_remote_udp: Port = 14540
    radio_endpoint: str | None = None
    """Zenoh locator of the 802.11 emulator; None flies without a radio."""


class VehicleConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Everything that one UAV's process is told."""

    run_id: str
    instance: Annotated[int, Meta(ge=0, le=254)]
    """MAVLink system id is this plus one; radio station number is this."""
    seed: Annotated[int, Meta(ge=0)]
    step_us: Annotated[int, Meta(ge=1_000, le=20_000)] = 4_000
    epoch_unix_us: Annotated[int, Meta(ge=0)] = 0
    """The date of simulated time 0, as SYSTEM_TIME tells it."""
    site: Site = Site()
    ports: VehiclePorts = VehiclePorts()
    autopilot: AutopilotConfig = AutopilotConfig()
    links: LinksConfig = LinksConfig()
    onboard: OnboardConfig = OnboardConfig()
    devices: Devices = Devices()
    places_ned_m: tuple[tuple[Position, Position, Position], ...]
    """The formation: each UAV's place from the site's origin, before it moves."""
    heading_deg: Angle = 0.0
    """Of the formation, before it moves."""
    motion: AnyMotion | None = None
    log_path: str | None = None
    """Binary log of estimates; None writes none."""
    params_path: str | None = None
    """Where MAV_CMD_PREFLIGHT_STORAGE writes the parameters; None: it is not supported."""
    record_period_us: Annotated[int, Meta(ge=1_000)] = 20_000
    connect_timeout_s: Annotated[float, Meta(gt=0.0, le=1e5)] = 30.0
    profile_from_us: Annotated[int, Meta(ge=0)] | None = None
    """Simulated time from which the process looks where its processor time goes; None: never."""
