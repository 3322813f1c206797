"""Commands other than flight: messages and their rates, storage, calibration, restart."""

import math
from collections.abc import Callable, Mapping, Sequence

from pymavlink.dialects.v20 import common

from autopilot.commander.mode_table import ModeTable
from autopilot.mavlink.codec import Message
from autopilot.mavlink.dialect import ProtocolVersion
from autopilot.parameters.table import ROWS, ParameterSet
from autopilot.services.available_modes import AVAILABLE_MODES_ID, available_modes
from autopilot.services.command import (
    ACCEPTED,
    DENIED,
    IN_PROGRESS,
    REJECTED,
    UNSUPPORTED,
    Action,
    Answer,
    CommandRequest,
    whole,
)
from autopilot.services.status import status_text
from autopilot.services.streams import MessageStreams

_HEARTBEAT = common.MAVLINK_MSG_ID_HEARTBEAT
_MESSAGE_INTERVAL = common.MAVLINK_MSG_ID_MESSAGE_INTERVAL
_WRITE, _RESET, _RESET_SENSORS, _RESET_ALL = 1, 2, 3, 4
"""First parameter of MAV_CMD_PREFLIGHT_STORAGE. _RESET_ALL equals _RESET: nothing is exempt from either."""
_OF_SENSORS = ("CAL_ACC", "CAL_GYRO", "CAL_MAG")
"""Prefixes of the parameters that are reset with the sensors, as in PX4."""


class SystemCommands:
    """Actions on links and files; ``table`` holds them by MAV_CMD."""

    def __init__(
        self,
        streams: Mapping[int, MessageStreams],
        *,
        calibrate: Action,
        save_parameters: Callable[[], bool],
        parameters: ParameterSet,
        is_armed: Callable[[], bool],
        modes: ModeTable,
    ) -> None:
        """``streams`` are keyed by link number.

        ``save_parameters`` starts writing the parameter file and returns whether there is one.
        """
        self._streams = streams
        self._save_parameters = save_parameters
        self._parameters = parameters
        self._is_armed = is_armed
        self._modes = modes
        self.table: dict[int, Action] = {
            common.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_message_interval,
            common.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_message_interval,
            common.MAV_CMD_REQUEST_MESSAGE: lambda request: self._send(whole(request.params[0]), request),
            common.MAV_CMD_REQUEST_PROTOCOL_VERSION: lambda request: self._send(ProtocolVersion.id, request),
            common.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: lambda request: self._send(
                common.MAVLINK_MSG_ID_AUTOPILOT_VERSION, request
            ),
            common.MAV_CMD_REQUEST_FLIGHT_INFORMATION: lambda request: self._send(
                common.MAVLINK_MSG_ID_FLIGHT_INFORMATION, request
            ),
            common.MAV_CMD_PREFLIGHT_STORAGE: self._store,
            common.MAV_CMD_PREFLIGHT_CALIBRATION: calibrate,
            common.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: _restart,
            common.MAV_CMD_DO_SET_ACTUATOR: lambda _: Answer(),  # as PX4 without actuators
        }

    def _set_message_interval(self, request: CommandRequest) -> Answer:
        message_id, interval_us = request.params[:2]
        if not (math.isfinite(message_id) and math.isfinite(interval_us)):
            return Answer(DENIED)
        if int(message_id) == _HEARTBEAT and interval_us < 0.0:
            return Answer(DENIED)  # stations treat a vehicle without heartbeats as lost
        streams = self._streams[request.partner.link]
        accepted = streams.set_interval(int(message_id), int(interval_us), request.now_us)
        return Answer(ACCEPTED if accepted else UNSUPPORTED)

    def _get_message_interval(self, request: CommandRequest) -> Answer:
        return Answer(messages=(self._interval(request, 0),))

    def _interval(self, request: CommandRequest, at: int) -> Message:
        """MESSAGE_INTERVAL of the message whose id is the parameter at an index."""
        message_id = whole(request.params[at])
        message_id = message_id if 0 <= message_id <= 0xFFFF else 0xFFFF  # the range of its field
        interval_us = self._streams[request.partner.link].interval_us(message_id)
        return common.MAVLink_message_interval_message(message_id, min(interval_us, 2**31 - 1))

    def _send(self, message_id: int, request: CommandRequest) -> Answer:
        """Send a message on request; for two ids the second parameter selects which."""
        streams = self._streams[request.partner.link]
        messages: Sequence[Message | None]
        if message_id == AVAILABLE_MODES_ID:
            messages = available_modes(self._modes, whole(request.params[1]))
        elif message_id == _MESSAGE_INTERVAL:
            messages = (self._interval(request, 1),)
        elif streams.is_supported(message_id):
            messages = streams.form(message_id)
        else:
            return Answer(UNSUPPORTED)
        sent = tuple(message for message in messages if message is not None)
        return Answer(ACCEPTED if sent else REJECTED, sent)

    def _store(self, request: CommandRequest) -> Answer:
        """Write the parameters to their file or reset them; the file is read at the next start."""
        what = request.params[0]
        what = int(what) if math.isfinite(what) else -1
        if what == _WRITE:
            return Answer(IN_PROGRESS if self._save_parameters() else UNSUPPORTED)
        if what not in {_RESET, _RESET_SENSORS, _RESET_ALL}:
            return Answer(UNSUPPORTED)
        if self._is_armed():
            text = "Parameter reset denied: armed"
            return Answer(REJECTED, (status_text(common.MAV_SEVERITY_CRITICAL, text),))
        beginnings = _OF_SENSORS if what == _RESET_SENSORS else ("",)
        self._parameters.reset(row.name for row in ROWS if row.name.startswith(beginnings))
        return Answer()


def _restart(request: CommandRequest) -> Answer:
    """DENIED, as in PX4's simulation; a request for no action is accepted."""
    return Answer(ACCEPTED if request.params[0] == 0.0 else DENIED)
