"""A file for all that decoding needs besides the secret: geometry, statistics and noise.

One safetensors file: the tensors of the statistics and of the distribution that masks are drawn
from, and as its metadata one JSON text with the rest. None of it is secret. It holds no code.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import safetensors.torch
import torch
from pydantic import BaseModel, ValidationError
from safetensors import SafetensorError, safe_open
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.imperfections import NOMINAL, Imperfections
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.decoding.decoder import Precision, SceneDecoding
from veilcam_optics.decoding.noise import DEFAULT_NOISE, MeasurementNoise
from veilcam_optics.decoding.statistics import SceneStatistics
from veilcam_optics.errors import OpticsError
from veilcam_optics.files import write_whole
from veilcam_optics.keys.masks import Levels, MaskDistribution
from veilcam_optics.transfer.operator import Reach, TransferOperator

KEY = "veilcam"
STATISTICS = ("mean", "basis", "residual")
DISTRIBUTION = ("lowest", "highest", "curve")
MAX_BYTES = 2**30


class _Header(BaseModel, frozen=True, extra="forbid", strict=True):
    format: Literal["veilcam-frame"] = "veilcam-frame"
    version: Literal[1] = 1
    camera: Camera
    scene: Scene
    embedding: Embedding
    reach: Reach
    noise: MeasurementNoise
    calibration: Imperfections = NOMINAL


@dataclass(frozen=True)
class SceneFrame:
    """Camera, scene, embedding, and what is publicly known of scenes, noise and masks."""

    camera: Camera
    scene: Scene
    embedding: Embedding
    statistics: SceneStatistics
    noise: MeasurementNoise = DEFAULT_NOISE
    reach: Reach = field(default_factory=Reach)
    distribution: MaskDistribution | None = None
    """What masks are drawn from; None is uniform over all that the panel can show."""
    imperfections: Imperfections = NOMINAL
    """Of the camera as it was built; whatever reads it takes out the stray light."""

    def shown(self, levels: Levels) -> Tensor:
        """Weights that the panel shows for ``levels``: what decoders are prepared for."""
        return self.imperfections.shown(to_weights(levels, self.camera.panel))

    def decoding(
        self, *, rank: int | None = None, precision: Precision = Precision.MIXED
    ) -> SceneDecoding:
        """What prepares decoders, with fewer components of the statistics if ``rank`` says so."""
        operator = TransferOperator(
            self.camera,
            self.scene,
            self.embedding,
            reach=self.reach,
            dtype=getattr(torch, precision.products),
            imperfections=self.imperfections,
        )
        statistics = self.statistics if rank is None else self.statistics.truncate(rank)
        return SceneDecoding(operator, statistics, self.noise, precision=precision)


def write_frame(path: Path, frame: SceneFrame) -> None:
    """Write ``frame`` so that ``path`` holds either what it held before or all of it."""
    write_whole(path, dump_frame(frame), private=True)


def read_frame(path: Path) -> SceneFrame:
    """Read what :func:`write_frame` wrote.

    Raises:
        OpticsError: the file is missing, damaged, too large, or not such a file.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise OpticsError(f"is too large: a frame has at most {MAX_BYTES} bytes")
        with safe_open(path, framework="pt") as archive:
            metadata = archive.metadata() or {}
            names = set(archive.keys())
            drawn = bool(names & set(DISTRIBUTION))
            if names != {*STATISTICS, *(DISTRIBUTION if drawn else ())} or KEY not in metadata:
                raise OpticsError("is not a frame file: give one that veilcam-train wrote")
            tensors = {name: archive.get_tensor(name) for name in STATISTICS}
            arrays = {name: archive.get_tensor(name).numpy() for name in DISTRIBUTION if drawn}
        header = _Header.model_validate_json(metadata[KEY])
        if any(tensor.dtype != torch.float32 for tensor in tensors.values()):
            raise OpticsError("tensors are not float32: make it again")
        statistics = SceneStatistics(**tensors)
        if statistics.pixels != header.scene.rows * header.scene.columns:
            raise OpticsError("statistics are of another scene: make it again")
        distribution = MaskDistribution(**arrays) if drawn else None
        if distribution is not None and (
            distribution.lowest.shape != header.camera.mask_shape
            or distribution.curve.size != header.camera.panel.levels
        ):
            raise OpticsError("distribution is of another panel: make it again")
    except OSError as error:
        raise OpticsError(f"{path} cannot be read ({error.strerror}): check the path") from None
    except SafetensorError as error:
        raise OpticsError(f"{path} is damaged ({error}): copy it again") from None
    except ValidationError as error:
        details = error.errors(include_url=False, include_input=False, include_context=False)[0]
        place = ".".join(map(str, details["loc"])) or "header"
        raise OpticsError(f"{path} is not valid: {place}: {details['msg']}") from None
    except OpticsError as error:
        raise OpticsError(f"{path}: {error}") from None
    return SceneFrame(
        header.camera,
        header.scene,
        header.embedding,
        statistics,
        header.noise,
        header.reach,
        distribution,
        header.calibration,
    )


def dump_frame(frame: SceneFrame) -> bytes:
    """The bytes that :func:`write_frame` writes; the same frame gives the same bytes."""
    header = _Header(
        camera=frame.camera,
        scene=frame.scene,
        embedding=frame.embedding,
        reach=frame.reach,
        noise=frame.noise,
        calibration=frame.imperfections,
    )
    statistics = frame.statistics.to("float32")
    tensors = {name: getattr(statistics, name).contiguous() for name in STATISTICS}
    if frame.distribution is not None:
        for name in DISTRIBUTION:
            tensors[name] = torch.from_numpy(getattr(frame.distribution, name).copy())
    return safetensors.torch.save(tensors, metadata={KEY: header.model_dump_json()})
