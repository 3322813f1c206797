"""Errors of the bench's commands: one line on stderr, and an exit status."""

import contextlib
from collections.abc import Iterator
from typing import NoReturn

import typer
from rich.console import Console

from foundation.exit_status import BAD_INPUT, FAILED, INTERRUPTED
from foundation.system_error import in_words
from harness.launch.kernel_cache import CompileError
from harness.scenario.scenario import ScenarioError
from studies.bench.bench import BenchError


def end(messages: Console, status: int, line: str) -> NoReturn:
    """End the command with a line and a status."""
    messages.print(f"bench: {line}", soft_wrap=True)
    raise typer.Exit(status) from None


@contextlib.contextmanager
def errors_end_the_command(messages: Console) -> Iterator[None]:
    """End the command where its input is wrong, a measurement fails, or it is interrupted."""
    try:
        yield
    except (ScenarioError, ValueError) as error:
        end(messages, BAD_INPUT, str(error))
    except OSError as error:
        end(messages, FAILED, in_words(error))
    except (BenchError, CompileError) as error:
        end(messages, FAILED, str(error))
    except KeyboardInterrupt:
        end(messages, INTERRUPTED, "interrupted")
