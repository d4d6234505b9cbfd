"""Whose bundles are taken, and that none that was replaced comes back."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from tests.unit.server.bundles.test_manager import chunks

from veilcam_client.wire.bundles import (
    BUNDLE_MEDIA_TYPE,
    BundleInfo,
    InstalledBundle,
    InstalledBundles,
)
from veilcam_client.wire.events import BundleChanged, Event
from veilcam_server.bundles.loader import LoadedBundle, Opener, last_good
from veilcam_server.bundles.manager import BundleManager
from veilcam_server.bundles.owners import Owners, Used
from veilcam_server.bundles.store import BundleStore, append
from veilcam_server.errors import (
    BundleOlderError,
    BundleRefusedError,
    ProblemError,
    StartError,
)
from veilcam_server.masks.pairs import load_pairs
from veilcam_training.bundle import Bundle, OwnerKey, read_bundle, sign_bundle, write_bundle

if TYPE_CHECKING:
    import httpx
    from tests.unit.server.conftest import Bench, Running

pytestmark = pytest.mark.anyio

KEY, OTHER = (Ed25519PrivateKey.from_private_bytes(bytes([n]) * 32) for n in (1, 2))
OWNER, STRANGER = (OwnerKey(key.public_key().public_bytes_raw()) for key in (KEY, OTHER))
BINARY = {"Content-Type": BUNDLE_MEDIA_TYPE}
OWNERS = Owners(frozenset((OWNER,)))

Make = Callable[..., bytes]


@pytest.fixture
def make(bundle: Bundle, tmp_path: Path) -> Make:
    """Bundles of this camera, with masks of their own."""

    def one(version: int = 0, key: Ed25519PrivateKey | None = None, seed: int = 0) -> bytes:
        path = tmp_path / "made.veilcam"
        random = np.random.default_rng((version, seed))
        pairs = tuple(
            dataclasses.replace(pair, levels=random.integers(0, 64, pair.levels.shape, np.uint8))
            for pair in bundle.pairs
        )
        write_bundle(path, dataclasses.replace(bundle, pairs=pairs))
        if version:
            sign_bundle(path, version, key)
        return path.read_bytes()

    return one


class Api:
    """The routes of bundles."""

    def __init__(self, client: httpx.AsyncClient) -> None:
        self._client = client

    async def install(self, data: bytes) -> str:
        """Digest, or the code of the refusal."""
        answer = await self._client.post("/v1/bundles", content=data, headers=BINARY)
        told = answer.json()
        return str(told["digest" if answer.status_code == 201 else "code"])

    async def activate(self, digest: str, **query: str) -> str:
        """``active``, or the code of the refusal."""
        answer = await self._client.post(f"/v1/bundles/{digest}/activate", params=query)
        if answer.status_code != 200:
            return str(answer.json()["code"])
        return "active" if InstalledBundle.model_validate_json(answer.content).active else "not"

    async def infos(self) -> dict[str, BundleInfo]:
        """What is told of each that is whole."""
        answer = await self._client.get("/v1/bundles")
        listed = InstalledBundles.model_validate_json(answer.content).bundles
        return {one.digest: one.bundle for one in listed if one.bundle is not None}


async def test_only_owners_bundles_are_taken_in(running: Running, bench: Bench, make: Make) -> None:
    bench.owners = OWNERS
    async with running() as client:
        api = Api(client)
        before = set(await api.infos())
        assert await api.install(make()) == "bundle_refused"
        assert await api.install(make(3)) == "bundle_refused"
        assert await api.install(make(3, OTHER)) == "bundle_refused"
        assert set(await api.infos()) == before
        digest = await api.install(make(3, KEY))
        info = (await api.infos())[digest]
        assert (info.version, info.signed_by) == (3, OWNER.short)
        assert await api.activate(digest) == "active"
        status = (await client.get("/v1/status")).json()
        assert status["bundle"]["signed_by"] == OWNER.short
        assert status["bundle"]["version"] == 3
        refused = await client.post("/v1/bundles", content=make(4, OTHER), headers=BINARY)
        assert refused.status_code == 422
        assert refused.json()["detail"] == (
            f"this bundle is signed by {STRANGER.short}: "
            f"this camera takes bundles that {OWNER.short} signed"
        )


async def test_versions_of_an_owner_rise(running: Running, bench: Bench, make: Make) -> None:
    bench.owners = OWNERS
    async with running() as client:
        api = Api(client)
        third, fourth = await api.install(make(3, KEY)), await api.install(make(4, KEY))
        fifth = await api.install(make(5, KEY))
        assert await api.activate(fourth) == "active"
        assert await api.activate(fourth) == "active"
        for query in ({}, {"allow_older": "true"}):
            assert await api.activate(third, **query) == "bundle_older"
        assert await api.install(make(3, KEY)) == "bundle_older"
        assert await api.install(make(4, KEY, seed=1)) == "bundle_older"
        assert await api.install(make(4, KEY)) == fourth
        assert await api.activate(fifth) == "active"
        assert await api.activate(fourth, allow_older="true") == "bundle_older"


async def test_bundle_installed_before_there_were_owners_is_shown_and_not_used(
    running: Running, bench: Bench, make: Make
) -> None:
    async with running() as client:
        digest = await Api(client).install(make(3, OTHER))
    bench.owners = OWNERS
    async with running() as client:
        info = (await Api(client).infos())[digest]
        assert (info.version, info.signed_by) == (3, STRANGER.short)
        assert await Api(client).activate(digest) == "bundle_refused"


async def test_without_owners_an_older_one_is_asked_for_and_said(bench: Bench, make: Make) -> None:
    service = bench.service(bench.camera())
    heard: list[Event] = []
    service._events.subscribe(heard.append)
    async with service.open():

        async def taken(data: bytes) -> str:
            return (await service.bundles.install(chunks(data))).digest

        old, new = await taken(make(3)), await taken(make(4))
        plain = await taken(make())
        await service.activate_bundle(new)
        for digest, version in ((old, 3), (plain, 0)):
            with pytest.raises(BundleOlderError, match=f"of version {version}, and version 4"):
                await service.activate_bundle(digest)
        await service.activate_bundle(old, allow_older=True)
        await service.activate_bundle(new)
    changes = [event for event in heard if isinstance(event, BundleChanged)]
    assert [(each.digest, each.version, each.older) for each in changes] == [
        *((new, 4, False), (old, 3, True), (new, 4, False))
    ]
    assert {each.task for each in changes} == {"mnist"}


async def test_key_to_repeat_with_is_of_one_answer_to_older(running: Running, make: Make) -> None:
    async with running() as client:
        digest = await Api(client).install(make(3))
        key = {"Idempotency-Key": "one"}
        path = f"/v1/bundles/{digest}/activate"
        assert (await client.post(path, headers=key)).status_code == 200
        again = await client.post(path, headers=key, params={"allow_older": "true"})
        assert again.json()["code"] == "idempotency_key_reused"


class Starts:
    """What starts find that follow one another on one state directory."""

    def __init__(self, directory: Path, make: Make) -> None:
        self.directory, self._make = directory, make
        self.owners = OWNERS

    def file(self, version: int, key: Ed25519PrivateKey | None = KEY) -> Path:
        path = self.directory / f"{version}-{key is not None}.veilcam"
        path.write_bytes(self._make(version, key))
        return path

    def store(self, path: Path) -> BundleStore:
        return BundleStore(self.directory / "bundles", path, read_bundle(path).digest)

    def start(self, path: Path, *, allow_older: bool = False) -> tuple[int, list[str]]:
        """Version that is served, and what is said."""
        bundle, store = read_bundle(path), self.store(path)
        opener = Opener(bundle, load_pairs, self.owners)
        faults: list[ProblemError] = []
        keys = last_good(store, opener, bundle, faults.append, allow_older=allow_older)
        BundleManager(store, opener, keys).note_start(faults.append)
        return keys.info.version, [str(fault) for fault in faults]

    def activate(self, configured: Path, path: Path) -> Path:
        """As a running daemon does; returns the installed file."""
        store, bundle = self.store(configured), read_bundle(path)
        opener = Opener(read_bundle(configured), load_pairs, self.owners)
        with store.incoming() as (temporary, stream):
            append(stream, path.read_bytes())
            store.install(temporary, bundle.digest)
        keys: LoadedBundle = opener.open(store.path(bundle.digest), bundle.digest)
        used = self.owners.remember(keys.info, store.used)
        before = store.candidates()[0]
        with closing(store.stage(bundle.digest, before, used)) as staged:
            staged.commit()
        return store.path(bundle.digest)


@pytest.fixture
def starts(tmp_path: Path, make: Make) -> Starts:
    return Starts(tmp_path, make)


def test_start_with_a_bundle_of_nobody_or_somebody_else_is_refused(starts: Starts) -> None:
    for path in (starts.file(1, None), starts.file(2, OTHER)):
        with pytest.raises(BundleRefusedError):
            starts.start(path)


def test_start_remembers_the_highest_version(starts: Starts) -> None:
    third, fourth, fifth = starts.file(3), starts.file(4), starts.file(5)
    assert starts.start(fourth) == (4, [])
    assert starts.start(fourth) == (4, [])
    for allow_older in (False, True):
        with pytest.raises(BundleOlderError, match="version 4 was in use already"):
            starts.start(third, allow_older=allow_older)
    starts.activate(fourth, fifth)
    assert starts.start(fourth) == (5, [])
    with pytest.raises(BundleOlderError, match="version 5 was in use already"):
        starts.start(third)
    assert starts.start(fifth) == (5, [])
    with pytest.raises(BundleOlderError, match="version 5 was in use already"):
        starts.start(fourth)


def test_stand_in_for_a_damaged_bundle_is_an_owner_s_and_said_to_be_older(
    starts: Starts,
) -> None:
    third, fourth, fifth = starts.file(3), starts.file(4), starts.file(5)
    starts.start(third)
    starts.activate(third, fourth)
    installed = starts.activate(third, fifth)
    data = installed.read_bytes()
    installed.write_bytes(data[:1000])
    version, (damaged, older) = starts.start(third)
    assert version == 4
    assert "not a whole bundle" in damaged
    assert "of version 4 is in use, which is older than the one before it" in older
    # It is remembered all the same: no other is taken instead, and mended it is in use again.
    assert starts.start(third)[0] == 4
    assert starts.store(third).used.highest == 5
    installed.write_bytes(data)
    assert starts.start(third) == (5, [])


def test_one_that_is_no_owner_s_any_more_gives_way(starts: Starts) -> None:
    third = starts.file(3)
    starts.start(third)
    starts.owners = Owners(frozenset((OWNER, STRANGER)))
    starts.activate(third, starts.file(7, OTHER))
    assert starts.start(third) == (7, [])
    starts.owners = OWNERS
    version, faults = starts.start(third)
    assert version == 3
    assert f"is signed by {STRANGER.short}" in faults[0]
    assert "older" in faults[1]


def test_without_owners_a_start_with_an_older_one_is_asked_for_and_said(starts: Starts) -> None:
    starts.owners = Owners()
    third, fourth = starts.file(3, None), starts.file(4, OTHER)
    assert starts.start(fourth) == (4, [])
    with pytest.raises(BundleOlderError, match=r"version 4 is in use: take it with --allow-older"):
        starts.start(third)
    version, (older,) = starts.start(third, allow_older=True)
    assert version == 3
    assert "of version 3 is in use, which is older" in older
    assert starts.start(third) == (3, [])
    assert starts.start(fourth) == (4, [])
    assert starts.store(fourth).used.highest == 0  # nobody vouched for it


def test_versions_of_somebody_else_count_for_nothing_once_there_are_owners(starts: Starts) -> None:
    starts.owners = Owners()
    third = starts.file(3)
    starts.start(third)
    starts.activate(third, starts.file(1000, None))
    starts.owners = OWNERS
    version, (fault,) = starts.start(third)
    assert version == 3
    assert "is not signed" in fault
    assert starts.start(starts.file(4)) == (4, [])


def test_start_that_cannot_be_remembered_is_said(
    starts: Starts, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    path = starts.file(3)
    monkeypatch.setattr(os, "fsync", full)
    version, (fault,) = starts.start(path)
    assert version == 3
    assert fault.startswith("which bundle is in use is not remembered: ")
    assert "No space left" in fault


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (None, "cannot be read"),
        ("", "holds no key"),
        ("# nobody yet\n\n", "holds no key"),
        (f"{OWNER}\nveilcam-owner:AA==\n", "line 2: this is no owner's key"),
        ("-----BEGIN PRIVATE KEY-----\n", "line 1: this is no owner's key"),
    ],
)
def test_file_that_names_no_owner_is_refused(
    tmp_path: Path, content: str | None, reason: str
) -> None:
    path = tmp_path / "owners"
    if content is not None:
        path.write_text(content)
    with pytest.raises(StartError, match=reason) as caught:
        Owners.open(path)
    assert "\n" not in str(caught.value)


def test_file_names_several_owners(tmp_path: Path) -> None:
    path = tmp_path / "owners"
    path.write_text(f"# of the hall\n{OWNER} {OWNER.short} Ada\n\n  {STRANGER}\n")
    assert Owners.open(path).keys == {OWNER, STRANGER}
    assert Owners.open(None).keys == ()


def test_versions_used_are_remembered() -> None:
    info = BundleInfo(
        digest="a", task="", mode="pairs", labels=(), embedding_shape=(), pairs=1, version=4
    )
    assert Owners().remember(info, Used(2, 3, "b")) == Used(4, 3, "b")
    assert OWNERS.remember(info, Used(2, 3, "b")) == Used(4, 4, "a")
    assert OWNERS.remember(info, Used(9, 9, "b")) == Used(4, 9, "b")
