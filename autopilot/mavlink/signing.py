"""MAVLink 2's message signing: who may speak to a vehicle, told by a key that both sides have.

Source: https://mavlink.io/en/guide/message_signing.html. A signed frame ends in 13 bytes: link id, a 48-bit
timestamp and 48 bits of SHA-256 over key, frame, link id and timestamp. Timestamps are wall time in units of
10 us since 2015, and are only compared: what a vehicle does never follows from them. No clock is read here.
"""

import hashlib
import hmac
import struct
from enum import Enum

SIGNATURE_BYTES = 13
KEY_BYTES = 32
INCOMPAT_SIGNED = 0x01
EPOCH_UNIX_S = 1_420_070_400
"""2015-01-01, from which timestamps count."""
TICKS_PER_S = 100_000
OLDEST_NEW_STREAM = 60 * TICKS_PER_S
"""A stream that begins with a frame older than a minute is one that somebody has recorded."""
MAX_STREAMS = 256
"""Senders whose last timestamp is remembered at a time; those a minute old need not be."""

_TIMESTAMP_BYTES = 6
_DIGEST_BYTES = 6
_LAST_TIMESTAMP = (1 << 8 * _TIMESTAMP_BYTES) - 1
_SOURCE = slice(5, 7)
"""System and component in a frame of MAVLink 2."""
_HEX_KEY_LENGTH = 2 * KEY_BYTES


class SigningKeyError(ValueError):
    """A signing key that cannot be used; the text is one line."""


class SignatureVerdict(Enum):
    """What a frame's signature says."""

    GOOD = "good"
    UNSIGNED = "unsigned"
    BAD = "bad"
    REPLAYED = "replayed"


class SigningStreams:
    """Last timestamps of the senders that a vehicle has heard, by link id and source.

    Its ports share them, or what was recorded at one could be played to another.
    """

    def __init__(self) -> None:
        self._last: dict[tuple[int, bytes], int] = {}

    def take(self, stream: tuple[int, bytes], timestamp: int, now: int) -> bool:
        """Note the timestamp of a frame, unless the frame is not later than one before."""
        last = self._last.get(stream)
        if last is None:
            if timestamp + OLDEST_NEW_STREAM < now or not self._has_room(now):
                return False
        elif timestamp <= last:
            return False
        self._last[stream] = timestamp
        return True

    def _has_room(self, now: int) -> bool:
        """Whether one more stream can be remembered.

        One whose last frame is a minute old can be forgotten: what was recorded of it is no new stream.
        """
        if len(self._last) >= MAX_STREAMS:
            self._last = {
                stream: last for stream, last in self._last.items() if last + OLDEST_NEW_STREAM >= now
            }
        return len(self._last) < MAX_STREAMS


class Signer:
    """Signs what one port sends and judges what it hears, with one key.

    ``link_id`` tells the streams that a vehicle's ports send apart, for each has timestamps of its own.
    ``heard`` are the streams that the vehicle hears; without it the port has its own.
    """

    def __init__(self, key: bytes, *, link_id: int, heard: SigningStreams | None = None) -> None:
        """Raise SigningKeyError for a key that is not of 32 bytes."""
        if len(key) != KEY_BYTES:
            raise SigningKeyError(f"a signing key has {KEY_BYTES} bytes, not {len(key)}")
        self._key = key
        self._link_id = link_id
        self._sent = 0
        """Timestamp of the last frame that was signed, or of a later one that was heard."""
        self._heard = SigningStreams() if heard is None else heard

    def sign(self, frame: bytes, now: int) -> bytes:
        """Append the signature to a frame whose header already says that it is signed.

        Timestamps rise from frame to frame, whatever the clock ``now`` does.
        """
        self._sent = min(max(now, self._sent + 1), _LAST_TIMESTAMP)
        stamp = struct.pack("<BQ", self._link_id, self._sent)[: 1 + _TIMESTAMP_BYTES]
        return b"".join((frame, stamp, self._digest(frame + stamp)))

    def judge(self, frame: bytes | bytearray, now: int) -> SignatureVerdict:
        """Judge a whole frame whose checksum is right. Only a good one leaves a trace.

        The signature is looked at before the timestamp: a forged one must not make those to come look old.
        """
        if frame[0] != 0xFD or not frame[2] & INCOMPAT_SIGNED:
            return SignatureVerdict.UNSIGNED
        if not hmac.compare_digest(self._digest(frame[:-_DIGEST_BYTES]), bytes(frame[-_DIGEST_BYTES:])):
            return SignatureVerdict.BAD
        stream = (frame[-SIGNATURE_BYTES], bytes(frame[_SOURCE]))
        timestamp = int.from_bytes(frame[-SIGNATURE_BYTES + 1 : -_DIGEST_BYTES], "little")
        if not self._heard.take(stream, timestamp, now):
            return SignatureVerdict.REPLAYED
        # whoever is ahead of this clock would take what is signed by it for old
        self._sent = max(self._sent, timestamp)
        return SignatureVerdict.GOOD

    def _digest(self, signed: bytes | bytearray) -> bytes:
        return hashlib.sha256(self._key + signed).digest()[:_DIGEST_BYTES]


def key_of(text: bytes) -> bytes:
    """Give the key that a key file's contents mean. Raises SigningKeyError if they mean none.

    A passphrase, whose SHA-256 is the key as ground stations make it, or the key itself: 64 hexadecimal
    digits, or 32 bytes that are no text.
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
