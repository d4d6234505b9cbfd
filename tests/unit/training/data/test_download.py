"""Downloads are checked, resumable by file, and clear about what went wrong. No network is used."""

from __future__ import annotations

import functools
import hashlib
import io
import tarfile
import threading
from collections.abc import Iterator
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


@pytest.fixture
def site(tmp_path: Path) -> Iterator[tuple[str, Path]]:
    folder = tmp_path / "site"
    folder.mkdir()
    handler = functools.partial(Quiet, directory=str(folder))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}/", folder
        server.shutdown()
        thread.join()


def console() -> Console:
    return Console(file=io.StringIO())


def serve(monkeypatch: pytest.MonkeyPatch, remote: Remote) -> None:
    monkeypatch.setattr(module, "REMOTES", {"small": remote})


def sha(data: bytes) -> str:
    return f"sha256:{hashlib.sha256(data).hexdigest()}"


def test_files_are_fetched_once(
    monkeypatch: pytest.MonkeyPatch, site: tuple[str, Path], tmp_path: Path
) -> None:
    base, folder = site
    (folder / "a.gz").write_bytes(b"data")
    serve(monkeypatch, Remote(base, {"a.gz": sha(b"data")}))
    download("small", tmp_path / "out", console())
    assert (tmp_path / "out" / "a.gz").read_bytes() == b"data"
    (folder / "a.gz").unlink()
    download("small", tmp_path / "out", console())


def test_wrong_digest_is_refused(
    monkeypatch: pytest.MonkeyPatch, site: tuple[str, Path], tmp_path: Path
) -> None:
    base, folder = site
    (folder / "a.gz").write_bytes(b"other")
    serve(monkeypatch, Remote(base, {"a.gz": sha(b"data")}))
    with pytest.raises(TrainingError, match="not the published file"):
        download("small", tmp_path / "out", console())
    assert not list((tmp_path / "out").iterdir())


def test_download_that_is_not_there_is_named(
    monkeypatch: pytest.MonkeyPatch, site: tuple[str, Path], tmp_path: Path
) -> None:
    serve(monkeypatch, Remote(site[0], {"a.gz": sha(b"data")}))
    with pytest.raises(TrainingError, match=r"cannot be fetched .*404.*: check the network"):
        download("small", tmp_path / "out", console())
    with pytest.raises(TrainingError, match="cannot be downloaded: use one of small"):
        download("celeba-gender", tmp_path / "out", console())


def test_archives_are_unpacked_into_the_folder_alone(
    monkeypatch: pytest.MonkeyPatch, site: tuple[str, Path], tmp_path: Path
) -> None:
    base, folder = site
    for name, inside in (("good.tar.gz", "batches/a.bin"), ("bad.tar.gz", "../evil.bin")):
        with tarfile.open(folder / name, "w:gz") as tar:
            entry = tarfile.TarInfo(inside)
            entry.size = 4
            tar.addfile(entry, io.BytesIO(b"data"))
        digest = sha((folder / name).read_bytes())
        serve(monkeypatch, Remote(base, {name: digest}, unpack=True))
        out = tmp_path / name / "out"
        if name.startswith("good"):
            download("small", out, console())
            assert (out / "batches" / "a.bin").read_bytes() == b"data"
        else:
            with pytest.raises(TrainingError, match="cannot be unpacked"):
                download("small", out, console())
            assert not (tmp_path / name / "evil.bin").exists()


def test_published_digests_have_their_full_length() -> None:
    for remote in REMOTES.values():
        for digest in remote.files.values():
            algorithm, _, value = digest.partition(":")
            assert len(bytes.fromhex(value)) == hashlib.new(algorithm).digest_size
