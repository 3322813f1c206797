"""Counts of the input that a port rejected, by cause; a run's manifest has them for each vehicle and link."""

from dataclasses import dataclass


@dataclass(slots=True)
class Counters:
    """Counts of one port since its start."""

    datagrams_foreign: int = 0
    """Datagrams of programs of this machine that are neither of this user nor of root, dropped unread."""
    datagrams_over_budget: int = 0
    """Datagrams beyond the budget of the link or their sender (`autopilot.mavlink.input_budget`), dropped
    unread."""
    datagrams_too_long: int = 0
    """Datagrams longer than MAVLink senders make them, dropped unread."""
    bytes_bad: int = 0
    """Bytes that belonged to no complete frame of the dialect with a right checksum."""
    frames_bad_checksum: int = 0
    """Apparent frames with a wrong checksum. Random bytes contain many."""
    frames_unknown: int = 0
    """Apparent frames of messages that are not in the dialect, whose checksum cannot be verified."""
    bytes_unknown: int = 0
    """Bytes of those of them that were skipped whole."""
    frames_incompatible: int = 0
    """Apparent frames with an unknown incompatibility flag, which must not be parsed."""
    unsigned: int = 0
    """Right frames without a signature, if a key is set. MAVLink 1 cannot be signed."""
    signature_bad: int = 0
    """Right frames whose signature does not match the key."""
    replayed: int = 0
    """Signed frames not later than an earlier one of their stream, or older than a minute in a new stream."""
    setup_signing: int = 0
    """SETUP_SIGNING messages, which are refused: only the scenario sets the key."""
    not_addressed: int = 0
    """Messages for another system or component."""
    rate_limited: int = 0
    """Messages dropped because the link's budget was spent."""
