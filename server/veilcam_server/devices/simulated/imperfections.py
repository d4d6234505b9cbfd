"""The file that says how a simulated camera was built: what a calibration has to find out."""

from __future__ import annotations

from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from veilcam_optics.camera.geometry import Camera
from veilcam_optics.camera.imperfections import Imperfections
from veilcam_optics.errors import OpticsError
from veilcam_server.errors import StartError


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
