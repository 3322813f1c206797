"""The scenario of a run that has ended, from its manifest."""

import msgspec

from harness.records.run_folder import RunFolder
from harness.scenario.scenario import Scenario
from harness.scenario.validation_errors import explain


class NotARun(Exception):
    """A folder does not hold a run that can be read; the text is one line that says why."""


class _Manifest(msgspec.Struct, frozen=True, kw_only=True):
    scenario: Scenario


def read_scenario(folder: RunFolder) -> Scenario:
    """Return the scenario that a run flew, with all overrides. Raises NotARun."""
    try:
        content = folder.manifest.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        raise NotARun(f"{folder.path}: no run that has ended: it has no manifest.json") from None
    try:
        return msgspec.json.decode(content, type=_Manifest).scenario
    except msgspec.ValidationError as error:
        raise NotARun(f"{folder.manifest}: of another version: {explain(error, {})}") from None
    except msgspec.DecodeError as error:
        raise NotARun(f"{folder.manifest}: not JSON: {error}") from None
