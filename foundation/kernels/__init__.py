"""Compiled numerical kernels: the folder of the on-disk cache.

Import `cache_folder` before Numba. Compiling all kernels ahead of a flight is left to `harness.launch`.
"""
