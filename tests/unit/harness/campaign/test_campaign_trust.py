"""A cache of compiled kernels that others can write ends a campaign with one line."""

from pathlib import Path

import pytest

from foundation.kernels.cache_trust import UntrustedCache
from harness.campaign import cluster, flights
from harness.launch import kernel_cache


def test_an_untrusted_cache_is_an_error_of_the_machine_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def environment() -> dict[str, str]:
        raise UntrustedCache("others can write it")

    assert issubclass(UntrustedCache, flights.OF_THE_MACHINE)
    monkeypatch.setattr(kernel_cache, "environment", environment)
    with (
        pytest.raises(kernel_cache.CompileError, match=r"^others can write it$"),
        cluster.connected(workers=1, scheduler=None, folder=tmp_path, note=lambda _: None),
    ):
        pass
