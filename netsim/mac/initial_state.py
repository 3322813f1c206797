"""Initial state of the tables of `netsim.model.tables`: settings, modes, idle stations."""

from collections.abc import Sequence
from typing import get_args

from netsim.mac.access_parameters import AccessParameters
from netsim.model import columns as c
from netsim.model import tables as t
from netsim.model.config import Mode, RadioConfig
from netsim.model.event_queue import NEVER_NS
from netsim.model.tables import Air, Tables
from netsim.phy.errors import error_model
from netsim.phy.medium import PREAMBLE_SINR
from netsim.phy.modes import PhyMode, phy_mode, response_mode
from netsim.phy.propagation import thermal_noise_mw

MODE_NAMES: list[Mode] = list(get_args(Mode))
"""Mode names in the order of the rows of ``modes``."""


class ModeRows(dict[PhyMode, int]):
    """Row numbers of modes in ``tables``; a row is filled at the first access to its mode."""

    def __init__(self, tables: Tables) -> None:
        self.tables = tables

    def __missing__(self, mode: PhyMode) -> int:
        """Fill the rows of a mode and of the mode of its responses."""
        row = self[mode] = MODE_NAMES.index(mode.name)
        errors, tables = error_model(mode), self.tables
        columns = [c.PREAMBLE, c.BITS_PER_SYMBOL, c.VHT, c.HAZARDS]
        tables.modes[row, columns] = (
            mode.preamble_ns, mode.bits_per_symbol, mode.vht, len(errors.log_hazards),
        )  # fmt: skip
        tables.hazards[row, 0] = errors.clean_linear
        tables.hazards[row, 1 : 1 + len(errors.log_hazards)] = errors.log_hazards
        tables.modes[row, c.RESPONSE_MODE] = self[response_mode(mode)]
        return row


def silent_air(
    config: RadioConfig, *, stations: int, queues: Sequence[AccessParameters], observed: bool
) -> tuple[Air, ModeRows]:
    """Return tables of stations with these queues each; ``observed``: report the end of every frame."""
    air = t.new_air(stations=stations, categories=len(queues))
    tables = t.tables_of(air)
    modes = ModeRows(tables)
    noise_mw = thermal_noise_mw(config.bandwidth_mhz, config.noise_figure_db)
    preamble_mw = max(10.0 ** (config.cca_preamble_dbm / 10.0), PREAMBLE_SINR * noise_mw)
    energy_mw = 10.0 ** (config.cca_energy_dbm / 10.0)
    tables.levels_mw[0, [c.NOISE_MW, c.ENERGY_MW, c.PREAMBLE_MW]] = noise_mw, energy_mw, preamble_mw
    tables.levels_mw[0, c.SENSED_MW] = min(energy_mw, preamble_mw)
    air[c.QUEUE_FRAMES] = config.queue_frames
    air[c.CONTROL_MODE] = modes[phy_mode(config.control_mode, config.bandwidth_mhz)]
    air[c.OBSERVED] = observed
    air[c.DRAWS_LOW] = 1
    air[c.DUE] = c.NOTHING
    rows = tables.stations
    rows[:, [c.SENDING_FROM, c.SENDING_UNTIL, c.LOCKED]] = -1
    rows[:, [c.LOCK, c.RESERVED_BY, c.CURRENT]] = c.NOTHING
    rows[:, [c.BACKOFFS, c.RECEPTIONS]] = c.BLOCK_DRAWS
    rows = tables.queues
    rows[:, [c.FIRST, c.LAST]] = c.NOTHING
    rows[:, [c.BASE, c.ACCESS_AT, c.DEADLINE_AT]] = NEVER_NS
    for k, each in enumerate(queues):
        columns = [c.AIFS, c.WINDOW, c.WINDOW_LEAST, c.WINDOW_MOST, c.TXOP, c.SLOT_OFFSET]
        rows[k :: len(queues), columns] = (
            each.aifs_ns, each.cw_min, each.cw_min, each.cw_max, each.txop_ns, each.edca,
        )  # fmt: skip
    tables.last_received_ns[...] = -NEVER_NS
    tables.budgets[:, c.BUDGET_UNTIL] = -1
    return air, modes
