"""Labelled measurements in a file: what a classifier is adapted to a camera with.

JSON lines. The first says which camera and which bundle it was, every other one is a measurement
and its label. See docs/adaptation.md.
"""

from __future__ import annotations

from datetime import datetime
from typing import Literal

from pydantic import Field

from veilcam_client.wire.arrays import Float32List
from veilcam_client.wire.base import Answer


class MeasurementsHeader(Answer):
    """The first line."""

    format: Literal["veilcam-measurements"] = "veilcam-measurements"
    """Name of the format."""
    version: Literal[1] = 1
    """Version of the format."""
    device: str
    """Public key of the camera."""
    bundle: str
    """SHA-256 of the bundle that it used."""
    mode: Literal["pairs", "fresh"]
    """Masks of the bundle: stored ``pairs``, or ``fresh`` ones."""
    labels: tuple[str, ...]
    """Labels of the bundle, in their order."""
    shape: tuple[int, ...]
    """Shape of an embedding."""
    begun_at: datetime
    """Time of the first measurement."""


class Measured(Answer):
    """One measurement; every other line is one."""

    picture: str | None
    """Path of the picture in its folder; None where a person told the label."""
    label: str
    """Label of the scene."""
    epoch: str
    """Random name of one showing of one mask."""
    number: int = Field(ge=0)
    """Number of the capture in its epoch."""
    taken_at: datetime
    """Time of the capture, to the second."""
    values: Float32List = Field(repr=False)
    """As they were read, row by row."""
    mask_key: str | None = Field(default=None, pattern=r"^[0-9a-f]{64}$", repr=False)
    """Behind a fresh mask: what its levels are drawn from, hexadecimal. It opens nothing sealed,
    and decodes what stands in this file."""
