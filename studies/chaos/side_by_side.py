"""Flights beside each other, each in a thread that waits for the processes of its launcher."""

import threading
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait

from studies.chaos.faults import Fault
from studies.chaos.flight import Outcome, fly_in_temporary_folder

Fly = Callable[[Fault, threading.Event], Outcome]


def fly_all(
    faults: Sequence[tuple[int, Fault]], beside: int, fly: Fly = fly_in_temporary_folder
) -> Generator[tuple[int, Outcome]]:
    """Fly ``beside`` flights at a time; yields number and outcome as each ends.

    When the iterator is closed or the caller is interrupted while it waits, all flights are cancelled, and
    their processes and folders are gone when it returns.
    """
    cancelled = threading.Event()
    waiting = iter(faults)
    under_way: dict[Future[Outcome], int] = {}
    with ThreadPoolExecutor(beside) as threads:
        try:
            while True:
                while len(under_way) < beside and (each := next(waiting, None)) is not None:
                    under_way[threads.submit(fly, each[1], cancelled)] = each[0]
                if not under_way:
                    return
                ended, _ = wait(under_way, return_when=FIRST_COMPLETED)
                for flight in ended:
                    yield under_way.pop(flight), flight.result()
        finally:
            cancelled.set()
