"""Catalogues: what an owner publishes is what an operator pulls, and nothing else is."""

from __future__ import annotations

import json
import stat
import threading
from collections.abc import Callable, Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from tests.training.bundle.test_fresh import make_bundle
from typer.testing import CliRunner

from veilcam_client import CatalogueError, pull_bundle
from veilcam_client.cli.main import app as veilcam
from veilcam_training.bundle import (
    BundleError,
    OwnerKey,
    read_bundle,
    read_key,
    sign_bundle,
    write_bundle,
    write_key,
)
from veilcam_training.bundle.catalogue import publish_bundle
from veilcam_training.cli.main import app as veilcam_train

Change = Callable[[dict[str, Any]], None]


class Publisher:
    """An owner, a signed bundle, and the catalogue that it stands in."""

    def __init__(self, folder: Path) -> None:
        self.key, self.bundle = folder / "owner.pem", folder / "hall.veilcam"
        self.folder, self.out = folder / "catalogue", folder / "pulled" / "hall.veilcam"
        self.out.parent.mkdir()
        self.owner: OwnerKey = write_key(self.key)
        write_bundle(self.bundle, make_bundle())
        self.publish(4)

    def publish(self, version: int) -> None:
        sign_bundle(self.bundle, version, read_key(self.key))
        publish_bundle(self.bundle, self.folder, read_key(self.key))

    def change(self, change: Change) -> None:
        path = self.folder / "catalogue.json"
        content = json.loads(path.read_text())
        change(content["bundles"][0])
        path.write_text(json.dumps(content))

    def pull(self, name: str = "hall", place: str | None = None) -> None:
        pull_bundle(place or str(self.folder), name, str(self.owner), self.out)


@pytest.fixture
def publisher(tmp_path: Path) -> Publisher:
    return Publisher(tmp_path)


@pytest.fixture
def address(publisher: Publisher) -> Iterator[str]:
    class Handler(SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            pass

    handler = partial(Handler, directory=str(publisher.folder))
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}/"
    server.shutdown()
    server.server_close()
    thread.join()


@pytest.mark.parametrize("web", [False, True])
def test_what_was_published_is_what_is_pulled(
    publisher: Publisher, address: str, *, web: bool
) -> None:
    publisher.pull(place=address if web else None)
    assert publisher.out.read_bytes() == publisher.bundle.read_bytes()
    assert read_bundle(publisher.out).owner == publisher.owner
    assert stat.S_IMODE(publisher.out.stat().st_mode) == 0o600
    assert [each.name for each in publisher.out.parent.iterdir()] == ["hall.veilcam"]


def test_a_higher_version_takes_the_place_of_a_lower_one(publisher: Publisher) -> None:
    with pytest.raises(BundleError, match="has hall in version 4: sign a higher one"):
        publisher.publish(4)
    publisher.publish(5)
    publisher.pull()
    assert read_bundle(publisher.out).version == 5
    listed = json.loads((publisher.folder / "catalogue.json").read_text())["bundles"]
    assert [(each["name"], each["version"]) for each in listed] == [("hall", 5)]


def test_only_what_the_owner_signed_is_published(publisher: Publisher, tmp_path: Path) -> None:
    other = tmp_path / "other.pem"
    write_key(other)
    with pytest.raises(BundleError, match="is not signed with this key"):
        publish_bundle(publisher.bundle, publisher.folder, read_key(other))
    odd = publisher.bundle.rename(tmp_path / "a hall.veilcam")
    with pytest.raises(BundleError, match="is no name for a catalogue"):
        publish_bundle(odd, publisher.folder, read_key(publisher.key))
    (publisher.folder / "catalogue.json").write_text("mine")
    with pytest.raises(BundleError, match="is no catalogue"):
        publish_bundle(odd, publisher.folder, read_key(publisher.key))


@pytest.mark.parametrize(
    "change",
    [
        {"name": "door"},
        {"version": 5},
        {"sha256": "ab" * 32},
        {"signature": "AAAA"},
        {"signature": "not base64"},
    ],
    ids=str,
)
def test_nothing_that_was_signed_can_be_changed(
    publisher: Publisher, change: dict[str, Any]
) -> None:
    publisher.change(lambda entry: entry.update(change))
    with pytest.raises(CatalogueError, match="is not signed by this owner, or was changed"):
        publisher.pull(change.get("name", "hall"))
    assert not list(publisher.out.parent.iterdir())


@pytest.mark.parametrize("web", [False, True])
def test_a_file_that_is_not_the_one_that_was_signed_is_not_kept(
    publisher: Publisher, address: str, *, web: bool
) -> None:
    publisher.out.write_bytes(b"before")
    place = address if web else None
    file = publisher.folder / "hall.veilcam"
    content = file.read_bytes()
    for broken, why in (
        (content[:-1], "is not what was signed"),
        (content[:-1] + bytes([content[-1] ^ 1]), "is not what was signed"),
        (content + b"x", "is longer than"),
    ):
        file.write_bytes(broken)
        with pytest.raises(CatalogueError, match=why):
            publisher.pull(place=place)
    file.unlink()
    with pytest.raises(CatalogueError, match=r"hall\.veilcam cannot be read"):
        publisher.pull(place=place)
    assert publisher.out.read_bytes() == b"before"
    assert [each.name for each in publisher.out.parent.iterdir()] == ["hall.veilcam"]


@pytest.mark.parametrize("file", ["../owner.pem", "/etc/hostname", ".hidden", "a/b"])
def test_no_file_outside_the_folder_is_read(publisher: Publisher, file: str) -> None:
    publisher.change(lambda entry: entry.update(file=file))
    with pytest.raises(CatalogueError, match="holds no catalogue"):
        publisher.pull()


def test_what_is_not_there_is_said(publisher: Publisher, tmp_path: Path, address: str) -> None:
    with pytest.raises(CatalogueError, match="lists 'door' 0 times: it has hall"):
        publisher.pull("door")
    with pytest.raises(CatalogueError, match=r"catalogue.json cannot be read"):
        publisher.pull(place=str(tmp_path))
    with pytest.raises(CatalogueError, match=r"catalogue.json cannot be read.*404"):
        publisher.pull(place=f"{address}none")
    with pytest.raises(CatalogueError, match="is no owner's key"):
        pull_bundle(str(publisher.folder), "hall", "veilcam-owner:AAAA", publisher.out)
    out = tmp_path / "none" / "x"
    with pytest.raises(CatalogueError, match="cannot be written"):
        pull_bundle(str(publisher.folder), "hall", str(publisher.owner), out)
    (publisher.folder / "catalogue.json").write_bytes(b" " * (2**20 + 1))
    with pytest.raises(CatalogueError, match="is longer than"):
        publisher.pull()


def test_from_the_command_line(publisher: Publisher, tmp_path: Path) -> None:
    runner, line = CliRunner(), tmp_path / "owner.pub"
    line.write_text(f"{publisher.owner}\n")
    sign_bundle(publisher.bundle, 7, read_key(publisher.key))
    key, to = ("--key", str(publisher.key)), ("--to", str(publisher.folder))
    published = runner.invoke(
        veilcam_train, ["bundle", "publish", str(publisher.bundle), *key, *to]
    )
    assert published.exit_code == 0, published.output
    assert "hall, version 7" in published.output
    place = ("--from", str(publisher.folder))
    command = ["bundle", "pull", "hall", *place, "--out", str(publisher.out)]
    for owner in (str(publisher.owner), str(line)):
        pulled = runner.invoke(veilcam, [*command, "--owner", owner])
        assert pulled.exit_code == 0, pulled.output
        assert "version 7" in pulled.stdout
        assert read_bundle(publisher.out).version == 7
    write_key(tmp_path / "other.pem")
    publisher.change(lambda entry: entry.update(version=9))
    refused = runner.invoke(veilcam, [*command, "--owner", str(line)])
    assert refused.exit_code == 19
    missing = runner.invoke(veilcam, [*command, "--owner", str(tmp_path / "none")])
    assert missing.exit_code == 2
