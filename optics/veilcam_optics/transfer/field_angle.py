"""Brightness of oblique light: "Off the axis" in docs/mathematics.md.

Light from a scene point at the tangent ``t`` of the field angle is fainter by the fourth power of
the cosine: a cosine for Lambert's law, two for the distance, one for the tilt of the sensor.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from veilcam_optics.camera.geometry import Scene

Values = npt.NDArray[Any]

_NARROW = 1e-4
"""Scene pixels, as tangents, whose middle stands for all of them to 1e-8."""

MASK_POWER = 0.75
"""Power of ``1 / (1 + t^2)`` for the amplitude at the mask: the tilt of the sensor comes later."""


def scene_tangents(scene: Scene, centre: tuple[float, float] = (0.0, 0.0)) -> tuple[Values, Values]:
    """Return the tangents of the field angle of scene rows and of scene columns, at their middles.

    Args:
        scene: flat object.
        centre: middle of the scene, from the optical axis along y and x [m].
    """
    y: Values
    x: Values
    y, x = (
        ((np.arange(count) - (count - 1) / 2) * scene.pixel + middle) / scene.distance
        for count, middle in zip(scene.shape, centre, strict=True)
    )
    return y, x


def fading(scene: Scene, centre: tuple[float, float] = (0.0, 0.0)) -> Values:
    """Return the mean of cos^4 over every scene pixel, (rows, columns).

    In closed form: it is the light that a rectangle sends to a small plate that faces it (Howell,
    A Catalog of Radiation Heat Transfer Configuration Factors, B-4).

    Args:
        scene: flat object.
        centre: middle of the scene, from the optical axis along y and x [m].
    """
    y, x = scene_tangents(scene, centre)
    side = scene.pixel / scene.distance
    if side < _NARROW:  # differences of the closed form would round
        middles: Values = (1 + np.square(y)[:, None] + np.square(x)) ** -2
        return middles
    edges_y, edges_x = (np.append(at - side / 2, at[-1] + side / 2) for at in (y, x))
    corners = _seen(edges_y[:, None], edges_x)
    means: Values = (np.diff(np.diff(corners, axis=0), axis=1) / side**2).clip(0)
    return means


def _seen(y: Values, x: Values) -> Values:
    """Integral of ``(1 + y^2 + x^2)^-2`` over the rectangle from the axis to a corner."""
    root_y, root_x = np.sqrt(1 + y**2), np.sqrt(1 + x**2)
    seen: Values = (y / root_y * np.arctan(x / root_y) + x / root_x * np.arctan(y / root_x)) / 2
    return seen
