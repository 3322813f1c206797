"""The licences of locked packages are those of their metadata; an unknown one is an error of one line."""

from email.message import Message

import pytest
from msgspec import __version__ as version

from reference.licences import NoLicenceError, licences_page, stated_licence


def metadata(**fields: str | list[str]) -> Message:
    message = Message()
    for name, values in fields.items():
        for value in [values] if isinstance(values, str) else values:
            message[name.replace("_", "-")] = value
    return message


BSD = ["License :: OSI Approved :: BSD License"]
LISTED = ["License :: A", "License :: B"]


@pytest.mark.parametrize(
    ("made", "licence"),
    [
        (metadata(License_Expression="MIT", License="other"), "MIT"),
        (metadata(License="BSD 2-Clause License", Classifier=BSD), "BSD 2-Clause License"),
        (metadata(License="Copyright (c) 2015\nall of it", Classifier=BSD), "BSD License"),
        (metadata(License="UNKNOWN", Classifier=["License :: OSI Approved", *LISTED]), "A; B"),
    ],
)
def test_the_most_exact_statement_is_taken(made: Message, licence: str) -> None:
    assert stated_licence("demo", made) == licence


def test_a_package_without_a_statement_is_refused() -> None:
    with pytest.raises(NoLicenceError, match="demo: its metadata states no licence"):
        stated_licence("demo", metadata(License="UNKNOWN", Classifier=["Topic :: A"]))


def test_a_package_that_is_not_installed_keeps_its_row_only_in_the_same_version() -> None:
    present = "| absent-package | 1.0 | MIT |\n"
    locks = {"requirements.lock": f"msgspec=={version} \\\nabsent-package==1.0 \\\n    --hash=sha256:0\n"}
    page = licences_page(locks, present)
    assert f"| msgspec | {version} | BSD-3-Clause |\n| absent-package | 1.0 | MIT |\n" in page
    with pytest.raises(NoLicenceError, match=r"absent-package 2\.0 is not installed"):
        licences_page({"requirements.lock": "absent-package==2.0 \\\n"}, present)
