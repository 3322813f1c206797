"""Initial state of the tables of `netsim.model.tables`: settings, modes, idle stations."""

from collections.abc import Sequence

from foundation.kernels.records import Block
from netsim.mac.access_parameters import AccessParameters
from netsim.model import codes as c
from netsim.model import tables as t
from netsim.model.config import RadioConfig
from netsim.model.event_queue import NEVER_NS
from netsim.model.records import BUFFERED_DRAWS
from netsim.model.tables import Tables
from netsim.phy.errors import error_table
from netsim.phy.interfaces import ErrorModel
from netsim.phy.medium import PREAMBLE_SINR
from netsim.phy.modes import MODE_NAMES, PhyMode, response_mode
from netsim.phy.propagation import thermal_noise_mw
from netsim.phy.timing import channel_mode, timing_of


class ModeRows(dict[PhyMode, int]):
    """Row numbers of modes in ``tables``; a row is filled at the first access to its mode."""

    def __init__(self, tables: Tables, errors: ErrorModel) -> None:
        self.tables = tables
        self._errors = errors

    def __missing__(self, mode: PhyMode) -> int:
        """Fill the rows of a mode and of the mode of its responses."""
        row = self[mode] = MODE_NAMES.index(mode.name)
        errors, phy = error_table(mode, self._errors), self.tables.modes[row]
        phy.preamble_ns, phy.bits_per_symbol, phy.vht = mode.preamble_ns, mode.bits_per_symbol, mode.vht
        phy.hazard_count, phy.clean_linear = len(errors.log_hazards), errors.clean_linear
        phy.log_hazards[: len(errors.log_hazards)] = errors.log_hazards
        phy.response_mode = self[response_mode(mode)]
        return row


def silent_block(
    config: RadioConfig,
    *,
    stations: int,
    queues: Sequence[AccessParameters],
    errors: ErrorModel,
    observed: bool,
) -> tuple[Block, ModeRows]:
    """Return tables of stations with these queues each; ``observed``: report the end of every frame."""
    block = t.new_block(stations=stations, categories=len(queues))
    tables = t.tables_of(block)
    modes = ModeRows(tables, errors)
    noise_mw = thermal_noise_mw(config.bandwidth_mhz, config.noise_figure_db)
    preamble_mw = max(10.0 ** (config.cca_preamble_dbm / 10.0), PREAMBLE_SINR * noise_mw)
    energy_mw = 10.0 ** (config.cca_energy_dbm / 10.0)
    air, idle, empty = tables.air[0], tables.stations, tables.queues
    air.noise_mw, air.energy_mw, air.preamble_mw = noise_mw, energy_mw, preamble_mw
    missed_mw = max(10.0 ** (config.cca_missed_dbm / 10.0), preamble_mw)
    air.missed_mw = min(missed_mw, energy_mw)
    air.queue_frames = config.queue_frames
    timing = timing_of(config)
    air.slot_ns, air.sifs_ns, air.signal_extension_ns = (
        timing.slot_ns, timing.sifs_ns, timing.signal_extension_ns
    )  # fmt: skip
    air.eifs_extra_ns, air.response_timeout_ns = timing.eifs_extra_ns, timing.response_timeout_ns
    air.control_mode = modes[channel_mode(config, config.control_mode)]
    air.observed, air.draws_low, air.due_queue = observed, True, c.NOTHING
    for name in ("sending_from_ns", "sending_until_ns", "last_detection_ns", "budget_until_ns"):
        idle[name] = -1
    idle["locked_frame"] = idle["nav_set_by"] = idle["current_queue"] = c.NOTHING
    idle["backoffs_used"] = idle["receptions_used"] = BUFFERED_DRAWS
    empty["first_job"] = empty["last_job"] = c.NOTHING
    empty["slots_from_ns"] = empty["access_ns"] = empty["deadline_ns"] = NEVER_NS
    for k, each in enumerate(queues):
        of_category = empty[k :: len(queues)]
        of_category["window"] = of_category["window_min"] = each.cw_min
        of_category["window_max"], of_category["aifs_ns"] = each.cw_max, each.aifs_ns(timing)
        of_category["txop_ns"], of_category["slot_offset"] = each.txop_ns, each.edca
    tables.links["last_received_ns"] = -NEVER_NS
    return block, modes
