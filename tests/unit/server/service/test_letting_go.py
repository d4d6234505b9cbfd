"""Captures let go of their epoch whatever becomes of the request, so that it can be erased."""

from __future__ import annotations

import asyncio
import threading
from typing import TYPE_CHECKING

import pytest

from veilcam_client.wire.captures import Prediction
from veilcam_server.camera.camera import MaskedCamera
from veilcam_server.camera.epochs import Epoch
from veilcam_server.devices.base import Measurement
from veilcam_server.masks.fresh import FreshReader

from .waiting import until

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench

pytestmark = pytest.mark.anyio


def shown(camera: MaskedCamera) -> Epoch:
    active = camera._panel.active
    assert active is not None
    return active.epoch


async def test_request_that_was_called_off_lets_go(
    fresh_bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    inside, go_on = threading.Event(), threading.Event()
    classify = FreshReader.classify

    def slow(reader: FreshReader, measurement: Measurement) -> Prediction:
        inside.set()
        assert go_on.wait(200)
        return classify(reader, measurement)

    monkeypatch.setattr(FreshReader, "classify", slow)
    camera = fresh_bench.camera()
    service = fresh_bench.service(camera)
    async with service.open():
        epoch = shown(camera)
        requests = [
            asyncio.create_task(service.classify(include_embedding=False)) for _ in range(2)
        ]
        await asyncio.to_thread(inside.wait, 20)
        # The first is being classified, the second waits for its turn.
        await until(lambda: camera.present[1] == 2)
        for request in requests:
            request.cancel()
        assert [type(each) for each in await asyncio.gather(*requests, return_exceptions=True)] == [
            asyncio.CancelledError
        ] * 2
        await service.rotate()
        assert shown(camera) is not epoch
        assert not epoch.erased
        go_on.set()
        await until(lambda: epoch.erased)


async def test_request_that_fails_lets_go(
    fresh_bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(reader: FreshReader, measurement: Measurement) -> Prediction:
        raise RuntimeError("a classifier that fails")

    monkeypatch.setattr(FreshReader, "classify", broken)
    camera = fresh_bench.camera()
    service = fresh_bench.service(camera)
    async with service.open():
        epoch = shown(camera)
        with pytest.raises(RuntimeError, match="a classifier that fails"):
            await service.classify(include_embedding=True)
        await service.rotate()
        await until(lambda: epoch.erased)
