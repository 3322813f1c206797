"""Parts of a vehicle's process, for `foundation.profiling.profiler`: which modules are what."""

from foundation.profiling.profiler import LINK

CODEC = "link codec"
RADIO = "radio"

PARTS = {
    "autopilot.mavlink.hil": CODEC,
    "autopilot.sensors": "estimator",
    "autopilot.estimation": "estimator",
    "autopilot.inertial_step": "inertial steps",
    "autopilot.control": "control",
    "autopilot.commander": "commander and modes",
    "autopilot.monitor": "commander and modes",
    "autopilot.navigation": "commander and modes",
    "autopilot.pilot": "commander and modes",
    "autopilot.onboard": "on-board application",
    "autopilot.formation_plan": "on-board application",
    "autopilot.mavlink": "MAVLink services",
    "autopilot.protocol": "MAVLink services",
    "autopilot.messaging": "MAVLink services",
    "netsim.transport.lockstep_radio": RADIO,
    "netsim.transport.zenoh_session": RADIO,
    "netsim.wire": RADIO,
    "autopilot.recording": "records",
    "foundation.records.record_log": "records",
    "autopilot.vehicle": "the step around them",
    "autopilot.host": "the step around them",
    "autopilot.__main__": LINK,
}
