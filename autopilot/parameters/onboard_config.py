"""Settings of the programs on board: the scenario's ``[onboard]`` table."""

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct

from netsim.wire.messages import DEFAULT_PORT

FORMATION = "formation"
"""Name of the built-in application."""
_OF_ALL = (
    "enabled", "application", "settings", "folder", "port", "programs", "loop_period_ms", "ranging_radio",
)  # fmt: skip
"""Fields that do not configure the formation."""
UdpPort = Annotated[int, Meta(ge=1, le=65_535)]
Seconds = Annotated[float, Meta(ge=0.0, le=1e5)]
ErrorStd = Annotated[float, Meta(ge=0.001, le=1_000.0)]
"""In metres; within the range in which a filter that squares and inverts it stays well conditioned."""


class ProgramConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A program beside the application that flies the UAV: one of ``[[onboard.programs]]``."""

    name: Annotated[str, Meta(pattern=r"^[a-z][a-z0-9_]{0,15}$")]
    """Name of its numbers, texts and failures."""
    application: str
    """``package.module:Class``, or the name of an entry point of ``coflight.applications``."""
    port: UdpPort
    """UDP port of its datagrams on the radio."""
    settings: dict[str, Any] = {}
    """Settings of its own type: table ``[onboard.programs.settings]``."""
    uavs: Literal["all"] | tuple[Annotated[int, Meta(ge=0, le=253)], ...] = "all"
    """Numbers of the UAVs that have it."""

    def runs_on(self, uav: int) -> bool:
        """Whether a UAV has it."""
        return self.uavs == "all" or uav in self.uavs


class OnboardConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The scenario's ``[onboard]`` table: the application with each autopilot."""

    enabled: bool = True
    """False: no application; the vehicles are controlled by the ground station alone."""
    application: str = "formation"
    """The application that flies the UAVs: ``formation``, which the fields from ``hold`` on configure,
    ``package.module:Class``, or the name of an entry point of ``coflight.applications``."""
    settings: dict[str, Any] = {}
    """Settings of another application than ``formation``, of its own type: table ``[onboard.settings]``."""
    folder: str = ""
    """Folder in which modules are looked up first; empty: that of the scenario's file."""
    port: UdpPort = DEFAULT_PORT
    """UDP port of the application's datagrams on the radio."""
    programs: tuple[ProgramConfig, ...] = ()
    """Programs beside the application: tables ``[[onboard.programs]]``."""
    loop_period_ms: Annotated[int, Meta(ge=4, le=40)] = 40
    """Period of the loop of all programs, which exchange data with autopilot and radio at multiples of it: a
    whole number of steps. The channel advances in equal intervals."""
    ranging_radio: Literal["wifi", "uwb"] = "wifi"
    """Radio that measures the distances: the 802.11 radio by Fine Time Measurement, or a UWB radio beside it,
    of the table ``[uwb]``."""
    hold: bool = False
    """Run beacons and ranging only; take off when a ground station sends component 191 MAV_CMD_USER_1."""
    localisation: Literal["gps", "ftm", "truth"] = "ftm"
    """Source of the position estimate. ftm: the own position corrected by all vehicles' GPS and the measured
    distances. gps: the own GPS alone. truth: the simulator. The last two are references for the first."""
    beacon_period_ms: Annotated[int, Meta(ge=10, le=1_000)] = 100
    """Period of a UAV's beacons, milliseconds."""
    neighbours: Annotated[int, Meta(ge=0, le=254)] = 0
    """Number of UAVs with the nearest places that are localised, ranged to and avoided, plus those that have
    this one among theirs; 0: all. With ``ftm``, neighbourhoods agree on a common frame by beacons."""
    ranging: Literal["all_pairs", "scheduled"] = "all_pairs"
    """all_pairs: every UAV to every other in each period. scheduled: each pair once, in its own slot, if the
    distance is worth its airtime."""
    ftm_period_s: Annotated[float, Meta(ge=0.02, le=3600.0)] = 1.0
    """With ``all_pairs``: period in which each UAV ranges to every other once."""
    ranging_slot_ms: Annotated[int, Meta(ge=2, le=1_000)] = 4
    """With ``scheduled``: length of each pair's slot; the slots of all pairs repeat in turn."""
    ranging_airtime: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.1
    """With ``scheduled``: channel occupancy from all causes, as measured by the own radio, above which only
    the more valuable distances are measured."""
    wind_feed_forward: bool | None = None
    """Compensate the estimated wind by tilt; for autopilots that do not do so themselves. Default: beside a
    PX4 only. ArduPilot takes accelerations as those of the path, so it cannot be used there."""
    climb_speed_m_s: Annotated[float, Meta(gt=0.0, le=5.0)] = 1.5
    """Speed of the climb to the height of the formation, m/s."""
    on_station_tolerance_m: Annotated[float, Meta(gt=0.0, le=1_000.0)] = 0.7
    """Largest estimated distance from the own place that counts as being on station."""
    on_station_hold_s: Seconds = 2.0
    """Time within ``on_station_tolerance_m`` after which the UAV reports that it is on its place."""
    gps_bias_std_m: ErrorStd = 1.5
    """Standard deviation of GPS errors that the localisation filter assumes; horizontal, per axis."""
    gps_bias_time_constant_s: Annotated[float, Meta(ge=0.1, le=1e6)] = 60.0
    """Correlation time of the GPS errors that the localisation filter assumes, seconds."""
    odometry_drift_m_sqrt_s: Annotated[float, Meta(ge=1e-4, le=10.0)] = 0.1
    """Error of the integrated velocity after one second; horizontal, per axis.

    It grows with the square root of time.
    """
    range_floor_std_m: ErrorStd = 0.05
    """Error of a range that averaging within an FTM session does not reduce."""
    safety_radius_m: Annotated[float, Meta(ge=0.0, le=1_000.0)] = 1.2
    """Neighbours nearer than this plus two sigma are avoided.

    A UAV at its place keeps at most 0.6 of the distance between the two places; one that is away from its
    place keeps more, by half of the distance to it.
    """

    def __post_init__(self) -> None:
        """Check that settings of the formation belong to it, and that names and ports differ."""
        if self.application != FORMATION:
            for each in msgspec.structs.fields(self):
                if each.name not in _OF_ALL and getattr(self, each.name) != each.default:
                    raise ValueError(
                        f"{each.name}: a setting of the application {FORMATION}; expected those of "
                        f"{self.application} in [onboard.settings]"
                    )
        elif self.settings:
            raise ValueError("settings: those of the application formation are fields of [onboard] itself")
        ports, names = {self.port: "port"}, set[str]()
        for number, program in enumerate(self.programs):
            path = f"programs[{number}]"
            if program.application == FORMATION:
                raise ValueError(f"{path}.application: {FORMATION} flies the UAV; expected another program")
            if program.name in names:
                raise ValueError(f"{path}.name: {program.name!r} occurs twice")
            if program.port in ports:
                raise ValueError(
                    f"{path}.port: {program.port} is that of {ports[program.port]}; expected another"
                )
            names.add(program.name)
            ports[program.port] = f"{path}.port"

    @property
    def loop_period_us(self) -> int:
        """Period of the application's loop in microseconds."""
        return 1_000 * self.loop_period_ms
