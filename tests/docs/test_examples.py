"""Examples, and the blocks of the SDK's page: they run against a simulated camera."""

from __future__ import annotations

import gc
import re
import runpy
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from tests.docs.conftest import Lead
from tests.unit.training.conftest import write_digits

from veilcam_client.keys.receivers import ReceiverKey
from veilcam_optics.decoding import write_frame
from veilcam_server.demo_data import FRESH
from veilcam_server.testing import FakeCamera
from veilcam_training.bundle import read_bundle

pytestmark = pytest.mark.slow
EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@dataclass(frozen=True)
class Served:
    fake: FakeCamera
    frame: Path
    key: Path


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    folder = tmp_path_factory.mktemp("examples")
    path, frame = folder / "key", folder / "frame.safetensors"
    key, bundle = ReceiverKey.generate(), read_bundle(FRESH)
    key.write(path)
    assert bundle.fresh is not None
    write_frame(frame, bundle.fresh.frame(bundle.camera, bundle.scene, bundle.embedding))
    with FakeCamera({"bundle": FRESH}) as fake:
        with fake.camera() as camera:
            camera.receivers.add("examples", key.public)
            camera.rotation.advance()
        yield Served(fake, frame, path)


@dataclass
class Run:
    monkeypatch: pytest.MonkeyPatch
    capsys: pytest.CaptureFixture[str]

    def __call__(self, name: str, *arguments: object) -> list[str]:
        self.monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return self.capsys.readouterr().out.splitlines()


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    return Run(monkeypatch, capsys)


@pytest.fixture
def ask(run: Run, served: Served, lead_to: Lead) -> Run:
    lead_to(served.fake)
    return run


def test_read_label(ask: Run) -> None:
    first, best, *_ = ask("read_label.py")
    assert first.startswith("label ")
    assert best.startswith(f"  {first.split()[1].rstrip(',')}: ")


def test_watch_events(ask: Run) -> None:
    lines = ask("watch_events.py")
    assert sum(line.endswith(" classification") for line in lines) == 2


def test_rotate_masks(ask: Run) -> None:
    *captures, last = ask("rotate_masks.py")
    epochs = {line.split(":")[0] for line in captures}
    assert len(captures) == len(epochs) == 3
    assert last.startswith("back to ")


def test_decode_embedding(ask: Run, served: Served) -> None:
    lines = ask("decode_embedding.py", served.frame, served.key)
    assert [len(line) for line in lines] == [2 * 28] * 28
    # The digit is bright in the middle of the picture and dark around it.
    middle = "".join(line[18:38] for line in lines[7:21])
    edge = "".join(lines[:2] + lines[-2:])
    assert middle.count(" ") / len(middle) < edge.count(" ") / len(edge)


def test_sealed_embedding(ask: Run, served: Served, tmp_path: Path) -> None:
    ReceiverKey.generate().write(tmp_path / "another")
    for key in (served.key, tmp_path / "another"):
        (line,) = ask("sealed_embedding.py", key)
        assert re.fullmatch(r"epoch [0-9a-f]{32}, number \d+: mean [0-9.e-]+", line)


def test_plan_optics(run: Run) -> None:
    lines = run("plan_optics.py")
    assert any("gamma" in line for line in lines)
    assert lines[-1].startswith("a white scene: (1, 12, 16), mean ")


def test_fit_bundle(run: Run, tmp_path: Path) -> None:
    data, out = tmp_path / "data", tmp_path / "small.veilcam"
    data.mkdir()
    write_digits(data, 130, 20, packed=True)
    lines = run("fit_bundle.py", data, out)
    assert lines[-1].startswith("2 pairs, accuracy ")
    assert len(read_bundle(out).pairs) == 2


def test_every_example_has_a_test() -> None:
    tested = {name.removeprefix("test_") for name in globals() if name.startswith("test_")}
    assert {path.stem for path in EXAMPLES.glob("*.py")} <= tested


PAGE = Path(__file__).resolve().parents[2] / "docs" / "sdk.md"
PROGRAMS = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
PRINTED = (
    r"\d \(\d+, \d+\)",
    r"\['\d', '\d', '\d'\] Camera\('unix://\S+'\)",
    r"\w+ application/json \d",
    r"seen \d",
    r"digit \d\nrefused \w+",
)


@pytest.fixture(scope="module")
def raw() -> Iterator[FakeCamera]:
    with FakeCamera({"release": "raw", "raw_budget": 1000}) as fake:
        yield fake


@pytest.mark.slow
@pytest.mark.numerical
@pytest.mark.filterwarnings("ignore::ResourceWarning")  # a program may end without closing
@pytest.mark.parametrize(("program", "printed"), [*zip(PROGRAMS, PRINTED, strict=True)])
def test_program_of_the_page_runs(
    raw: FakeCamera, lead_to: Lead, capsys: pytest.CaptureFixture[str], program: str, printed: str
) -> None:
    lead_to(raw)
    exec(compile(program, str(PAGE), "exec"), {})
    gc.collect()
    assert re.fullmatch(printed, capsys.readouterr().out.strip())


def test_page_of_the_sdk_is_short() -> None:
    assert len(PAGE.read_text().split()) <= 1500
