"""Authorised decoding: with a receiver's private key, a sealed embedding becomes a scene again.

Needs the optics, ``pip install -e '.[optics]'`` in a checkout; the rest of the SDK does without.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import numpy.typing as npt

from veilcam_client.arguments import of_type
from veilcam_client.errors import VeilcamError
from veilcam_client.keys.opening import KeySource, receiver_key
from veilcam_client.wire.captures import Capture, Classification, SealedEmbedding


class SceneDecoder:
    """Turns what one camera sealed to a receiver into scenes, away from it.

    Args:
        frame: file of what is public about camera and scenes; ``veilcam-train frame`` writes it.
        key: private key of a receiver, or its file.
        device: public key of the camera, 64 hexadecimal digits; that of the first answer that is
            decoded if None.

    Raises:
        VeilcamError: the optics are not installed (code ``optics_missing``), or the frame cannot be
            used (code ``decoding_failed``).
        FileError: the key's file cannot be used.
    """

    def __init__(
        self, frame: str | os.PathLike[str], key: KeySource, device: str | None = None
    ) -> None:
        try:
            from veilcam_optics.decoding import read_frame  # noqa: PLC0415 - an extra
            from veilcam_optics.errors import OpticsError  # noqa: PLC0415
        except ImportError:
            raise VeilcamError(
                "decoding needs the extra 'optics': run pip install -e '.[optics]' in the checkout",
                code="optics_missing",
            ) from None
        of_type("frame", frame, (str, os.PathLike), "the path of a file")
        self._key, self._device = receiver_key(key), device
        try:
            self._frame = read_frame(Path(frame))
        except OpticsError as error:
            raise VeilcamError(str(error), code="decoding_failed") from None
        self._decoding = self._frame.decoding()

    def decode(self, answer: Capture | Classification) -> npt.NDArray[np.float32]:
        """Best estimate of the scene, (rows, columns).

        The answer is one that is still sealed, of a ``Camera`` without a key: it holds the key that
        the mask was drawn from. It may be decoded again: whether it came before is not asked.

        Raises:
            SealedError: it cannot be opened, as :class:`Camera` would say.
            VeilcamError: the answer holds no sealed embedding (code ``no_embedding``), or the frame
                is of another camera (code ``decoding_failed``).
        """
        from veilcam_client.keys.blocks import open_block  # noqa: PLC0415 - late, as cryptography is
        from veilcam_client.keys.envelopes import open_key  # noqa: PLC0415
        from veilcam_optics.errors import OpticsError  # noqa: PLC0415 - an extra
        from veilcam_optics.keys.masks import draw_levels  # noqa: PLC0415

        sealed = answer.embedding
        if not isinstance(sealed, SealedEmbedding):
            raise VeilcamError(
                "this answer holds no sealed embedding: take it without key=, and a classification "
                "with include_embedding=True",
                code="no_embedding",
            )
        frame, key = self._frame, open_key(sealed.envelope, self._key, device=self._device)
        try:
            embedding, _ = open_block(key.sealing(), answer, sealed)
            self._device = sealed.envelope.device
            levels = draw_levels(key.levels(), camera=frame.camera, distribution=frame.distribution)
            decoder = self._decoding.prepare(frame.shown(levels))
            scenes = decoder(np.asarray(embedding)[None])
        except OpticsError as error:
            raise VeilcamError(str(error), code="decoding_failed") from None
        finally:
            key.erase()
        scene: npt.NDArray[np.float32] = scenes[0]
        return scene
