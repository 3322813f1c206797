"""Compile all kernels before the first test, so that no test with a time limit compiles them."""

import pytest

from harness.launch import kernel_cache


@pytest.fixture(scope="session", autouse=True)
def kernels() -> None:
    kernel_cache.prepare(lambda _: None)
