"""Groups of modules of a vehicle's process, for `foundation.profiling.profiler`."""

from foundation.profiling.profiler import LINK

RADIO = "radio"

PROFILE_GROUPS = {
    "autopilot.mavlink.hil": "link codec",
    "autopilot.estimation": "estimator",
    "autopilot.vehicle.fast_step": "inertial steps",
    "autopilot.control": "control",
    "autopilot.commander": "commander and modes",
    "autopilot.vehicle.monitor": "commander and modes",
    "autopilot.navigation": "commander and modes",
    "autopilot.vehicle.pilot": "commander and modes",
    "autopilot.onboard": "on-board application",
    "autopilot.mavlink": "MAVLink services",
    "autopilot.services": "MAVLink services",
    "autopilot.vehicle.messaging": "MAVLink services",
    "netsim.transport.lockstep_radio": RADIO,
    "netsim.transport.zenoh_session": RADIO,
    "netsim.wire": RADIO,
    "autopilot.logs.vehicle_record": "records",
    "foundation.records.record_log": "records",
    "autopilot.vehicle.vehicle": "the step around them",
    "autopilot.vehicle.host": "the step around them",
    "autopilot.__main__": LINK,
}
