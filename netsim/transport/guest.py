"""Client of a station with an external host: a ground station, a jammer, a protocol under test.

    with Guest("runs/ground", name="ground") as radio:
        radio.broadcast(b"hello")
        for item in radio.receive(timeout_s=1.0):
            print(item)

The scenario defines the position of the guest (``radio.guests``). The run's folder has the radio's endpoint
and the guest's password (`netsim.transport.guest_access`). Its transmissions go on the air as soon as
they reach the emulator, so such a run is not repeatable; its manifest states this.
"""

import queue
from pathlib import Path
from typing import Self

from netsim.transport.access_control import User
from netsim.transport.asynchronous_radio import AsynchronousRadio
from netsim.transport.guest_access import GuestAccess, GuestLogin, read_guest_access
from netsim.transport.lockstep_radio import RadioLost, directory_key
from netsim.transport.zenoh_session import Transport
from netsim.wire.messages import (
    DEFAULT_PORT,
    MAX_PAYLOAD_BYTES,
    MAX_STATION,
    Broadcast,
    Directory,
    DirectoryRequest,
    FtmRequest,
    RxBatch,
    RxItem,
    TxItem,
    Unicast,
    decode,
    encode,
)

DIRECTORY_LIMIT_S = 5.0
CONNECT_LIMIT_S = 5.0
"""Wall time within which the radio must accept the guest's password."""


class Guest:
    """Radio of one guest, for one thread. Close it, or use it as a context manager.

    ``run`` is the folder of a run that flies or of an emulator alone, or the path of its ``guests.json``.

    Raises TransportError without that file or if the radio cannot be reached, RadioLost if it has no guest of
    that name. If two programs use one name, the first one receives the deliveries. The methods that send
    raise RadioLost if the emulator has ended, RadioFull if it drops transmissions because the guest sends too
    many of them, and ValueError for invalid arguments.
    """

    def __init__(self, run: str | Path, *, name: str) -> None:
        access = read_guest_access(run)
        login = _login(access, name)
        user = User(login.user, login.password)
        self._transport = Transport.connect(access.endpoint, user, limit_s=CONNECT_LIMIT_S)
        try:
            self.directory = self._request_directory(access)
            """The run and its stations."""
            self.station = login.station
            """Number of this station on the channel."""
            self.now_us = 0
            """Simulated time up to which `receive` has returned deliveries."""
            self._seq = 0
            self._batches: queue.SimpleQueue[RxBatch] = queue.SimpleQueue()
            self._radio = AsynchronousRadio(
                self._transport, run_id=self.directory.run_id, station=self.station, put=self._batches.put
            )
        except BaseException:
            self._transport.close()
            raise

    def _request_directory(self, access: GuestAccess) -> Directory:
        asker = self._transport.asker(directory_key(access.run_id), timeout_s=DIRECTORY_LIMIT_S)
        answer = asker.ask(encode(DirectoryRequest())).answer()
        directory = None if answer is None else decode(Directory, answer)
        if directory is None:
            raise RadioLost(f"{access.endpoint}: no response of a radio emulator of this version")
        return directory

    def broadcast(self, payload: bytes, *, port: int = DEFAULT_PORT) -> int:
        """Send a datagram to a UDP port of every station in range; return its sequence number."""
        return self._send(Broadcast(seq=self._seq + 1, at_us=0, payload=_checked(payload), port=_port(port)))

    def unicast(self, destination: int, payload: bytes, *, port: int = DEFAULT_PORT) -> int:
        """Send a datagram to a UDP port of a station; a `Sent` with the returned sequence number follows."""
        item = Unicast(
            seq=self._seq + 1, at_us=0, destination=_station(destination), payload=_checked(payload),
            port=_port(port),
        )  # fmt: skip
        return self._send(item)

    def request_ftm(self, peer: int) -> int:
        """Range to a station; an `FtmResult` with the returned sequence number follows."""
        return self._send(FtmRequest(seq=self._seq + 1, at_us=0, peer=_station(peer)))

    def receive(self, *, timeout_s: float) -> list[RxItem]:
        """Return the received items; wait up to ``timeout_s`` of wall time for the first one.

        Raises RadioLost if there are none and the emulator has ended.
        """
        items: list[RxItem] = []
        try:
            batch = self._batches.get(timeout=timeout_s)
            while True:
                self.now_us = batch.release_us
                items.extend(batch.items)
                batch = self._batches.get_nowait()
        except queue.Empty:
            if not items and not self._transport.connected:
                raise RadioLost(f"station {self.station}: the 802.11 emulator has ended") from None
            return items

    def close(self) -> None:
        """Leave the channel; repeated calls have no effect."""
        self._transport.close()

    def _send(self, item: TxItem) -> int:
        self._radio.hand_over((item,))
        self._seq = item.seq
        return item.seq

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _checked(payload: object) -> bytes:
    if not isinstance(payload, bytes) or len(payload) > MAX_PAYLOAD_BYTES:
        raise ValueError(f"a datagram must have at most {MAX_PAYLOAD_BYTES} bytes, not {payload!r:.40}")
    return payload


def _port(number: int) -> int:
    if not 1 <= number <= 65_535:
        raise ValueError(f"a UDP port must be 1 to 65535, not {number}")
    return number


def _station(number: int) -> int:
    if not 0 <= number <= MAX_STATION:
        raise ValueError(f"a station number must be 0 to {MAX_STATION}, not {number}")
    return number


def _login(access: GuestAccess, name: str) -> GuestLogin:
    try:
        return access.guests[name]
    except KeyError:
        guests = ", ".join(access.guests) or "none"
        raise RadioLost(f"no guest {name!r} on this channel; its guests: {guests}") from None
