"""Compiled numerical kernels: folder of the on-disk cache, and the error of warm-ups.

Import `cache_folder` before Numba. `harness.launch` compiles all kernels before a flight.
"""
