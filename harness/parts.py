"""Parts of the physics server's process, for `foundation.profiling.profiler`: which modules are what."""

from foundation.profiling.profiler import LINK

PARTS = {
    "harness.physics": "physics",
    "harness.wind": "wind",
    "harness.sensors": "sensors",
    "harness.faults": "sensors",
    "harness.esc": "sensors",
    "harness.hil": "link codec",
    "harness.hil_frames": "link codec",
    "autopilot.mavlink": "link codec",
    "harness.lockstep": LINK,
    "harness.patience": LINK,
    "harness.air": "radio",
    "netsim": "radio",
    "harness.recording": "records",
    "foundation.records.record_log": "records",
    "harness.simulation": "the step around them",
    "harness.physics_server": "the step around them",
}
