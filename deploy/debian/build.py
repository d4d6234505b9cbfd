"""Builds the Debian package of one architecture, on any machine with dpkg-deb and the Pythons.

    python -m deploy.debian.build --architecture arm64 --out build/debian

Python packages are resolved by pip for the platform, by a Python of the same minor version, and
unpacked into a folder for each version; what is compiled in them comes from their wheels. NumPy is
left to the system, whose picamera2 is built for it. Nothing here is run by the package's machine.
"""

from __future__ import annotations

import gzip
import hashlib
import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from email.message import Message
from email.parser import HeaderParser
from email.utils import formatdate
from enum import StrEnum
from pathlib import Path
from string import Template
from typing import Annotated

import typer

ROOT = Path(__file__).resolve().parents[2]
DEPLOY, HERE = ROOT / "deploy", ROOT / "deploy" / "debian"
PYTHONS = ("3.11", "3.13")
"""Of Debian 12 and 13, and of the Raspberry Pi OS that follow them."""
MAINTAINER = "The Veilcam authors <veilcam@localhost>"
SYSTEM = ("numpy",)
"""What is never unpacked, as it has to be the system's."""
DEPENDS = (
    # One folder of wheels for each of them.
    "python3 (>= 3.11)",
    "python3 (<< 3.12) | python3 (>= 3.13)",
    "python3 (<< 3.14)",
    # That of Debian 12; picamera2 is built for the system's, and would not take another.
    "python3-numpy (>= 1:1.24)",
    # Has no wheels.
    "python3-spidev",
    # Wheels of the newest platform that is taken are built for it.
    "libc6 (>= 2.34)",
    # The first that keeps a service from running what it wrote, and takes credentials.
    "systemd (>= 252)",
    "udev",
)
"""Of the package, each for a reason; picamera2 is recommended, as Debian itself has none."""


class Architecture(StrEnum):
    """Debian's name of it."""

    AMD64 = "amd64"
    ARM64 = "arm64"

    @property
    def machine(self) -> str:
        """Return what wheels call it."""
        return {"amd64": "x86_64", "arm64": "aarch64"}[self.value]


class BuildError(Exception):
    """The package cannot be built here; the message ends with what to do."""


def interpreter(minor: str) -> str:
    """Return the path of a Python of a minor version.

    Raises:
        BuildError: there is none.
    """
    folders = sorted(Path.home().glob(f".pyenv/versions/{minor}.*/bin"))
    for place in (*folders, None):
        found = shutil.which(f"python{minor}", path=None if place is None else str(place))
        if found is not None:
            return found
    raise BuildError(
        f"there is no python{minor} here: install one, as with 'pyenv install {minor}'"
    )


def _run(*command: str | Path, **environment: str) -> str:
    done = subprocess.run(
        [str(each) for each in command],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **environment},
    )
    if done.returncode != 0:
        raise BuildError(f"{' '.join(map(str, command))}\n{done.stderr.strip()}: see above")
    return done.stdout.strip()


def resolve(target: Path, minor: str, architecture: Architecture, wheel: Path) -> None:
    """Unpack a device's wheels for one Python: the daemon, the bridge, and what they need.

    Raises:
        BuildError: pip cannot resolve them.
    """
    platforms = (f"manylinux_2_{glibc}_{architecture.machine}" for glibc in (34, 28, 17))
    _run(
        *(interpreter(minor), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"),
        *("--target", target, "--no-compile", "--only-binary", ":all:"),
        *("--implementation", "cp", "--python-version", minor),
        *(f"--platform={platform}" for platform in platforms),
        f"veilcam[device] @ {wheel.as_uri()}",
    )
    for name in SYSTEM:
        for path in (*target.glob(name), *target.glob(f"{name}.libs"), *target.glob(f"{name}-*")):
            shutil.rmtree(path)
    shutil.rmtree(target / "bin")


def unpack(stage: Path, architecture: Architecture) -> None:
    """Make the folder that a release is: wheels for each Python, and byte code of theirs."""
    with tempfile.TemporaryDirectory() as folder:
        _run(*(interpreter(PYTHONS[0]), "-m", "pip", "wheel", "--quiet", "--no-deps"),
            "--wheel-dir", folder, ROOT)  # fmt: skip
        [wheel] = Path(folder).glob("veilcam-*.whl")
        for minor in PYTHONS:
            resolve(stage / f"py{minor.replace('.', '')}", minor, architecture, wheel)
    # Our own packages are the same for each.
    shared = stage / "lib"
    shared.mkdir()
    first, *others = (stage / f"py{minor.replace('.', '')}" for minor in PYTHONS)
    for path in first.glob("veilcam*"):
        path.rename(shared / path.name)
    for path in (path for other in others for path in other.glob("veilcam*")):
        shutil.rmtree(path)


def compile_all(stage: Path) -> None:
    """Write the byte code, which says of no source when it was written: none of them changes."""
    for minor in PYTHONS:
        _run(
            *(interpreter(minor), "-m", "compileall", "-q", "--invalidation-mode=unchecked-hash"),
            *("-s", stage, "-p", "/usr/lib/veilcam/unpacked"),
            *(stage / "lib", stage / f"py{minor.replace('.', '')}"),
        )


def digest(stage: Path) -> str:
    """Return what tells a release from every other one: SHA-256 of its files, in part."""
    whole = hashlib.sha256()
    for path in sorted(path for path in stage.rglob("*") if path.is_file()):
        if path.suffix != ".pyc":
            content = hashlib.sha256(path.read_bytes()).hexdigest()
            whole.update(f"{path.relative_to(stage)}\0{content}\n".encode())
    return whole.hexdigest()[:12]


def components(stage: Path) -> Iterator[Message]:
    """Yield the metadata of every Python package, once."""
    found: dict[tuple[str, str], Message] = {}
    for path in sorted(stage.glob("*/*.dist-info/METADATA")):
        metadata = HeaderParser().parsestr(path.read_text())
        found.setdefault((metadata["Name"], metadata["Version"]), metadata)
    yield from found.values()


def license_of(metadata: Message) -> str:
    """Return the licence that a package names: an SPDX expression, where it gives one."""
    expression = metadata["License-Expression"]
    classifiers = (
        each.rpartition(" :: ")[2]
        for each in metadata.get_all("Classifier", [])
        if each.startswith("License ::")
    )
    said = expression or ", ".join(classifiers) or (metadata["License"] or "").partition("\n")[0]
    if not said:
        raise BuildError(f"{metadata['Name']} names no licence: look into it, and add it here")
    return str(said)


def bill_of_materials(stage: Path, version: str) -> dict[str, object]:
    """Return what is in the package, as CycloneDX 1.5."""
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": {"component": {"type": "application", "name": "veilcam", "version": version}},
        "components": [
            {
                "type": "library",
                "name": each["Name"],
                "version": each["Version"],
                "purl": f"pkg:pypi/{each['Name'].lower().replace('_', '-')}@{each['Version']}",
                "licenses": [{"license": {"name": license_of(each)}}],
            }
            for each in components(stage)
        ],
    }


def rights(stage: Path, own: Message) -> str:
    """Return ``copyright``: our licence, and that of each package that comes along."""
    lines = [
        "Format: https://www.debian.org/doc/packaging-manuals/copyright-format/1.0/",
        f"Source: {own['Project-URL'] or own['Home-page'] or 'the checkout it was built from'}",
        "",
        "Files: *",
        f"Copyright: {datetime.fromtimestamp(changed(), UTC).year} the authors of Veilcam",
        "License: Apache-2.0",
        " On Debian systems the text is in /usr/share/common-licenses/Apache-2.0.",
    ]
    for each in components(stage):
        if each["Name"] == "veilcam":
            continue
        who = each["Author"] or each["Author-email"] or each["Maintainer-email"] or "its authors"
        name = each["Name"].replace("-", "?").replace("_", "?")
        lines += [
            "",
            f"Files: usr/lib/veilcam/unpacked/py*/{name}*",
            f"Copyright: {' '.join(who.split())}",
            f"License: {license_of(each)}",
            f" In full in {each['Name'].replace('-', '_')}-{each['Version']}.dist-info.",
        ]
    return "\n".join(lines) + "\n"


def changed() -> int:
    """Return when what is built was committed, in seconds since 1970."""
    return int(_run("git", "-C", ROOT, "log", "-1", "--format=%ct"))


def manual(name: str, version: str) -> str:
    """Return the manual page of a command, which leads to what it says of itself."""
    return Template((HERE / "manual.in").read_text()).substitute(
        name=name.replace("-", r"\-"),
        upper=name.upper(),
        purpose=COMMANDS[name],
        version=version,
        day=datetime.fromtimestamp(changed(), UTC).date().isoformat(),
    )


def changes(version: str) -> str:
    """Return the newest entry of the changelog, as Debian writes one."""
    when = formatdate(changed())
    entry = "  * See CHANGELOG.md of the checkout that it was built from."
    return f"veilcam ({version}) stable; urgency=medium\n\n{entry}\n\n -- {MAINTAINER}  {when}\n"


FILES: Mapping[str, str] = {
    "veilcamd.service": "usr/lib/systemd/system/veilcamd.service",
    "veilcamd.socket": "usr/lib/systemd/system/veilcamd.socket",
    "veilcam-mqtt.service": "usr/lib/systemd/system/veilcam-mqtt.service",
    "veilcam.sysusers": "usr/lib/sysusers.d/veilcam.conf",
    "veilcam.tmpfiles": "usr/lib/tmpfiles.d/veilcam.conf",
    "60-veilcam.rules": "usr/lib/udev/rules.d/60-veilcam.rules",
    "veilcam.env": "usr/share/veilcam/veilcam.env",
    "mqtt.env": "usr/share/veilcam/mqtt.env",
    "veilcam.avahi": "usr/share/veilcam/veilcam.avahi",
    "veilcam.dnssd": "usr/share/veilcam/veilcam.dnssd",
    "debian/lintian-overrides": "usr/share/lintian/overrides/veilcam",
}
"""Of ``deploy/``, and where they go."""
PROGRAMS: Mapping[str, str] = {
    "debian/command.py": "usr/lib/veilcam/command",
    "debian/release.sh": "usr/lib/veilcam/release",
}
COMMANDS: Mapping[str, str] = {
    "veilcam": "ask a camera without a lens",
    "veilcamd": "serve a camera without a lens",
    "veilcam-mqtt": "tell a house over MQTT what a camera without a lens reads",
}
"""And what each is for."""


def lay_out(stage: Path, version: str) -> None:
    """Put everything beside the release: programs, units, and what is said of it."""
    for name, place in {**FILES, **PROGRAMS}.items():
        target = stage / place
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(DEPLOY / name, target)
        target.chmod(0o755 if name in PROGRAMS else 0o644)
    (stage / "usr/bin").mkdir(parents=True)
    for name in COMMANDS:
        (stage / "usr/bin" / name).symlink_to("../lib/veilcam/command")
        page = stage / f"usr/share/man/man1/{name}.1.gz"
        page.parent.mkdir(parents=True, exist_ok=True)
        page.write_bytes(gzip.compress(manual(name, version).encode(), 9, mtime=0))
    # Secrets of the bridge: root alone may look.
    (stage / "etc/veilcam/house").mkdir(parents=True)
    (stage / "etc/veilcam/house").chmod(0o700)
    release = stage / "usr/lib/veilcam/unpacked"
    (release / "RELEASE").write_text(f"{version}-{digest(release)}\n")
    told = stage / "usr/share/doc/veilcam"
    told.mkdir(parents=True)
    own = next(each for each in components(release) if each["Name"] == "veilcam")
    (told / "copyright").write_text(rights(release, own))
    (told / "sbom.cdx.json").write_text(json.dumps(bill_of_materials(release, version), indent=1))
    (told / "changelog.gz").write_bytes(gzip.compress(changes(version).encode(), 9, mtime=0))


def close(stage: Path, version: str, architecture: Architecture, out: Path) -> Path:
    """Make a package of a staged tree; return its file."""
    control = stage / "DEBIAN"
    control.mkdir()
    size = sum(path.lstat().st_size for path in stage.rglob("*") if not path.is_dir()) // 1024
    text = Template((HERE / "control.in").read_text()).substitute(
        version=version,
        architecture=architecture.value,
        size=str(size),
        depends=", ".join(DEPENDS),
        maintainer=MAINTAINER,
    )
    (control / "control").write_text(text)
    for name in ("postinst", "prerm", "postrm"):
        shutil.copyfile(HERE / name, control / name)
        (control / name).chmod(0o755)
    for path in stage.rglob("*"):
        if path.is_dir() and path.name != "house":
            path.chmod(0o755)
    out.mkdir(parents=True, exist_ok=True)
    file = out / f"veilcam_{version}_{architecture.value}.deb"
    _run("dpkg-deb", "--root-owner-group", "-Zxz", "-z3", "--build", stage, file,
        SOURCE_DATE_EPOCH=str(changed()))  # fmt: skip
    return file


def version_of(release: Path) -> str:
    """Return the version that the release's own metadata names."""
    [own] = release.glob("lib/veilcam-*.dist-info/METADATA")
    return str(HeaderParser().parsestr(own.read_text())["Version"])


def build(architecture: Architecture, out: Path) -> Path:
    """Build the package; return its file.

    Raises:
        BuildError: it cannot be built here.
    """
    if shutil.which("dpkg-deb") is None:
        raise BuildError("there is no dpkg-deb here: use Debian, or apt install dpkg")
    with tempfile.TemporaryDirectory() as folder:
        stage = Path(folder) / "stage"
        release = stage / "usr/lib/veilcam/unpacked"
        release.mkdir(parents=True)
        unpack(release, architecture)
        compile_all(release)
        version = version_of(release)
        lay_out(stage, version)
        return close(stage, version, architecture, out)


def main(
    *,
    architecture: Annotated[
        list[Architecture], typer.Option(help="Of the device; give it again for another.")
    ] = [Architecture.ARM64, Architecture.AMD64],  # noqa: B006 - Typer copies it
    out: Annotated[Path, typer.Option(help="Folder for the packages.")] = ROOT / "build/debian",
) -> None:
    """Build the Debian packages."""
    try:
        for each in architecture:
            typer.echo(build(each, out))
    except BuildError as error:
        typer.echo(f"error: {error}", err=True)
        raise SystemExit(1) from None


if __name__ == "__main__":
    typer.run(main)
