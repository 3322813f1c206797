"""Parts of the physics server's process, for `foundation.profiling.profiler`: which modules are what."""

from foundation.profiling.profiler import LINK

PROFILE_GROUPS = {
    "harness.world.physics": "physics",
    "harness.world.wind": "wind",
    "harness.world.sensors": "sensors",
    "harness.world.faults": "sensors",
    "harness.world.esc": "sensors",
    "harness.simulator.hil": "link codec",
    "harness.simulator.hil_frames": "link codec",
    "autopilot.mavlink": "link codec",
    "harness.simulator.lockstep": LINK,
    "harness.simulator.response_watchdog": LINK,
    "harness.simulator.application_links": LINK,
    "foundation.processes.message_stream": "radio",
    "harness.simulator.emulator_client": "radio",
    "netsim": "radio",
    "harness.simulator.truth_record": "records",
    "foundation.records.record_log": "records",
    "harness.simulator.simulation": "the step around them",
    "harness.simulator.server": "the step around them",
}
