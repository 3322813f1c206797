"""Fine Time Measurement (IEEE 802.11-2016, 11.24.6) of one radio, as initiator and responder, above its MAC.

The initiator's request contains the requested parameters, the responder's first measurement frame the granted
ones. Then 2^e bursts follow, the first at once (ASAP) or at the granted time. The initiator triggers each
burst at its beginning, except an ASAP one. In a burst the responder sends measurement frames, each
acknowledged. t1 (departure) and t4 (arrival of the ACK) of a frame are measured by the responder and sent in
the next frame, if necessary in the next burst, so N frames give N - 1 round trips. If a frame or ACK is lost
after all retries, its round trips are lost. The grant is repeated until it has been acknowledged. No frame is
sent after the end of its burst. A session ends with a frame of dialog token 0, or with the end of its last
burst.

A request has one result over all bursts, with one of these statuses:

- ``ok``: at least one round trip.
- ``no_response``: the request was never acknowledged.
- ``rejected``: the responder has no free session; the result has the retry time in seconds, which is not
  enforced. Or, at once: the peer is unknown, is the station itself, or has a session already.
- ``incapable``: the responder cannot measure in the requested format.
- ``dropped``: the queue was full, the request expired in it, or the radio was switched off.
- ``timeout``: no round trip by the request's time-out (which a grant extends by the time to the beginning of
  the last burst) or by the end of the session.
- ``lost``: at least one round trip, but the initiator's host has lost the result (``drop_fraction``,
  `netsim.emulator.emulator`).

Not modelled: location reports. A responder obeys a request to stop, but initiators do not send one.
"""

from collections.abc import Callable

import numpy as np

from netsim.ftm.elements import Measurement, Request
from netsim.ftm.initiator import Initiator, Ranging
from netsim.ftm.port import Port
from netsim.ftm.responder import Responder
from netsim.mac.jobs import Reception


class FtmRadio:
    """Fine Time Measurement of one station; see `netsim.mac.jobs.Upper`.

    ``nlos_generator`` draws the excess range of a blocked line of sight for each session that it initiates.
    """

    def __init__(
        self,
        port: Port,
        nlos_generator: np.random.Generator,
        *,
        on_result: Callable[[Ranging], None],
    ) -> None:
        self.initiator = Initiator(port, nlos_generator, on_result)
        self._responder = Responder(port)

    def on_frame(self, reception: Reception) -> None:
        """Process a frame; a repeated measurement has new time stamps, a repeated request is ignored."""
        body = reception.body
        if isinstance(body, Measurement):
            self.initiator.on_measurement(reception, body)
        elif isinstance(body, Request) and not reception.duplicate:
            self._responder.on_request(reception.source, body)

    def silence(self) -> None:
        """End every session."""
        self._responder.silence()
        self.initiator.silence()
