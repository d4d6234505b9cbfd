"""Downloads are checked, resumable by file, and clear about what went wrong. No network is used."""

from __future__ import annotations

import functools
import hashlib
import io
import tarfile
import threading
from collections.abc import Callable, Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from rich.console import Console

from veilcam_training.data import download as module
from veilcam_training.data.download import REMOTES, Remote, download
from veilcam_training.errors import TrainingError


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        pass


Fetch = Callable[..., Path]


@pytest.fixture
def fetch(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Fetch]:
    """Downloads a file, which should be ``data``, from a server that has ``offered``."""
    folder = tmp_path / "site"
    folder.mkdir()
    handler = functools.partial(Quiet, directory=str(folder))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()

        def run(offered: bytes | None, data: bytes, *, unpack: bool = False) -> Path:
            (folder / "a.gz").unlink(missing_ok=True)
            if offered is not None:
                (folder / "a.gz").write_bytes(offered)
            base = f"http://127.0.0.1:{server.server_address[1]}/"
            files = {"a.gz": f"sha256:{hashlib.sha256(data).hexdigest()}"}
            monkeypatch.setattr(module, "REMOTES", {"small": Remote(base, files, unpack=unpack)})
            download("small", tmp_path / "out", Console(file=io.StringIO()))
            return tmp_path / "out"

        yield run
        server.shutdown()
        thread.join()


def test_files_are_fetched_once(fetch: Fetch) -> None:
    assert (fetch(b"data", b"data") / "a.gz").read_bytes() == b"data"
    fetch(None, b"data")


def test_wrong_digest_is_refused(fetch: Fetch, tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match="not the published file"):
        fetch(b"other", b"data")
    assert not list((tmp_path / "out").iterdir())


def test_download_that_is_not_there_is_named(fetch: Fetch, tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match=r"cannot be fetched .*404.*: check the network"):
        fetch(None, b"data")
    with pytest.raises(TrainingError, match="cannot be downloaded: use one of small"):
        download("celeba-gender", tmp_path / "out", Console(file=io.StringIO()))


def packed(inside: str) -> bytes:
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w:gz") as tar:
        entry = tarfile.TarInfo(inside)
        entry.size = 4
        tar.addfile(entry, io.BytesIO(b"data"))
    return buffer.getvalue()


def test_archives_are_unpacked_into_the_folder_alone(fetch: Fetch, tmp_path: Path) -> None:
    evil = packed("../evil.bin")
    with pytest.raises(TrainingError, match="cannot be unpacked"):
        fetch(evil, evil, unpack=True)
    assert not (tmp_path / "evil.bin").exists()
    (tmp_path / "out" / "a.gz").unlink(missing_ok=True)
    good = packed("batches/a.bin")
    out = fetch(good, good, unpack=True)
    assert (out / "batches" / "a.bin").read_bytes() == b"data"


def test_published_digests_have_their_full_length() -> None:
    for remote in REMOTES.values():
        for digest in remote.files.values():
            algorithm, _, value = digest.partition(":")
            assert len(bytes.fromhex(value)) == hashlib.new(algorithm).digest_size
