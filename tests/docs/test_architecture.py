"""The page on architecture names what there is: rooms, files and tests."""

from __future__ import annotations

import ast
import re
import tomllib
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text()
PACKAGES = [
    "client/veilcam_mqtt",
    *(f"{name}/veilcam_{name}" for name in ("client", "optics", "training", "server")),
]
CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"][
    "contracts"
]


@pytest.mark.parametrize("package", PACKAGES)
def test_its_rooms_are_those_of_the_tree_in_the_order_that_is_checked(package: str) -> None:
    [row] = re.findall(rf"^\| `{package}` \| (.*) \|$", PAGE, re.MULTILINE)
    folder = ROOT / package
    [layers] = [each["layers"] for each in CONTRACTS if each.get("containers") == [folder.name]]
    rooms = [room.strip() for layer in layers for room in layer.split(":")]
    assert re.findall(r"`([^`]+)`", row) == [
        f"{room}/" if (folder / room).is_dir() else room for room in rooms if room != "__main__"
    ]
    there = {entry.stem for entry in folder.iterdir() if entry.is_dir() or entry.suffix == ".py"}
    assert set(rooms) == there - {"__init__", "__pycache__"} | ({"__main__"} & there)


def test_its_tests_exist() -> None:
    named = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", PAGE)
    assert len(named) >= 3
    for path, name in named:
        module = ast.parse((ROOT / path).read_text())
        functions = (ast.FunctionDef, ast.AsyncFunctionDef)
        assert name in {node.name for node in module.body if isinstance(node, functions)}, name


def test_its_names_are_in_the_files_beside_them() -> None:
    named = re.findall(r"`(\w+)` in \[[^]]+\]\(([^)]+)\)", PAGE)
    assert named
    for name, path in named:
        assert re.search(rf"\b{name}\b", (ROOT / "docs" / path).read_text()), name


def test_no_file_is_in_a_circle_of_imports() -> None:
    graph = grimp.build_graph(*(Path(package).name for package in PACKAGES))
    imports = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    TopologicalSorter(imports).prepare()  # raises CycleError, which names the files
