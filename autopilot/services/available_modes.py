"""AVAILABLE_MODES: the flight modes, as ground stations list them."""

from collections.abc import Sequence

from autopilot.commander.mode_table import ModeTable
from autopilot.mavlink.codec import Message
from autopilot.mavlink.dialect import AvailableModes

AVAILABLE_MODES_ID: int = AvailableModes.id

_ADVANCED, _NOT_SELECTABLE, _AUTO = 1, 2, 4
"""MAV_MODE_PROPERTY bits."""
_MAIN_AUTO = 4


def available_modes(modes: ModeTable, index: int) -> Sequence[Message]:
    """Return the mode of a 1-based index, all modes for 0, or none for an index out of range."""
    count = len(modes.offered)
    if index == 0:
        return [_describe(modes, number) for number in range(1, count + 1)]
    return [_describe(modes, index)] if 1 <= index <= count else []


def _describe(modes: ModeTable, number: int) -> Message:
    mode = modes.offered[number - 1]
    traits = modes.traits[mode]
    properties = _ADVANCED if traits.is_advanced else 0
    if mode.main == _MAIN_AUTO and not traits.by_sticks:
        properties |= _AUTO
    if not traits.is_selectable:
        properties |= _NOT_SELECTABLE
    return AvailableModes(
        number_modes=len(modes.offered), mode_index=number, standard_mode=traits.standard,
        custom_mode=mode.custom_mode, properties=properties,
        mode_name="" if traits.standard else modes.name(mode),
    )  # fmt: skip
