"""Users of the radio, their passwords and files."""

import stat

import msgspec
import pytest

from foundation.records.private_files import write_private
from netsim.model.config import GuestConfig, RadioConfig, RadioPasswords, ServerConfig
from netsim.transport.access_control import Rights, User, access_control, dictionary
from netsim.transport.guest_access import FILE, read_guest_access, write_guest_access
from netsim.transport.radio_users import new_passwords, packets_user, rights

GUESTS = tuple(GuestConfig(name=name, pos_ned_m=(0.0, 0.0, 0.0)) for name in ("ground", "car"))


PASSWORDS = RadioPasswords(vehicles="v", guests=("g", "c"))


def config(passwords=PASSWORDS):
    return ServerConfig(run_id="r", stations=8, seed=1, radio=RadioConfig(guests=GUESTS), passwords=passwords)


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


def test_each_guest_has_its_own_user_with_the_keys_of_its_station():
    vehicles, ground, car = rights(config())
    assert vehicles == Rights(User("vehicles", "v"), shares=("coflight/r/radio/**",))
    assert ground == Rights(
        User("guest-8", "g"),
        asks=("coflight/r/radio/tx/8", "coflight/r/radio/directory"),
        served=("coflight/r/radio/tx/8", "coflight/r/radio/directory"),
        serves=("coflight/r/radio/rx/8",),
    )
    assert car.serves == ("coflight/r/radio/rx/9",)


def test_no_guest_may_publish_or_subscribe():
    given = access_control(rights(config()))
    assert given["default_permission"] == "deny"
    for policy in given["policies"]:
        (name,) = policy["subjects"]
        messages = {
            message
            for rule in given["rules"]
            if rule["id"] in policy["rules"]
            for message in rule["messages"]
        }
        assert ({"put", "declare_subscriber"} <= messages) is (name == "vehicles")
    assert {rule["permission"] for rule in given["rules"]} == {"allow"}
    assert len({rule["id"] for rule in given["rules"]}) == len(given["rules"])
    assert dictionary(rights(config())) == "vehicles:v\nguest-8:g\nguest-9:c\n"


def test_the_host_of_interfaces_may_publish_and_receive_packets_and_nothing_else():
    passwords = msgspec.structs.replace(PASSWORDS, packets="p")
    one = msgspec.structs.replace(config(passwords), packets=True)
    *others, interfaces = rights(one)
    assert others == rights(config())
    assert interfaces == Rights(
        packets_user("p"),
        publishes=("coflight/r/radio/packets/tx",),
        subscribes=("coflight/r/radio/packets/rx",),
    )
    rules = access_control([interfaces])["rules"]
    assert {(*each["flows"], *each["messages"], *each["key_exprs"]) for each in rules} == {
        ("ingress", "put", "coflight/r/radio/packets/tx"),
        ("egress", "declare_subscriber", "coflight/r/radio/packets/tx"),
        ("ingress", "declare_subscriber", "coflight/r/radio/packets/rx"),
        ("egress", "put", "coflight/r/radio/packets/rx"),
    }
    assert rights(config(passwords)) == rights(config())  # no user without packets
    with pytest.raises(ValueError, match="passwords: expected one for the host of network interfaces"):
        rights(msgspec.structs.replace(one, passwords=PASSWORDS))


def test_passwords_are_different_in_each_run_and_for_each_user():
    first, second = new_passwords(2), new_passwords(2)
    assert len({first.vehicles, *first.guests, second.vehicles, *second.guests}) == 6
    assert all(len(password) == 32 for password in (first.vehicles, *first.guests))
    assert first.packets is None
    with_packets = new_passwords(0, packets=True)
    assert len(with_packets.packets) == 32
    assert with_packets.packets != with_packets.vehicles


@pytest.mark.parametrize("passwords", [None, RadioPasswords(vehicles="v", guests=("g",))])
def test_a_router_without_a_password_for_each_user_is_refused(passwords):
    with pytest.raises(ValueError, match="passwords: expected one for the vehicles and 2 for guests"):
        rights(config(passwords))


def test_the_guests_file_is_private_and_has_no_password_of_the_vehicles(tmp_path):
    path = tmp_path / FILE
    path.write_text("of an earlier run")
    path.chmod(0o644)
    with path.open() as opened:
        write_guest_access(path, config(), "tcp/127.0.0.1:7447")
        assert opened.read() == "of an earlier run"  # a reader has the old file or the new one
    assert [each.name for each in tmp_path.iterdir()] == [FILE]
    assert mode(path) == 0o600
    assert msgspec.json.decode(path.read_bytes()) == {
        "endpoint": "tcp/127.0.0.1:7447",
        "run_id": "r",
        "guests": {
            "ground": {"station": 8, "user": "guest-8", "password": "g"},
            "car": {"station": 9, "user": "guest-9", "password": "c"},
        },
    }
    assert read_guest_access(tmp_path) == read_guest_access(str(path))


def test_a_private_file_is_replaced(tmp_path):
    path = tmp_path / "secret"
    write_private(path, b"one")
    write_private(path, b"2")
    assert (mode(path), path.read_bytes()) == (0o600, b"2")
