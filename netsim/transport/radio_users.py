"""The users of a run's radio and their rights: all vehicles are one user, each guest is one of its own.

A guest queries its own transmit key and the directory, and serves its own receive key; so it can neither
receive another station's frames nor send as another station. The host of network interfaces is a user that
publishes the packets sent and receives those delivered, and nothing else.
"""

import secrets

from netsim.model.config import RadioPasswords, ServerConfig
from netsim.transport.access_control import Rights, User
from netsim.transport.lockstep_radio import (
    all_keys,
    directory_key,
    guest_transmit_key,
    packets_received_key,
    packets_sent_key,
    receive_key,
    vehicles_user,
)

_PASSWORD_BYTES = 16


def new_passwords(guests: int, *, packets: bool = False) -> RadioPasswords:
    """Return random passwords for the vehicles, each guest and, with ``packets``, the network interfaces."""
    return RadioPasswords(
        vehicles=secrets.token_hex(_PASSWORD_BYTES),
        guests=tuple(secrets.token_hex(_PASSWORD_BYTES) for _ in range(guests)),
        packets=secrets.token_hex(_PASSWORD_BYTES) if packets else None,
    )


def guest_user(station: int, password: str) -> User:
    """Return the user of a guest's station."""
    return User(f"guest-{station}", password)


def packets_user(password: str) -> User:
    """Return the user of the host of network interfaces."""
    return User("packets", password)


def rights(config: ServerConfig) -> list[Rights]:
    """Return the users of a run's router with their rights. Raises ValueError without a password for each."""
    run_id, passwords = config.run_id, config.passwords
    if passwords is None or len(passwords.guests) != len(config.radio.guests):
        raise ValueError(
            f"passwords: expected one for the vehicles and {len(config.radio.guests)} for guests"
        )
    interfaces = []
    if config.packets:
        if passwords.packets is None:
            raise ValueError("passwords: expected one for the host of network interfaces")
        user = packets_user(passwords.packets)
        keys = packets_sent_key(run_id), packets_received_key(run_id)
        interfaces.append(Rights(user, publishes=keys[:1], subscribes=keys[1:]))
    return [
        Rights(vehicles_user(passwords.vehicles), shares=(all_keys(run_id),)),
        *(
            Rights(
                guest_user(station, password),
                asks=(guest_transmit_key(run_id, station), directory_key(run_id)),
                served=(guest_transmit_key(run_id, station), directory_key(run_id)),
                serves=(receive_key(run_id, station),),
            )
            for station, password in enumerate(passwords.guests, start=config.stations)
        ),
        *interfaces,
    ]
