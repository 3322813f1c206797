"""The scenario of a run: one frozen object of all settings, and checks of settings of several parts.

Each package defines the settings of its part. All processes of a run read the object as JSON from the run
folder; `harness.scenario.scenario_file` reads it from a TOML file.
"""

from datetime import UTC, datetime, timedelta
from ipaddress import IPv4Address
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from antenna.model.config import AntennaConfig
from autopilot.onboard import formation_plan
from autopilot.onboard.factory import layout_of
from autopilot.onboard.formation_plan import FormationPlan
from autopilot.parameters.config import (
    REMEMBERED_S,
    SESSION_S,
    AutopilotConfig,
    Devices,
    LinksConfig,
    LoggingConfig,
    Port,
    RadioEndpoint,
    Site,
    VehicleConfig,
    VehiclePorts,
)
from autopilot.parameters.onboard_config import OnboardConfig
from foundation.airframe.description import Airframe
from harness.scenario import airframe_choice, autopilot_settings, formation_shape, world_checks
from harness.scenario import programs as vehicle_programs
from harness.scenario import stations as ground_stations
from harness.scenario.airframe_choice import VehicleTable
from harness.scenario.formation_shape import FormationConfig
from harness.scenario.programs import NetworkTable, VehicleProgram
from harness.scenario.stations import GroundStation, GroundStations
from harness.world.faults import MOST_TIME_S, AnyFault, check
from harness.world.physics.environment import EnvironmentConfig
from harness.world.sensors.config import SensorsConfig
from harness.world.wind import WindConfig
from netsim.emulator import settings_checks as radio_settings
from netsim.ftm.stamps import distance_m, round_trip_std_ps
from netsim.model.config import RadioConfig
from netsim.serial_radio.config import SerialPairsConfig, SerialRadioConfig
from netsim.serial_radio.hopping import channel_count
from netsim.serial_radio.timing import make_timing
from netsim.uwb import access as uwb_access
from netsim.uwb import frames as uwb_frames
from netsim.uwb.config import UwbConfig
from netsim.uwb.time_of_flight import distance_std_m

_UNIX_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_EPOCH_END = datetime(2500, 1, 1, tzinfo=UTC)


class ScenarioError(ValueError):
    """An invalid scenario; the text for the user has a line for each wrong field."""


class RunConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The ``[run]`` table: duration, seed, timing and recording of a run."""

    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 1
    """Seed of all random streams of the run."""
    duration_s: Annotated[float, Meta(ge=0.0, le=MOST_TIME_S)] = 60.0
    """Simulated time in formation."""
    reach_timeout_s: Annotated[float, Meta(gt=0.0, le=MOST_TIME_S)] = 120.0
    """Simulated time from the start within which the formation must be reached."""
    step_us: Annotated[int, Meta(ge=4_000, le=4_000)] = 4_000
    """Step of physics and lockstep: 250 Hz, the rate of PX4's simulator interface."""
    on_vehicle_loss: Literal["continue", "end"] = "continue"
    """Whether the run continues with the other vehicles or ends when a vehicle is lost."""
    silence_limit_s: Annotated[float, Meta(gt=0.0, le=120.0)] = 5.0
    """Wall time after which a running vehicle that does not answer is given up."""
    record_rate_hz: Annotated[float, Meta(ge=0.001, le=250.0)] = 25.0
    """Rows per simulated second and vehicle in the flight log."""
    epoch_utc: Annotated[datetime, Meta(tz=True)] = datetime(2026, 1, 1, tzinfo=UTC)
    """Date of simulated time 0 for the vehicles' clocks and captures; the flight does not depend on it."""

    def __post_init__(self) -> None:
        if self.epoch_utc < _UNIX_EPOCH:
            raise ValueError("epoch_utc is before 1970, which MAVLink's clocks cannot represent")
        if self.epoch_utc >= _EPOCH_END:
            raise ValueError("epoch_utc is in 2500 or later; captures represent dates up to 2554")

    @property
    def epoch_unix_us(self) -> int:
        """``epoch_utc`` as UNIX time, us."""
        return (self.epoch_utc - _UNIX_EPOCH) // timedelta(microseconds=1)


class PortsConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The ``[ports]`` table: vehicle i uses each base plus i; the defaults are PX4's."""

    host: str = "127.0.0.1"
    """Address of simulator and radio; the addresses of the vehicles' links are in ``[links]``."""
    simulator_tcp: Port = 4560
    """Simulator: TCP port that vehicle 0 connects to, if it does (``simulator_link``)."""
    simulator_link: Literal["unix", "tcp"] = "unix"
    """Connection of coflight's own vehicles to the simulator. "unix": a pair of Unix sockets without a name,
    which each process inherits; a message takes a third of the time of "tcp", which can be captured on the
    loopback interface. PX4s and ArduPilots always use TCP."""
    simulator_peers: Literal["started", "any"] = "started"
    """Programs of this machine that may connect to the simulator's ports. "started": for each vehicle the
    process that the run has started for it, and its descendants; others are closed, counted and named in the
    manifest. "any": all, for a command that has a PX4 or ArduPilot started by another program, such as a
    container's."""
    gcs_local_udp: Port = 18570
    """Local UDP port of the ground station link. With ``links.telemetry = "radio"`` it is that of the first
    of ``[[stations]]`` for vehicle 0; those of the next one for all vehicles follow, and so on."""
    gcs_remote_udp: Port = 14550
    """Port of the ground station's program, common to all vehicles. 0: none; messages are sent only to
    programs that have sent some. With ``links.telemetry = "radio"`` the second of ``[[stations]]`` uses the
    next port, and so on."""
    companion_local_udp: Port = 14580
    """Local UDP port of the companion link."""
    companion_remote_udp: Port = 14540
    """Vehicle i sends to this port plus i, unless that is the ground station's port or bound by a vehicle of
    the swarm: with PX4's numbers 14550 for vehicle 10, and 14580 for vehicle 40 and so on. Those vehicles
    send only to a companion that has sent to them, and to programs on the vehicle."""
    radio_link: Literal["unix", "tcp"] = "unix"
    """Where vehicles and guests reach the 802.11 emulator. "unix": a Unix socket in a folder that only the
    user of the run may enter. "tcp": a TCP port of ``host``, for guests on other machines, with the same
    passwords, but without encryption."""
    radio_tcp: Port = 7447
    """With ``radio_link = "tcp"``: port of the 802.11 emulator."""

    def __post_init__(self) -> None:
        try:
            IPv4Address(self.host)
        except ValueError:
            raise ValueError(
                f"host: {self.host!r} is no IPv4 address; expected one of this machine, such as 127.0.0.1"
            ) from None

    def numbers(self) -> dict[str, int]:
        """Return the ports and bases by their fields' names, without other fields of the table."""
        return {name: value for name, value in msgspec.structs.asdict(self).items() if isinstance(value, int)}

    def free(self) -> "PortsConfig":
        """Return the table with 0 for all ports: free ports, and no remote port."""
        return msgspec.structs.replace(self, **dict.fromkeys(self.numbers(), 0))

    def raised(self, offset: int, agents: int) -> "PortsConfig":
        """Return the table with ``offset`` added to each port; 0 stays 0.

        ``agents`` is the greatest number of ports from a base on. Raises ValueError for a negative offset,
        and for an invalid port.
        """
        most = max(0, 65_535 - max(self.numbers().values()) - (agents - 1))
        if not 0 <= offset <= most:
            raise ValueError(f"a port offset of {offset}: expected 0 to {most}, as ports end at 65535")
        changed = {name: base + offset if base else 0 for name, base in self.numbers().items()}
        return msgspec.structs.replace(self, **changed)

    def check(self, agents: int, stations: int = 1) -> None:
        """Check that ports are valid and do not overlap. Raises ValueError with the field's path.

        ``stations`` is the number of ground stations that have a port for each of the ``agents``.
        """
        counts = dict.fromkeys(("simulator_tcp", "companion_local_udp", "companion_remote_udp"), agents)
        counts["gcs_local_udp"] = agents * stations
        for field, count in counts.items():
            base = getattr(self, field)
            if base and base + count - 1 > 65_535:
                raise ValueError(f"ports.{field}: {base} + {count - 1} vehicles is over 65535")
        for first, others in (
            ("gcs_local_udp", (("companion_local_udp", agents), ("gcs_remote_udp", stations))),
            ("companion_local_udp", (("gcs_remote_udp", stations),)),
            ("simulator_tcp", (("radio_tcp", 1),) if self.radio_link == "tcp" else ()),
        ):
            begin = getattr(self, first)
            for second, count in others:
                other = getattr(self, second)
                port = max(begin, other)
                if begin and other and port < min(begin + counts[first], other + count):
                    of_uav = f" of UAV {port - other}" if count > 1 else ""
                    raise ValueError(
                        f"ports.{first} of UAV {port - begin} and ports.{second}{of_uav} are both {port}; "
                        f"expected the ports of {agents} vehicles to be apart from others"
                    )


class Scenario(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All settings of a run; runs with equal scenarios have equal logs."""

    name: Annotated[str, Meta(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
    """Name of the scenario; without it the file's name."""
    agents: Annotated[int, Meta(ge=1, le=254)] = 8
    """Number of UAVs."""
    run: RunConfig = RunConfig()
    """Duration, seed and records."""
    formation: FormationConfig = FormationConfig()
    """Places of the formation and its motion."""
    site: Site = Site()
    """Geographic origin."""
    environment: EnvironmentConfig = EnvironmentConfig()
    """Air density and ground effect."""
    wind: WindConfig = WindConfig()
    """Wind, turbulence and gusts."""
    faults: tuple[AnyFault, ...] = ()
    """Faults by time: tables ``[[faults]]``."""
    sensors: SensorsConfig = SensorsConfig()
    """Error models of the sensors, and sensors in addition."""
    vehicle: VehicleTable = VehicleTable()
    """Airframes of the vehicles."""
    autopilot: AutopilotConfig = AutopilotConfig()
    """Parameters, geofence, mission and PX4."""
    links: LinksConfig = LinksConfig()
    """Addresses of the MAVLink links."""
    logging: LoggingConfig = LoggingConfig()
    """ULog and tlog files."""
    onboard: OnboardConfig = OnboardConfig()
    """The on-board application."""
    radio: RadioConfig = RadioConfig()
    """The 802.11 channel."""
    antenna: AntennaConfig = AntennaConfig()
    """Elements, feeds and solver of the antenna."""
    ports: PortsConfig = PortsConfig()
    """TCP and UDP ports."""
    network: NetworkTable = NetworkTable()
    """Network namespaces of the vehicles."""
    programs: tuple[VehicleProgram, ...] = ()
    """Unmodified programs on the vehicles: tables ``[[programs]]``."""
    stations: GroundStations = ()
    """Ground stations on the channel: tables ``[[stations]]``."""
    serial_radio: SerialRadioConfig = SerialRadioConfig()
    """Serial modems of the vehicles and their ground station, with ``links.telemetry = "serial-radio"``."""
    uwb: UwbConfig = UwbConfig()
    """Ranging radios of the vehicles, with ``onboard.ranging_radio = "uwb"``."""

    def __post_init__(self) -> None:
        """Check what no single field can."""
        autopilot_settings.check(self.autopilot, self.site, self.agents)
        airframe_choice.check(self.vehicle, self.autopilot, self.agents)
        if self.onboard.loop_period_us % self.run.step_us:
            raise ValueError(
                f"onboard.loop_period_ms: {self.onboard.loop_period_ms} ms is no whole number of steps; "
                f"expected a multiple of {self.run.step_us / 1e3:g}"
            )
        for number, program in enumerate(self.onboard.programs):
            wrong = [uav for uav in program.uavs if uav >= self.agents] if program.uavs != "all" else []
            if wrong:
                raise ValueError(
                    f"onboard.programs[{number}].uavs: there is no UAV {wrong[0]} among {self.agents}"
                )
        if self.onboard.wind_feed_forward:
            self._check_wind()
        for number, fault in enumerate(self.faults):
            check(fault, self.rotors(), path=f"faults[{number}]", other_compasses=self.ardupilots)
        world_checks.check_sensors(self.sensors.extra, self.agents)
        ground_stations.check(
            self.stations,
            radio=self.radio,
            links=self.links,
            onboard=self.onboard,
            autopilot=self.autopilot,
            agents=self.agents,
        )
        if self.links.telemetry == "serial-radio":
            make_timing(self.serial_radio, channel_count(self.serial_radio))
        try:
            radio_settings.check(self.channel, self.agents)
        except ValueError as error:
            raise ValueError(f"radio.{error}") from None
        if self.uwb_radios is not None:
            try:
                uwb_frames.check(self.uwb)
                uwb_access.check_stations(self.uwb, self.agents + len(self.channel.guests))
            except ValueError as error:
                raise ValueError(f"uwb.{error}") from None
        session_s = (2**self.radio.ftm.bursts_exponent - 1) * self.radio.ftm.burst_period_ms * 1e-3
        by_ftm = self.onboard.localisation == "ftm" and self.uwb_radios is None
        if by_ftm and session_s > LONGEST_SESSION_S:
            raise ValueError(
                f"radio.ftm.bursts_exponent: sessions of {session_s:g} s; the application stores the "
                f"vehicle's positions of {REMEMBERED_S:g} s, of which beacons take some: "
                f"at most {LONGEST_SESSION_S:g} s"
            )
        places_ned_m = self.places_ned_m()
        airframe_choice.check_spacing(self.airframes(), places_ned_m)
        if self.formation.motion is not None:
            try:
                formation_plan.check(places_ned_m, self.formation.motion)
            except ValueError as error:
                raise ValueError(f"formation.motion.{error}") from None
        self.ports.check(self.agents, max(1, len(self.ground_stations)))
        vehicle_programs.check(self.programs, self.agents)
        if self.has_network and self.ports.radio_link != "unix":
            raise ValueError(
                "ports.radio_link: network namespaces reach the emulator by its Unix socket; expected unix"
            )

    def _check_wind(self) -> None:
        """Check that only one part of a vehicle compensates the wind."""
        for instance in range(self.agents):
            if self.autopilot.is_px4(instance):
                continue
            if self.autopilot.is_external(instance):
                raise ValueError(
                    "onboard.wind_feed_forward: ArduPilot takes accelerations as those of the path; expected "
                    "false or none beside it"
                )
            if self.autopilot.for_uav(instance).params.get("CF_DOB_EN"):
                raise ValueError(
                    f"onboard.wind_feed_forward: the autopilot of UAV {instance} already compensates "
                    "the wind; expected CF_DOB_EN to be 0"
                )

    def places_ned_m(self) -> NDArray[np.float64]:
        """Return the places (agents, 3) of the formation before it moves, in the site's NED frame."""
        return formation_shape.places_ned_m(self.formation, self.agents, self.antenna.wavelength_m)

    def companion_port(self, instance: int) -> int:
        """Return the port of a vehicle's companion; 0: none, because another process uses that port."""
        p, links = self.ports, self.links
        port = p.companion_remote_udp + instance if p.companion_remote_udp else 0
        of_stations = range(p.gcs_remote_udp, p.gcs_remote_udp + max(1, len(self.ground_stations)))
        if port in of_stations and links.companion_host == links.ground_station_host:
            return 0
        own = ((p.gcs_local_udp, self.ground_ports), (p.companion_local_udp, self.agents))
        is_own = any(base and base <= port < base + count for base, count in own)
        return 0 if is_own and IPv4Address(links.companion_host).is_loopback else port

    def airframes(self) -> tuple[Airframe, ...]:
        """Return the airframe of each vehicle."""
        return tuple(self.vehicle.airframe_of(i) for i in range(self.agents))

    def rotors(self) -> tuple[int, ...]:
        """Return the number of rotors of each vehicle."""
        return tuple(len(airframe.rotors) for airframe in self.airframes())

    @property
    def most_rotors(self) -> int:
        """Greatest number of rotors of a vehicle: that of the rotor speeds in records."""
        return max(self.rotors())

    def plan(self) -> FormationPlan:
        """Return the plan of the formation's motion."""
        return FormationPlan(self.places_ned_m(), self.formation.heading_deg, self.formation.motion)

    def vehicle_ports(self, instance: int) -> VehiclePorts:
        """Return the ports of vehicle ``instance``, without the radio's endpoint."""
        p = self.ports
        return VehiclePorts(
            host=p.host,
            simulator_tcp=p.simulator_tcp + instance if p.simulator_tcp else 0,
            gcs_local_udp=p.gcs_local_udp + instance if p.gcs_local_udp else 0,
            gcs_remote_udp=p.gcs_remote_udp,
            companion_local_udp=p.companion_local_udp + instance if p.companion_local_udp else 0,
            companion_remote_udp=self.companion_port(instance),
            radio_endpoint=None,
        )

    def vehicle_config(
        self, instance: int, *, run_id: str, radio_endpoint: RadioEndpoint | None, log_path: str | None
    ) -> VehicleConfig:
        """Return the settings of vehicle ``instance``."""
        return VehicleConfig(
            run_id=run_id,
            instance=instance,
            seed=self.run.seed,
            step_us=self.run.step_us,
            epoch_unix_us=self.run.epoch_unix_us,
            site=self.site,
            airframe=self.vehicle.airframe_of(instance),
            ports=msgspec.structs.replace(self.vehicle_ports(instance), radio_endpoint=radio_endpoint),
            autopilot=self.autopilot.for_uav(instance),
            links=self.links,
            logging=self.logging,
            onboard=self.onboard,
            devices=Devices(
                gps_delay_s=self.sensors.gps_model().delay_s,
                ftm_trip_std_m=self.round_trip_std_m,
            ),
            ground_stations=ground_stations.numbers(self.ground_stations, self.radio, self.agents),
            serial_modem=self.links.telemetry == "serial-radio",
            places_ned_m=tuple((float(n), float(e), float(d)) for n, e, d in self.places_ned_m()),
            heading_deg=self.formation.heading_deg,
            motion=self.formation.motion,
            log_path=log_path,
            call_limit_s=self.run.silence_limit_s,
            record_period_us=self.record_period_us,
        )

    @property
    def ground_stations(self) -> tuple[GroundStation, ...]:
        """Ground stations that the vehicles reach by radio or serial modem; none with telemetry by wire."""
        if self.links.telemetry == "serial-radio":
            return self.stations[:1]
        return self.stations if self.links.telemetry == "radio" else ()

    @property
    def serial_pairs(self) -> SerialPairsConfig | None:
        """Pairs of serial modems, one for each vehicle; None without any."""
        if self.links.telemetry != "serial-radio":
            return None
        (number,) = ground_stations.numbers(self.ground_stations, self.radio, self.agents).values()
        return SerialPairsConfig(settings=self.serial_radio, ground_station=number)

    @property
    def uwb_radios(self) -> UwbConfig | None:
        """Settings of the UWB radios that measure the distances; None: the 802.11 radios measure them."""
        return self.uwb if self.onboard.ranging_radio == "uwb" else None

    @property
    def round_trip_std_m(self) -> float:
        """Standard deviation of a distance from one round trip, or one UWB exchange, at high SNR."""
        if self.uwb_radios is not None:
            return distance_std_m(self.uwb)
        return distance_m(round_trip_std_ps(self.radio.ftm, self.radio.bandwidth_mhz))

    @property
    def round_trips(self) -> int:
        """Number of round trips whose mean a distance is, without losses."""
        if self.uwb_radios is not None:
            return 1
        return max(self.radio.ftm.ftms_per_burst - 1, 1) << self.radio.ftm.bursts_exponent

    @property
    def ground_ports(self) -> int:
        """Number of local UDP ports of the ground links, from ``ports.gcs_local_udp`` on."""
        return self.agents * max(1, len(self.ground_stations))

    @property
    def channel(self) -> RadioConfig:
        """Settings of the 802.11 channel: `radio` with the ground stations as the last guests."""
        return ground_stations.channel(self.radio, self.ground_stations, self.agents)

    @property
    def has_network(self) -> bool:
        """Whether the vehicles have network namespaces."""
        return self.network.enabled or bool(self.programs)

    @property
    def ardupilots(self) -> tuple[int, ...]:
        """Vehicles that an ArduPilot flies."""
        return tuple(i for i in range(self.agents) if self.autopilot.kind_of(i) == "ardupilot")

    @property
    def forms(self) -> bool:
        """Whether the applications reach their aim by themselves; otherwise no run waits for it."""
        return not self.onboard.hold and bool(layout_of(self.onboard).formed)

    @property
    def record_period_us(self) -> int:
        """Period of the flight log, a whole number of steps."""
        steps = max(1, round(1e6 / self.run.record_rate_hz / self.run.step_us))
        return steps * self.run.step_us


LONGEST_SESSION_S = REMEMBERED_S - SESSION_S
"""Longest time from the first to the last burst of a ranging session; the rest is for queue and beacons."""
