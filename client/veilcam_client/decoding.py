"""Authorised decoding: with the camera's secret, a released embedding becomes a scene again.

Needs the optics, ``pip install -e '.[optics]'`` in a checkout; the rest of the SDK does without.
"""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from veilcam_client.errors import VeilcamError
from veilcam_client.wire.captures import Capture, Classification


class SceneDecoder:
    """Turns what one camera released into scenes, away from it.

    Args:
        frame: file of what is public about camera and scenes; ``veilcam-train frame`` writes it.
        secret: file with the camera's secret, readable by its owner alone.
        device: label of the camera in its key schedule, as the daemon has it.

    Raises:
        VeilcamError: the optics are not installed (code ``optics_missing``), or a file cannot be
            used (code ``decoding_failed``).
    """

    def __init__(self, frame: Path | str, secret: Path | str, *, device: str) -> None:
        try:
            from veilcam_optics.decoding import read_frame  # noqa: PLC0415 - an extra
            from veilcam_optics.errors import OpticsError  # noqa: PLC0415
            from veilcam_optics.keys.masks import Secret  # noqa: PLC0415
        except ImportError:
            raise VeilcamError(
                "decoding needs the extra 'optics': run pip install -e '.[optics]' in the checkout",
                code="optics_missing",
            ) from None
        self._device = device
        try:
            self._frame, self._secret = read_frame(Path(frame)), Secret.read(Path(secret))
        except OpticsError as error:
            raise VeilcamError(str(error), code="decoding_failed") from None

    def decode(self, answer: Capture | Classification) -> npt.NDArray[np.float32]:
        """Best estimate of the scene, (rows, columns).

        Another secret, or another device's, gives something else, and nothing says so.

        Raises:
            VeilcamError: the answer holds no embedding (code ``no_embedding``), or it is not one of
                this camera's (code ``decoding_failed``).
        """
        import torch  # noqa: PLC0415 - an extra

        from veilcam_optics.decoding.release import ReleaseForm, decode_released  # noqa: PLC0415
        from veilcam_optics.errors import OpticsError  # noqa: PLC0415

        embedding = answer.embedding
        if embedding is None:
            raise VeilcamError(
                "this classification holds no embedding: ask for it with include_embedding=True",
                code="no_embedding",
            )
        try:
            scenes = decode_released(
                torch.from_numpy(np.asarray(embedding))[None],
                ReleaseForm(embedding.form),
                self._frame,
                secret=self._secret,
                device=self._device,
                epoch=answer.epoch,
            )
        except OpticsError as error:
            raise VeilcamError(str(error), code="decoding_failed") from None
        scene: npt.NDArray[np.float32] = scenes[0].float().numpy()
        return scene
