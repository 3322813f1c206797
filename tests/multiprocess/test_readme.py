"""What the README shows a user works as it stands there."""

import re

import pytest
from paths import ROOT

pytestmark = pytest.mark.multiprocess

README = ROOT / "README.md"


def test_the_readmes_test_of_a_users_passes(swarm):
    (code,) = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    names = {}
    exec(compile(code, str(README), "exec"), names)  # noqa: S102  it is ours
    (test,) = (value for name, value in names.items() if name.startswith("test_"))
    test(swarm)
