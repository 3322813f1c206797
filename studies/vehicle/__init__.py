"""Flight performance of one vehicle, with simulated and recorded sensors; and the benchmark of its step.

Import `cli`, which makes docs/results/validation.md, or `bench_cli`; `solo` and `rigid_body` are flights of
one vehicle, which tests use as well. Physics and sensors are in `harness.world`.
"""
