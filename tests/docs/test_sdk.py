"""The blocks of the page on the SDK run, one after the other, against a camera in this process."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from tests.docs.conftest import Lead

from veilcam_server.testing import FakeCamera

PAGE = Path(__file__).resolve().parents[2] / "docs" / "sdk.md"
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)


@pytest.mark.slow
@pytest.mark.numerical
def test_blocks_run(lead_to: Lead, capsys: pytest.CaptureFixture[str]) -> None:
    assert len(BLOCKS) == 7
    with FakeCamera({"release": "raw", "raw_budget": 1000}) as fake:
        lead_to(fake)
        names: dict[str, object] = {}
        for block in BLOCKS:
            exec(compile(block, str(PAGE), "exec"), names)
    assert str(names["label"]).isdigit()
    printed = capsys.readouterr().out
    assert "events were missed" in printed
    assert "application/json" in printed
