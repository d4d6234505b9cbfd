"""Bundles: taken in, used, rolled back, and never a change of what runs but on purpose."""

from __future__ import annotations

import asyncio
import dataclasses
import os
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch
from tests.unit.server.damage import DAMAGES

from veilcam_client.wire.base import Problem
from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE, InstalledBundle, InstalledBundles
from veilcam_client.wire.captures import Classification
from veilcam_client.wire.events import Event, Fault
from veilcam_client.wire.rotation import EveryCaptures
from veilcam_client.wire.status import Status
from veilcam_optics.camera.geometry import Embedding
from veilcam_server.bundles import store as bundle_store
from veilcam_server.bundles.loader import LoadedBundle, Opener, last_good
from veilcam_server.bundles.owners import Used
from veilcam_server.bundles.store import BundleStore
from veilcam_server.camera.epochs import Epoch, Preparation
from veilcam_server.devices import DisplayError
from veilcam_server.errors import (
    BundleRefusedError,
    NotReadyError,
    ProblemError,
)
from veilcam_server.masks.pairs import load_pairs
from veilcam_server.security.admission import UPLOADS, UPLOADS_OF_ONE, Admission
from veilcam_server.security.limits import ConcurrencyLimit
from veilcam_training.bundle import Bundle, read_bundle, write_bundle

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable

    import httpx
    from tests.unit.server.conftest import Bench, Running

pytestmark = pytest.mark.anyio


def other(bundle: Bundle, *, pairs: int = 2, seed: int = 1, task: str = "other") -> Bundle:
    """A bundle for the same camera, with other masks, classifiers and task."""
    random = np.random.default_rng(seed)
    generator = torch.Generator().manual_seed(seed)
    changed = tuple(
        dataclasses.replace(
            pair,
            levels=random.integers(0, 64, pair.levels.shape, np.uint8),
            weights={
                name: torch.randn(array.shape, generator=generator).numpy()
                for name, array in pair.weights.items()
            },
        )
        for pair in bundle.pairs[:pairs]
    )
    return dataclasses.replace(bundle, task=task, pairs=changed)


@pytest.fixture
def data(bundle: Bundle, tmp_path: Path) -> bytes:
    return packed(other(bundle), tmp_path)


async def upload(client: httpx.AsyncClient, data: bytes) -> httpx.Response:
    headers = {"Content-Type": BUNDLE_MEDIA_TYPE}
    return await client.post("/v1/bundles", content=data, headers=headers)


def packed(bundle: Bundle, folder: Path) -> bytes:
    """The content of its file."""
    folder.mkdir(exist_ok=True)
    path = folder / "packed.veilcam"
    write_bundle(path, bundle)
    return path.read_bytes()


async def chunks(*parts: bytes) -> AsyncIterator[bytes]:
    for part in parts:
        yield part


async def unchanged(_: LoadedBundle) -> None:
    """A change of the camera that is none."""


async def install(client: httpx.AsyncClient, data: bytes) -> InstalledBundle:
    answer = await upload(client, data)
    assert answer.status_code == 201, answer.text
    return InstalledBundle.model_validate_json(answer.content)


async def activate(client: httpx.AsyncClient, digest: str) -> httpx.Response:
    return await client.post(f"/v1/bundles/{digest}/activate")


async def active(client: httpx.AsyncClient) -> str:
    """Of list and status, which must agree."""
    answer = InstalledBundles.model_validate_json((await client.get("/v1/bundles")).content)
    (digest,) = [installed.digest for installed in answer.bundles if installed.active]
    status = Status.model_validate_json((await client.get("/v1/status")).content)
    assert status.bundle.digest == digest
    return digest


async def label(client: httpx.AsyncClient) -> Classification:
    answer = await client.post("/v1/classifications")
    assert answer.status_code == 200, answer.text
    return Classification.model_validate_json(answer.content)


def expected(bundle: Bundle, bench: Bench) -> str:
    """What the classifier of the mask on the panel says."""
    (pair,) = [p for p in bundle.pairs if np.array_equal(p.levels, bench.display.shown[-1])]
    logits = pair.weights["0.weight"] @ bench.sensor.measurement.ravel()
    return bundle.labels[int((logits + pair.weights["0.bias"]).argmax())]


def code(answer: httpx.Response) -> str:
    return Problem.model_validate_json(answer.content).code


async def test_bundle_taken_in_is_not_used(running: Running, bench: Bench, data: bytes) -> None:
    async with running() as client:
        before = await active(client)
        installed = await install(client, data)
        assert (installed.active, installed.configured, installed.size) == (False, False, len(data))
        assert installed.bundle is not None
        assert installed.bundle.task == "other"
        again = await install(client, data)
        assert again == installed
        assert await active(client) == before
        answer = InstalledBundles.model_validate_json((await client.get("/v1/bundles")).content)
        assert [one.digest for one in answer.bundles] == [before, installed.digest]
    assert len(bench.display.shown) == 2  # a mask, and opaque at the end
    (path,) = (bench.state_dir / "bundles").iterdir()
    assert path.name == f"{installed.digest}.veilcam"
    assert path.stat().st_mode & 0o077 == 0
    assert path.parent.stat().st_mode & 0o077 == 0


async def test_mask_and_classifier_change_together_and_back(
    running: Running, bench: Bench, data: bytes, bundle: Bundle
) -> None:
    bench.sensor.measurement = np.random.default_rng(0).random((4, 5), np.float32)
    async with running() as client:
        first = await active(client)
        installed = await install(client, data)
        answer = await activate(client, installed.digest)
        assert InstalledBundle.model_validate_json(answer.content).active
        assert await active(client) == installed.digest
        changed = other(bundle)
        for _ in range(4):
            result = await label(client)
            assert result.epoch == bench.epochs[-1]
            assert result.label == expected(changed, bench)
            await client.post("/v1/rotation/advance")
        assert (await activate(client, first)).status_code == 200
        assert await active(client) == first
        result = await label(client)
        assert result.label == expected(bundle, bench)


@pytest.mark.parametrize("faults", [1, 3])
async def test_panel_that_fails_keeps_the_bundle_or_is_opaque(
    running: Running, bench: Bench, data: bytes, bundle: Bundle, faults: int
) -> None:
    bench.sensor.measurement = np.random.default_rng(0).random((4, 5), np.float32)
    async with running() as client:
        before = await active(client)
        installed = await install(client, data)
        bench.display.faults = [DisplayError("no answer") for _ in range(faults)]
        answer = await activate(client, installed.digest)
        assert code(answer) == "display_failed"
        assert await active(client) == before
        if faults > 1:
            assert (await client.get("/v1/status")).json()["state"] in ("safe", "ready")
            await client.post("/v1/rotation/advance")
        assert (await label(client)).label == expected(bundle, bench)
    assert not list((bench.state_dir / "bundles").glob(".new-*"))
    assert not (bench.state_dir / "bundles" / "in-use.json").exists()


async def test_first_mask_that_cannot_be_made_keeps_the_bundle(
    running: Running, bench: Bench, data: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> Epoch:
        raise NotReadyError("the first mask is still being prepared: try again")

    async with running() as client:
        before = await active(client)
        installed = await install(client, data)
        with monkeypatch.context() as patch:
            patch.setattr(Preparation, "first_of", fail)
            assert code(await activate(client, installed.digest)) == "not_ready"
        assert await active(client) == before
        assert (await activate(client, installed.digest)).status_code == 200


async def test_change_that_cannot_be_made_durable_is_rolled_back(
    running: Running, bench: Bench, data: bytes, monkeypatch: pytest.MonkeyPatch, bundle: Bundle
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(5, "Input/output error")

    bench.sensor.measurement = np.random.default_rng(0).random((4, 5), np.float32)
    async with running() as client:
        before = await active(client)
        installed = await install(client, data)
        with monkeypatch.context() as patch:
            patch.setattr(Path, "replace", refuse)
            assert code(await activate(client, installed.digest)) == "storage_failed"
        assert await active(client) == before
        assert (await label(client)).label == expected(bundle, bench)


async def test_lone_mask_does_not_fit_a_policy_that_wants_another(
    running: Running, bundle: Bundle, tmp_path: Path
) -> None:
    async with running(policy=EveryCaptures(captures=5)) as client:
        installed = await install(client, packed(other(bundle, pairs=1), tmp_path))
        assert code(await activate(client, installed.digest)) == "conflict"
        await client.put("/v1/rotation", json={"mode": "off"})
        assert (await activate(client, installed.digest)).status_code == 200
        assert code(await client.post("/v1/rotation/advance")) == "conflict"


async def test_bundle_that_cannot_be_used_is_refused_with_the_reason(
    running: Running, bench: Bench, data: bytes, tmp_path: Path, fresh_file: Path
) -> None:
    pairs = tuple(
        dataclasses.replace(
            pair,
            weights={**pair.weights, "0.weight": np.zeros((10, 12), np.float32)},
            layers=(pair.layers[0].model_copy(update={"inputs": 12}),),
        )
        for pair in bench.bundle.pairs
    )
    other_embedding = dataclasses.replace(bench.bundle, embedding=Embedding(3, 4), pairs=pairs)
    async with running() as client:
        before = await active(client)
        for content, wanted, word in (
            (b"", "bundle_refused", "not a whole bundle"),
            (data[:-100], "bundle_refused", "not a whole bundle"),
            (packed(other_embedding, tmp_path), "bundle_refused", "another embedding"),
            (fresh_file.read_bytes(), "bundle_refused", "another mode"),
        ):
            answer = await upload(client, content)
            assert code(answer) == wanted
            assert word in answer.json()["detail"]
            assert str(bench.state_dir) not in answer.text
        assert await active(client) == before
        answer = await upload(client, bytes(2**20 + 1))
        assert code(answer) == "body_too_large"
        answer = await client.post(f"/v1/bundles/{'0' * 64}/activate")
        assert code(answer) == "not_found"
        assert code(await activate(client, "../../etc/passwd")) == "not_found"
        assert code(await activate(client, "A" * 64)) == "invalid_request"
    assert list((bench.state_dir / "bundles").iterdir()) == []


async def test_removed_for_good_but_not_what_is_in_use(running: Running, data: bytes) -> None:
    async with running() as client:
        configured = await active(client)
        installed = await install(client, data)
        await activate(client, installed.digest)
        for digest in (configured, installed.digest):
            assert code(await client.delete(f"/v1/bundles/{digest}")) == "conflict"
        await activate(client, configured)
        answer = await client.delete(f"/v1/bundles/{installed.digest}")
        assert [one["digest"] for one in answer.json()["bundles"]] == [configured]
        assert code(await activate(client, installed.digest)) == "not_found"


async def test_bundles_have_room_for_so_many(
    running: Running, data: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bundle_store, "CAPACITY", 1)
    async with running() as client:
        installed = await install(client, data)
        assert code(await upload(client, data)) == "conflict"
        assert (await activate(client, installed.digest)).status_code == 200


async def test_upload_that_stands_still_holds_up_nothing(bench: Bench, bundle: Bundle) -> None:
    async def slow() -> AsyncIterator[bytes]:
        yield first[:100]
        await go_on.wait()
        yield first[100:]

    go_on = asyncio.Event()
    first, second = (packed(other(bundle, seed=seed), bench.state_dir) for seed in (1, 2))
    bundles = bench.service(bench.camera()).bundles
    configured = bundles.info.digest
    async with asyncio.timeout(60):
        standing = asyncio.create_task(bundles.install(slow()))
        await asyncio.sleep(0)
        installed = await bundles.install(chunks(second))
        await bundles.activate(installed.digest, unchanged)
        await bundles.activate(configured, unchanged)
        await bundles.remove(installed.digest)
        assert not standing.done()
        go_on.set()
        assert (await standing).bundle is not None


async def test_one_change_at_a_time(bench: Bench, data: bytes) -> None:
    async def slow(_: LoadedBundle) -> None:
        changing.set()
        await go_on.wait()

    changing, go_on = asyncio.Event(), asyncio.Event()
    bundles = bench.service(bench.camera()).bundles
    digest = (await bundles.install(chunks(data))).digest
    async with asyncio.timeout(60):
        activation = asyncio.create_task(bundles.activate(digest, slow))
        await changing.wait()
        with pytest.raises(ProblemError):
            await bundles.remove(digest)
        # What was sent to the end is taken in afterwards.
        upload = asyncio.create_task(bundles.install(chunks(data)))
        while not list((bench.state_dir / "bundles").glob(".new-*")):
            await asyncio.sleep(0.001)
        assert not upload.done()
        go_on.set()
        assert (await activation).active
        assert (await upload).digest == digest


async def test_uploads_at_once_leave_no_more_than_there_is_room_for(
    bench: Bench, bundle: Bundle, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def sent(content: bytes) -> AsyncIterator[bytes]:
        begun.append(content)
        while len(begun) < 2:
            await asyncio.sleep(0)
        yield content

    begun: list[bytes] = []
    monkeypatch.setattr(bundle_store, "CAPACITY", 1)
    contents = [packed(other(bundle, seed=seed), bench.state_dir) for seed in (1, 2)]
    bundles = bench.service(bench.camera()).bundles
    results = await asyncio.gather(
        *(bundles.install(sent(content)) for content in contents), return_exceptions=True
    )
    assert sum(isinstance(result, ProblemError) for result in results) == 1
    assert len((await bundles.all()).bundles) == 2
    assert not list((bench.state_dir / "bundles").glob(".new-*"))


async def test_so_many_uploads_at_once(running: Running, data: bytes) -> None:
    for admission, told in (
        (Admission(uploads=ConcurrencyLimit(0, UPLOADS)), "0 uploads"),
        (Admission(uploads_of_one=ConcurrencyLimit(0, UPLOADS_OF_ONE)), "0 of your"),
    ):
        async with running(admission=admission) as client:
            refused = await upload(client, data)
            assert code(refused) == "too_many_requests"
            assert told in refused.json()["detail"]
            assert int(refused.headers["retry-after"]) >= 1


async def test_full_disk_leaves_nothing_behind(
    running: Running, bench: Bench, data: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    async with running() as client:
        monkeypatch.setattr(os, "fsync", full)
        answer = await upload(client, data)
        monkeypatch.undo()
        assert code(answer) == "storage_failed"
        assert "No space left" in answer.json()["detail"]
    assert list((bench.state_dir / "bundles").iterdir()) == []


class Restarts:
    """What a start finds after another has activated bundles."""

    def __init__(self, bundle: Bundle, directory: Path) -> None:
        self.directory = directory
        self.faults: list[ProblemError] = []
        """Of the start that was tried last."""
        self.files = []
        for number in range(3):
            path = directory / f"{number}.veilcam"
            write_bundle(path, other(bundle, seed=number, task=f"task {number}"))
            self.files.append(path)
        self.digests = [read_bundle(path).digest for path in self.files]

    def store(self, configured: int = 0) -> BundleStore:
        path, digest = self.files[configured], self.digests[configured]
        return BundleStore(self.directory / "bundles", path, digest, self.faults.append)

    def use(self, number: int, before: int) -> None:
        """Install and activate."""
        store = self.store()
        with store.incoming() as (path, stream):
            bundle_store.append(stream, self.files[number].read_bytes())
            store.install(path, self.digests[number])
        with closing(store.stage(self.digests[number], self.digests[before], Used())) as staged:
            staged.commit()

    def start(self, configured: int = 0) -> tuple[str, list[str]]:
        """Task that is served, and what could not be."""
        bundle = read_bundle(self.files[configured])
        self.faults.clear()
        opener = Opener(bundle, load_pairs)
        keys = last_good(self.store(configured), opener, bundle, self.faults.append)
        return keys.info.task, [str(each) for each in self.faults]


@pytest.fixture
def restarts(bundle: Bundle, tmp_path: Path) -> Restarts:
    return Restarts(bundle, tmp_path)


def test_restart_goes_on_with_the_bundle_in_use(restarts: Restarts) -> None:
    assert restarts.start() == ("task 0", [])
    restarts.use(1, before=0)
    assert restarts.start() == ("task 1", [])
    restarts.use(2, before=1)
    assert restarts.start() == ("task 2", [])


def test_restart_with_another_bundle_uses_that(restarts: Restarts) -> None:
    restarts.use(1, before=0)
    assert restarts.start(configured=2) == ("task 2", [])
    assert restarts.start() == ("task 1", [])


def test_damaged_bundle_gives_way_to_the_last_good_one(restarts: Restarts) -> None:
    restarts.use(1, before=0)
    restarts.use(2, before=1)
    installed = restarts.directory / "bundles" / f"{restarts.digests[2]}.veilcam"
    data = installed.read_bytes()
    installed.write_bytes(data[:1000])
    task, (fault,) = restarts.start()
    assert task == "task 1"
    assert restarts.digests[2][:12] in fault
    assert "not a whole bundle" in fault
    assert str(restarts.directory) not in fault
    # Whole, but another one than its name says.
    installed.write_bytes(restarts.files[0].read_bytes())
    task, (fault,) = restarts.start()
    assert task == "task 1"
    assert "changed on the disk" in fault
    (restarts.directory / "bundles" / f"{restarts.digests[1]}.veilcam").unlink()
    task, faults = restarts.start()
    assert task == "task 0"
    assert len(faults) == 2


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_lost_record_rolls_nothing_back_in_silence(
    restarts: Restarts, damage: Callable[[Path], None]
) -> None:
    restarts.use(1, before=0)
    for name in ("in-use.json", "in-use.json.copy"):
        damage(restarts.directory / "bundles" / name)
    for _ in range(2):
        task, (fault,) = restarts.start()
        assert (task, restarts.faults[0].code) == ("task 0", "state_lost")
        assert "the bundle that the daemon was started with is in use; activate" in fault
    restarts.use(1, before=0)
    assert restarts.start() == ("task 1", [])


def test_remains_of_a_killed_upload_are_removed(restarts: Restarts) -> None:
    restarts.use(1, before=0)
    left = restarts.directory / "bundles" / ".new-abc"
    left.write_bytes(b"half")
    assert restarts.start() == ("task 1", [])
    assert not left.exists()


async def test_faults_of_the_start_are_events(bench: Bench) -> None:
    service = bench.service(bench.camera())
    service.report(BundleRefusedError("bundle 0123 is not in use any more"))
    async with service.open():
        service.report(ProblemError("state_lost", "of later"))
        heard = [event async for event in _until_quiet(service.events("x-0"))]
    faults = [event for event in heard if isinstance(event, Fault)]
    assert [(fault.code, fault.detail) for fault in faults] == [
        ("bundle_refused", "bundle 0123 is not in use any more"),
        ("state_lost", "of later"),
    ]


async def _until_quiet(events: AsyncIterator[Event | None]) -> AsyncIterator[Event]:
    async for event in events:
        if event is None:
            return
        yield event
