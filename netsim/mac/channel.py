"""When a station may send: its queues' contention for a medium that it senses, physically and by NAV.

Every queue contends through its `Contender`. The medium counts as busy from `CCA_NS` after energy arrives,
while the station sends, while NAV stands, and after a broken frame for EIFS. A frame that finds it idle for
AIFS, with no backoff left, goes at once (10.3.4.2; EDCA's alignment of that to slots since the last busy
period is left out: after a long silence no two stations would agree on them).

A frame whose lifetime is over leaves its queue at once, from any place in it and however long the medium
stays busy; only an exchange that has begun goes on to its end.

What is said at access, and what follows from it, is `netsim.mac.station`'s.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping

from netsim.kernel import NEVER_NS, EventQueue
from netsim.mac.access import CCA_NS, EIFS_EXTRA_NS, SLOT_NS, AccessParameters, Contender
from netsim.mac.jobs import Job, Outcome
from netsim.phy.medium import Receiver
from netsim.phy.sensing import (
    BROKEN,
    BUSY_FROM,
    BUSY_UNTIL,
    HEEDS_BUSY,
    HEEDS_END,
    IDLE_BEFORE,
    RESERVED_UNTIL,
    SENDING_UNTIL,
    UPSET,
)
from netsim.streams import Uniforms


class ChannelAccess(ABC):
    """Queues of one station and their access; the exchange that has got it excludes all others."""

    def __init__(
        self,
        *,
        queue: EventQueue,
        receiver: Receiver,
        access: Mapping[str, AccessParameters],
        queue_frames: int,
        backoff: Uniforms,
    ) -> None:
        self._queue = queue
        self._receiver = receiver
        self._sensed = receiver.row
        """What is known of the medium, NAV included; the station heeds it while it has something to count."""
        self._access = access
        self._queue_frames = queue_frames
        self._backoff = backoff
        self._held = 0
        self._contenders: list[Contender] = []
        """Of the categories used so far, in order of falling priority."""
        self._by_category: dict[str, Contender] = {}
        self._current: Contender | None = None
        """Whose exchange it is."""
        self._silent = False
        self._wait_until_ns = 0
        self._planned = False
        """The planned accesses follow from what is known of the medium."""

    @abstractmethod
    def _begin(self, contender: Contender) -> None:
        """Start the exchange of a queue that has got access."""

    # --- queues

    def _contender(self, category: str) -> Contender:
        """Queue of a category, made when it is first used; those with the same parameters share one (DCF)."""
        contender = self._by_category.get(category)
        if contender is None:
            parameters = self._access[category]
            same = [each for each in self._contenders if each.parameters is parameters]
            if same:
                (contender,) = same
            else:
                contender = Contender(parameters, list(self._access).index(category), self._backoff)
                self._contenders.append(contender)
                self._contenders.sort(key=lambda each: each.priority)
            self._by_category[category] = contender
        return contender

    def _drop_expired(self, contender: Contender) -> None:
        now = self._queue.now_ns
        while contender.jobs and (contender.jobs[0].expires_ns <= now or contender.jobs[0].cancelled):
            self._give_up(contender, Outcome.EXPIRED)

    def _watch(self, contender: Contender, expires_ns: int) -> None:
        """Look for frames whose lifetime is over at that time, which is before any other that is planned."""
        if contender.deadline is not None:
            self._queue.cancel(contender.deadline)
        contender.deadline_ns = expires_ns
        contender.deadline = self._queue.at(max(expires_ns, self._queue.now_ns), self._on_deadline, contender)

    def _unwatch(self, contender: Contender) -> None:
        if contender.deadline is not None:
            self._queue.cancel(contender.deadline)
            contender.deadline = None
            contender.deadline_ns = NEVER_NS

    def _on_deadline(self, contender: Contender) -> None:
        """End the frames whose lifetime is over, all but the one that is being exchanged."""
        self._unwatch(contender)
        now = self._queue.now_ns
        jobs = contender.jobs
        expired = [job for job in jobs if job.expires_ns <= now]
        if expired and contender is self._current and expired[0] is jobs[0]:
            del expired[0]  # it ends with its exchange
        for job in expired:
            jobs.remove(job)
        self._held -= len(expired)
        next_ns = min((job.expires_ns for job in jobs if job.expires_ns > now), default=NEVER_NS)
        if next_ns < NEVER_NS:
            self._watch(contender, next_ns)
        for job in expired:
            job.done(job, Outcome.EXPIRED)

    def _give_up(self, contender: Contender, outcome: Outcome) -> None:
        job = contender.jobs.popleft()
        self._held -= 1
        if not contender.jobs:
            self._unwatch(contender)
        job.done(job, outcome)

    def _full(self) -> bool:
        """Whether no frame can be taken, those gone whose lifetime is over."""
        if self._held >= self._queue_frames:
            for contender in self._contenders:
                if contender is not self._current:
                    self._drop_expired(contender)
        return self._held >= self._queue_frames

    def _contend(self, category: str, job: Job) -> None:
        """Queue a frame, and plan its access if it is the first."""
        self._heed()
        contender = self._contender(category)
        first = not contender.jobs
        contender.jobs.append(job)
        self._held += 1
        if job.expires_ns < contender.deadline_ns:
            self._watch(contender, job.expires_ns)
        if not first or self._current is contender:
            return
        busy = self._medium_busy()
        remaining_ns = contender.backoff_slots * SLOT_NS
        if not remaining_ns or (not busy and self._queue.now_ns >= contender.base_ns + remaining_ns):
            contender.backoff_slots = 0
            contender.fresh = not busy
            if busy:
                contender.draw_backoff()
        self._resume()

    def _fail(self, contender: Contender) -> None:
        """Back off after an exchange in vain; the retry limit or the lifetime may end its frame."""
        job = contender.jobs[0]
        job.failures += 1
        if job.failures > job.retry_limit:
            contender.succeeded()
            self._give_up(contender, Outcome.RETRY_LIMIT)
            return
        contender.collided()
        if job.expires_ns <= self._queue.now_ns:
            self._give_up(contender, Outcome.EXPIRED)

    # --- the medium

    def on_busy(self, from_ns: int) -> None:
        """See `netsim.phy.medium.Listener`."""
        if self._planned:
            self._freeze(from_ns + CCA_NS)

    def on_air_changed(self) -> None:
        """See `netsim.phy.medium.Listener`."""
        if not self._planned and self._current is None:
            self._resume()

    def on_unused(self) -> None:
        """See `netsim.phy.medium.Listener`."""
        self._sensed[UPSET] = True
        self._revise()
        self._resume()

    def _medium_busy(self) -> bool:
        now = self._queue.now_ns
        sensed = self._sensed
        return (
            self._current is not None
            or sensed[BUSY_FROM] + CCA_NS < now < sensed[BUSY_UNTIL]
            or now < sensed[RESERVED_UNTIL]
            or now < sensed[SENDING_UNTIL]
        )

    # --- accesses

    def _heed(self) -> None:
        """Be told of what happens on the medium: with a plan of what upsets it, without one of every end."""
        self._sensed[HEEDS_BUSY] = self._planned
        self._sensed[HEEDS_END] = not self._planned

    def _freeze(self, sensed_ns: int) -> None:
        """Stop all backoffs, as the medium is sensed busy from then on."""
        self._planned = False
        self._sensed[HEEDS_BUSY] = False
        attentive = self._held > 0
        for contender in self._contenders:
            contender.freeze(sensed_ns)
            if contender.backoff_slots:
                attentive = True
        # with nothing to send and no backoff to count, the station stays frozen until that changes
        self._sensed[HEEDS_END] = attentive

    def _revise(self) -> None:
        """Withdraw a plan that is upset; the medium is still busy, or by NAV."""
        if self._planned and self._sensed[UPSET]:
            self._freeze(self._queue.now_ns)

    def _resume(self) -> None:
        """Plan each queue's next access from what is known of the medium; what changes that calls again."""
        now = self._queue.now_ns
        sensed = self._sensed
        sending_until_ns = sensed[SENDING_UNTIL]
        if (
            self._current is not None
            or sending_until_ns > now
            or self._silent
            or not (sensed[HEEDS_END] or self._planned)
        ):
            return
        nav_until_ns = sensed[RESERVED_UNTIL]
        idle_ns = sensed[BUSY_UNTIL]
        unsensed = False
        # what NAV covers holds back no plan, and so no frame that comes meanwhile
        if idle_ns > now and idle_ns > nav_until_ns:
            # a busy period that the station cannot have sensed yet does not hold it back
            unsensed = now <= sensed[BUSY_FROM] + CCA_NS
            if not unsensed:
                return
            idle_ns = sensed[IDLE_BEFORE]
        eifs_until_ns = sensed[BROKEN] and sensed[BROKEN] + EIFS_EXTRA_NS
        idle_ns = max(idle_ns, sending_until_ns, nav_until_ns, eifs_until_ns, self._wait_until_ns)
        self._planned = True
        sensed[UPSET] = False
        self._heed()
        for contender in self._contenders:
            if unsensed and contender.backoff_slots and contender.base_ns == NEVER_NS:
                continue  # the slots before that busy period were counted when it froze the backoff
            base_ns = contender.base_ns = idle_ns + contender.aifs_ns
            if not contender.jobs:
                continue
            access_ns = base_ns + contender.backoff_slots * SLOT_NS
            if access_ns < now:
                access_ns = now
            if contender.access is not None:
                if contender.access_ns == access_ns:
                    continue
                self._queue.cancel(contender.access)
            contender.access_ns = access_ns
            contender.access = self._queue.at(access_ns, self._on_access, contender)
        if unsensed:
            self._freeze(sensed[BUSY_FROM] + CCA_NS)

    def _on_access(self, contender: Contender) -> None:
        contender.access = None
        now = self._queue.now_ns
        if self._current is not None or self._sensed[SENDING_UNTIL] > now:
            contender.base_ns = NEVER_NS
            return
        self._drop_expired(contender)
        if not contender.jobs:
            self._resume()
            return
        winner = contender
        if len(self._contenders) > 1:
            winner = self._collide_inside(contender, now)
        self._current = winner
        winner.backoff_slots = 0
        winner.fresh = False
        self._begin(winner)

    def _collide_inside(self, contender: Contender, now: int) -> Contender:
        """Of queues that would send at one time the first in priority does; the others have collided."""
        rivals = [
            each
            for each in self._contenders
            if each is contender or (each.access is not None and each.access_ns <= now)
        ]
        for rival in rivals:
            self._drop_expired(rival)
        rivals = [rival for rival in rivals if rival.jobs]
        winner = self._current = rivals[0]
        for rival in rivals:
            if rival.access is not None:
                self._queue.cancel(rival.access)
                rival.access = None
            if rival is not winner:
                rival.base_ns = NEVER_NS
                self._fail(rival)
        return winner
