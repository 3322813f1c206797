"""Without the extra, environments are refused in one line that says how to install it."""

import sys

import pytest

import coflight


@pytest.mark.parametrize("make", ["parallel_env", "single_env"])
def test_without_the_extra_one_line_names_it(make, monkeypatch):
    for name in ("pettingzoo", "gymnasium", "harness.env.parallel", "harness.env.single"):
        monkeypatch.delitem(sys.modules, name, raising=False)
        if not name.startswith("harness"):
            monkeypatch.setitem(sys.modules, name, None)
    text = r"^coflight\.env: \w+ is not installed; .*coflight\[env\]'$"
    with pytest.raises(ModuleNotFoundError, match=text):
        getattr(coflight.env, make)("article")
