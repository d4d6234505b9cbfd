"""The Debian package, made of little: what is in it, what it says of it, and how commands start."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from deploy.debian import build
from deploy.debian.build import COMMANDS, DEPLOY, FILES, PROGRAMS, Architecture, BuildError

SCRIPTS = ("postinst", "prerm", "postrm", "release.sh")

packs = pytest.mark.skipif(
    shutil.which("dpkg-deb") is None, reason="dpkg-deb is not here: apt install dpkg"
)


def wheel(folder: Path, name: str, version: str, *lines: str) -> None:
    info = folder / f"{name}-{version}.dist-info"
    info.mkdir(parents=True)
    told = [f"Name: {name}", f"Version: {version}", *lines]
    (info / "METADATA").write_text("\n".join(told) + "\n\nA text.\n")


@pytest.fixture
def release(tmp_path: Path) -> Path:
    folder = tmp_path / "stage/usr/lib/veilcam/unpacked"
    wheel(folder / "lib", "veilcam", "1.2.3", "License-Expression: Apache-2.0")
    for minor in ("py311", "py313"):
        wheel(folder / minor, "one", "1.0", "License-Expression: MIT", "Author: Ann")
        classifier = "Classifier: License :: OSI Approved :: BSD License"
        wheel(folder / minor, "two_more", "2.0", classifier)
    return folder


def test_everything_of_this_folder_is_in_the_package() -> None:
    there = {
        str(path.relative_to(DEPLOY))
        for path in DEPLOY.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    apart = {"README.md", "config.py", "Containerfile", "prometheus/veilcam.rules.yml"}
    apart |= {f"debian/{name}" for name in ("__init__.py", "build.py", "control.in", "manual.in")}
    apart |= {f"debian/{name}" for name in ("postinst", "prerm", "postrm")}
    assert there - apart == {*FILES, *PROGRAMS}


def test_what_units_and_scripts_call_is_there() -> None:
    ours = {f"/{place}" for place in PROGRAMS.values()} | {f"/usr/bin/{name}" for name in COMMANDS}
    called = set()
    for path in (*DEPLOY.glob("*.service"), *(DEPLOY / "debian").glob("post*")):
        called |= set(re.findall(r"/usr/(?:bin|lib/veilcam)/[a-z-]+", path.read_text()))
    assert called
    assert called <= ours


@pytest.mark.parametrize("name", SCRIPTS)
def test_scripts_are_sh_and_stop_at_what_fails(name: str) -> None:
    path = DEPLOY / "debian" / name
    text = path.read_text()
    assert text.startswith("#!/bin/sh\n")
    assert re.search(r"(?m)^set -eu?$", text)
    subprocess.run(["sh", "-n", str(path)], check=True)


def test_each_python_package_is_listed_once_and_must_have_a_licence(release: Path) -> None:
    bill = json.loads(json.dumps(build.bill_of_materials(release, "1.2.3")))
    assert (bill["bomFormat"], bill["specVersion"]) == ("CycloneDX", "1.5")
    told = {each["purl"]: each["licenses"][0]["license"]["name"] for each in bill["components"]}
    assert told == {
        "pkg:pypi/veilcam@1.2.3": "Apache-2.0",
        "pkg:pypi/one@1.0": "MIT",
        "pkg:pypi/two-more@2.0": "BSD License",
    }
    own = next(each for each in build.components(release) if each["Name"] == "veilcam")
    text = build.rights(release, own)
    assert "py*/one*\nCopyright: Ann\nLicense: MIT\n" in text
    assert "py*/two?more*" in text
    wheel(release / "py311", "three", "3.0")
    with pytest.raises(BuildError, match="three names no licence"):
        build.bill_of_materials(release, "1.2.3")


def test_a_release_is_called_by_what_is_in_it(release: Path) -> None:
    before = build.digest(release)
    (release / "lib/module.pyc").write_bytes(b"made of the source")
    assert build.digest(release) == before
    (release / "lib/module.py").write_text("")
    after = build.digest(release)
    (release / "lib/module.py").rename(release / "py311/module.py")
    assert len({before, after, build.digest(release)}) == 3


def packed(folder: Path, architecture: Architecture) -> Path:
    build.lay_out(folder / "stage", "1.2.3")
    return build.close(folder / "stage", "1.2.3", architecture, folder / "out")


@packs
@pytest.mark.usefixtures("release")
@pytest.mark.parametrize("architecture", list(Architecture))
def test_the_package_holds_what_it_says(tmp_path: Path, architecture: Architecture) -> None:
    file = packed(tmp_path, architecture)
    assert file.name == f"veilcam_1.2.3_{architecture.value}.deb"

    def said(*command: str) -> str:
        done = subprocess.run(["dpkg-deb", *command], check=True, capture_output=True, text=True)
        return done.stdout

    assert said("--field", str(file), "Architecture").strip() == architecture.value
    depends = said("--field", str(file), "Depends")
    assert "python3-numpy (>= 1:1.24)" in depends
    assert "$" not in said("--field", str(file))
    listed = said("--contents", str(file)).splitlines()
    rows = {line.split()[5].removeprefix("."): line.split()[:2] for line in listed}
    assert {owner for _, owner in rows.values()} == {"root/root"}
    for places, mode in ((FILES, "-rw-r--r--"), (PROGRAMS, "-rwxr-xr-x")):
        assert {rows[f"/{place}"][0] for place in places.values()} == {mode}
    assert rows["/etc/veilcam/house/"][0] == "drwx------"
    for name in COMMANDS:
        assert rows[f"/usr/bin/{name}"][0].startswith("l")
        assert rows[f"/usr/share/man/man1/{name}.1.gz"][0] == "-rw-r--r--"
    # dpkg asks nobody which settings to keep.
    assert not [name for name in rows if name.startswith("/etc/") and not name.endswith("/")]


@packs
@pytest.mark.slow
@pytest.mark.skipif(shutil.which("lintian") is None, reason="apt install lintian")
@pytest.mark.usefixtures("release")
def test_lintian_finds_nothing_in_what_is_laid_out(tmp_path: Path) -> None:
    file = packed(tmp_path, Architecture.AMD64)
    command = ["lintian", "--allow-root", "--tag-display-limit", "0", str(file)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    # What is overridden because of wheels has no use where there is none.
    found = [line for line in done.stdout.splitlines() if "mismatched-override" not in line]
    assert found == [], done.stderr


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_runs_from_the_release_in_use_whatever_the_environment_says(
    tmp_path: Path, name: str
) -> None:
    program = tmp_path / "command"
    text = (DEPLOY / "debian/command.py").read_text()
    state = tmp_path / "state"
    state.mkdir()
    moved = text.replace("/var/lib/veilcam-release", str(tmp_path))
    program.write_text(moved.replace("/var/lib/veilcam", str(state)))
    (tmp_path / name).symlink_to(program)
    minor = "py{}{}".format(*sys.version_info)
    for number in (1, 2):
        packages = tmp_path / f"releases/{number}/lib"
        for module in ("veilcam_client.cli.main", "veilcam_server.cli.main", "veilcam_mqtt.cli"):
            path = packages.joinpath(*module.split(".")).with_suffix(".py")
            path.parent.mkdir(parents=True, exist_ok=True)
            for folder in (path.parent, packages / module.partition(".")[0]):
                (folder / "__init__.py").touch()
            path.write_text(
                "import needed, os\n"
                f"def main(): print('{module}', {number}, needed.__file__, "
                "os.environ['VEILCAM_STATE_DIRECTORY'])"
            )
        needed = tmp_path / f"releases/{number}/{minor}/needed.py"
        needed.parent.mkdir()
        needed.write_text("")
    other = tmp_path / "elsewhere"
    other.mkdir()
    (other / "needed.py").write_text("raise SystemExit('not this one')")
    for number in (1, 2):
        (tmp_path / "current").unlink(missing_ok=True)
        (tmp_path / "current").symlink_to(tmp_path / f"releases/{number}")
        done = subprocess.run(
            [sys.executable, "-Iu", str(tmp_path / name)],
            capture_output=True,
            text=True,
            check=True,
            timeout=60,
            env={"PYTHONPATH": str(other)},
            cwd=other,
        )
        needed = tmp_path / f"releases/{number}/{minor}/needed.py"
        assert done.stdout.split()[1:] == [str(number), str(needed), str(state)]
        room = {"veilcam": "client", "veilcamd": "server", "veilcam-mqtt": "mqtt"}[name]
        assert done.stdout.startswith(f"veilcam_{room}.cli")
    assert text.startswith("#!/usr/bin/python3 -Iu\n")
