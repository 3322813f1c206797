"""New random numbers for an episode that continues a state in the air: the only place that reseeds.

`RandomStreams` are all NumPy Generators of this process, also those of user code. A Generator is identified
by the SeedSequence that it was made from; its new state is that of the same SeedSequence with the episode's
seed appended, so it depends on nothing else.

Not reseeded, as it was drawn when the flight began: constant errors of sensors, clocks and pairs of radios,
the waves of fading and shadowing, and all present values, such as wind, drifts and estimates, which continue.
Nor are Generators whose seed is not from a SeedSequence, and Python's ``random``.
"""

import gc
from typing import Protocol

import numpy as np

from harness.world.sensors.errors import SensorError
from harness.world.wind.force import GustyWind
from harness.world.wind.turbulence import Turbulence
from netsim.mac.radios import Radios
from netsim.model.random_streams import FloatStream

STREAM = 26
"""Key that separates the seeds of episodes from those of a run."""


class _DrawsAhead(Protocol):
    def discard_drawn(self) -> None: ...


_SECOND = (SensorError, GustyWind, Turbulence, Radios)
"""What draws in advance, of Generators or of `FloatStream`."""


class RandomStreams:
    """All random streams of this process; to be created before `gc.freeze`, which hides them."""

    def __init__(self) -> None:
        objects = gc.get_objects()
        self._generators = [each for each in objects if isinstance(each, np.random.Generator)]
        self._first: list[_DrawsAhead] = [each for each in objects if isinstance(each, FloatStream)]
        self._second: list[_DrawsAhead] = [each for each in objects if isinstance(each, _SECOND)]

    def __len__(self) -> int:
        return len(self._generators)

    def reseed(self, seed: int) -> None:
        """Give every Generator the state of its stream in the episode with this seed, 0 or greater."""
        for generator in self._generators:
            bits = generator.bit_generator
            own = bits.seed_seq
            if isinstance(own, np.random.SeedSequence):
                entropy = [*np.atleast_1d(np.asarray(own.entropy, dtype=object)).tolist(), STREAM, seed]
                state = type(bits)(np.random.SeedSequence(entropy, spawn_key=own.spawn_key)).state
                bits.state = state
        for each in self._first:
            each.discard_drawn()
        for each in self._second:
            each.discard_drawn()
