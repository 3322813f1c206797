"""Kernels of the link simulation: the convolutional encoder, the amplitudes, and the soft decoder."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

# Delays, in bits, that the generators 133 and 171 (octal) add: their highest digit is the newest bit.
_TAPS = ((0, 2, 3, 5, 6), (0, 1, 2, 3, 6))
_MATH = {"nnan", "nsz"}
"""Lets loops be vectorised; sums keep their order, so that a seed counts the same on every processor."""
_BLOCK_BITS = 8
"""Bits that the decoder settles at a time."""


def _outputs() -> NDArray[np.uint8]:
    """(2, 128) outputs A and B by the last seven bits, the newest lowest."""
    last = np.arange(128)
    return np.array([sum((last >> delay) & 1 for delay in delays) % 2 for delays in _TAPS], np.uint8)


_OUTPUTS = _outputs()
_SIGNS = _OUTPUTS[:, :64:2].astype(np.float32) * 2.0 - 1.0
"""(2, 32): A and B as signs when a 0 comes in a state below 32.

Both generators take the newest bit and the oldest: both outputs turn over with either of them.
"""


@njit(cache=True)
def encode(bits: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Encode (frames, n) bits from state 0 at rate 1/2: (frames, 2 n), outputs A and B in turn."""
    frames, n = bits.shape
    coded = np.empty((frames, 2 * n), np.uint8)
    for f in range(frames):
        last = 0  # seven bits, the newest lowest
        for t in range(n):
            last = ((last << 1) | bits[f, t]) & 127
            coded[f, 2 * t] = _OUTPUTS[0, last]
            coded[f, 2 * t + 1] = _OUTPUTS[1, last]
    return coded


@njit(cache=True)
def modulate(
    coded: NDArray[np.uint8],
    on_air: NDArray[np.int64],
    levels: NDArray[np.float32],
    sent: NDArray[np.float32],
) -> None:
    """Turn (frames, 2 n) outputs of the encoder into (frames, m) amplitudes."""
    for f in range(sent.shape[0]):
        for k in range(sent.shape[1]):
            value = 0
            for b in range(on_air.shape[1]):
                value = 2 * value + coded[f, on_air[k, b]]
            sent[f, k] = levels[value]


@njit(cache=True, fastmath=_MATH)
def _demap(
    heard: NDArray[np.float32],
    on_air: NDArray[np.int64],
    levels_by_bit: NDArray[np.float32],
    likelihoods: NDArray[np.float32],
) -> None:
    """Give each bit's max-log likelihood ratio, to a common factor: positive for a 1.

    It is the least squared distance to a level with a 0 there, less that to one with a 1.
    """
    for k in range(heard.size):
        y = heard[k]
        for b in range(on_air.shape[1]):
            zero = one = np.float32(np.inf)
            for i in range(levels_by_bit.shape[2]):
                zero = min(zero, (y - levels_by_bit[b, 0, i]) ** 2)
                one = min(one, (y - levels_by_bit[b, 1, i]) ** 2)
            likelihoods[on_air[k, b]] = zero - one


@njit(cache=True, fastmath=_MATH)
def _add_compare_select(
    a: np.float32,
    b: np.float32,
    metric: NDArray[np.float32],
    zero: NDArray[np.float32],
    one: NDArray[np.float32],
    decision: NDArray[np.uint8],
) -> None:
    """Take one step of Viterbi's algorithm: ``metric`` by state, ``decision`` whether the path is the higher.

    States j and j + 32 both lead to 2 j and 2 j + 1: a butterfly with one metric, taken with either sign.
    """
    for j in range(32):
        step = _SIGNS[0, j] * a + _SIGNS[1, j] * b
        low, high = metric[j] + step, metric[j + 32] - step
        zero[j] = max(low, high)
        decision[j] = high > low
        low, high = metric[j] - step, metric[j + 32] + step
        one[j] = max(low, high)
        decision[j + 32] = high > low
    for j in range(32):
        metric[2 * j] = zero[j]
        metric[2 * j + 1] = one[j]


@njit(cache=True)
def _trace_back(
    decisions: NDArray[np.uint8], state: int, last: int, first: int, until: int, decoded: NDArray[np.uint8]
) -> None:
    """Follow the path to ``state`` from bit ``last`` back to bit ``first``; keep its bits below ``until``."""
    for t in range(last, first - 1, -1):
        bit = state & 1
        if t < until:
            decoded[t] = bit
        state = (state >> 1) | (decisions[t, (state >> 1) + 32 * bit] << 5)


@njit(cache=True, fastmath=_MATH)
def _viterbi(
    likelihoods: NDArray[np.float32],
    delay: int,
    decisions: NDArray[np.uint8],
    decoded: NDArray[np.uint8],
) -> None:
    """Find the likeliest path from state 0 to state 0, settling bits about ``delay`` bits after they came.

    They are settled in blocks, the middle of a block after that delay, by the path that is then the best.
    """
    n = decoded.size
    metric = np.full(64, np.float32(-1e9))
    metric[0] = 0.0
    zero = np.empty(32, np.float32)
    one = np.empty(32, np.float32)
    settled = 0
    for t in range(n):
        _add_compare_select(likelihoods[2 * t], likelihoods[2 * t + 1], metric, zero, one, decisions[t])
        if t == settled + _BLOCK_BITS // 2 + delay:
            best = int(np.argmax(metric))
            _trace_back(decisions, best, t, settled, settled + _BLOCK_BITS, decoded)
            settled += _BLOCK_BITS
        if t % 64 == 63:  # metrics must not outgrow their precision
            metric -= metric[0]
    _trace_back(decisions, 0, n - 1, settled, n, decoded)


@njit(cache=True, fastmath=_MATH)
def decode(
    heard: NDArray[np.float32],
    on_air: NDArray[np.int64],
    levels_by_bit: NDArray[np.float32],
    delay: int,
    decoded: NDArray[np.uint8],
) -> None:
    """Decode (frames, m) noisy amplitudes into (frames, n) bits, each settled some ``delay`` bits later."""
    n = decoded.shape[1]
    likelihoods = np.zeros(2 * n, np.float32)  # what was punctured stays 0
    decisions = np.empty((n, 64), np.uint8)
    for f in range(heard.shape[0]):
        _demap(heard[f], on_air, levels_by_bit, likelihoods)
        _viterbi(likelihoods, delay, decisions, decoded[f])
