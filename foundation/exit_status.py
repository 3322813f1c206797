"""Exit statuses of every command of coflight.

`docs/reference/exit-status.md` states what each means for each command.
"""

FINE = 0
FAILED = 1
"""What was asked for was tried and did not succeed: a run failed, a requirement is not met."""
BAD_INPUT = 2
"""Nothing was done: an option, a file or a value is wrong."""
INTERRUPTED = 130
"""Ctrl-C, as shells report it: 128 and the number of SIGINT."""
