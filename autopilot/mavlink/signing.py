"""MAVLink 2's message signing: authentication by a key that both sides share.

Source: https://mavlink.io/en/guide/message_signing.html. A signed frame ends in 13 bytes: link id, a 48-bit
timestamp and 48 bits of SHA-256 over key, frame, link id and timestamp. Timestamps are wall time in units of
10 us since 2015, and are only compared with each other; no vehicle behaviour depends on them. This module
reads no clock.
"""

import hashlib
import hmac
import struct
from enum import Enum

SIGNATURE_BYTES = 13
KEY_BYTES = 32
INCOMPAT_SIGNED = 0x01
EPOCH_UNIX_S = 1_420_070_400
"""2015-01-01, the epoch of timestamps."""
TICKS_PER_S = 100_000
OLDEST_NEW_STREAM = 60 * TICKS_PER_S
"""A new stream whose first frame is older than a minute is treated as a replay."""
MAX_STREAMS = 256
"""Senders whose last timestamp is stored; those older than a minute may be dropped."""

_TIMESTAMP_BYTES = 6
_DIGEST_BYTES = 6
_LAST_TIMESTAMP = (1 << 8 * _TIMESTAMP_BYTES) - 1
_SOURCE = slice(5, 7)
"""System and component in a frame of MAVLink 2."""
_HEX_KEY_LENGTH = 2 * KEY_BYTES


class SigningKeyError(ValueError):
    """An invalid signing key; the text is one line."""


class SignatureVerdict(Enum):
    """Result of a signature check."""

    GOOD = "good"
    UNSIGNED = "unsigned"
    BAD = "bad"
    REPLAYED = "replayed"


class SigningStreams:
    """Last timestamps of the senders from which a vehicle has received, by link id and source.

    The vehicle's ports share it; otherwise frames recorded at one port could be replayed at another.
    """

    def __init__(self) -> None:
        self._last: dict[tuple[int, bytes], int] = {}

    def take(self, stream: tuple[int, bytes], timestamp: int, now: int) -> bool:
        """Store a frame's timestamp and return True, unless it is not later than the stream's last."""
        last = self._last.get(stream)
        if last is None:
            if timestamp + OLDEST_NEW_STREAM < now or not self._has_room(now):
                return False
        elif timestamp <= last:
            return False
        self._last[stream] = timestamp
        return True

    def _has_room(self, now: int) -> bool:
        """Whether one more stream can be stored.

        Streams whose last frame is older than a minute are dropped: a replay of theirs is no new stream.
        """
        if len(self._last) >= MAX_STREAMS:
            self._last = {
                stream: last for stream, last in self._last.items() if last + OLDEST_NEW_STREAM >= now
            }
        return len(self._last) < MAX_STREAMS


class Signer:
    """Signs the frames that one port sends and verifies those that it receives, with one key.

    ``link_id`` distinguishes the streams that a vehicle's ports send, since each has its own timestamps.
    ``received`` are the streams that the vehicle receives; by default the port has its own.
    """

    def __init__(self, key: bytes, *, link_id: int, received: SigningStreams | None = None) -> None:
        """Raise SigningKeyError for a key whose length is not 32 bytes."""
        if len(key) != KEY_BYTES:
            raise SigningKeyError(f"a signing key has {KEY_BYTES} bytes, not {len(key)}")
        self._key = key
        self._link_id = link_id
        self._sent = 0
        """Timestamp of the last frame signed, or of a later one received."""
        self._received = SigningStreams() if received is None else received

    def sign(self, frame: bytes, now: int) -> bytes:
        """Append the signature to a frame whose header already has the signed flag.

        Timestamps increase from frame to frame, even if the clock ``now`` does not.
        """
        self._sent = min(max(now, self._sent + 1), _LAST_TIMESTAMP)
        stamp = struct.pack("<BQ", self._link_id, self._sent)[: 1 + _TIMESTAMP_BYTES]
        return b"".join((frame, stamp, self._digest(frame + stamp)))

    def judge(self, frame: bytes | bytearray, now: int) -> SignatureVerdict:
        """Verify a whole frame whose checksum is right. Only a good one changes the state.

        The signature is checked before the timestamp: a forged timestamp must not make later frames old.
        """
        if frame[0] != 0xFD or not frame[2] & INCOMPAT_SIGNED:
            return SignatureVerdict.UNSIGNED
        if not hmac.compare_digest(self._digest(frame[:-_DIGEST_BYTES]), bytes(frame[-_DIGEST_BYTES:])):
            return SignatureVerdict.BAD
        stream = (frame[-SIGNATURE_BYTES], bytes(frame[_SOURCE]))
        timestamp = int.from_bytes(frame[-SIGNATURE_BYTES + 1 : -_DIGEST_BYTES], "little")
        if not self._received.take(stream, timestamp, now):
            return SignatureVerdict.REPLAYED
        # a sender ahead of this clock would reject frames that are signed by it as old
        self._sent = max(self._sent, timestamp)
        return SignatureVerdict.GOOD

    def _digest(self, signed: bytes | bytearray) -> bytes:
        return hashlib.sha256(self._key + signed).digest()[:_DIGEST_BYTES]


def key_of(text: bytes) -> bytes:
    """Return the key in a key file's contents. Raises SigningKeyError if there is none.

    Contents are a passphrase, whose SHA-256 is the key, as in ground stations, or the key itself: 64
    hexadecimal digits, or 32 bytes that are not text.
    """
    try:
        passphrase = text.decode("utf-8").strip("\r\n")
    except UnicodeDecodeError:
        passphrase = ""
    if not passphrase.isprintable() or not passphrase:
        if len(text) == KEY_BYTES:
            return text
        raise SigningKeyError(f"neither a passphrase nor {KEY_BYTES} bytes of a key")
    if len(passphrase) == _HEX_KEY_LENGTH:
        try:
            return bytes.fromhex(passphrase)
        except ValueError:
            pass  # a long passphrase
    return hashlib.sha256(passphrase.encode()).digest()
