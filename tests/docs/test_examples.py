"""Every script of ``examples/`` runs as it says, against a simulated camera."""

from __future__ import annotations

import re
import runpy
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from tests.unit.training.conftest import write_digits

from veilcam_client import Camera
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_optics.decoding import write_frame
from veilcam_server.demo.daemon import running
from veilcam_server.demo_data import FRESH, load_digits
from veilcam_server.devices.simulated.scenes import write_scene
from veilcam_training.bundle import read_bundle

pytestmark = pytest.mark.slow
EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@dataclass(frozen=True)
class Daemon:
    """One with fresh masks, and what decodes the embeddings that it seals."""

    url: str
    frame: Path
    key: Path
    digit: str


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    folder = tmp_path_factory.mktemp("examples")
    path, frame, scene = folder / "key", folder / "frame.safetensors", folder / "scene.npy"
    key = ReceiverKey.generate()
    key.write(path)
    bundle, digits = read_bundle(FRESH), load_digits()
    assert bundle.fresh is not None
    write_frame(frame, bundle.fresh.frame(bundle.camera, bundle.scene, bundle.embedding))
    write_scene(scene, digits.images[0])
    with running(FRESH, scene, folder, "--settle", "0", "--exposure", "0") as url:
        with Camera(url) as camera:
            camera.add_receiver("examples", key.public)
            camera.rotate()
        yield Daemon(url, frame, path, str(digits.labels[0]))


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    return Run(monkeypatch, capsys)


@dataclass
class Run:
    """Runs an example with arguments, and returns the lines that it prints."""

    monkeypatch: pytest.MonkeyPatch
    capsys: pytest.CaptureFixture[str]

    def __call__(self, name: str, *arguments: object) -> list[str]:
        self.monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return self.capsys.readouterr().out.splitlines()


def test_read_label(run: Run, daemon: Daemon) -> None:
    first, best, *_ = run("read_label.py", daemon.url)
    assert first.startswith("label ")
    assert best.startswith(f"  {first.split()[1].rstrip(',')}: ")


def test_watch_events(run: Run, daemon: Daemon) -> None:
    lines = run("watch_events.py", daemon.url)
    assert sum(line.endswith(" classification") for line in lines) == 2


def test_rotate_masks(run: Run, daemon: Daemon) -> None:
    *captures, last = run("rotate_masks.py", daemon.url)
    epochs = {line.split(":")[0] for line in captures}
    assert len(captures) == len(epochs) == 3
    assert last.startswith("back to ")


def test_decode_embedding(run: Run, daemon: Daemon) -> None:
    lines = run("decode_embedding.py", daemon.frame, daemon.key, daemon.url)
    assert [len(line) for line in lines] == [2 * 28] * 28
    # The digit is bright in the middle of the picture and dark around it.
    middle = "".join(line[18:38] for line in lines[7:21])
    edge = "".join(lines[:2] + lines[-2:])
    assert middle.count(" ") / len(middle) < edge.count(" ") / len(edge)


def test_sealed_embedding(run: Run, daemon: Daemon, tmp_path: Path) -> None:
    ReceiverKey.generate().write(tmp_path / "another")
    for key in (daemon.key, tmp_path / "another"):
        (line,) = run("sealed_embedding.py", key, daemon.url)
        assert re.fullmatch(r"epoch [0-9a-f]{32}, number \d+: mean [0-9.e-]+", line)


def test_plan_optics(run: Run) -> None:
    lines = run("plan_optics.py")
    assert any("gamma" in line for line in lines)
    assert lines[-1].startswith("a white scene: (1, 12, 16), mean ")


def test_fit_bundle(run: Run, tmp_path: Path) -> None:
    data, out = tmp_path / "data", tmp_path / "small.veilcam"
    data.mkdir()
    write_digits(data, 300, 100, packed=True)
    lines = run("fit_bundle.py", data, out)
    assert lines[-1].startswith("2 pairs, accuracy ")
    assert len(read_bundle(out).pairs) == 2


def test_every_example_has_a_test() -> None:
    tested = {name.removeprefix("test_") for name in globals() if name.startswith("test_")}
    assert {path.stem for path in EXAMPLES.glob("*.py")} <= tested
