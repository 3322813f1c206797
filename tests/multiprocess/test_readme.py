"""The README's example test passes."""

import re

import pytest
from paths import ROOT

pytestmark = pytest.mark.multiprocess

README = ROOT / "README.md"


def test_example_of_the_readme_passes(swarm):
    (code,) = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    names = {}
    exec(compile(code, str(README), "exec"), names)  # noqa: S102  the repository's own code
    (test,) = (value for name, value in names.items() if name.startswith("test_"))
    test(swarm)
