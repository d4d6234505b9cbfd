"""A root of Debian in a folder: made by mmdebstrap once, and taken anew from its archive."""

from __future__ import annotations

import os
import shutil
import ssl
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

MIRROR = "http://deb.debian.org/debian"
PACKAGES = ("systemd", "udev", "python3-numpy", "python3-spidev")
CERTIFICATES = "/etc/ssl/certs/ca-certificates.crt"
DEVICES = {"null": (1, 3), "zero": (1, 5), "full": (1, 7), "random": (1, 8), "urandom": (1, 9)}
ENVIRONMENT: Mapping[str, str] = {
    "PATH": "/usr/sbin:/usr/bin:/sbin:/bin",
    "LANG": "C.UTF-8",
    "DEBIAN_FRONTEND": "noninteractive",
}
OF_APT = ("var/cache", "var/lib/apt", "var/lib/dpkg", "var/log", "proc", "dev", "tmp", "run")
"""What apt and dpkg keep for themselves, and what is no file."""


def archive(build: Path, suite: str, architecture: str, packages: Sequence[str] = PACKAGES) -> Path:
    file = build / f"{suite}-{architecture}.tar"
    if not file.exists():
        part = file.with_suffix(".part.tar")
        trusted = ssl.get_default_verify_paths().cafile
        upload = f"--customize-hook=upload {trusted} {CERTIFICATES}"
        subprocess.run(
            [
                *("mmdebstrap", "--quiet", f"--arch={architecture}", "--variant=apt"),
                *([upload] if trusted and "ca-certificates" in packages else []),
                *(f"--include={','.join(packages)}", suite, str(part), MIRROR),
            ],
            check=True,
        )
        part.replace(file)
    return file


@dataclass(frozen=True)
class Root:
    path: Path
    environment: Mapping[str, str] = field(default_factory=lambda: ENVIRONMENT)

    @classmethod
    def unpack(cls, file: Path, path: Path) -> Root:
        if path.exists():
            shutil.rmtree(path)
        path.mkdir(parents=True)
        subprocess.run(["tar", "-C", str(path), "--exclude=./dev/*", "-xpf", str(file)], check=True)
        for name, (major, minor) in DEVICES.items():
            node = path / "dev" / name
            os.mknod(node, 0o666 | 0o020000, os.makedev(major, minor))
            node.chmod(0o666)
        # Nothing of it outlives a power cut anyway: dpkg need not wait for the disk at every file.
        (path / "etc/dpkg/dpkg.cfg.d/root").write_text("force-unsafe-io\n")
        return cls(path)

    def run(self, *command: str, user: str | None = None, check: bool = True) -> str:
        who = () if user is None else (f"--userspec={user}:{user}",)
        done = subprocess.run(
            [
                *("unshare", "--net", "--mount", "--pid", "--fork", "--kill-child", "sh", "-c"),
                'mount -t proc proc "$0/proc"; exec "$@"',
                *(str(self.path), "chroot", *who, str(self.path), *command),
            ],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=dict(self.environment),
            check=False,
        )
        if check and done.returncode != 0:
            raise AssertionError(f"{' '.join(command)}: {done.stdout[-2000:]}")
        return done.stdout

    def install(self, package: Path) -> None:
        there = self.path / "srv" / package.name
        shutil.copyfile(package, there)
        self.run("apt-get", "install", "--yes", "--quiet", "--reinstall",
            "--no-install-recommends", f"/srv/{package.name}")  # fmt: skip
        there.unlink()

    def identity(self, user: str) -> tuple[int, int]:
        for line in (self.path / "etc/passwd").read_text().splitlines():
            name, _, number, group, *_ = line.split(":")
            if name == user:
                return int(number), int(group)
        raise AssertionError(f"there is no user {user}")

    def files(self) -> set[str]:
        found = set()
        for folder, folders, names in os.walk(self.path):
            here = os.path.relpath(folder, self.path)
            folders[:] = [one for one in folders if os.path.normpath(f"{here}/{one}") not in OF_APT]
            found |= {os.path.normpath(f"{here}/{one}") for one in (*folders, *names)}
        return found

    def room(self) -> float:
        blocks: dict[int, int] = {}
        for name in self.files():
            status = (self.path / name).lstat()
            blocks[status.st_ino] = status.st_blocks
        return 512 * sum(blocks.values()) / 1e6
