"""Write all transmissions of a channel to a pcapng file, ordered by time, as sent or as received.

A packet's time is the UNIX time of its simulated time, in 64 bits of nanoseconds. The interface option
if_tsoffset would state the epoch once, but it counts whole seconds.
The simulated time is in the radiotap header.
"""

from heapq import heappop, heappush
from math import log10
from pathlib import Path

from netsim.capture.ieee80211 import mpdu
from netsim.capture.pcapng_blocks import (
    LINKTYPE_IEEE802_11_RADIOTAP,
    enhanced_packet,
    interface_description,
    section_header,
)
from netsim.capture.radiotap import Radiotap
from netsim.model.config import RadioConfig
from netsim.phy.frames import Frame, FrameKind, Transmission
from netsim.phy.propagation import thermal_noise_mw

HOLD_NS = 7_000_000
"""Time for which a frame is held back, since frames that began before it may end later.

The longest frame takes 5.484 ms (aPPDUMaxTime) and is reported after its end at the last receiver.
"""
CHUNK_BYTES = 1 << 16
"""Size from which pending blocks are written; only whole blocks, so a killed process leaves a valid file."""
WRITE_PERIOD_NS = 1_000_000_000
"""Simulated time after which pending blocks are written whatever their size."""
_SEQUENCE_NUMBERS = 4096
_FCS_BYTES = 4
_INVERTED = bytes(range(255, -1, -1))
_NUMBERED = frozenset({FrameKind.DATA, FrameKind.FTM_REQUEST, FrameKind.FTM})


class Capture:
    """A capture file of all frames of the channel, including those that no station received.

    A packet's time is the time at which its preamble leaves the transmitter's antenna; ``epoch_unix_us`` is
    that of simulated time 0. A comment names the receivers that a frame did not reach. If ``config.capture``
    is "receivers", every station has an interface: of the ``vehicles``, then of the guests. It has the
    station's own frames, and those that its radio was locked on to until their end, at the time at which
    their preamble arrives. Of a frame received with errors, the bytes are those sent, since the emulator
    determines errors but not their positions, and the FCS is inverted.

    The bytes depend only on the transmissions, not on when they are written. The file is valid at any time.
    Raises OSError, with the path, if it cannot be created or written.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        config: RadioConfig,
        vehicles: int = 0,
        epoch_unix_us: int = 0,
        comment: str = "",
    ) -> None:
        self._path = str(path)
        self._epoch_ns = 1_000 * epoch_unix_us
        self._of_receivers = config.capture == "receivers"
        self._file = Path(path).open("wb", buffering=0)  # noqa: SIM115 - closed by close()
        self._frequency_mhz = config.frequency_mhz
        self._power_dbm = config.tx_power_dbm
        self._power_of_dbm = {
            each.station: each.tx_power_dbm for each in config.stations if each.tx_power_dbm is not None
        }
        noise_mw = thermal_noise_mw(config.bandwidth_mhz, config.noise_figure_db)
        self._noise_dbm = 10.0 * log10(noise_mw) if config.channel != "ideal" else None
        self._sent: dict[tuple[str, int, int], Radiotap] = {}
        """Headers by mode, bandwidth and transmitter."""
        self._received: dict[tuple[str, int, int, bool], Radiotap] = {}
        """Headers by mode, bandwidth, signal in dBm and whether there are errors."""
        self._packets = 0
        """Number of packets added to the file so far."""
        self._newest_sequence: dict[int, int] = {}
        self._held: list[tuple[int, int, bytes]] = []
        """Heap of (time, station, block); a station sends one frame at a time."""
        self._chunk = bytearray(section_header(application="coflight", comment=comment))
        names = [f"uav {i}" for i in range(vehicles)] + [guest.name for guest in config.guests]
        channel = f"emulated channel, {config.bandwidth_mhz} MHz wide at {config.frequency_mhz:g} MHz"
        for name in names if self._of_receivers else ["radio"]:
            self._chunk += interface_description(
                link_type=LINKTYPE_IEEE802_11_RADIOTAP, name=name, description=channel
            )
        self._write_due_ns = WRITE_PERIOD_NS
        try:
            self._write()
        except OSError:
            self._file.close()
            raise

    def append(self, transmission: Transmission) -> None:
        """Add a transmission that has ended; transmissions are added in order of their end."""
        frame = transmission.frame
        start_ns = transmission.start_ns
        content = mpdu(frame, retry=self._is_retry(frame))
        comment = _losses(transmission) if transmission.collided or transmission.lost_to_noise else ""
        self._hold(start_ns, frame.source, self._sent_header(frame), content, comment)
        if self._of_receivers:
            for station in transmission.received:
                self._hold_received(transmission, station, content, bad_fcs=False)
            in_error = transmission.received_in_error
            if in_error:
                content = content[:-_FCS_BYTES] + content[-_FCS_BYTES:].translate(_INVERTED)
                for station in in_error:
                    self._hold_received(transmission, station, content, bad_fcs=True)
        self.settle(transmission.end_ns)

    def settle(self, now_ns: int) -> None:
        """Write frames that no later frame can precede. All frames that ended by ``now_ns`` must be appended.

        A frame is written at the first call later than `HOLD_NS` + `WRITE_PERIOD_NS` after its start.
        """
        held = self._held
        settled_ns = now_ns - HOLD_NS
        while held and held[0][0] < settled_ns:
            self._chunk += heappop(held)[2]
        if self._chunk and (now_ns >= self._write_due_ns or len(self._chunk) >= CHUNK_BYTES):
            self._write_due_ns = now_ns + WRITE_PERIOD_NS
            self._write()

    def close(self) -> None:
        """Write the remaining frames and close the file; repeated calls have no effect."""
        if self._file.closed:
            return
        try:
            while self._held:
                self._chunk += heappop(self._held)[2]
            self._write()
        finally:
            self._file.close()

    def _hold(
        self, time_ns: int, station: int, radiotap: Radiotap, content: bytes, comment: str = ""
    ) -> None:
        packet = radiotap.header(time_ns, self._packets) + content
        self._packets += 1
        interface = station if self._of_receivers else 0
        block = enhanced_packet(self._epoch_ns + time_ns, packet, interface=interface, comment=comment)
        heappush(self._held, (time_ns, station, block))

    def _hold_received(
        self, transmission: Transmission, station: int, content: bytes, *, bad_fcs: bool
    ) -> None:
        """Add a frame as a station's radio received it."""
        mode = transmission.frame.mode
        signal_dbm = round(10.0 * log10(transmission.powers_mw.item(station)))
        key = (mode.name, mode.bandwidth_mhz, signal_dbm, bad_fcs)
        radiotap = self._received.get(key)
        if radiotap is None:
            radiotap = Radiotap(
                mode,
                frequency_mhz=self._frequency_mhz,
                power_dbm=signal_dbm,
                is_received=True,
                noise_dbm=self._noise_dbm,
                bad_fcs=bad_fcs,
            )
            self._received[key] = radiotap
        arrival_ns = transmission.start_ns + transmission.delays_ns.item(station)
        self._hold(arrival_ns, station, radiotap, content)

    def _sent_header(self, frame: Frame) -> Radiotap:
        """Return the radiotap headers of a frame as sent."""
        mode = frame.mode
        key = (mode.name, mode.bandwidth_mhz, frame.source)
        radiotap = self._sent.get(key)
        if radiotap is None:
            power_dbm = self._power_of_dbm.get(frame.source, self._power_dbm)
            radiotap = Radiotap(mode, frequency_mhz=self._frequency_mhz, power_dbm=power_dbm)
            self._sent[key] = radiotap
        return radiotap

    def _is_retry(self, frame: Frame) -> bool:
        """Whether a data or action frame is a retransmission.

        A station numbers its frames at their first transmission, and a retransmission keeps its number. So
        the number of a retransmission is not ahead of all before, modulo 4096.
        """
        if frame.kind not in _NUMBERED:
            return False
        newest = self._newest_sequence.get(frame.source)
        if newest is not None and (newest - frame.sequence) % _SEQUENCE_NUMBERS < _SEQUENCE_NUMBERS // 2:
            return True
        self._newest_sequence[frame.source] = frame.sequence
        return False

    def _write(self) -> None:
        chunk, self._chunk = self._chunk, bytearray()
        rest = memoryview(chunk)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            raise OSError(error.errno, error.strerror, self._path) from error


def _losses(transmission: Transmission) -> str:
    parts = (("collided at", transmission.collided), ("lost to noise at", transmission.lost_to_noise))
    return "; ".join(f"{what} {', '.join(map(str, where))}" for what, where in parts if where)
