"""Validation of the 802.11 emulator against ns-3, Bianchi's model and the standard; and its benchmark.

Import `cli`, which makes docs/results/radio-validation.md, or `bench_cli`; each ``*_section`` is a part of
the page. The simulations are left to `netsim.lab`, runner and report to `studies.common`.
"""
