"""A sampling profiler of CPU time by part of a process.

Import `profiler`. Each process defines its parts in `profile_groups`.
"""
