"""The camera as it was drawn: what a calibration is measured against."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass

from veilcam_optics.camera.geometry import Camera, Embedding, Scene


@dataclass(frozen=True, slots=True)
class Geometry:
    """Camera, scene and embedding of a bundle."""

    camera: Camera
    scene: Scene
    embedding: Embedding

    @property
    def digest(self) -> str:
        """SHA-256 over all numbers of the drawing: 64 hexadecimal digits."""
        drawing = json.dumps(asdict(self), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(drawing.encode()).hexdigest()
