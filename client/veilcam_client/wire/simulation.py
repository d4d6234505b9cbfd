"""The wire contract of a simulated camera: what it looks at."""

from __future__ import annotations

import io

import numpy as np
import numpy.typing as npt

from veilcam_client.wire.base import Answer

PICTURE_MEDIA_TYPE = "application/octet-stream"


class HeldScene(Answer):
    """What a simulated camera looks at from now on."""

    scene: int
    """Its number, as captures name it that see it."""


def picture_bytes(picture: npt.ArrayLike | bytes) -> bytes:
    """Return a picture as it is sent: a file's content as it is, an array as ``.npy``."""
    if isinstance(picture, bytes):
        return picture
    buffer = io.BytesIO()
    np.save(buffer, np.asarray(picture), allow_pickle=False)
    return buffer.getvalue()


EXAMPLES = (HeldScene(scene=1),)
