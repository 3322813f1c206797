"""Kernels are compiled before the first process is timed: a fresh checkout would do it within a test."""

import pytest

from harness.launch import kernel_cache


@pytest.fixture(scope="session", autouse=True)
def kernels() -> None:
    kernel_cache.prepare(lambda _: None)
