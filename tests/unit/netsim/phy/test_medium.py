"""What receivers sense and receive: energy, preambles, capture, interferers. 4 s."""

import numpy as np
import pytest
from netsim_air import Air
from netsim_swarm import Swarm, make_links
from numba import njit

from netsim.mac.interference import Interferer
from netsim.mac.jobs import Job, JobOutcome
from netsim.mac.radios import KIND_ROWS, Radios
from netsim.mac.station import schedule_frame
from netsim.model.codes import MODES, NOTHING
from netsim.model.config import InterfererConfig, RadioConfig
from netsim.model.event_queue import NEVER_NS, EventQueue
from netsim.model.random_streams import Model, RandomStreams
from netsim.model.tables import open_air
from netsim.phy.fading import gain
from netsim.phy.frames import GROUP, Frame, FrameKind
from netsim.phy.modes import phy_mode
from netsim.phy.propagation import LinkRow, Trajectories

A, B, C = range(3)
UNDETECTED_DBM = -200.0
MILLISECOND_NS = 1_000_000
SECOND_NS = 1_000_000_000


class Powers:
    """Links of given powers in dBm by (from, to), -50 where nothing is said; "x" is the interferer."""

    version = 0
    fading = None

    def __init__(self, stations, powers_dbm, delay_ns=0):
        self._powers_dbm, self._stations, self._delay_ns = powers_dbm, stations, delay_ns

    def row(self, source, _at_ns):
        powers_mw = [10 ** (self._powers_dbm.get((source, r), -50.0) / 10) for r in range(self._stations)]
        return LinkRow(np.array(powers_mw), np.full(self._stations, self._delay_ns), self._delay_ns)

    def interferer_row(self, _index, at_ns):
        return self.row("x", at_ns)


@njit
def transmit(block, source, to, what, frame_bytes):
    air = open_air(block)
    schedule_frame(air, air.now_ns, source, to, what, frame_bytes, 0)
    return air.scheduled


class Listener:
    """Logs what a station receives, in microseconds."""

    def __init__(self):
        self.received = []

    def on_frame(self, reception):
        self.received.append((reception.source, reception.end_ns / 1_000))


class Channel:
    """Stations with empty queues; frames are sent at given times."""

    def __init__(self, powers_dbm=None, *, stations=3, links=None, seed=1, delay_ns=0, **settings):
        self.queue = EventQueue()
        self.ended = []
        config = RadioConfig(bandwidth_mhz=20, **{"rician_k_db": None, "access": "dcf", **settings})
        self.radios = Radios(
            config=config,
            queue=self.queue,
            links=links or Powers(stations, powers_dbm or {}, delay_ns),
            stations=stations,
            streams=RandomStreams(np.random.SeedSequence(seed)),
            on_datagram=self._on_datagram,
            on_ended=self.ended.append,
        )
        self.listeners = [Listener() for _ in range(stations)]
        for i, listener in enumerate(self.listeners):
            self.radios.join(i, listener)

    def send(self, at_us, source, to=GROUP, *, frame_bytes=100, mode="ofdm6"):
        """A frame of 100 bytes at 6 Mbit/s lasts 20 + 4 ceil(822 / 24) = 160 us."""
        frame = Frame(
            kind=FrameKind.DATA,
            source=source,
            destination=to,
            mode=phy_mode(mode, 20),
            frame_bytes=frame_bytes,
        )
        self.queue.at(1_000 * at_us, self._transmit, frame)

    def _transmit(self, frame):
        """Send a frame now, regardless of the medium."""
        radios = self.radios
        radios._make_ready()
        what = KIND_ROWS[frame.kind] * MODES + radios._modes[frame.mode]
        self.queue.scheduled = transmit(
            radios._block, frame.source, frame.destination, what, frame.frame_bytes
        )

    def _on_datagram(self, reception):
        for station, end_ns in zip(reception.stations, reception.ends_ns, strict=True):
            self.listeners[station].received.append((reception.source, end_ns / 1_000))

    def row(self, station):
        return self.radios.tables.stations[station]

    def busy_us(self, station):
        row = self.row(station)
        return row.busy_from_ns / 1_000, row.busy_until_ns / 1_000


def interferer(duty_cycle, burst_us=1_000.0):
    return (InterfererConfig(pos_ned_m=(0.0, 0.0, 0.0), duty_cycle=duty_cycle, burst_us=burst_us),)


# --- clear channel assessment


@pytest.mark.parametrize("power_dbm", [-50.0, -62.1, -81.9])
def test_frames_are_sensed_from_arrival_to_end_at_any_power(power_dbm):
    channel = Channel({(A, C): power_dbm}, delay_ns=300)
    channel.send(1000, A)
    channel.queue.run_until(1_100_000)
    assert channel.busy_us(C) == (1000.3, 1160.3)


@pytest.mark.parametrize(("thresholds_dbm", "sensed"), [((-62.0, -82.0), False), ((-84.0, -82.0), True)])
def test_a_frame_that_is_too_weak_for_a_preamble_is_sensed_by_its_energy(thresholds_dbm, sensed):
    energy_dbm, preamble_dbm = thresholds_dbm
    settings = {"cca_energy_dbm": energy_dbm, "cca_preamble_dbm": preamble_dbm}
    channel = Channel({(A, C): -83.0}, **settings)
    channel.send(1000, A)
    channel.queue.run_until(MILLISECOND_NS * 2)
    assert channel.busy_us(C) == ((1000, 1160) if sensed else (0, 0))
    assert channel.listeners[C].received == []


def test_colliding_weak_frames_are_sensed_without_being_received():
    # neither is 4 dB over the other, and -70 dBm twice is -67
    channel = Channel({(A, C): -70.0, (B, C): -70.0, (A, B): UNDETECTED_DBM, (B, A): UNDETECTED_DBM})
    channel.send(1000, A)
    channel.send(1100, B)
    channel.queue.run_until(1_110_000)
    assert channel.busy_us(C) == (1000, 1260)
    channel.queue.run_until(MILLISECOND_NS * 2)
    assert channel.listeners[C].received == []
    channel.send(3000, A)
    channel.send(3000, B)
    channel.queue.run_until(3_110_000)
    assert channel.busy_us(C) == (3000, 3160)
    assert channel.row(C).locked_frame == NOTHING


#   A  weak  |====================|  1000..2376
#   B strong     |====|              1008..1168     C takes B; A is sensed on, unless it is under -82 dBm
@pytest.mark.parametrize(("weak_dbm", "busy_us"), [(-82.5, (1008, 1168)), (-75.0, (1000, 2376))])
def test_aborted_frame_is_still_sensed_after_a_capture(weak_dbm, busy_us):
    channel = Channel({(A, C): weak_dbm, (B, C): -50.0, (A, B): UNDETECTED_DBM, (B, A): UNDETECTED_DBM})
    channel.send(1000, A, frame_bytes=1014)  # 20 + 4 ceil(8134 / 24) = 1376 us
    channel.send(1008, B)
    channel.queue.run_until(1_200_000)
    assert channel.busy_us(C) == busy_us
    channel.queue.run_until(3_000_000)
    assert channel.listeners[C].received == [(B, 1168.0)]


#   A  |====================|  1000..2376
#   C        |====|            1100..1260     C responds to another frame and aborts the reception of A
@pytest.mark.parametrize(("power_dbm", "busy_us"), [(-82.5, (0, 0)), (-75.0, (1000, 2376))])
def test_station_that_sends_while_receiving_senses_the_rest(power_dbm, busy_us):
    channel = Channel({(A, C): power_dbm})
    channel.send(1000, A, frame_bytes=1014)
    channel.send(1100, C)
    channel.queue.run_until(1_300_000)
    assert channel.busy_us(C) == busy_us
    channel.queue.run_until(3_000_000)
    assert (channel.listeners[C].received, channel.row(C).last_error_ns) == ([], 0)


# --- missed preambles, by 17.3.10.6: frames of 100 bytes last 160 us, of 1014 bytes 1376 us

MISSED = {"cca_missed_dbm": -62.0}


@pytest.mark.parametrize(("power_dbm", "until_us"), [(-62.1, None), (-61.9, 2476)])
def test_frame_that_begins_during_an_own_transmission_is_sensed_by_its_energy(power_dbm, until_us):
    #   C  |======|             1000..1160
    #   A      |=============|  1100..2476
    channel = Channel({(A, C): power_dbm}, **MISSED)
    channel.send(1000, C)
    channel.send(1100, A, frame_bytes=1014)
    channel.queue.run_until(1_300_000)
    assert channel.busy_us(C) == ((1100, until_us) if until_us else (0, 0))


@pytest.mark.parametrize(("power_dbm", "until_us"), [(-64.0, 1160), (-61.9, 2476)])
def test_frame_that_outlasts_the_received_one_is_sensed_by_its_energy(power_dbm, until_us):
    #   A  |======|             1000..1160, with -60 dBm
    #   B      |=============|  1100..2476
    channel = Channel({(A, C): -60.0, (B, C): power_dbm}, **MISSED)
    channel.send(1000, A)
    channel.send(1100, B, frame_bytes=1014)
    channel.queue.run_until(1_300_000)
    assert channel.busy_us(C) == (1000, until_us)


@pytest.mark.parametrize(("power_dbm", "busy_us"), [(-65.1, (0, 0)), (-64.9, (1000, 1160))])
def test_colliding_preambles_are_sensed_by_their_total_energy(power_dbm, busy_us):
    channel = Channel({(A, C): power_dbm, (B, C): power_dbm}, **MISSED)
    channel.send(1000, A)
    channel.send(1000, B, frame_bytes=1014)
    channel.queue.run_until(1_110_000)
    assert channel.busy_us(C) == busy_us
    assert channel.row(C).locked_frame == NOTHING


@pytest.mark.parametrize("power_dbm", [-62.1, -81.9])
def test_detected_frame_is_sensed_from_its_arrival_on(power_dbm):
    channel = Channel({(A, C): power_dbm}, delay_ns=300, **MISSED)
    channel.send(1000, A)
    channel.queue.run_until(1_003_999)
    assert channel.busy_us(C) == (0, 0)
    channel.queue.run_until(1_004_000)
    assert channel.busy_us(C) == (1000.3, 1160.3)


def test_captured_receiver_senses_the_aborted_frame_by_its_energy():
    #   A  |=============|  1000..2376, with -75 dBm
    #   B    |====|         1008..1168
    channel = Channel(
        {(A, C): -75.0, (B, C): -50.0, (A, B): UNDETECTED_DBM, (B, A): UNDETECTED_DBM}, **MISSED
    )
    channel.send(1000, A, frame_bytes=1014)
    channel.send(1008, B)
    channel.queue.run_until(1_010_000)
    assert channel.busy_us(C) == (1000, 2376)
    channel.queue.run_until(1_100_000)
    assert channel.busy_us(C) == (1000, 1168)
    channel.queue.run_until(3_000_000)
    assert channel.listeners[C].received == [(B, 1168.0)]


def test_station_that_sends_while_receiving_senses_the_rest_by_its_energy():
    channel = Channel({(A, C): -75.0}, **MISSED)
    channel.send(1000, A, frame_bytes=1014)
    channel.send(1100, C)
    channel.queue.run_until(1_300_000)
    assert channel.busy_us(C) == (1000, 1100)
    channel.queue.run_until(3_000_000)
    # the rest of the own transmission counts as busy, and nothing after it
    assert channel.radios.surveyed_ns()[C] == 260_000


@pytest.mark.parametrize(
    ("margin_db", "later_us", "captured"), [(5.1, 16, True), (4.9, 16, False), (5.1, 17, False)]
)
def test_capture_takes_five_db_within_sixteen_microseconds(margin_db, later_us, captured):
    hidden = {(A, C): -70.0, (B, C): -70.0 + margin_db, (A, B): UNDETECTED_DBM, (B, A): UNDETECTED_DBM}
    channel = Channel(hidden)
    channel.send(1000, A)
    channel.send(1000 + later_us, B)
    channel.queue.run_until(1_050_000)
    assert channel.row(C).locked_frame == (2 if captured else 1)  # frames are numbered as they begin


@pytest.mark.parametrize(("power_dbm", "found"), [(-81.9, True), (-82.1, False)])
def test_preambles_are_detected_down_to_the_threshold(power_dbm, found):
    channel = Channel({(A, C): power_dbm})
    channel.send(1000, A)
    channel.queue.run_until(MILLISECOND_NS * 2)
    assert bool(channel.listeners[C].received) is found


# --- interferers


@pytest.mark.parametrize("duty_cycle", [0.1, 0.5, 0.9])
def test_an_interferer_occupies_the_medium_for_its_duty_cycle(duty_cycle):
    """Some 10^4 bursts and pauses, exponential both: the share's standard error is 1.4 % (1 - duty cycle)."""
    channel = Channel(stations=1, interferers=interferer(duty_cycle))
    channel.queue.run_until(round(10 * SECOND_NS / duty_cycle))
    assert channel.radios.busy_ns() / channel.queue.now_ns == pytest.approx(duty_cycle, rel=0.05)
    assert channel.ended == []


def test_duty_cycles_of_0_and_1():
    assert Channel(interferers=interferer(0.0)).queue.next_ns() == NEVER_NS
    channel = Channel(interferers=interferer(1.0), delay_ns=500)
    # from the first burst on no receiver senses an idle nanosecond
    for at_ns in range(1_000, SECOND_NS, 7_300_000):
        channel.queue.run_until(at_ns)
        for row in map(channel.row, range(3)):
            assert (row.busy_from_ns, row.idle_before_ns) == (500, 0)
            assert row.busy_until_ns > at_ns
        assert channel.radios.busy_ns() == at_ns


def test_a_long_burst_is_one_busy_period_in_parts_that_follow_the_receivers():
    trajectories = Trajectories(1)
    trajectories.set(0, [(100.0, 0.0, 0.0)], [(-90.0, 0.0, 0.0)])
    config = RadioConfig(bandwidth_mhz=20, interferers=interferer(1.0, 1e7))
    links = make_links(config, trajectories, 1, seed=1)
    channel = Channel(stations=1, links=links, interferers=config.interferers)
    # 20 dBm less 46.78 dB over 1 m are -62 dBm at 57.6 m, after 471 ms: from the part at 480 ms on it is busy
    channel.queue.run_until(479 * MILLISECOND_NS)
    assert channel.busy_us(0) == (0, 0)
    channel.queue.run_until(990 * MILLISECOND_NS)
    assert channel.row(0).busy_from_ns == pytest.approx(480 * MILLISECOND_NS, abs=1_000)
    assert channel.radios.busy_ns() == 990 * MILLISECOND_NS


def burst_over(channel):
    """(start, end) in ns of the first burst after 1 ms that lasts over 1 ms, from the energy at A."""
    row = channel.row(A)
    while not (row.busy_from_ns > MILLISECOND_NS and row.busy_until_ns - row.busy_from_ns > MILLISECOND_NS):
        channel.queue.run_until(channel.queue.next_ns())
    return row.busy_from_ns, row.busy_until_ns


# the frame of C's choice lies within the burst, overlaps its beginning by half, or has ended before it
@pytest.mark.parametrize(("before_us", "lost"), [(-10, True), (80, True), (170, False)])
@pytest.mark.parametrize("interference_dbm", [-50.0, -100.0])
def test_frames_are_lost_under_a_strong_burst(before_us, lost, interference_dbm):
    settings = {"interferers": interferer(0.2, 2_000.0), "seed": 3}
    begin_ns, _ = burst_over(Channel(**settings))
    channel = Channel({("x", B): interference_dbm}, **settings)
    channel.send(begin_ns // 1_000 - before_us, A, B)
    channel.queue.run_until(begin_ns + MILLISECOND_NS)
    frame = channel.ended[0]
    assert frame.source == A
    if lost and interference_dbm == -50.0:
        assert frame.collided == [B]
        # under the burst there is no preamble to be found; before it there was
        assert bool(channel.row(B).last_error_ns) is (before_us > 0)
    else:
        assert frame.delivered == [B]


def test_a_burst_is_sensed_by_its_energy_alone_and_with_that_of_others():
    settings = {"interferers": interferer(0.2, 2_000.0), "seed": 3}
    begin_ns, end_ns = burst_over(Channel(**settings))
    # at -64 dBm a frame is not sensed by itself with this threshold of preambles
    settings |= {"cca_preamble_dbm": -60.0}
    powers = {("x", A): -60.0, ("x", B): -64.0, ("x", C): -64.0, (A, B): -64.0, (A, C): UNDETECTED_DBM}
    channel = Channel(powers, **settings)
    channel.send(begin_ns // 1_000 + 100, A, C)
    channel.queue.run_until(begin_ns + 200_000)
    assert channel.row(A).busy_until_ns == end_ns
    assert channel.row(C).busy_until_ns == 0
    # -64 dBm twice are -61, as long as A sends; no preamble can be found at 0 dB
    start_us = begin_ns // 1_000 + 100
    assert channel.busy_us(B) == (start_us, start_us + 160)
    channel.queue.run_until(end_ns)
    assert [listener.received for listener in channel.listeners] == [[], [], []]


# --- fading


def test_frames_have_the_faded_power_of_their_beginning():
    config = RadioConfig(bandwidth_mhz=20, rician_k_db=-10.0, fading_doppler_hz=20.0)
    trajectories = Trajectories(2)
    trajectories.set(0, [(0.0, 0.0, 0.0), (10.0, 0.0, 0.0)], [(0.0, 0.0, 0.0)] * 2)
    links = make_links(config, trajectories, 2, seed=4)
    channel = Channel(stations=2, links=links, rician_k_db=-10.0)
    for k in range(30):
        channel.send(10_000 * k, k % 2)
    channel.queue.run_until(SECOND_NS)
    mean_mw = links.row(A, 0).powers_mw[B]
    powers = np.array([frame.powers_mw[1 - frame.source] for frame in channel.ended])
    expected = [
        mean_mw * gain(links.fading.block, 2, frame.source, 1 - frame.source, frame.start_ns)
        for frame in channel.ended
    ]
    assert powers.tolist() == expected
    assert powers.max() > 10.0 * powers.min()


# --- with stations


def bursts_of(settings, seed, until_ns):
    """When the only interferer of a run sends."""
    source = Interferer(
        0, settings, RandomStreams(np.random.SeedSequence(seed)).generator(Model.INTERFERENCE, 0)
    )
    bursts_ns, at_ns = [], source.first_ns()
    while at_ns < until_ns:
        bursts_ns.append((at_ns, at_ns + source.burst_ns()))
        at_ns = bursts_ns[-1][1] + source.pause_ns()
    return bursts_ns


@pytest.mark.parametrize(("eirp_dbm", "sensed"), [(20.0, True), (-10.0, False)])
def test_stations_defer_to_an_interferer_that_they_sense(eirp_dbm, sensed):
    """At 10 m 20 dBm arrive with -46.8 dBm, -10 dBm with -76.8 under the threshold.

    Half of the time the medium is busy: of 400 frames sent without carrier sense, 200 would begin in a burst.
    """
    settings = InterfererConfig(
        pos_ned_m=(0.0, 10.0, 0.0), duty_cycle=0.5, eirp_dbm=eirp_dbm, burst_us=3_000.0
    )
    swarm = Swarm(
        [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)],
        rician_k_db=None,
        broadcast_rts=False,
        interferers=(settings,),
    )
    for k in range(400):
        swarm.broadcast(0, 5_000 * k)
    swarm.run(2_100_000)
    frames = swarm.emulator.take_frames()
    assert len(frames) == 400
    bursts_ns = bursts_of(settings, 1, 2_100_000_000)
    # from the burst's arrival, 33 ns after its beginning, until DIFS after its end
    within = sum(
        any(begin + 40 < frame.start_ns < end + 34_000 for begin, end in bursts_ns) for frame in frames
    )
    assert within == 0 if sensed else within > 100
    assert swarm.emulator.busy_ns > 0.9 * sum(end - begin for begin, end in bursts_ns)


def saturated_mbps(power_dbm, *, spread_db=0.0, stations=5, seconds=3, seed=1, **settings):
    """Return the payload of saturated stations received by one more, with powers about this one."""
    generator = np.random.default_rng(3)
    powers_dbm = {}
    for i in range(stations + 1):
        for j in range(i):
            powers_dbm[i, j] = powers_dbm[j, i] = power_dbm + generator.uniform(-spread_db, spread_db)
    air = Air(stations + 1, powers_dbm=powers_dbm, seed=seed, **settings)
    outcomes = []

    def feed(source):
        def done(_job, outcome):
            outcomes.append(outcome)
            feed(source)

        job = Job(
            kind=FrameKind.DATA,
            destination=stations,
            mode=phy_mode("ofdm6", 20),
            frame_bytes=500,
            expires_ns=NEVER_NS,
            retry_limit=7,
            done=done,
        )
        air.stations[source].enqueue("vo" if settings else "be", job)

    for source in range(stations):
        feed(source)
        feed(source)
    air.queue.run_until(seconds * SECOND_NS)
    return 500 * 8 * outcomes.count(JobOutcome.ACKNOWLEDGED) / seconds / 1e6


@pytest.mark.parametrize("settings", [{}, {"access": "edca"}])
def test_weak_stations_share_the_medium_as_well_as_strong_ones(settings):
    """With equal powers nothing depends on the power; with others captures let more through."""
    strong = saturated_mbps(-50.0, **settings)
    assert strong > 2.5
    assert saturated_mbps(-70.0, **settings) == strong
    assert saturated_mbps(-70.0, spread_db=6.0, **settings) > 0.97 * strong


def test_continuous_interferers_do_not_accumulate_state():
    swarm = Swarm(
        [(0.0, 0.0, -10.0), (10.0, 0.0, -10.0)],
        interferers=2 * interferer(1.0),
    )
    swarm.run(1_000_000)
    # about 2000 bursts have been; two are on the air, and their successors may be
    tables = swarm.emulator._channel.tables
    free, row = 0, tables.air[0].free_signal
    while row != NOTHING:
        free, row = free + 1, tables.signals[row].next_signal
    assert free >= len(tables.signals) - 4
