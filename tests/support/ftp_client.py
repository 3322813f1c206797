"""A ground station's side of file transfer, for tests of the vehicle's side."""

import struct

from pymavlink.dialects.v20 import common

from autopilot.services.ftp import DATA_BYTES, FtpFailure, Opcode
from autopilot.services.service import NEVER_US

HEADER = struct.Struct("<HBBBBBxI")
MS = 1_000


def request(opcode, *, seq=1, session=0, size=None, offset=0, data=b""):
    header = HEADER.pack(seq, session, opcode, len(data) if size is None else size, 0, 0, offset)
    return common.MAVLink_file_transfer_protocol_message(0, 1, 1, (header + data).ljust(251, b"\0"))


class Reply:
    def __init__(self, message):
        payload = bytes(message.payload)
        self.seq, self.session, self.opcode, size, self.request, self.complete, self.offset = (
            HEADER.unpack_from(payload)
        )
        self.data = payload[HEADER.size : HEADER.size + size]
        assert payload[HEADER.size + size :].strip(b"\0") == b""
        self.to = message.target_system, message.target_component
        self.failure = FtpFailure(self.data[0]) if self.opcode == Opcode.NAK else None


class Downloader:
    """Reads a file as QGroundControl and MAVProxy do: in bursts, then the gaps individually."""

    def __init__(self, path, *, session, retry_us=500 * MS):
        self.path, self.session, self.retry_us = path, session, retry_us
        self.size = None
        self.parts = {}
        self.done = False
        self.bursting = True
        self.at = 0
        self.seq = 0
        self.last = None
        self.due_us = 0

    @property
    def content(self):
        return b"".join(self.parts[offset] for offset in sorted(self.parts))

    def send(self, now_us, opcode, **named):
        self.last = opcode, named
        self.seq = (self.seq + 1) % 65_536
        self.due_us = now_us + self.retry_us
        return [request(opcode, seq=self.seq, session=self.session, **named)]

    def on_timer(self, now_us):
        if self.last is None:
            return self.send(now_us, Opcode.OPEN_READ, data=self.path)
        opcode, named = self.last
        if opcode == Opcode.BURST:
            return self.next_burst(now_us)
        if opcode == Opcode.READ:
            return self.next_gap(now_us)
        self.due_us = now_us + self.retry_us  # the same request again
        return [request(opcode, seq=self.seq, session=self.session, **named)]

    def next_deadline_us(self):
        return NEVER_US if self.done else self.due_us

    def next_burst(self, now_us):
        if self.at >= self.size:
            return self.next_gap(now_us)
        return self.send(now_us, Opcode.BURST, size=DATA_BYTES, offset=self.at)

    def next_gap(self, now_us):
        at = 0
        for offset in sorted(self.parts):
            if offset > at:
                break
            at = offset + len(self.parts[offset])
        if at >= self.size:
            return self.send(now_us, Opcode.TERMINATE)
        return self.send(now_us, Opcode.READ, size=DATA_BYTES, offset=at)

    def on_message(self, message, now_us):
        answer = Reply(message)
        if answer.session != self.session or answer.request != self.last[0] or self.done:
            return ()
        if answer.request == Opcode.OPEN_READ:
            (self.size,) = struct.unpack("<I", answer.data)
            return self.next_burst(now_us)
        if answer.request == Opcode.TERMINATE:
            self.done = answer.seq == (self.seq + 1) % 65_536
            return ()
        if answer.opcode == Opcode.ACK:
            self.parts[answer.offset] = answer.data
            self.at = max(self.at, answer.offset + len(answer.data))
            self.due_us = now_us + self.retry_us
        if answer.request == Opcode.READ or answer.opcode == Opcode.NAK:
            return self.next_gap(now_us)
        return self.next_burst(now_us) if answer.complete else ()
