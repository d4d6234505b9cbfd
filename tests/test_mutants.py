"""Mutants: drawn by a seed, found again in a changed tree, judged by the tests of their room."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest
import typer
from tests.mutants import draw, judges_of, locate, main, modules, mutants_of
from typer.testing import CliRunner

MODULE = "optics/veilcam_optics/sides/square.py"
SOURCE = """\
def area(side: float) -> float:
    if side < 0:
        raise ValueError("a side is not negative")
    return side * side
"""
TEST = """\
from veilcam_optics.sides.square import area


def test_area_of_a_side() -> None:
    assert area(3) == 9
"""


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A repository of one module and its test."""
    for file, text in {
        MODULE: SOURCE,
        "tests/unit/optics/sides/test_square.py": TEST,
        "optics/veilcam_optics/__init__.py": "",
        "optics/veilcam_optics/lone.py": "ONE = 1\n",
        **{f"{name}/.keep": "" for name in ("client/veilcam_client", "client/veilcam_mqtt")},
        **{f"{name}/veilcam_{name}/.keep": "" for name in ("training", "server")},
        "pytest.ini": "[pytest]\nmarkers =\n    system: x\n    page: x\n",
    }.items():
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_text(text)
    subprocess.run(["git", "init", "-q", tmp_path], check=True)
    return tmp_path


def test_draw_repeats_with_its_seed_and_takes_one_mutant_a_place(tree: Path) -> None:
    drawn = draw(tree, modules(tree), count=100, seed=1)
    assert draw(tree, modules(tree), count=100, seed=1) == drawn
    assert {each["line"] for each in drawn if each["file"] == MODULE} == {2, 4}
    assert len(draw(tree, modules(tree), count=2, seed=1)) == 2


def test_rooms_tests_judge_a_module_wherever_their_folder_is(tree: Path) -> None:
    assert judges_of(tree, MODULE) == ("tests/unit/optics/sides/test_square.py",)
    assert judges_of(tree, "optics/veilcam_optics/lone.py") == ()


def test_mutant_is_found_again_where_its_line_went(tree: Path) -> None:
    mutant = next(each for each, _ in mutants_of(tree, MODULE) if each["before"].startswith("if"))
    (tree / MODULE).unlink()
    assert locate(mutant, tree) is None
    moved = tree / "server/veilcam_server/square.py"
    moved.write_text("def other(side: float) -> None:\n    if side < 0:\n        return\n" + SOURCE)
    spec = locate(mutant, tree)
    assert spec is not None
    assert (str(spec.module_path), spec.start_pos[0]) == ("server/veilcam_server/square.py", 5)


def test_command_writes_which_mutants_live(tree: Path, tmp_path: Path) -> None:
    found = [each for each, _ in mutants_of(tree, MODULE)]
    chosen = {"core/ReplaceBinaryOperator_Mul_Div", "core/ReplaceComparisonOperator_Lt_LtE"}
    gone = {**found[0], "before": "return 1"}
    given, out = tmp_path / "given.json", tmp_path / "out.json"
    given.write_text(json.dumps([each for each in found if each["operator"] in chosen] + [gone]))
    app = typer.Typer()
    app.command()(main)
    told = ["--given", str(given), "--tree", str(tree), "--workers", "1", "--out", str(out)]
    result = CliRunner().invoke(app, told)
    assert result.exit_code == 0, result.output
    outcomes = {each["before"]: each["outcome"] for each in json.loads(out.read_text())}
    due = {"return side * side": "killed", "if side < 0:": "survived", "return 1": "gone"}
    assert outcomes == due
