"""The file from which programs outside a run read how to join its radio: endpoint, user and password."""

from collections.abc import Mapping
from pathlib import Path

import msgspec
from msgspec import Struct

from foundation.records.whole_file import write_whole
from netsim.model.config import ServerConfig
from netsim.transport.radio_users import guest_user
from netsim.transport.zenoh_session import TransportError

FILE = "guests.json"
"""Name of the file in the run's folder."""


class GuestLogin(Struct, frozen=True, kw_only=True):
    """One guest's station with the user and password that its program presents."""

    station: int
    user: str
    password: str


class GuestAccess(Struct, frozen=True, kw_only=True):
    """The content of the file."""

    endpoint: str
    """Zenoh endpoint of the radio's router."""
    run_id: str
    guests: Mapping[str, GuestLogin]
    """By the guests' names."""


def write_guest_access(path: Path, config: ServerConfig, endpoint: str, *, guests: int | None = None) -> None:
    """Write the file of a run's radio, readable for its owner alone; a reader finds all of it or none.

    It has the first ``guests`` of the settings, by default all. Raises OSError.
    """
    passwords = () if config.passwords is None else config.passwords.guests
    logins = {}
    for station, (guest, password) in enumerate(
        zip(config.radio.guests[:guests], passwords[:guests], strict=True), start=config.stations
    ):
        user = guest_user(station, password)
        logins[guest.name] = GuestLogin(station=station, user=user.name, password=user.password)
    access = GuestAccess(endpoint=endpoint, run_id=config.run_id, guests=logins)
    write_whole(path, msgspec.json.format(msgspec.json.encode(access), indent=2), private=True)


def read_guest_access(place: str | Path) -> GuestAccess:
    """Return the content of the file, given its path or its folder. Raises TransportError."""
    path = Path(place)
    try:
        if path.is_dir():
            path /= FILE
        return msgspec.json.decode(path.read_bytes(), type=GuestAccess)
    except FileNotFoundError:
        raise TransportError(f"{path}: no such file; {_missing(str(place))}") from None
    except OSError as error:
        raise TransportError(f"{path}: {error.strerror}") from None
    except ValueError as error:  # also of undecodable text
        raise TransportError(f"{path}: not the file {FILE} of a run's radio: {error}") from None


def _missing(place: str) -> str:
    """Return what to do if the file is missing."""
    if place.startswith(("tcp/", "unixsock-stream/", "udp/", "tls/")):
        return f"a radio's endpoint alone is not enough: pass the run's folder, whose {FILE} has the password"
    return (
        f"pass the folder of a run that flies now and has [[radio.guests]]: its {FILE} exists from the start "
        "of the radio to the end of the run"
    )
