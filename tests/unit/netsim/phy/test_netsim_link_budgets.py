"""Requests for link budgets: only at the begin of a frame, for its sender. 5 s.

A budget is valid for some time from its request on. If an event without a transmission requested it, later
frames would have the powers of an earlier time.
"""

import numpy as np
import pytest
from netsim_air import A, Air, B, C

from netsim.mac.access_parameters import EDCA
from netsim.mac.rates import AdaptiveRate, channel_modes
from netsim.model.random_streams import FloatStream


def asked_and_sent(air, until_us):
    air.run(until_us)
    sent = sorted((each.start_ns, each.source) for each in air.transmissions)
    return sorted(air.links.asked), sent


def test_access_of_a_cancelled_frame_requests_no_budget():
    air = Air(2)
    jobs = [air.send(1_000 + 10 * k, k, 1 - k) for k in (A, B)]
    air.queue.at(1_020_000, air.stations[B].cancel, jobs[B])
    asked, sent = asked_and_sent(air, 50_000)
    assert asked == sent
    assert {source for _, source in sent[::2]} == {A}


def test_station_silenced_before_its_response_requests_no_budget():
    air = Air(2)
    air.send(1_000, A, B, mode="ofdm24", retry_limit=2)
    silence = lambda _: air.stations[B].silence()  # noqa: E731
    air.queue.at(1_065_000, silence, None)  # the frame ends at 1056 us, its ACK would begin at 1072 us
    asked, sent = asked_and_sent(air, 50_000)
    assert asked == sent
    assert {source for _, source in sent} == {A}


@pytest.mark.parametrize("seed", range(6))
def test_each_frame_on_a_busy_channel_requests_exactly_one_budget(seed):
    """Queues collide inside and outside of stations, frames expire and are cancelled, TXOPs break off."""
    rng = np.random.default_rng(seed)
    air = Air(3, access="edca", powers_dbm={(A, C): -84.0, (C, A): -84.0}, seed=seed)
    rates = [
        AdaptiveRate(channel_modes(20, vht=True), FloatStream(np.random.default_rng(k).random))
        for k in range(3)
    ]
    for _ in range(400):
        source, to = rng.permutation(3)[:2].tolist()
        at_us = int(rng.integers(1_000, 300_000))
        job = air.send(
            at_us,
            source,
            to if rng.random() < 0.7 else -1,
            frame_bytes=int(rng.integers(50, 2_000)),
            rts=bool(rng.random() < 0.3),
            category=str(rng.choice(list(EDCA))),
            retry_limit=2,
            lifetime_us=int(rng.integers(500, 20_000)),
        )
        if job.destination >= 0 and rng.random() < 0.5:
            job.rates = rates[source]
        if rng.random() < 0.1:
            air.queue.at(1_000 * (at_us + int(rng.integers(3_000))), air.stations[source].cancel, job)
    air.queue.at(290_000_000, lambda _: air.stations[B].silence(), None)
    asked, sent = asked_and_sent(air, 400_000)
    assert asked == sent
    assert len(sent) > 300
