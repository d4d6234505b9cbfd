"""``veilcam-train table`` asks for a GPU where one computes."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest
import torch

from veilcam_training.cli import main as cli
from veilcam_training.cli import table as command


@pytest.mark.parametrize(("device", "gpus"), [("cuda", 1), ("cpu", 0)])
def test_gpus_of_a_worker(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, device: str, gpus: int
) -> None:
    asked: list[int] = []
    places: list[torch.device] = []

    def make_executor(*_: object, gpus: int) -> None:
        asked.append(gpus)

    def run_cells(_cells: object, runner: Any, _workers: object) -> tuple[()]:
        places.append(runner.device)
        return ()

    monkeypatch.setattr(command, "choose_device", torch.device)  # no CUDA is needed to ask for it
    monkeypatch.setattr(command, "make_executor", make_executor)
    monkeypatch.setattr(command, "run_cells", run_cells)
    options = f"veilcam-train table mnist --data {tmp_path} --work {tmp_path} --device {device}"
    monkeypatch.setattr(sys, "argv", options.split())
    with pytest.raises(SystemExit):
        cli.main()
    assert asked == [gpus]
    assert places == [torch.device(device)]
