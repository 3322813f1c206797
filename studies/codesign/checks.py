"""Checks of flights that several sections share, and their bounds."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from harness.campaign.intervals import Interval
from studies.codesign.book import Book
from studies.codesign.cases import CodesignCase
from studies.common.report import Check

SHAPE_MOST_M = 0.25
"""With FTM over the emulated channel, in the article's scenario"""
SEEDS_LEAST = 10
NO_WORSE_MOST = 1.1
"""Limit of the ratio of two errors where the first is claimed to be no worse: at most 10 % larger"""


def formed_check(book: Book, cases: Sequence[CodesignCase]) -> Check:
    """Check that enough flights of each case reached their formation; others have no results of it."""
    fewest = min(map(book.formed, cases))
    return Check("flights that formed, fewest", float(fewest), at_least=float(SEEDS_LEAST))


def pairs_check(what: str, count: int) -> Check:
    """Check that enough seeds have both flights."""
    return Check(f"pairs of flights, {what}", float(count), at_least=float(SEEDS_LEAST))


def fewest_pairs_check(ratios: Sequence[Interval]) -> Check:
    """Check that each ratio is based on enough pairs."""
    return pairs_check("fewest of a ratio", min(ratio.count for ratio in ratios))


def sound_checks(book: Book, cases: Sequence[CodesignCase], by: str = "with FTM") -> tuple[Check, Check]:
    """Check that all flights of the cases formed and none collided; a broken flight has not formed.

    ``by`` names the position source of the cases, because flights with GPS alone may collide.
    """
    flown = any(book.begun(case) for case in cases)
    missed = sum(book.begun(case) - book.formed(case) for case in cases)
    collided = sum(map(book.collided, cases))
    return (
        Check(f"{by}: flights that broke or did not form", float(missed) if flown else math.nan, at_most=0.0),
        Check(
            f"{by}: flights with a collision", float(collided) if any(map(book.flown, cases)) else math.nan,
            at_most=0.0,
        ),
    )  # fmt: skip


def largest_shape_check(book: Book, cases: Sequence[CodesignCase], of_what: str) -> Check:
    """Check the mean shape error of every case against the limit with FTM in the article's scenario."""
    return Check(
        f"shape error with FTM, {of_what}, largest mean", extreme(book, cases, "shape_m", np.max), "m",
        at_most=SHAPE_MOST_M,
    )  # fmt: skip


def extreme(
    book: Book, cases: Sequence[CodesignCase], what: str, which: Callable[[Sequence[float]], float]
) -> float:
    """Return the largest (``np.max``) or smallest (``np.min``) mean of the cases; NaN if one is missing."""
    return float(which([book.mean(case, what).value for case in cases]))
