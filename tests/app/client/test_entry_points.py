"""The commands as they are installed, where an extra is not."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import pytest

PROJECT = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]
SCRIPTS: dict[str, str] = PROJECT["scripts"]
EXTRAS = ("torch", "scipy", "matplotlib", "PIL", "safetensors", "pooch", "fastapi", "aiomqtt")
"""First imports of every extra: without them there is the base install alone."""
CLIENT = """
import sys
from veilcam_client import AsyncCamera, Camera
from veilcam_client.models import Embedding
from veilcam_client.wire.status import example_status
example_status()
of_sdk = {name.split('.')[0] for name in sys.modules}
import veilcam_client.cli.main
of_command = {name.split('.')[0] for name in sys.modules}
import numpy
"""
FORKS = """
import json, os, sys
for line in sys.stdin:
    program, sys.argv, out, err = json.loads(line)
    child = os.fork()
    if child == 0:
        for path, stream in ((out, 1), (err, 2)):
            os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), stream)
        exec(program, {})
        sys.exit()
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


class Done(NamedTuple):
    code: int
    out: str
    err: str


Run = Callable[..., Done]


@contextmanager
def interpreter(folder: Path, loaded: str = "") -> Iterator[Run]:
    """Yield what runs programs, each in a fork of an interpreter that is started once."""
    out, err = folder / "out", folder / "err"
    environment = {name: text for name, text in os.environ.items() if name != "OMP_NUM_THREADS"}
    with subprocess.Popen(
        [sys.executable, "-c", loaded + FORKS],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
    ) as process:
        asked, answered = process.stdin, process.stdout
        assert asked is not None
        assert answered is not None

        def run(program: str, *arguments: str) -> Done:
            line = json.dumps([program, ["command", *arguments], str(out), str(err)])
            print(line, file=asked, flush=True)
            code = int(answered.readline())
            return Done(code, out.read_text(), err.read_text())

        yield run
        asked.close()


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    with interpreter(tmp_path_factory.mktemp("bare")) as run:
        yield run


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    with interpreter(tmp_path_factory.mktemp("base"), CLIENT) as run:
        yield run


def script(command: str, without: Iterable[str] = ()) -> str:
    """The program that a script of the project is, where some modules are not installed."""
    module, _, function = SCRIPTS[command].partition(":")
    return (
        f"import sys; sys.modules.update(dict.fromkeys({list(without)!r}))\n"
        f"from {module} import {function}; {function}()"
    )


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("command", "arguments", "missing", "extra"),
    [
        ("veilcamd", ["serve", "--simulate"], EXTRAS, "server"),
        ("veilcamd", ["serve", "--simulate"], ["uvicorn"], "server"),
        ("veilcam-train", ["--help"], EXTRAS, "training"),
        ("veilcam-optics", ["--help"], EXTRAS, "optics"),
        ("veilcam-mqtt", ["--help"], EXTRAS, "mqtt"),
    ],
)
def test_command_names_the_extra_that_it_needs(
    base: Run, command: str, arguments: list[str], missing: list[str], extra: str
) -> None:
    assert extra in PROJECT["optional-dependencies"]
    done = base(script(command, missing), *arguments)
    assert (done.code, done.out) == (1, "")
    (line,) = done.err.splitlines()
    assert line.startswith(f"{command} needs the extra '{extra}' (")
    assert any(f"({name} is not installed)" in line for name in missing)
    assert line.endswith(f": run pip install -e '.[{extra}]' in the checkout")


@pytest.mark.slow
@pytest.mark.parametrize("command", [each for each in SCRIPTS if each != "veilcam"])
def test_command_that_has_its_extra_runs(
    command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module, _, function = SCRIPTS[command].partition(":")
    monkeypatch.setattr(sys, "argv", [command, "--help"])
    with pytest.raises(SystemExit) as ended:
        getattr(import_module(module), function)()
    assert ended.value.code == 0
    assert "Usage" in capsys.readouterr().out


@pytest.mark.parametrize("missing", ["veilcam_server", "veilcam_server.settings", "getpass"])
def test_module_that_no_extra_brings_is_a_defect_that_is_not_hidden(
    base: Run, missing: str
) -> None:
    done = base(script("veilcamd", [missing]), "--help")
    assert done.code == 1
    assert "Traceback" in done.err
    assert missing in done.err.splitlines()[-1]
    assert "needs the extra" not in done.err


def test_client_needs_no_extra_and_loads_numbers_and_cryptography_late(base: Run) -> None:
    late = ("cryptography", "veilcam_server", "veilcam_optics", "veilcam_training", *EXTRAS)
    done = base(
        "from __main__ import of_sdk, of_command\n"
        f"assert not of_sdk & {{'numpy', *{late}}}; assert not of_command & {set(late)}"
    )
    assert done.code == 0, done.err
    assert "classify" in base(script("veilcam", EXTRAS), "--help").out


MODULES = ("veilcam_server", "veilcam_mqtt")
TELL = """
import os, runpy, sys

class Tell:
    def find_spec(self, name, *_):
        if name in ("numpy", "torch", "typer"):
            print("threads", os.environ.get("OMP_NUM_THREADS"), flush=True)
            os._exit(0)

sys.meta_path.insert(0, Tell())
"""
"""Tells how many threads are set when the first library is loaded, and ends."""


@pytest.mark.parametrize("chosen", [None, "3"])
@pytest.mark.parametrize("started", [*SCRIPTS, *(f"-m {module}" for module in MODULES)])
def test_command_computes_on_one_thread_unless_the_user_chose(
    bare: Run, started: str, chosen: str | None
) -> None:
    choose = f"os.environ['OMP_NUM_THREADS'] = {chosen!r}\n" if chosen else ""
    run_it = (
        f"runpy.run_module({started.removeprefix('-m ')!r}, run_name='__main__')"
        if started.startswith("-m ")
        else script(started)
    )
    assert bare(TELL + choose + run_it, "--help").out == f"threads {chosen or 1}\n"
