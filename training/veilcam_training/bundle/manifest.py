"""``bundle.json``: everything in a bundle but its arrays, as strictly validated JSON."""

import json
from typing import Annotated, Literal, Self

from pydantic import BaseModel, Field, JsonValue, ValidationError, model_validator

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.decoding import MeasurementNoise
from veilcam_optics.transfer.tables import Reach
from veilcam_training.bundle.errors import BundleError
from veilcam_training.bundle.hiding import Hiding
from veilcam_training.bundle.layers import LayerRecord
from veilcam_training.bundle.model import Accuracy, LightPlan, TransferError

FORMAT = "veilcam-bundle"
VERSION = 1

Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class PairManifest(BaseModel, frozen=True, extra="forbid", strict=True):
    """The classifier of one pair; its arrays are in the other parts."""

    layers: tuple[LayerRecord, ...]
    transfer_error: TransferError | None = Field(default=None, exclude_if=lambda it: it is None)
    """Where it was measured."""


class FreshManifest(BaseModel, frozen=True, extra="forbid", strict=True):
    """Key policy, noise and the one classifier of mode ``fresh``."""

    scheme: Literal["veilcam mask levels, version 1"] = "veilcam mask levels, version 1"
    """How a key becomes a mask: see :mod:`veilcam_optics.keys.masks`."""
    noise: MeasurementNoise
    reach: Reach
    layers: tuple[LayerRecord, ...]


class Manifest(BaseModel, frozen=True, extra="forbid", strict=True):
    """The content of ``bundle.json``."""

    format: Literal["veilcam-bundle"] = "veilcam-bundle"
    version: Literal[1] = 1
    task: str
    labels: tuple[str, ...]
    camera: Camera
    scene: Scene
    embedding: Embedding
    channels: Literal[1, 3]
    mode: Literal["pairs", "fresh"]
    pairs: tuple[PairManifest, ...] = ()
    fresh: FreshManifest | None = None
    provenance: dict[str, JsonValue]
    accuracy: Accuracy | None
    light: LightPlan | None = Field(default=None, exclude_if=lambda it: it is None)
    """Where the light was planned."""
    hiding: Hiding | None = Field(default=None, exclude_if=lambda it: it is None)
    """Where it was measured."""
    parts: dict[str, Digest]
    """SHA-256 of every other part, by its name."""

    @model_validator(mode="after")
    def _one_mode(self) -> Self:
        if self.mode == "fresh" and (self.fresh is None or self.pairs):
            raise ValueError("mode 'fresh' has a key policy and no pairs")
        if self.mode == "pairs" and self.fresh is not None:
            raise ValueError("mode 'pairs' has no key policy")
        return self


def dump_manifest(manifest: Manifest) -> bytes:
    """Manifest as readable JSON.

    Raises:
        BundleError: the provenance holds NaN or infinity.
    """
    other = {"pairs"} if manifest.mode == "fresh" else {"fresh"}
    try:
        text = json.dumps(
            manifest.model_dump(mode="json", exclude=other, warnings="error"),
            indent=1,
            allow_nan=False,
        )
    except ValueError as error:
        raise BundleError(f"bundle.json cannot be written: {error}") from None
    return text.encode()


def load_manifest(data: bytes) -> Manifest:
    """Manifest from JSON.

    Raises:
        BundleError: not JSON, another format or version, an unknown key, a value out of range.
    """
    content = _parse(data)
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise BundleError(f"bundle.json is not of format {FORMAT!r}: is this a Veilcam bundle?")
    if content.get("version") != VERSION or content.get("version") is True:
        raise BundleError(
            f"bundle format version {content.get('version')!r} is unknown: this Veilcam reads "
            f"version {VERSION}; update Veilcam or export the bundle again"
        )
    try:
        return Manifest.model_validate_json(data)
    except ValidationError as error:
        raise BundleError(f"bundle.json is not valid: {_first(error)}") from None


def _parse(data: bytes) -> object:
    """JSON with neither NaN nor a key given twice."""

    def constant(name: str) -> object:
        raise ValueError(f"{name} is not a number")

    def unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
        result = dict(pairs)
        if len(result) != len(pairs):
            raise ValueError("a key occurs twice")
        return result

    try:
        result: object = json.loads(data, parse_constant=constant, object_pairs_hook=unique)
    except (ValueError, RecursionError) as error:
        raise BundleError(f"bundle.json is not valid JSON: {error}") from None
    return result


def _first(error: ValidationError) -> str:
    """Return the first fault, on one line."""
    details = error.errors(include_url=False, include_input=False, include_context=False)[0]
    place = ".".join(str(step) for step in details["loc"]) or "bundle"
    return f"{place}: {details['msg']}".replace("\n", " ")
