"""A sampling profiler of processor time by part of a process.

Import `profiler`. Which modules form a part is left to each process's `profile_groups`.
"""
