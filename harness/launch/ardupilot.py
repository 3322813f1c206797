"""Vehicles flown by ArduPilot: checks of the scenario, and the command and parameters of an ArduPilot.

``autopilot.ardupilot_command`` may contain

    {program}     ``autopilot.ardupilot_program``, as an absolute path
    {i}           the instance number, the vehicle's number; {sysid} its MAVLink system
    {work}        the vehicle's working folder in the run folder
    {parameters}  the file of its parameters
    {home}        the site: latitude, longitude, altitude and heading
    {host}        the simulator's address, {simulator} its UDP and TCP port for this vehicle
    {gcs_remote} {companion_remote}    UDP ports to which its MAVLink links are sent

Parameters are ArduPilot's defaults, those of `parameters`, and the scenario's, in this order.
"""

import math
import os
from pathlib import Path

from autopilot.commander.battery import BatteryParams
from autopilot.estimation.atmosphere import GRAVITY_M_S2
from autopilot.parameters.config import AutopilotConfig
from foundation.airframe.description import Airframe
from foundation.airframe.files import IRIS
from harness.launch.external_process import AutopilotError, ExternalProcessConfig
from harness.scenario.scenario import Scenario
from harness.simulator.ardupilot_json import PWM_MAX_US, PWM_MIN_US
from harness.world.sensors.config import PROFILES

LOOP_RATES_HZ = (50, 400)
"""Range of SCHED_LOOP_RATE."""
SPIN_ARM, SPIN_MIN, SPIN_MAX = 0.1, 0.15, 0.95
"""ArduPilot's defaults of MOT_SPIN_ARM, MOT_SPIN_MIN and MOT_SPIN_MAX, as controls 0..1."""
COMPASS_OFFSETS = (("X", 5.0), ("Y", 13.0), ("Z", -18.0))
"""Of ArduPilot's simulated compasses, in mGauss (SIM_MAG1_OFS): with them the compasses are calibrated."""
PULSES_US = {"MOT_PWM_MIN": PWM_MIN_US, "MOT_PWM_MAX": PWM_MAX_US}
"""Pulses of motors, as the simulator reads them."""
_MS_PER_S = 1e3
_GPS_MAVLINK = 14
_QUAD, _X = 1, 1
_VOLTAGE_AND_CURRENT = 4
_KEEP_HEADING = 0


def check_start(scenario: Scenario) -> None:
    """Check ArduPilot's program and the settings before anything starts. Raises AutopilotError."""
    if not scenario.ardupilots:
        return
    program = _program(scenario.autopilot)
    if not (program.is_file() and os.access(program, os.X_OK)):
        raise AutopilotError(
            f"autopilot.ardupilot_program: there is no program {program}; expected ArduPilot's SITL program "
            "for copters, build/sitl/bin/arducopter"
        )
    for vehicle in scenario.ardupilots:
        given = scenario.autopilot.external_params(vehicle)
        for name, pulse_us in PULSES_US.items():
            if given.get(name, pulse_us) != pulse_us:
                raise AutopilotError(f"autopilot.params.{name}: expected {pulse_us} as in the simulator")
    if not scenario.onboard.enabled:
        return
    for vehicle in scenario.ardupilots:
        if not scenario.companion_port(vehicle):
            raise AutopilotError(
                f"ports.companion_remote_udp: the application of UAV {vehicle}, beside an ArduPilot, has no "
                "port, as another process uses that number; expected a range of free ones, such as 30000"
            )
    if scenario.onboard.localisation == "truth":
        raise AutopilotError(
            "onboard.localisation: 'truth' is sent over the simulator's link, which ArduPilot does not have"
        )


def process_config(
    scenario: Scenario, instance: int, *, run_folder: Path, simulator_port: int
) -> ExternalProcessConfig:
    """Return how a vehicle's ArduPilot is started; writes its parameters to its folder. Raises OSError."""
    config, ports, site = scenario.autopilot, scenario.vehicle_ports(instance), scenario.site
    work = (run_folder / "ardupilot" / f"uav-{instance}").absolute()
    work.mkdir(parents=True)
    file = work / "coflight.parm"
    given = parameters(scenario) | config.external_params(instance)
    file.write_text("".join(f"{name} {value:.9g}\n" for name, value in given.items()), encoding="ascii")
    values: dict[str, object] = {
        "program": _program(config),
        "i": instance,
        "sysid": instance + 1,
        "work": work,
        "parameters": file,
        "home": f"{site.latitude_deg:.9f},{site.longitude_deg:.9f},{site.altitude_m:.3f},"
        f"{scenario.formation.heading_deg % 360.0:g}",
        "host": ports.host,
        "simulator": simulator_port,
        "gcs_remote": ports.gcs_remote_udp,
        "companion_remote": ports.companion_remote_udp,
    }
    return ExternalProcessConfig(
        name=f"uav {instance}",
        command=tuple(part.format_map(values) for part in config.ardupilot_command),
        environment={},
        folder=str(work),
    )


def parameters(scenario: Scenario) -> dict[str, float]:
    """Return the parameters that follow from simulator, vehicle and sensors."""
    profile = PROFILES[scenario.sensors.profile]
    mag_std_gauss = profile.mag_gauss.at_interval(1.0 / profile.mag_rate_hz).white_std
    return {
        "FRAME_CLASS": _QUAD,
        "FRAME_TYPE": _X,
        **PULSES_US,
        **thrust_curve(IRIS),
        "SCHED_LOOP_RATE": min(max(round(5e5 / scenario.run.step_us), LOOP_RATES_HZ[0]), LOOP_RATES_HZ[1]),
        "GPS1_TYPE": _GPS_MAVLINK,
        "GPS1_DELAY_MS": scenario.sensors.gps_model().delay_s * _MS_PER_S,
        "SIM_BARO_RND": 0,
        "SIM_MAG_RND": mag_std_gauss * math.sqrt(3.0) * 1e3,
        **{f"COMPASS_OFS{n}_{axis}": offset for n in ("", "2", "3") for axis, offset in COMPASS_OFFSETS},
        "WP_YAW_BEHAVIOR": _KEEP_HEADING,
        "BATT_MONITOR": _VOLTAGE_AND_CURRENT,
        "BATT_CAPACITY": BatteryParams().capacity_mah,
    }


def thrust_curve(airframe: Airframe) -> dict[str, float]:
    """Return MOT_THST_EXPO and MOT_THST_HOVER of a vehicle.

    A control u turns a rotor at w0 + w1 u, and thrust is proportional to the square of the speed. Over the
    controls that ArduPilot uses, u = u0 + r (u1 - u0) with r in 0..1, the thrust above that at u0, divided by
    its range, is (1 - e) r + e r^2 with

        e = a / (a + b),   a = (w1 (u1 - u0))^2,   b = 2 (w0 + w1 u0) w1 (u1 - u0).
    """
    unit = airframe.propulsion
    span_rad_s = unit.range_rad_s * (SPIN_MAX - SPIN_MIN)
    least_rad_s = unit.idle_rad_s + unit.range_rad_s * SPIN_MIN
    square, linear = span_rad_s**2, 2.0 * least_rad_s * span_rad_s
    hover_rad_s2 = airframe.mass_kg * GRAVITY_M_S2 / (len(airframe.rotors) * unit.thrust_n_s2)
    return {
        "MOT_SPIN_ARM": SPIN_ARM,
        "MOT_SPIN_MIN": SPIN_MIN,
        "MOT_SPIN_MAX": SPIN_MAX,
        "MOT_THST_EXPO": round(square / (square + linear), 4),
        "MOT_THST_HOVER": round((hover_rad_s2 - least_rad_s**2) / (square + linear), 4),
    }


def _program(config: AutopilotConfig) -> Path:
    return Path(config.ardupilot_program or "").expanduser().absolute()
