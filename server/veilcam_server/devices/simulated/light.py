"""Light of a simulated camera on raw pixels, and the imperfections that it was built with.

A plan chooses the path of the optics and says how far off it is. Its tolerance is a tenth of that
which decoders are trained with, as far as a start and a capture have time for it.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Protocol

import structlog
import torch
from pydantic import TypeAdapter, ValidationError

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.imperfections import NOMINAL, Imperfections
from veilcam_optics.camera.imperfections import Conditions as Optical
from veilcam_optics.effects import Model
from veilcam_optics.errors import OpticsError
from veilcam_optics.plan import plan
from veilcam_optics.plan.cost import cost
from veilcam_optics.simulation.operator import LightOperator, Response
from veilcam_server.errors import StartError
from veilcam_server.system.memory import share_one_heap

_FINER, _FINEST = 4, 40
"""Raw pixels along each side of an embedding pixel, at least and at most; each stands for many of a
real sensor's."""
DECODERS_TOLERANCE = 3e-3
"""Relative error of the light that decoders are trained with."""
TOLERANCE = DECODERS_TOLERANCE / 10
"""Relative error that is asked of the simulated light; few cameras' light gets so near."""
_LONGEST_BUILD, _LONGEST_CAPTURE = 1000.0, 8.0
"""Predicted times above which the light is as coarse as the decoders' [ms]."""

log = structlog.get_logger()


def use_torch_sparingly() -> None:
    """Make simulated light fit for a small machine and a sandbox."""
    # One thread: two pools fighting over the cores of a Raspberry Pi are slower than one.
    torch.set_num_threads(1)
    # oneDNN writes machine code for convolutions as it goes, which MemoryDenyWriteExecute= forbids.
    # Torch's own are as fast for one scene at a time (deploy/README.md).
    torch.backends.mkldnn.set_flags(_enabled=False)  # type: ignore[no-untyped-call]
    share_one_heap()


class Light(Protocol):
    """Light of the optics; :class:`veilcam_optics.effects.LightOperator` is one."""

    def response(self, weights: torch.Tensor) -> Response:
        """Return what a mask makes of the light."""

    def collect(self, scenes: torch.Tensor, response: Response) -> torch.Tensor:
        """Return the light of scenes on raw pixels: (batch, rows, columns) of a raw frame.

        In colour it is (batch, 3, rows, columns), of two by two raw pixels each.
        """


class ColourLight:
    """Light in colour: that of three gray cameras, each of one channel alone.

    Args:
        model: model of the light on two by two raw pixels.
    """

    def __init__(self, model: Model) -> None:
        alone = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        sensors = [replace(model.camera.sensor, channel_weights=weights) for weights in alone]
        cameras = [replace(model.camera, sensor=sensor) for sensor in sensors]
        self._channels = [LightOperator(replace(model, camera=camera)) for camera in cameras]

    def response(self, weights: torch.Tensor) -> Response:
        """Return those of the channels, one after the other."""
        return tuple(part for channel in self._channels for part in channel.response(weights))

    def collect(self, scenes: torch.Tensor, response: Response) -> torch.Tensor:
        """Return the light (batch, 3, rows, columns) of scenes (batch, 3, rows, columns)."""
        count = len(response) // len(self._channels)
        parts = [response[first : first + count] for first in range(0, len(response), count)]
        lights = zip(self._channels, scenes.unbind(1), parts, strict=True)
        return torch.stack([light.collect(scene, part) for light, scene, part in lights], 1)


def raw_shape(embedding: Embedding, *, colour: bool = False) -> tuple[int, int]:
    """Rows and columns of simulated raw frames: boxes are of whole pixels, where that can be.

    In colour they are of whole two by two pixels, which have one light.
    """
    unit = 2 if colour else 1
    for cells in range(_FINER // unit, _FINEST // unit + 1):
        side = round(embedding.fill * cells)
        whole = abs(embedding.fill * cells - side) < 1e-6
        if whole and unit * side >= 2 and (cells - side) % 2 == 0:
            break
    return unit * cells * embedding.rows, unit * cells * embedding.columns


def planned_light(
    camera: Camera,
    scene: Scene,
    embedding: Embedding,
    imperfections: Imperfections = NOMINAL,
    *,
    colour: bool = False,
) -> Light:
    """Return the light of a camera, as a plan for the embedding chooses it, on raw pixels.

    Args:
        camera: camera as it is, its filters' leakage included.
        scene: scene in front of it.
        embedding: embedding that is read.
        imperfections: imperfections that a decoder need not know of.
        colour: True keeps the channels apart.
    """
    rows, columns = raw_shape(embedding, colour=colour)
    pixels = Embedding(rows // 2, columns // 2) if colour else Embedding(rows, columns)
    conditions = Optical(imperfections=imperfections)
    for tolerance in (TOLERANCE, DECODERS_TOLERANCE):
        chosen = plan(camera, scene, embedding, tolerance, conditions, batch=1)
        model = replace(chosen.model, embedding=pixels)
        if model.sampling.method == "transfer":
            # The same light, without a matrix of all raw pixels for every mask.
            model = replace(model, sampling=replace(model.sampling, method="factors"))
        spent = cost(model, batch=1)
        if spent.build_ms <= _LONGEST_BUILD and spent.step_ms <= _LONGEST_CAPTURE:
            break
    log.info("simulated light", method=model.sampling.method, predicted_error=chosen.error)
    return ColourLight(model) if colour else LightOperator(model)


def read_imperfections(path: Path, camera: Camera) -> Imperfections:
    """Read a JSON file, an object of the fields of :class:`Imperfections`.

    Args:
        path: path of the file.
        camera: camera that shall have them.

    Raises:
        StartError: the file cannot be read, or says what ``camera`` cannot have.
    """
    try:
        found = TypeAdapter(Imperfections).validate_json(path.read_bytes())
        found.check(camera)
    except OSError as error:
        raise StartError(f"--imperfections {path} cannot be read: {error.strerror}") from None
    except ValidationError as error:
        item = error.errors(include_url=False, include_input=False)[0]
        place = ".".join(map(str, item["loc"])) or "file"
        message = item["msg"].removeprefix("Value error, ")
        raise StartError(f"--imperfections {path}: {place}: {message}") from None
    except OpticsError as error:
        raise StartError(f"--imperfections {path}: {error}") from None
    return found
