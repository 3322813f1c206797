"""Counter of invalid messages with a bounded number of log lines."""

import logging

logger = logging.getLogger(__name__)


class MalformedCount:
    """Counts invalid messages of one kind; the 1st, 10th, 100th and so on is logged."""

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._logged_at = 1
        self.count = 0
        """Number of messages so far."""

    def add(self, size: int) -> None:
        """Count a message of ``size`` bytes."""
        self.count += 1
        if self.count == self._logged_at:
            self._logged_at *= 10
            logger.warning(
                "dropped %d bytes that are not a valid %s; %d so far", size, self._kind, self.count
            )
