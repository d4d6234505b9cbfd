"""Scenes from sealed embeddings: with a receiver's key, away from the camera."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.unit.client.sealing import Device, Epoch

from veilcam_client import SceneDecoder, VeilcamError
from veilcam_client.errors import FileError, SealedError
from veilcam_client.keys.blocks import Opener
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.captures import Classification
from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Window
from veilcam_optics.decoding import SceneFrame, fit_statistics, write_frame
from veilcam_optics.keys.masks import draw_levels

pytestmark = pytest.mark.numerical
SCENE, EMBEDDING = Scene(rows=6, columns=6), Embedding(4, 5)

ROUNDING = 1e-5
"""Of float32, in which a frame's file keeps its statistics; scenes are up to 1."""


def make_frame(window: Window) -> SceneFrame:
    """Blobs of light somewhere: scenes that have statistics."""
    generator = torch.Generator().manual_seed(1)
    scenes = torch.rand(200, *SCENE.shape, generator=generator).cumsum(1).cumsum(2) / 36
    camera = Camera(panel=Panel(), window=window)
    return SceneFrame(camera, SCENE, EMBEDDING, fit_statistics([scenes], 8))


class Taken:
    """A scene behind a mask of an epoch, sealed, and what its decoder makes of it."""

    def __init__(self, frame: SceneFrame, device: Device, receiver: ReceiverKey) -> None:
        self.epoch = Epoch(device, receiver)
        levels = draw_levels(self.epoch.key.levels(), camera=frame.camera)
        decoding = frame.decoding()
        decoder = decoding.prepare(frame.shown(levels))
        transfer = decoding.operator(frame.shown(levels))
        scene = torch.linspace(0, 1, SCENE.rows * SCENE.columns)
        measurement = (scene @ transfer.to(scene.dtype)).reshape(1, *EMBEDDING.shape).float()
        self.decoder, self.measurement = decoder, measurement
        self.expected = decoder(measurement)[0].float().numpy()
        self.capture = self.epoch.capture(0, values=measurement[0].numpy())


@pytest.fixture(scope="module")
def frame() -> SceneFrame:
    return make_frame(Window(rows=9, columns=5))


@pytest.fixture
def path(frame: SceneFrame, tmp_path: Path) -> Path:
    write_frame(tmp_path / "frame", frame)
    return tmp_path / "frame"


def test_receiver_decodes_every_mask(
    frame: SceneFrame, path: Path, receiver: ReceiverKey, tmp_path: Path
) -> None:
    device = Device()
    receiver.write(tmp_path / "key")
    decoders = (SceneDecoder(path, receiver, device.public), SceneDecoder(path, tmp_path / "key"))
    first, second = Taken(frame, device, receiver), Taken(frame, device, receiver)
    mistaken = second.decoder(first.measurement)[0].numpy()
    assert np.abs(mistaken - first.expected).max() > 0.05  # the mask matters
    for taken in (first, second):
        for decoder in decoders:
            for _ in range(2):  # the same answer twice
                scene = decoder.decode(taken.capture)
                np.testing.assert_allclose(scene, taken.expected, atol=ROUNDING)
    assert scene.shape == SCENE.shape


def test_classification_is_decoded_too(
    frame: SceneFrame, path: Path, receiver: ReceiverKey
) -> None:
    taken = Taken(frame, Device(), receiver)
    told = {**taken.capture.model_dump(), "label": "7"}
    decoder = SceneDecoder(path, receiver)
    scene = decoder.decode(Classification.model_validate(told))
    np.testing.assert_allclose(scene, taken.expected, atol=ROUNDING)
    for answer in (
        Classification.model_validate({**told, "embedding": None}),
        Opener(receiver).open(taken.capture),
    ):
        with pytest.raises(VeilcamError, match="holds no sealed embedding") as refused:
            decoder.decode(answer)
        assert refused.value.code == "no_embedding"


def test_foreign_capture_is_not_decoded(
    frame: SceneFrame, path: Path, receiver: ReceiverKey
) -> None:
    taken, other = Taken(frame, Device(), receiver), Taken(frame, Device(), receiver)
    decoder = SceneDecoder(path, receiver)
    with pytest.raises(SealedError, match="changed on its way"):
        decoder.decode(taken.capture.model_copy(update={"number": 1}))
    decoder.decode(taken.capture)
    with pytest.raises(SealedError, match="check the camera"):
        decoder.decode(other.capture)
    with pytest.raises(SealedError, match="not sealed to receiver"):
        SceneDecoder(path, ReceiverKey.generate()).decode(taken.capture)


def test_frame_of_another_camera_is_refused(
    frame: SceneFrame, receiver: ReceiverKey, tmp_path: Path
) -> None:
    capture = Epoch(Device(), receiver).capture(0)
    write_frame(tmp_path / "frame", frame)
    with pytest.raises(VeilcamError) as refused:
        SceneDecoder(tmp_path / "frame", receiver).decode(capture)
    assert refused.value.code == "decoding_failed"
    with pytest.raises(VeilcamError, match="check the path"):
        SceneDecoder(tmp_path / "missing", receiver)
    with pytest.raises(FileError, match="cannot be read"):
        SceneDecoder(tmp_path / "frame", tmp_path / "missing")


def test_decoder_without_the_optics_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, path: Path, receiver: ReceiverKey
) -> None:
    monkeypatch.setitem(sys.modules, "veilcam_optics.decoding", None)
    with pytest.raises(VeilcamError, match="needs the extra 'optics'") as refused:
        SceneDecoder(path, receiver)
    assert refused.value.code == "optics_missing"
