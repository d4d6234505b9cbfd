"""What a machine lacks is said, with what to do."""

from __future__ import annotations

import os

import pytest
from tests.system.obstacle import obstacle


def test_a_program_that_is_missing_is_named_by_its_package() -> None:
    assert obstacle({"no-such-program": "some-package"}) == (
        "programs are missing: apt install some-package"
    )


@pytest.mark.parametrize(("user", "said"), [(0, False), (1000, True)])
def test_root_rights_are_asked_for(
    monkeypatch: pytest.MonkeyPatch, user: int, *, said: bool
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: user)
    assert (obstacle({"sh": "dash"}) is not None) == said
