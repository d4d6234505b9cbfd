"""``veilcam-optics decode``: a released embedding back into a scene, with the device's secret."""

import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import typer
from rich.console import Console
from torch import Tensor

from veilcam_optics.decoding import read_frame
from veilcam_optics.decoding.release import ReleaseForm, decode_released
from veilcam_optics.errors import OpticsError, invalid
from veilcam_optics.files import replacing
from veilcam_optics.keys.masks import Secret


def decode(
    released: Annotated[Path, typer.Argument(help="Embedding, or several, as .npy.")],
    out: Annotated[Path, typer.Argument(help="Scenes to write, as .npy.")],
    *,
    frame: Annotated[Path, typer.Option(help="Public frame of the camera, *.safetensors.")],
    secret: Annotated[Path, typer.Option(help="File with the secret, mode 600.")],
    device: Annotated[str, typer.Option(help="The camera's name in its key schedule.")],
    epoch: Annotated[str, typer.Option(help="Epoch of the embeddings: its name, or its number.")],
    form: Annotated[str, typer.Option(help="white, flat or raw.")] = "white",
) -> None:
    """Decode embeddings that a camera released. A wrong key gives another picture, not an error."""
    try:
        scenes = decode_released(
            _read(released),
            _form(form),
            read_frame(frame),
            secret=Secret.read(secret),
            device=device,
            # A name has 32 digits; the largest number has 20.
            epoch=int(epoch) if epoch.isdecimal() and len(epoch) <= 20 else epoch,
        )
        _write(out, scenes)
    except OpticsError as error:
        Console(stderr=True).print(f"error: {error}", markup=False, highlight=False, soft_wrap=True)
        sys.exit(1)
    Console().print(f"wrote {out}: {len(scenes)} scenes of {tuple(scenes.shape[1:])}")


def _form(name: str) -> ReleaseForm:
    try:
        return ReleaseForm(name)
    except ValueError:
        raise invalid("form", name, "", "white, flat or raw") from None


def _read(path: Path) -> Tensor:
    try:
        array = np.load(path, allow_pickle=False)
    except OSError as error:
        raise OpticsError(f"{path} cannot be read ({error.strerror}): check the path") from None
    except (ValueError, EOFError):
        raise OpticsError(f"{path} is not an array: give a .npy file") from None
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        raise OpticsError(f"{path} does not hold numbers: give a .npy file of an embedding")
    if not np.isfinite(array).all():
        raise OpticsError(f"{path} holds NaN or infinity: give an embedding as it was released")
    values = torch.from_numpy(array.astype(np.float64))
    return values[None] if values.ndim == 2 else values


def _write(path: Path, scenes: Tensor) -> None:
    try:
        with replacing(path) as stream:
            np.save(stream, scenes.numpy())
    except OSError as error:
        raise OpticsError(f"{path} cannot be written ({error.strerror}): check it") from None
