"""How a simulated camera departs from its drawing: what a calibration has to find out."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from veilcam_optics.camera import imperfections as optical
from veilcam_optics.errors import OpticsError
from veilcam_server.errors import StartError

Line = Annotated[int, Field(ge=0)]


class AsBuilt(BaseModel):
    """Departures; those of the optics as in :mod:`veilcam_optics.camera.imperfections`."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    shift_y: float = 0.0
    """Displacement of the mask along y [m]."""
    shift_x: float = 0.0
    """Displacement of the mask along x [m]."""
    rotation: float = 0.0
    """Of the mask around the axis, from x towards y [rad]."""
    distance_error: float = 0.0
    """How much farther the sensor is than drawn [m]."""
    gamma: float = 1.0
    """The panel shows the amplitude ``w^gamma``."""
    contrast_floor: float = 0.0
    """Amplitude of a sub-pixel that is told to be dark."""
    stray_light: float = 0.0
    """Share of the light on the sensor that is spread evenly over it."""
    dead_rows: tuple[Line, ...] = ()
    """Rows of the mask that do not obey."""
    dead_columns: tuple[Line, ...] = ()
    """Columns of the mask that do not obey."""
    dead_level: int = Field(default=0, ge=0, le=63)
    """What those show, 0 (opaque) to 63 (open)."""

    @property
    def conditions(self) -> optical.Conditions:
        """What of it the optics do."""
        known = {field.name for field in fields(optical.Conditions)}
        given: dict[str, Any] = self.model_dump(include=known)
        return optical.Conditions(**given)

    @model_validator(mode="after")
    def _possible(self) -> Self:
        try:
            self.conditions  # noqa: B018 - they check themselves
        except OpticsError as error:
            raise ValueError(str(error)) from None
        return self

    def require_lines(self, rows: int, columns: int) -> None:
        """Raise :class:`StartError` if a dead line is none of a mask of so many."""
        for name, dead, count in (
            ("dead_rows", self.dead_rows, rows),
            ("dead_columns", self.dead_columns, columns),
        ):
            if max(dead, default=0) >= count:
                raise StartError(f"--as-built {name} = {max(dead)}: use 0 to {count - 1}")


def read_as_built(path: Path) -> AsBuilt:
    """Read a JSON file; raises :class:`StartError`."""
    try:
        return AsBuilt.model_validate_json(path.read_bytes())
    except OSError as error:
        raise StartError(f"--as-built {path} cannot be read: {error.strerror}") from None
    except ValidationError as error:
        item = error.errors(include_url=False, include_input=False)[0]
        place = ".".join(map(str, item["loc"])) or "file"
        message = item["msg"].removeprefix("Value error, ")
        raise StartError(f"--as-built {path}: {place}: {message}") from None
