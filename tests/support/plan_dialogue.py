"""Messages of one station to a `PlanTransfer`, and the answers."""

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import stamp
from autopilot.mavlink.dialect import MissionAck, MissionCount
from autopilot.navigation.plan_store import NOTHING, PlanStore, PlanType
from autopilot.services.plan_transfer import PlanTransfer
from autopilot.services.plan_wire import encode_item
from autopilot.services.service import ALL, Partner

MISSION, FENCE, RALLY = PlanType
ME, OTHER = Partner(0, 3), Partner(1, 3)
V = (1, 1)
ACCEPTED, ERROR = common.MAV_MISSION_ACCEPTED, common.MAV_MISSION_ERROR
CANCELLED, UNSUPPORTED = common.MAV_MISSION_OPERATION_CANCELLED, common.MAV_MISSION_UNSUPPORTED
INVALID_SEQUENCE = common.MAV_MISSION_INVALID_SEQUENCE
TO_ALL_TYPES = common.MAV_MISSION_TYPE_ALL


def machine(*, make=lambda _kind, _items: NOTHING, current=lambda: 0, **plans):
    store = PlanStore()
    for name, items in plans.items():
        store.put(PlanType[name.upper()], items)
    return store, PlanTransfer(store, make=make, system=1, current=current)


def count(number, kind=MISSION):
    return MissionCount(*V, number, int(kind))


def item(plan, seq, kind=MISSION, *, current=False, in_integers=True):
    return encode_item(plan[seq], kind=kind, seq=seq, current=current, target=V, in_integers=in_integers)


def request(seq, kind=MISSION):
    return common.MAVLink_mission_request_int_message(*V, seq, int(kind))


def request_list(kind=MISSION):
    return common.MAVLink_mission_request_list_message(*V, int(kind))


def clear(kind):
    return common.MAVLink_mission_clear_all_message(*V, int(kind))


def ack(result, kind=MISSION):
    return MissionAck(*V, result, int(kind))


def send(service, message, now_us=0, partner=ME):
    """Answers to a message, after checks that they are to its sender or to all."""
    answers = service.on_message(stamp(message, system=255, component=190), now_us, partner)
    assert all(to in {partner, ALL} for to, _ in answers)
    assert sum(to == partner for to, _ in answers) <= 1
    for to, answer in answers:
        if to == partner:
            assert (answer.target_system, answer.target_component) == (255, 190)
    return [answer for _, answer in answers]


def results(messages):
    return [message.type for message in messages if message.get_type() == "MISSION_ACK"]


def requested(messages):
    return [message.seq for message in messages if message.get_type().startswith("MISSION_REQUEST")]


def write(service, plan, kind=MISSION, *, now_us=0, partner=ME):
    """Write a plan, with immediate answers; return the last ones."""
    answers = send(service, count(len(plan), kind), now_us, partner)
    for seq in range(len(plan)):
        assert requested(answers) == [seq]
        answers = send(service, item(plan, seq, kind), now_us, partner)
    return answers


def run_timers(service, until_us):
    """Messages sent by timers, with times."""
    sent = []
    while (now_us := service.next_deadline_us()) <= until_us:
        sent += [(now_us, message) for _, message in service.on_timer(now_us)]
    return sent
