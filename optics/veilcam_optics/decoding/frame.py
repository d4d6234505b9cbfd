"""A file for all that decoding needs besides the secret: geometry, statistics and noise.

One safetensors file: the tensors of the statistics and of the distribution that masks are drawn
from, and as its metadata one JSON text with the rest. None of it is secret. It holds no code.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Literal, overload

import numpy as np
import numpy.typing as npt
import safetensors.numpy
from pydantic import BaseModel, ValidationError
from safetensors import SafetensorError, safe_open

from veilcam_optics.arrays import Array, as_numpy, as_type, is_torch_array, namespace
from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.imperfections import NOMINAL, Imperfections
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.decoding.decoder import Precision, SceneDecoding
from veilcam_optics.decoding.noise import DEFAULT_NOISE, MeasurementNoise
from veilcam_optics.decoding.statistics import SceneStatistics
from veilcam_optics.errors import OpticsError
from veilcam_optics.files import write_whole
from veilcam_optics.keys.masks import Levels, MaskDistribution
from veilcam_optics.transfer.product import Transfer
from veilcam_optics.transfer.tables import Reach, make_transfer

if TYPE_CHECKING:
    from torch import Tensor

    from veilcam_optics.transfer.operator import TransferOperator

Values = npt.NDArray[Any]

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
class SceneFrame(Generic[Array]):
    """Camera, scene, embedding, and what is publicly known of scenes, noise and masks.

    What it makes computes in the library that its statistics are of.
    """

    camera: Camera
    scene: Scene
    embedding: Embedding
    statistics: SceneStatistics[Array]
    noise: MeasurementNoise = DEFAULT_NOISE
    reach: Reach = field(default_factory=Reach)
    distribution: MaskDistribution | None = None
    """What masks are drawn from; None is uniform over all that the panel can show."""
    imperfections: Imperfections = NOMINAL
    """Of the camera as it was built; whatever reads it takes out the stray light."""

    @property
    def colour(self) -> bool:
        """True where scenes have three colours."""
        return self.statistics.pixels == 3 * self.scene.rows * self.scene.columns

    def in_torch(self) -> SceneFrame[Tensor]:
        """Return the same frame, for training."""
        known = (self.statistics.in_torch(), self.noise, self.reach, self.distribution)
        return SceneFrame(self.camera, self.scene, self.embedding, *known, self.imperfections)

    def shown(self, levels: Levels) -> Array:
        """Weights that the panel shows for ``levels``: what decoders are prepared for."""
        weights = to_weights(levels, self.camera.panel)
        same: Array = namespace(self.statistics.mean).asarray(weights)
        return self.imperfections.shown(same)

    @overload
    def decoding(
        self: SceneFrame[Tensor], *, rank: int | None = None, precision: Precision = Precision.MIXED
    ) -> SceneDecoding[TransferOperator]: ...

    @overload
    def decoding(
        self: SceneFrame[Values], *, rank: int | None = None, precision: Precision = Precision.MIXED
    ) -> SceneDecoding[Transfer[Values]]: ...

    def decoding(
        self, *, rank: int | None = None, precision: Precision = Precision.MIXED
    ) -> SceneDecoding[Any]:
        """Prepare decoders, with fewer components of the statistics if ``rank`` says so.

        Of torch, its operator is a module.
        """
        statistics = self.statistics if rank is None else self.statistics.truncate(rank)
        like = as_type(statistics.mean[:0], precision.products)
        given = (self.camera, self.scene, self.embedding)
        operator: Any
        if is_torch_array(like):
            # An array of torch is here, so torch is.
            from veilcam_optics.transfer.operator import TransferOperator  # noqa: PLC0415

            operator = TransferOperator(
                *given,
                reach=self.reach,
                colour=self.colour,
                dtype=like.dtype,
                imperfections=self.imperfections,
            )
        else:
            operator = make_transfer(
                *given,
                reach=self.reach,
                colour=self.colour,
                like=like,
                imperfections=self.imperfections,
            )
        return SceneDecoding(operator, statistics, self.noise, precision=precision)


def write_frame(path: Path, frame: SceneFrame[Array]) -> None:
    """Write ``frame`` so that ``path`` holds either what it held before or all of it."""
    write_whole(path, dump_frame(frame), private=True)


def read_frame(path: Path) -> SceneFrame[Values]:
    """Read what :func:`write_frame` wrote.

    Raises:
        OpticsError: the file is missing, damaged, too large, or not such a file.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise OpticsError(f"is too large: a frame has at most {MAX_BYTES} bytes")
        with safe_open(path, framework="numpy") as archive:
            metadata = archive.metadata() or {}
            names = set(archive.keys())
            drawn = bool(names & set(DISTRIBUTION))
            if names != {*STATISTICS, *(DISTRIBUTION if drawn else ())} or KEY not in metadata:
                raise OpticsError("is not a frame file: give one that veilcam-train wrote")
            known = {name: archive.get_tensor(name) for name in STATISTICS}
            arrays = {name: archive.get_tensor(name) for name in DISTRIBUTION if drawn}
        header = _Header.model_validate_json(metadata[KEY])
        if any(array.dtype != np.float32 for array in known.values()):
            raise OpticsError("tensors are not float32: make it again")
        statistics: SceneStatistics[Values] = SceneStatistics(**known)
        pixels = header.scene.rows * header.scene.columns
        if statistics.pixels not in (pixels, 3 * pixels):
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


def dump_frame(frame: SceneFrame[Array]) -> bytes:
    """Return the bytes that :func:`write_frame` writes; the same frame gives the same bytes."""
    header = _Header(
        camera=frame.camera,
        scene=frame.scene,
        embedding=frame.embedding,
        reach=frame.reach,
        noise=frame.noise,
        calibration=frame.imperfections,
    )
    statistics = frame.statistics.to("float32")
    arrays = {name: as_numpy(getattr(statistics, name)) for name in STATISTICS}
    if frame.distribution is not None:
        arrays |= {name: getattr(frame.distribution, name) for name in DISTRIBUTION}
    whole = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    return safetensors.numpy.save(whole, metadata={KEY: header.model_dump_json()})
