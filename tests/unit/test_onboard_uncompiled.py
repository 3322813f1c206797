"""The application's kernels give the same bits whether or not they are compiled."""

import numpy as np
import pytest

from autopilot.onboard import avoidance, common_frame, formation, kernels, uncertainty

N = 4
RNG = np.random.default_rng(0)


def some(*shape, size=1.0):
    return size * RNG.standard_normal(shape)


def cov():
    root = some(5 * N, 5 * N, size=0.3)
    return root @ root.T


def filtered():
    return some(5 * N), cov()


def flags():
    return RNG.uniform(size=N) < 0.7


def told(count):
    rows = np.zeros(count, common_frame.TOLD)
    rows["heard_us"] = RNG.integers(6_000_000, 12_000_000, size=count)
    rows["fix_us"] = RNG.integers(9_000_000, 10_000_000, size=count)
    rows["fix_ne_m"], rows["error_ne_m"], rows["variance_m2"] = some(count, 2, size=9.0), some(count, 2), 2.25
    return rows


CASES = {
    common_frame.laid_onto: lambda: (some(5, 2, size=6.0), some(5, 2, size=0.3)),
    common_frame.to_everybodys_gps: lambda: (10_000_000, told(7), 1.0, -2.0),
    common_frame.play_round: lambda: (
        2, 10_000_000, np.array((0, 2, 3, 5)), told(7), some(N, 6),
        RNG.integers(9_900_000, 10_000_000, size=N),
        np.tile(np.arange(9_000_000, 10_000_000, 125_000), (N, 1)),
        some(N, 8, 6), np.full(N, 8), some(5 * N), flags(), 0.2, -0.1),
    kernels.odometry_at: lambda: (
        np.arange(8) * 33_000, some(8, 6), 8, int(RNG.integers(7 * 33_000)), np.zeros(3)),
    kernels.predict: lambda: (
        *filtered(), flags(), 0.01, RNG.uniform(0.0, 0.5), 0.04, 100.0, np.full(N, 2.25), 60.0),
    kernels.student_weight: lambda: (RNG.uniform(0.0, 50.0),),
    kernels.fuse_fix: lambda: (*filtered(), 1, some(3), 0.05, 700.0),
    kernels.fuse_range: lambda: (
        *filtered(), some(5 * N), some(N, 2, size=5.0), 0, 2, some(3, size=6.0), 6.0, 0.01, -1.0, 1.0),
    uncertainty.relative_variance: lambda: (cov(), 0, 1, some(3)),
    uncertainty.relative_stds: lambda: (cov(), 0, some(N, 3, size=6.0), flags(), 0.01, np.zeros(N)),
    uncertainty.variance_between: lambda: (cov(), 0, 1, some(N, 6), some(5 * N)),
    uncertainty.seen_from: lambda: (
        1, 900_000, some(N, 6), RNG.integers(900_000, size=N), 0.5, *filtered(), flags(), 400_000, 0.01,
        np.zeros((N, 3)), np.zeros(N), flags()),
    uncertainty.shape_variance: lambda: (some(N, 3, size=6.0), cov(), np.arange(N)),
    uncertainty.bend: lambda: (
        some(N, 2, size=6.0), some(N, 2, size=6.0), cov(), np.arange(N), np.zeros((N, N)), np.zeros((N, N))),
    formation.join: lambda: (some(3), some(3), some(3), some(3, 3), 0, 2, 1.0, 0.05, bool(RNG.integers(2))),
    formation.follow: lambda: (
        some(3, 3, size=2.0), flags()[:2], some(4, 3), bool(RNG.integers(2)), 1.5, 0.05),
    avoidance.velocity_change: lambda: (
        0, 10_000_000, some(N, 3, size=3.0), some(N, 3), np.abs(some(N)), flags(), some(6, 3, size=3.0),
        some(6, 3), np.array((0, 2, 3, 5)), RNG.integers(10_000_000, size=N), np.abs(some(5 * N)), 0.5, 1.2,
        some(5)),
    avoidance.keep_clear: lambda: (
        0, some(N, 3, size=3.0), some(N, 3), flags(), np.abs(some(N)), np.full(N, 3.0), 0.5, 1.2, some(3),
        some(3), some(2), some(3), np.zeros(2)),
    avoidance.remember: lambda: (
        10_000_000, some(N, 3), some(N, 3), some(N), flags(), some(N, 3), some(N, 3),
        RNG.integers(10_000_000, size=N), some(N, 3), some(N), flags()),
}  # fmt: skip


def results(kernel, arguments):
    own = [a.copy() if isinstance(a, np.ndarray) else a for a in arguments]
    returned = kernel(*own)
    return [0.0 if returned is None else returned, *own]


@pytest.mark.parametrize("kernel", CASES, ids=lambda kernel: kernel.__name__)
def test_the_interpreter_gives_a_kernels_bits(kernel):
    for _ in range(100):
        arguments = CASES[kernel]()
        for compiled, interpreted in zip(
            results(kernel, arguments), results(getattr(kernel, "py_func", kernel), arguments), strict=True
        ):
            np.testing.assert_array_equal(compiled, interpreted, strict=False)
