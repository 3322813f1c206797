"""A maximum-likelihood decoder of the HRP UWB PHY's convolutional code, for comparison with its tables."""

import numpy as np

RS_SYMBOL_BITS = 6


def error_rates(energy_ratio, *, blocks, bits, seed):
    """Simulate coherent reception of ``blocks`` of ``bits`` over white noise with E / N0 of a symbol.

    Return the rates of wrong bits and of wrong 6-bit symbols. The position of a symbol is the bit before, its
    polarity the sum of the bit and the one before the last. Two zeros end a block.
    """
    rng = np.random.default_rng(seed)
    sent = rng.integers(0, 2, (blocks, bits))
    padded = np.pad(sent, ((0, 0), (2, 2)))
    positions, parities = padded[:, 1:-1], padded[:, 2:] ^ padded[:, :-2]
    received = rng.normal(0.0, np.sqrt(0.5 / energy_ratio), (blocks, bits + 2, 2))
    rows, columns = np.indices(positions.shape)
    received[rows, columns, positions] += 1.0 - 2.0 * parities
    # state 2 a + b: the last bit a, the one before b
    metrics = np.full((blocks, 4), -np.inf)
    metrics[:, 0] = 0.0
    origins = np.empty((bits + 2, blocks, 4), np.int8)
    for step in range(bits + 2):
        reached = np.full((blocks, 4), -np.inf)
        for last in (0, 1):
            for bit in (0, 1) if step < bits else (0,):
                options = np.stack(
                    [
                        metrics[:, 2 * last + before] + (1.0 - 2.0 * (bit ^ before)) * received[:, step, last]
                        for before in (0, 1)
                    ]
                )
                before = options.argmax(axis=0)
                reached[:, 2 * bit + last] = options.max(axis=0)
                origins[step, :, 2 * bit + last] = 2 * last + before
        metrics = reached
    state = np.zeros(blocks, np.int64)
    decided = np.empty((blocks, bits + 2), np.int64)
    for step in reversed(range(bits + 2)):
        decided[:, step] = state // 2
        state = origins[step, np.arange(blocks), state].astype(np.int64)
    wrong = decided[:, :bits] != sent
    symbols = wrong[:, : bits - bits % RS_SYMBOL_BITS].reshape(blocks, -1, RS_SYMBOL_BITS).any(axis=2)
    return wrong.mean(), symbols.mean()
