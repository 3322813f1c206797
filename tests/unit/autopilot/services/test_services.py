"""The interface of a MAVLink service: a minimal one is served beside the built-in ones."""

from pymavlink.dialects.v20 import common

from autopilot.services.service import GROUND_STATION, NEVER_US, Partner, Services, reply

STATION = Partner(GROUND_STATION, 0)
PERIOD_US = 100_000


class Countdown:
    """Answers DEBUG with three messages in 100 ms intervals."""

    takes = frozenset({common.MAVLINK_MSG_ID_DEBUG})

    def __init__(self):
        self._partner, self._due_us, self._left = STATION, NEVER_US, 0

    def on_message(self, message, now_us, partner):
        self._partner, self._due_us, self._left = partner, now_us + PERIOD_US, 2
        return reply(partner, message)

    def on_timer(self, now_us):
        self._left -= 1
        self._due_us = now_us + PERIOD_US if self._left else NEVER_US
        return reply(self._partner, common.MAVLink_debug_message(0, 0, float(self._left)))

    def next_deadline_us(self):
        return self._due_us


def test_another_service_gets_its_messages_and_its_deadlines():
    services = Services((Countdown(),))
    services.on_timer(0)
    assert services.deadline_us == NEVER_US
    assert services.on_message(common.MAVLink_heartbeat_message(0, 0, 0, 0, 0, 3), 0, STATION) == []
    answers = services.on_message(common.MAVLink_debug_message(0, 0, 2.0), 1_000, STATION)
    while services.deadline_us < NEVER_US:
        answers += services.on_timer(services.deadline_us)
    assert [(each.partner, each.message.value) for each in answers] == [
        (STATION, 2.0), (STATION, 1.0), (STATION, 0.0)
    ]  # fmt: skip
