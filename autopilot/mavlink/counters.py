"""What a port did not take, by cause: a run's manifest tells it of every vehicle's links."""

from dataclasses import asdict, dataclass


@dataclass(slots=True)
class Counters:
    """Counts of one port since its start."""

    datagrams_too_long: int = 0
    """Datagrams that are longer than any sender of MAVLink makes them; nothing of them was read."""
    bytes_bad: int = 0
    """Bytes that belonged to no whole frame of a message of the dialect with a right checksum."""
    frames_bad_checksum: int = 0
    """What looked like such a frame but for the checksum. Among random bytes much looks like one."""
    frames_unknown: int = 0
    """What looked like a frame of a message that the dialect does not have: no checksum can be told of it."""
    frames_incompatible: int = 0
    """What looked like a frame with a flag that forbids whoever does not know it to read on."""
    unsigned: int = 0
    """Right frames without a signature, where a key is set. MAVLink 1 cannot be signed."""
    signature_bad: int = 0
    """Right frames whose signature is not of the key."""
    replayed: int = 0
    """Signed frames that are not later than one before, or begin a stream and are a minute old."""
    setup_signing: int = 0
    """Keys that somebody wanted to set by SETUP_SIGNING: refused, for a scenario alone says the key."""
    not_addressed: int = 0
    """Messages for another system or component."""
    rate_limited: int = 0
    """Messages that were not sent, for the link's budget was spent."""

    def told(self) -> dict[str, int]:
        """All counts by name, for the manifest."""
        return asdict(self)
