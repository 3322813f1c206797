"""Random streams: one independent NumPy Generator per model and link.

A stream depends only on the run's seed, its model and its indices, not on the order of creation.
"""

from collections.abc import Callable
from enum import IntEnum
from itertools import chain, islice, repeat

import numpy as np
from numpy.typing import NDArray


class Model(IntEnum):
    """Purpose of a stream. Values enter the seed: append, never renumber."""

    BACKOFF = 0
    RECEPTION = 1
    FADING = 2
    SHADOWING = 3
    HOST = 4
    CLOCK = 5
    TIME_STAMP = 6
    CALIBRATION = 7
    OBSTRUCTION = 8
    INTERFERENCE = 9
    NLOS_BIAS = 10
    RATE = 11
    HOST_LOSS = 12
    PATH_LOSS = 13
    ERROR_MODEL = 14
    ANTENNA = 15
    SERIAL_RADIO = 16
    UWB = 17


class FloatStream:
    """Floats from one Generator, drawn in blocks, since a single draw takes a microsecond.

    ``more`` draws the given number of floats: a method of the Generator.
    """

    BLOCK = 256

    def __init__(self, more: Callable[[int], NDArray[np.float64]]) -> None:
        self._floats = chain.from_iterable(more(size).tolist() for size in repeat(self.BLOCK))
        self.draw: Callable[[], float] = self._floats.__next__
        """Return the next float of the stream."""

    def take(self, count: int) -> list[float]:
        """Return the next ``count`` floats of the stream."""
        return list(islice(self._floats, count))

    def discard_drawn(self) -> None:
        """Discard what was drawn in advance: the next floats come from the Generator's present state."""
        self.take(self.BLOCK)  # the rest of the present block, and as much of the next one


class RandomStreams:
    """Generators derived from one seed."""

    def __init__(self, seed: np.random.SeedSequence) -> None:
        self._seed = seed

    def generator(self, model: Model, *index: int) -> np.random.Generator:
        """Return a new Generator at the beginning of this model's stream for a station, link or pair."""
        key = (*self._seed.spawn_key, int(model), *index)
        return np.random.default_rng(np.random.SeedSequence(self._seed.entropy, spawn_key=key))

    def uniforms(self, model: Model, *index: int) -> FloatStream:
        """Return uniform floats in [0, 1) from `generator`."""
        return FloatStream(self.generator(model, *index).random)
