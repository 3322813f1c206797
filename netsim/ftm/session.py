"""Fine Time Measurement (IEEE 802.11-2016, 11.24.6) of one radio, as initiator and responder, above its MAC.

A session: the initiator's request says what it wants, the responder's first measurement frame what it
grants. Then 2^e bursts, the first at once (ASAP) or at the time that was granted; the initiator triggers all
but an ASAP one at their beginning. In a burst the responder sends measurement frames, each acknowledged. t1
(departure) and t4 (arrival of the ACK) of one frame are known to the responder alone and ride in the next
one, if need be in the next burst's, so N frames give N - 1 round trips. A frame or ACK that is lost for good
costs the round trips it had a part in; the grant rides until it has been acknowledged. No frame goes out
after its burst's time. A session ends with a frame of dialog token 0, or with the time of its last burst.

How a request ends, once, with a result over all bursts:

- ``ok``: at least one round trip.
- ``no_response``: the request was never acknowledged.
- ``rejected``: by a responder that serves as many as it can, with the seconds for which it does not want to
  be asked again, which the application is told and not kept to; or at once, for a peer that is no other
  station or is being ranged to already.
- ``incapable``: the responder cannot measure in the requested format.
- ``dropped``: the queue gave the request up, which found no room or outlived its time, or the radio fell
  silent.
- ``timeout``: anything else without a round trip by the request's time-out, which a grant moves by the time
  to the beginning of the last burst, or by the end of the session.
- ``lost``: at least one round trip, and the initiator's host has lost what the radio said of it
  (``drop_fraction``, `netsim.emulator.emulator`).

Left out: location reports. A responder obeys a request to stop; no initiator here sends one.
"""

from collections.abc import Callable

import numpy as np

from netsim.ftm.elements import Measurement, Request
from netsim.ftm.initiator import Initiator, Ranging, lost
from netsim.ftm.port import Environment, Port
from netsim.ftm.responder import Responder
from netsim.ftm.stamps import Clock
from netsim.mac.jobs import FrameSender, Reception
from netsim.model.config import RadioConfig

__all__ = ["Environment", "FtmRadio", "Ranging", "lost"]


class FtmRadio:
    """Fine Time Measurement of one station; see `netsim.mac.jobs.Upper`.

    ``generator`` draws its time stamps' noise, ``nlos_generator`` what a blocked line of sight adds to the
    range of each session that it begins; without the latter a blocked one measures like a clear one.
    ``on_datagram`` takes what arrives and is no frame of it.
    """

    def __init__(
        self,
        *,
        station: int,
        stations: int,
        config: RadioConfig,
        environment: Environment,
        clocks: list[Clock],
        generator: np.random.Generator,
        on_result: Callable[[Ranging], None],
        on_datagram: Callable[[Reception], None],
        nlos_generator: np.random.Generator | None = None,
    ) -> None:
        self._on_datagram = on_datagram
        self._port = Port(
            station=station,
            stations=stations,
            config=config,
            environment=environment,
            clocks=clocks,
            generator=generator,
        )
        nlos = None
        if nlos_generator is not None and config.nlos_fraction > 0.0 and config.ftm.nlos_bias_mean_m > 0.0:
            nlos = (nlos_generator, config.ftm.nlos_bias_mean_m)
        self._initiator = Initiator(self._port, nlos=nlos, on_result=on_result)
        self._responder = Responder(self._port)

    def attach(self, mac: FrameSender) -> None:
        """Give it the MAC to send through."""
        self._port.attach(mac)

    def request(self, peer: int, seq: int, timeout_ns: int) -> None:
        """Range to a peer: see `netsim.ftm.initiator.Initiator.request`."""
        self._initiator.request(peer, seq, timeout_ns)

    def on_frame(self, reception: Reception) -> None:
        """Take a frame; a measurement that comes again brings new time stamps, a request nothing."""
        body = reception.body
        if isinstance(body, Measurement):
            self._initiator.on_measurement(reception, body)
        elif not isinstance(body, Request):
            self._on_datagram(reception)
        elif not reception.duplicate:
            self._responder.on_request(reception.source, body)

    def silence(self) -> None:
        """End every session."""
        self._responder.silence()
        self._initiator.silence()
