"""A Python that is not the one it was said to be is refused before anything is built with it."""

from __future__ import annotations

import sys

import pytest
from tests.system.pythons.__main__ import VersionError, parse

VERSION = "{}.{}".format(*sys.version_info)


def test_a_version_and_its_program() -> None:
    version, program = parse(f"{VERSION}={sys.executable}")
    assert (version, str(program)) == (VERSION, sys.executable)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (sys.executable, "names no program"),
        ("3.12=/no/such/python", "cannot be run"),
        (f"2.7={sys.executable}", f"is Python {VERSION}"),
    ],
)
def test_another_is_refused(asked: str, said: str) -> None:
    with pytest.raises(VersionError, match=said):
        parse(asked)
