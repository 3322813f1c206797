"""Settings of one vehicle.

They are the launcher's input to ``python -m autopilot``, and the tables of a scenario that concern vehicles.
"""

from ipaddress import IPv4Address
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct, field
from msgspec.structs import replace

from autopilot.parameters.onboard_config import OnboardConfig
from foundation.airframe.description import Airframe
from foundation.airframe.files import IRIS
from foundation.records.record_log import BLOCK_ROWS

REMEMBERED_S = 2.0
"""How long the application stores its vehicle's past positions; older distances cannot be used."""
SESSION_S = 0.5
"""Time from a ranging request until the formation has the distance: queueing, one burst, and beacons."""

OWN_PARAMETERS = "CF_"
"""Prefix of the parameters that only coflight's own autopilot has."""
AutopilotKind = Literal["own", "px4", "ardupilot"]
Port = Annotated[int, Meta(ge=0, le=65_535)]
Vector = tuple[float, float, float]
Position = Annotated[float, Meta(ge=-1e6, le=1e6)]
"""Metres from the site's origin, within the range of beacons."""
Gauss = Annotated[float, Meta(ge=-2.0, le=2.0)]
"""Of a magnetic field; the Earth's is at most 0.7."""
Angle = Annotated[float, Meta(ge=-360.0, le=360.0)]
"""In degrees."""
Seconds = Annotated[float, Meta(ge=0.0, le=1e5)]


class Site(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Location of the flight: origin of the formation's NED frame, and the magnetic field there."""

    latitude_deg: Annotated[float, Meta(ge=-90.0, le=90.0)] = 47.397742
    """Geodetic latitude (WGS 84), degrees."""
    longitude_deg: Annotated[float, Meta(ge=-180.0, le=180.0)] = 8.545594
    """Geodetic longitude (WGS 84), degrees."""
    altitude_m: Annotated[float, Meta(ge=-500.0, le=9_000.0)] = 488.0
    """Altitude of the ground above mean sea level."""
    magnetic_field_ned_gauss: tuple[Gauss, Gauss, Gauss] = (0.21523, 0.00771, 0.42741)
    """The Earth's magnetic field, gauss, NED."""


class CircleConfig(
    Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="shape", tag="circle"
):
    """A circular zone of the geofence, in metres from the site's origin."""

    north_m: Position = 0.0
    """Centre, metres north of the origin."""
    east_m: Position = 0.0
    """Centre, metres east of the origin."""
    radius_m: Annotated[float, Meta(gt=0.0, le=1e5)]
    """Radius, metres."""
    inclusion: bool = True
    """Whether the vehicle must stay inside; false: outside."""


class PolygonConfig(
    Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="shape", tag="polygon"
):
    """A polygonal zone of the geofence."""

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
    """From the site's origin, together with ``east_m``; if neither is given, the vehicle's position."""
    east_m: Position | None = None
    """From the site's origin, with ``north_m``."""
    height_m: Annotated[float, Meta(ge=-10_000.0, le=10_000.0)] = 0.0
    """Above home, in metres."""
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
    """An alternative to home for returns, used where it is nearer."""

    north_m: Position
    """From the site's origin."""
    east_m: Position
    """From the site's origin."""
    height_m: Annotated[float, Meta(ge=-10_000.0, le=10_000.0)] = 0.0
    """Above home: base of the return's heights; the vehicle lands on the ground."""


class AutopilotConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The scenario's ``[autopilot]`` table."""

    params: dict[str, float] = {}
    """Values of parameters by PX4's names."""
    params_file: str | None = None
    """Parameter file of a ground station, relative to the scenario; ``params`` take precedence."""
    per_uav: dict[str, dict[str, float]] = {}
    """Parameters of single vehicles by their number; they take precedence over all others."""
    fence: tuple[CircleConfig | PolygonConfig, ...] = ()
    """Geofence: tables ``[[autopilot.fence]]``."""
    mission: tuple[MissionItemConfig, ...] = ()
    """Mission: tables ``[[autopilot.mission]]``."""
    rally: Annotated[tuple[RallyPointConfig, ...], Meta(max_length=80)] = ()
    """Rally points: tables ``[[autopilot.rally]]``."""
    plan_file: str | None = None
    """Mission, geofence and rally points as QGroundControl saves them (.plan), relative to the scenario."""
    plan: str | None = None
    """The contents of such a file."""
    kind: AutopilotKind = "own"
    """px4: the vehicles are processes of a PX4 SITL build, each with coflight's on-board application beside
    it. ardupilot: likewise of ArduPilot's SITL program for copters."""
    px4_vehicles: tuple[Annotated[int, Meta(ge=0, le=253)], ...] | None = None
    """Numbers of the vehicles that run PX4; default: all. The others run coflight's autopilot."""
    px4_build: str | None = None
    """Folder of the build, which contains bin/px4 and etc/."""
    px4_command: Annotated[tuple[str, ...], Meta(min_length=1)] = (
        "{build}/bin/px4", "-i", "{i}", "-d", "{build}/etc", "-w", "{work}",
    )  # fmt: skip
    """Command line of a PX4 process; see `harness.launch.px4` for the fields in braces."""
    px4_env: dict[str, str] = field(default_factory=lambda: {"PX4_SIM_MODEL": "none_iris"})
    """Variables added to the environment of a PX4 process; the same fields in braces are replaced."""
    px4_simulation_parameters: bool = True
    """Set the parameters of PX4 that suit this simulator's sensors: height from the barometer instead of the
    GPS receiver. ``params`` has precedence; false: PX4's defaults."""
    px4_rc: bool = False
    """Send each PX4 the input of a radio control with centred sticks."""
    ardupilot_vehicles: tuple[Annotated[int, Meta(ge=0, le=253)], ...] | None = None
    """Numbers of the vehicles that run ArduPilot; default: all. The others run coflight's autopilot."""
    ardupilot_program: str | None = None
    """ArduPilot's SITL program for copters, build/sitl/bin/arducopter."""
    ardupilot_command: Annotated[tuple[str, ...], Meta(min_length=1)] = (
        "{program}", "--model", "JSON:{host}", "--sim-port-out", "{simulator}", "-I", "{i}",
        "--sysid", "{sysid}", "--rc-in-port", "0", "--home", "{home}", "--speedup", "1000",
        "--defaults", "{parameters}",
        "--serial0", "udpclient:{host}:{gcs_remote}", "--serial1", "udpclient:{host}:{companion_remote}",
        "--serial2", "tcpclient:{host}:{simulator}",
    )  # fmt: skip
    """Command line of an ArduPilot process; see `harness.launch.ardupilot` for the fields in braces."""

    controller: str | None = None
    """Class in place of the cascade of position, attitude and rates: ``package.module:Class``, or the name of
    an entry point of ``coflight.controllers``. Not beside a PX4 or ArduPilot; likewise the other two."""
    controller_settings: dict[str, Any] = {}
    """Settings of the controller's own type: table ``[autopilot.controller_settings]``."""
    modes: Annotated[tuple[str, ...], Meta(max_length=8)] = ()
    """Classes of further flight modes, which are PX4's external modes 1 to 8 in this order; by path, or by
    the name of an entry point of ``coflight.modes``."""
    mode_settings: dict[str, dict[str, Any]] = {}
    """Settings of these modes, by the name in ``modes``."""
    services: tuple[str, ...] = ()
    """Classes of further MAVLink services; by path, or by the name of an entry point of
    ``coflight.services``."""
    service_settings: dict[str, dict[str, Any]] = {}
    """Settings of these services, by the name in ``services``."""
    folder: str = ""
    """Folder in which modules of these classes are looked up first; empty: that of the scenario's file, or
    the working directory for a scenario without a file."""

    @property
    def has_code(self) -> bool:
        """Whether classes of the user are named."""
        return self.controller is not None or bool(self.modes or self.services)

    def kind_of(self, instance: int) -> AutopilotKind:
        """Return which autopilot that vehicle runs."""
        chosen = self.px4_vehicles if self.kind == "px4" else self.ardupilot_vehicles
        return self.kind if chosen is None or instance in chosen else "own"

    def is_px4(self, instance: int) -> bool:
        """Whether that vehicle runs PX4."""
        return self.kind_of(instance) == "px4"

    def is_external(self, instance: int) -> bool:
        """Whether that vehicle's autopilot is another program; the application is a process beside it."""
        return self.kind_of(instance) != "own"

    def external_params(self, instance: int) -> dict[str, float]:
        """Return the parameters of a vehicle with another autopilot: all but coflight's own (CF_...)."""
        params = self.for_uav(instance).params
        return {name: value for name, value in params.items() if not name.startswith(OWN_PARAMETERS)}

    def for_uav(self, instance: int) -> "AutopilotConfig":
        """Settings of one vehicle, with all its parameters in ``params``."""
        params = {**self.params, **self.per_uav.get(str(instance), {})}
        return replace(self, params=params, params_file=None, per_uav={}, plan_file=None)


class LinksConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The scenario's ``[links]`` table: the vehicles' MAVLink links to ground stations and companions.

    Without this table the vehicles communicate with this machine only.
    """

    telemetry: Literal["wire", "radio"] = "wire"
    """Way of MAVLink between vehicles and ground stations. "wire": UDP between the machine's processes,
    without delay and loss. "radio": the emulated 802.11 channel, from each vehicle to each of
    ``[[stations]]``, where programs of ground stations connect."""
    host: str = "127.0.0.1"
    """IPv4 address of this machine to which the links are bound; 0.0.0.0: all of its addresses."""
    ground_station_host: str = "127.0.0.1"
    """IPv4 address with ``ports.gcs_remote_udp``, the default destination of the ground station link."""
    companion_host: str = "127.0.0.1"
    """IPv4 address with ``ports.companion_remote_udp``, the default destination of the companion link."""
    local_senders: Literal["own", "any"] = "own"
    """Programs of this machine with which the links communicate over the loopback interface, whose ports all
    users share. "own": those of the run's user and of root; datagrams of others are dropped and counted. A
    sender at another address of this machine than the link's own, and not of 127.0.0.0/8, is not checked.
    "any": all, for instance for a ground station that another user runs. The application beside a PX4 or
    ArduPilot accepts, with "own", only the autopilot that the run has started."""
    bandwidth_bytes_s: Annotated[int, Meta(ge=0, le=1_000_000_000)] = 0
    """Limit of each link's MAVLink bytes per second of simulated time; 0: none."""
    signing_key_file: str | None = None
    """File with a passphrase or a key, relative to the scenario. With it the links accept only frames signed
    with the key, and sign the frames that they send."""

    def __post_init__(self) -> None:
        """Check the addresses. Host names are rejected, because their resolution may block."""
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
        raise ValueError(f"{field}: {text!r} is not an IPv4 address such as 127.0.0.1 or 0.0.0.0") from None


class LoggingConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The scenario's ``[logging]`` table: logs of the vehicles in the formats of PX4 and ground stations.

    Of coflight's own vehicles only: a PX4 or ArduPilot writes its own logs.
    """

    ulog: bool = False
    """Whether each vehicle writes ``uav-N.ulg`` from its start on, PX4's ULog. Otherwise a vehicle writes
    it from the first message of a ground station on."""
    tlog: bool = False
    """Whether the messages on each ground link are written to ``ground-N.tlog``, as ground stations do. A
    swarm in one process has ground links only with ``links.telemetry = "radio"``."""


class TrackMotion(
    Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="track"
):
    """Motion of the formation along a straight track that ends after ``length_m``."""

    speed_m_s: Annotated[float, Meta(ge=0.01, le=12.0)] = 3.0
    """Speed of the formation, m/s."""
    acceleration_m_s2: Annotated[float, Meta(ge=0.001, le=3.0)] = 0.5
    """Along the track, at its start and end."""
    length_m: Annotated[float, Meta(ge=0.1, le=1e5)] = 100.0
    """Length of the track, metres."""
    course_deg: Angle = 0.0
    """Direction of flight, clockwise from north; the formation keeps its heading."""


class RacetrackMotion(
    Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="racetrack"
):
    """Motion of the formation in laps of two straights joined by half turns."""

    speed_m_s: Annotated[float, Meta(ge=0.01, le=12.0)] = 3.0
    """Speed of the formation, m/s."""
    acceleration_m_s2: Annotated[float, Meta(ge=0.001, le=3.0)] = 0.5
    """Acceleration along the track, at its beginning."""
    length_m: Annotated[float, Meta(ge=0.0, le=1e5)] = 60.0
    """Length of a straight."""
    radius_m: Annotated[float, Meta(ge=0.1, le=1e5)] = 25.0
    """Smallest radius in a turn."""
    course_deg: Angle = 0.0
    """Direction of the first straight, which begins where the formation has formed."""
    side: Literal["left", "right"] = "right"
    """Side to which the formation turns."""
    heading: Literal["fixed", "track"] = "track"
    """track: the formation turns with the track. fixed: it keeps its heading."""


AnyMotion = TrackMotion | RacetrackMotion


class Devices(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Data-sheet values of the GPS receiver and the radio, as available to the vehicle."""

    gps_delay_s: Annotated[float, Meta(ge=0.0, le=0.3)] = 0.12
    """Age of a fix on arrival; the default of EKF2_GPS_DELAY."""
    ftm_trip_std_m: Annotated[float, Meta(ge=0.0, le=1_000.0)] = 0.08
    """Standard deviation of a distance from a single round trip, with the radio's bandwidth, at high SNR."""


class RadioEndpoint(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where and how a vehicle reaches the 802.11 emulator."""

    locator: str
    """Zenoh endpoint of the emulator's router."""
    password: str
    """Of the vehicles, random for each run."""


class VehiclePorts(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Addresses and ports of one vehicle.

    Port 0: any free one (local) or none (remote).
    """

    host: str = "127.0.0.1"
    """Address of the simulator; for that of the links see `LinksConfig`."""
    simulator_tcp: Port = 4560
    """Not used by a process that inherits its connection to the simulator."""
    gcs_local_udp: Port = 18570
    gcs_remote_udp: Port = 14550
    companion_local_udp: Port = 14580
    companion_remote_udp: Port = 14540
    radio_endpoint: RadioEndpoint | None = None
    """The 802.11 emulator; None: no radio."""


class VehicleConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The configuration of one UAV's process."""

    run_id: str
    instance: Annotated[int, Meta(ge=0, le=254)]
    """Radio station number; the MAVLink system id is this plus one."""
    seed: Annotated[int, Meta(ge=0)]
    step_us: Annotated[int, Meta(ge=1_000, le=20_000)] = 4_000
    epoch_unix_us: Annotated[int, Meta(ge=0)] = 0
    """The date of simulated time 0, reported by SYSTEM_TIME."""
    site: Site = Site()
    airframe: Airframe = IRIS
    ports: VehiclePorts = VehiclePorts()
    autopilot: AutopilotConfig = AutopilotConfig()
    links: LinksConfig = LinksConfig()
    logging: LoggingConfig = LoggingConfig()
    onboard: OnboardConfig = OnboardConfig()
    devices: Devices = Devices()
    ground_stations: dict[str, Annotated[int, Meta(ge=0, le=65_535)]] = {}
    """Radio station numbers of the ground stations by their names; with any, the ground link is over the
    radio."""
    places_ned_m: tuple[tuple[Position, Position, Position], ...]
    """The formation: each UAV's initial place from the site's origin."""
    heading_deg: Angle = 0.0
    """Initial heading of the formation."""
    motion: AnyMotion | None = None
    log_path: str | None = None
    """Binary log of estimates; None: no log."""
    log_block_rows: Annotated[int, Meta(ge=1)] = BLOCK_ROWS
    """Rows that are written to it at once; 1 for a log that is read in flight."""
    params_path: str | None = None
    """File to which MAV_CMD_PREFLIGHT_STORAGE writes the parameters; None: the command is not supported."""
    call_limit_s: Annotated[float, Meta(gt=0.0, le=120.0)] = 5.0
    """Wall time within which calls of the user's code must return."""
    record_period_us: Annotated[int, Meta(ge=1_000)] = 20_000
    connect_timeout_s: Annotated[float, Meta(gt=0.0, le=1e5)] = 30.0
    profile_from_us: Annotated[int, Meta(ge=0)] | None = None
    """Simulated time from which the process profiles its CPU time; None: never."""

    @property
    def feeds_wind_forward(self) -> bool:
        """Whether the application compensates the wind: as set, by default beside a PX4."""
        chosen = self.onboard.wind_feed_forward
        return self.autopilot.is_px4(self.instance) if chosen is None else chosen
