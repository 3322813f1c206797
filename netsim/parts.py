"""Parts of the 802.11 emulator's process, for `foundation.profiling.profiler`: which modules are what."""

from foundation.profiling.profiler import LINK

PARTS = {
    "netsim.phy": "physical layer",
    "netsim.mac": "medium access",
    "netsim.ftm": "ranging",
    "netsim.emulator": "events",
    "netsim.kernel": "events",
    "netsim.events": "events",
    "netsim.tables": "events",
    "netsim.channels": "events",
    "netsim.ideal": "events",
    "netsim.wire": "batches",
    "netsim.hosted": "batches",
    "netsim.logs": "records",
    "netsim.records": "records",
    "foundation.records.record_log": "records",
    "netsim.capture": "records",
    "netsim.clock_line": LINK,
    "netsim.transport": LINK,
    "netsim.server": LINK,
}
