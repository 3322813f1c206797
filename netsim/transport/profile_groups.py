"""Profile groups of the 802.11 emulator's modules, for `foundation.profiling.profiler`."""

from foundation.profiling.profiler import LINK

PROFILE_GROUPS = {
    "netsim.phy": "physical layer",
    "netsim.mac": "medium access",
    "netsim.ftm": "ranging",
    "netsim.emulator.emulator": "events",
    "netsim.model.event_queue": "events",
    "netsim.model.events": "events",
    "netsim.model.tables": "events",
    "netsim.emulator.arrivals": "events",
    "netsim.emulator.packets": "events",
    "netsim.emulator.ideal_channel": "events",
    "netsim.wire": "batches",
    "netsim.emulator.service": "batches",
    "netsim.emulator.log_layout": "records",
    "netsim.emulator.records": "records",
    "foundation.records.record_log": "records",
    "netsim.capture": "records",
    "foundation.processes.message_stream": LINK,
    "netsim.transport.zenoh_session": LINK,
    "netsim.transport.packet_exchange": LINK,
    "netsim.transport.packet_pace": LINK,
    "netsim.transport.server": LINK,
}
