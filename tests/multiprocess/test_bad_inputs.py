"""Every bad input is refused with one report that says what to do, and nothing is written."""

import forked_command
import pytest
from bad_inputs import BAD_INPUTS, BadInput, faults_of

pytestmark = pytest.mark.multiprocess


def test_the_list_is_long_and_its_names_differ():
    assert len({bad.name for bad in BAD_INPUTS}) == len(BAD_INPUTS) >= 60


@pytest.mark.parametrize("bad", BAD_INPUTS, ids=lambda bad: bad.name)
def test_a_bad_input_is_reported(bad: BadInput):
    assert faults_of(bad, forked_command.run) == []
