"""Kernels of the link simulation: convolutional encoder, modulator and soft-decision decoder."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

# Delays, in bits, of the taps of the generators 133 and 171 (octal); the highest digit is the newest bit.
_TAPS = ((0, 2, 3, 5, 6), (0, 1, 2, 3, 6))
_MATH = {"nnan", "nsz"}
"""Allows vectorised loops but keeps the order of sums: results of a seed are equal on all processors."""
_BLOCK_BITS = 8
"""Bits that the decoder decides at a time."""


def _outputs() -> NDArray[np.uint8]:
    """Return the (2, 128) outputs A and B by the last seven bits, newest bit lowest."""
    last = np.arange(128)
    return np.array([sum((last >> delay) & 1 for delay in delays) % 2 for delays in _TAPS], np.uint8)


_OUTPUTS = _outputs()
_SIGNS = _OUTPUTS[:, :64:2].astype(np.float32) * 2.0 - 1.0
"""(2, 32): outputs A and B as signs, for input 0 in states below 32.

Both generators tap the newest and the oldest bit, so both outputs are inverted with either of them.
"""


@njit(cache=True)
def encode(bits: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Encode (frames, n) bits from state 0 at rate 1/2; return (frames, 2 n), outputs A and B alternating."""
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
    """Map (frames, 2 n) outputs of the encoder to (frames, m) amplitudes ``sent``."""
    for f in range(sent.shape[0]):
        for k in range(sent.shape[1]):
            value = 0
            for b in range(on_air.shape[1]):
                value = 2 * value + coded[f, on_air[k, b]]
            sent[f, k] = levels[value]


@njit(cache=True, fastmath=_MATH)
def _demap(
    received: NDArray[np.float32],
    on_air: NDArray[np.int64],
    levels_by_bit: NDArray[np.float32],
    likelihoods: NDArray[np.float32],
) -> None:
    """Compute the max-log likelihood ratio of each bit, up to a common factor; positive means 1.

    It is the least squared distance to a level with 0 in that place minus that to a level with 1.
    """
    for k in range(received.size):
        y = received[k]
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
    """Do one step of the Viterbi algorithm: update ``metric`` and ``decision`` (1: upper path) by state.

    States j and j + 32 both lead to 2 j and 2 j + 1: a butterfly with one branch metric of either sign.
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
    """Trace the path to ``state`` back from bit ``last`` to ``first``; store its bits below ``until``."""
    for t in range(last, first - 1, -1):
        bit = state & 1
        if t < until:
            decoded[t] = bit
        state = (state >> 1) | (decisions[t, (state >> 1) + 32 * bit] << 5)


@njit(cache=True, fastmath=_MATH)
def _viterbi(
    likelihoods: NDArray[np.float32], delay: int, decisions: NDArray[np.uint8], decoded: NDArray[np.uint8]
) -> None:
    """Find the most likely path from state 0 to state 0; decide bits after about ``delay`` further bits.

    Bits are decided in blocks, the middle of a block after that delay, from the best path at that time.
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
    received: NDArray[np.float32],
    on_air: NDArray[np.int64],
    levels_by_bit: NDArray[np.float32],
    delay: int,
    decoded: NDArray[np.uint8],
) -> None:
    """Decode (frames, m) noisy amplitudes into (frames, n) bits, each decided about ``delay`` bits later."""
    n = decoded.shape[1]
    likelihoods = np.zeros(2 * n, np.float32)  # punctured bits stay 0
    decisions = np.empty((n, 64), np.uint8)
    for f in range(received.shape[0]):
        _demap(received[f], on_air, levels_by_bit, likelihoods)
        _viterbi(likelihoods, delay, decisions, decoded[f])
