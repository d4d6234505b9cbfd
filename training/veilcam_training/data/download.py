"""Fetching public data sets, checked against their published digests. Only ever on request."""

import shutil
import tarfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pooch  # type: ignore[import-untyped]
import requests
from rich.console import Console
from rich.progress import (
    BarColumn,
    DownloadColumn,
    Progress,
    TaskID,
    TextColumn,
    TransferSpeedColumn,
)

from veilcam_training.errors import TrainingError, require


@dataclass(frozen=True)
class Remote:
    """Files of one data set: where they are, and the digest of each, ``algorithm:hexadecimal``."""

    base: str
    files: Mapping[str, str]
    unpack: bool = False
    """True for tar archives."""


REMOTES: Mapping[str, Remote] = {
    "mnist": Remote(
        "https://ossci-datasets.s3.amazonaws.com/mnist/",
        {
            "train-images-idx3-ubyte.gz": "sha256:440fcabf73cc546fa21475e81ea37026"
            "5605f56be210a4024d2ca8f203523609",
            "train-labels-idx1-ubyte.gz": "sha256:3552534a0a558bbed6aed32b30c495cc"
            "a23d567ec52cac8be1a0730e8010255c",
            "t10k-images-idx3-ubyte.gz": "sha256:8d422c7b0a1c1c79245a5bcf07fe86e3"
            "3eeafee792b84584aec276f5a2dbc4e6",
            "t10k-labels-idx1-ubyte.gz": "sha256:f7ae60f92e00ec6debd23a6088c31dbd"
            "2371eca3ffa0defaefb259924204aec6",
        },
    ),
    # Zalando publishes MD5 for these, the authors of CIFAR-10 for theirs.
    "fashion": Remote(
        "http://fashion-mnist.s3-website.eu-central-1.amazonaws.com/",
        {
            "train-images-idx3-ubyte.gz": "md5:8d4fb7e6c68d591d4c3dfef9ec88bf0d",
            "train-labels-idx1-ubyte.gz": "md5:25c81989df183df01b3e8a0aad5dffbe",
            "t10k-images-idx3-ubyte.gz": "md5:bef4ecab320f06d8554ea6380940ec79",
            "t10k-labels-idx1-ubyte.gz": "md5:bb300cfdad3c16e7a12a480ee83cd310",
        },
    ),
    "cifar10": Remote(
        "https://www.cs.toronto.edu/~kriz/",
        {"cifar-10-binary.tar.gz": "md5:c32a1d4ab5d03f1284b67883e8d87530"},
        unpack=True,
    ),
}


def download(name: str, folder: Path, console: Console) -> None:
    """Fetch data set ``name`` into ``folder``; files that are there and right are kept.

    Raises:
        TrainingError: it cannot be fetched by a program, the network fails, or a digest is wrong.
    """
    require(
        name in REMOTES,
        f"data set {name!r} cannot be downloaded: use one of {', '.join(REMOTES)}, "
        "or fetch it by hand (see docs/training.md)",
    )
    remote = REMOTES[name]
    folder.mkdir(parents=True, exist_ok=True)
    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn())
    with Progress(*columns, TransferSpeedColumn(), console=console) as progress:
        for file, digest in remote.files.items():
            _fetch(remote.base + file, folder / file, digest, progress)
            if remote.unpack:
                _unpack(folder / file, folder)


def _fetch(url: str, path: Path, digest: str, progress: Progress) -> None:
    bar = _Bar(progress, path.name)
    try:
        pooch.retrieve(
            url,
            known_hash=digest,
            fname=path.name,
            path=path.parent,
            downloader=pooch.HTTPDownloader(progressbar=bar, timeout=30),
        )
    except ValueError as error:
        raise TrainingError(f"{url} is not the published file ({error}): try again later") from None
    except (OSError, requests.RequestException) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise TrainingError(
            f"{url} cannot be fetched ({reason}): check the network and try again"
        ) from None


def _unpack(archive: Path, folder: Path) -> None:
    # By hand: tarfile's own filter came with Python 3.11.4, and Debian 12 has 3.11.2.
    inside = folder.resolve()
    try:
        with tarfile.open(archive) as tar:
            for entry in tar:
                path = (inside / entry.name).resolve()
                if not path.is_relative_to(inside):
                    raise tarfile.TarError(f"{entry.name} is outside the folder")
                content = tar.extractfile(entry) if entry.isfile() else None
                if content is not None:
                    path.parent.mkdir(parents=True, exist_ok=True)
                    with content, path.open("wb") as file:
                        shutil.copyfileobj(content, file)
    except (tarfile.TarError, OSError, EOFError) as error:
        raise TrainingError(f"{archive} cannot be unpacked ({error}): remove it") from None


class _Bar:
    """Progress bar that pooch asks for, shown by rich."""

    def __init__(self, progress: Progress, name: str) -> None:
        self._progress = progress
        self._task: TaskID = progress.add_task(name, total=None)
        self.total: int | None = None

    def update(self, count: int) -> None:
        self._progress.update(self._task, advance=count, total=self.total)

    def reset(self) -> None:
        self._progress.reset(self._task, total=self.total)

    def close(self) -> None:
        self._progress.update(self._task, completed=self.total)
