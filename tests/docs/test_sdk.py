"""What the page on the SDK says is run, line by line, against a camera in this process."""

from __future__ import annotations

import re
from pathlib import Path

import httpx
import pytest

from veilcam_client.http.options import Options
from veilcam_server.testing import FakeCamera

PAGE = Path(__file__).resolve().parents[2] / "docs" / "sdk.md"
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)


@pytest.mark.slow
@pytest.mark.numerical
def test_every_block_runs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert len(BLOCKS) == 7
    with FakeCamera({"release": "raw", "raw_budget": 1000}) as fake:

        def lead_there(options: Options) -> httpx.Client:
            assert options.base == "http://127.0.0.1:8787"
            return fake.http_client()

        monkeypatch.delenv("VEILCAM_URL", raising=False)
        monkeypatch.setattr("veilcam_client.http.transport._own_client", lead_there)
        names: dict[str, object] = {}
        for block in BLOCKS:
            exec(compile(block, str(PAGE), "exec"), names)
    assert str(names["label"]).isdigit()
    printed = capsys.readouterr().out
    assert "events were missed" in printed
    assert "application/json" in printed
