"""What commands say before a fit."""

from __future__ import annotations

import io

import pytest
import torch
from rich.console import Console

from veilcam_training.cli.options import warn_of_precision


@pytest.mark.parametrize(
    ("device", "mixed", "capabilities", "warned"),
    [
        ("cpu", True, {"avx2": True, "avx512_bf16": False}, True),
        ("cpu", True, {"avx2": True, "amx_bf16": True}, False),
        ("cpu", False, {"avx2": True, "avx512_bf16": False}, False),
        ("meta", True, {"avx512_bf16": False}, False),  # stands for one that is no processor
    ],
)
def test_emulated_bfloat16_is_told_of(
    monkeypatch: pytest.MonkeyPatch,
    *,
    device: str,
    mixed: bool,
    capabilities: dict[str, bool],
    warned: bool,
) -> None:
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: capabilities)
    console = Console(file=io.StringIO())
    warn_of_precision(console, torch.device(device), mixed=mixed, instead="bfloat16 = false")
    printed = console.file.getvalue()  # type: ignore[attr-defined]
    assert ("use bfloat16 = false" in printed) == warned
