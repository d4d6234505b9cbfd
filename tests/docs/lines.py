"""Lines of a page, run as they are written: command lines and Python programs, in order."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
SAID = {
    "LINE": r"veilcam://\S+",
    "TOKEN": r"vc_[0-9a-f]{12}_[0-9a-f]{64}",
    "ID": r"^[0-9a-f]{12,}\b",
}
"""Words of a page in whose place a reader puts what an earlier line printed."""
SUDO = '#!/bin/sh\nwhile [ "$1" = -u ]; do shift 2; done\nexec "$@"\n'


@dataclass(frozen=True)
class Line:
    """A command line of a page, or a program of it."""

    text: str
    python: bool = False


class LineError(Exception):
    """Line that did not end well."""


def lines(page: str) -> list[Line]:
    """Return the lines of the page's blocks of code: those without a language, and Python."""
    found = []
    for language, block in BLOCK.findall(page):
        if language == "python":
            found.append(Line(block, python=True))
        elif not language:
            texts = (re.sub(r"(^|\s+)#.*", "", each) for each in re.split(r"(?<!\\)\n", block))
            found += [Line(text.replace("\\\n", " ")) for text in texts if text.strip()]
    return found


def make_serve(port: int = 0) -> list[str]:
    """Return the command of ``make serve``, with another port; 0: a free one."""
    shown = subprocess.run(
        ["make", "--dry-run", "--always-make", f"--directory={ROOT}", "serve"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    (line,) = (each for each in shown.replace("\\\n", " ").splitlines() if "veilcamd serve" in each)
    words = line.split()[1:]
    words[words.index("--port") + 1] = str(port)
    bundle = words.index("--bundle") + 1
    words[bundle] = str(ROOT / words[bundle])
    return ["veilcamd", *words]


@dataclass
class Desk:
    """Terminal of a reader, with an own home and folder. ``sudo`` changes no user there.

    Attributes:
        folder: working folder, which exists.
        url: URL of the camera that the page means; it is told until a profile is there.
        state: name of the state directory of the daemon that is meant.
        environment: more variables of the environment.
    """

    folder: Path
    url: str | None = None
    state: str = "state"
    environment: dict[str, str] = field(default_factory=dict)
    _said: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        (self.folder / "home").mkdir(exist_ok=True)
        (self.folder / ".venv").symlink_to(sys.prefix)
        programs = self.folder / "programs"
        programs.mkdir()
        (programs / "sudo").write_text(SUDO)
        (programs / "sudo").chmod(0o755)

    def said(self, word: str) -> str:
        """Return what was last printed in the place of a word of ``SAID``."""
        return self._said[word]

    def run(self, line: Line) -> str:
        """Run a line to its end in a terminal, and return what it prints.

        Raises:
            LineError: it did not end with 0.
        """
        text = line.text
        for word, value in self._said.items():
            text = re.sub(rf"\b{word}\b", value, text)
        shell = [sys.executable, "-c"] if line.python else ["bash", "-euc"]
        # Some commands print a secret to a terminal alone.
        terminal, stdout = os.openpty()
        with subprocess.Popen(
            [*shell, text],
            cwd=self.folder,
            env=self._variables(),
            stdin=subprocess.DEVNULL,
            stdout=stdout,
            stderr=stdout,
        ) as process:
            os.close(stdout)
            printed = b""
            with suppress(OSError), open(terminal, "rb", buffering=0) as stream:
                while some := stream.read(65_536):
                    printed += some
        words = printed.decode().replace("\r\n", "\n")
        if process.returncode != 0:
            raise LineError(f"{line.text!r} ends with {process.returncode}: {words[-2000:]}")
        for word, pattern in SAID.items():
            if found := re.search(pattern, words, re.MULTILINE):
                self._said[word] = found[0]
        return words

    @contextmanager
    def serving(self, *command: str) -> Iterator[str]:
        """Start a daemon, and yield its URL once it listens; it ends with the context."""
        with subprocess.Popen(
            command,
            cwd=self.folder,
            env=self._variables(),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        ) as process:
            assert process.stdout is not None
            try:
                said = (line for line in process.stdout if "listening on" in line)
                if (line := next(said, None)) is None:
                    raise LineError(f"{command} does not listen")
                self.url = line.split()[-1]
                yield self.url
            finally:
                process.terminate()
                process.wait(60)

    def _variables(self) -> dict[str, str]:
        """Return the environment of a line: none of the reader's own settings is in it."""
        home = self.folder / "home"
        foreign = re.compile(r"VEILCAM_|XDG_")
        kept = {name: value for name, value in os.environ.items() if not foreign.match(name)}
        programs = f"{self.folder / 'programs'}:{Path(sys.executable).parent}"
        own = {
            "HOME": str(home),
            "PATH": f"{programs}:{kept.get('PATH', '')}",
            "VEILCAM_STATE_DIRECTORY": str(self.folder / self.state),
        }
        if self.url is not None and not (home / ".config" / "veilcam" / "config.toml").exists():
            own["VEILCAM_URL"] = self.url
        return {**kept, **own, **self.environment}
