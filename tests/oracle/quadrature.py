"""Exact light once more, by another way: Rayleigh and Sommerfeld's integral, point by point.

Gauss and Legendre's nodes lie in every aperture, in every embedding pixel and in every scene pixel,
so that nothing is sampled evenly, no kernel is averaged, no scene pixel's image is moved, and no
transform is used. What it shares with the other way is the job's description alone.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from .physics import Array, Axis, Light

Nodes = tuple[Array, Array]


def transfer(
    light: Light, amplitudes: Array, *, nodes: tuple[int, int, int], pixel: tuple[int, int]
) -> Array:
    """The irradiance in every embedding pixel of one scene pixel's light."""
    found = np.zeros((len(amplitudes), light.y.pixels, light.x.pixels))
    hole_y, hole_x = _holes(light.y, nodes[0]), _holes(light.x, nodes[0])
    sensor_y, sensor_x = _sensor(light.y, nodes[1]), _sensor(light.x, nodes[1])
    source_y, source_x = (
        _source(light.y, nodes[2], pixel[0]),
        _source(light.x, nodes[2], pixel[1]),
    )
    cosine, sine = math.cos(light.rotation), math.sin(light.rotation)
    own_y, own_x = (found.ravel() for found in np.meshgrid(hole_y[0], hole_x[0], indexing="ij"))
    mask_y, mask_x = own_y * cosine + own_x * sine, own_x * cosine - own_y * sine
    at_y, at_x = (found.ravel() for found in np.meshgrid(sensor_y[0], sensor_x[0], indexing="ij"))
    area = np.outer(hole_y[1], hole_x[1]).ravel()
    repeated = np.repeat(np.repeat(amplitudes, nodes[0], axis=2), nodes[0], axis=3)
    reach = np.sqrt(
        (at_y[:, None] - mask_y) ** 2 + (at_x[:, None] - mask_x) ** 2 + light.distance**2
    )
    for beam in light.beams:
        k = 2 * math.pi / beam.wavelength
        turn = np.exp(1j * k * (reach - light.distance)) / (2 * math.pi)
        field = turn * light.distance * (1 / reach - 1j * k) / reach**2
        # Derivative of z g(R), g = (1/R - ik) exp(ikR) / R^2, along z: g + z (z / R) dg/dR.
        radial = turn * (k**2 / reach**2 + 3j * k / reach**3 - 3 / reach**4)
        slope = field / light.distance + light.distance**2 / reach * radial
        shown = repeated[:, beam.channel].reshape(len(amplitudes), -1) * area
        share = beam.share if light.shares is None else beam.share * light.shares[beam.channel]
        for y, weight_y in zip(*source_y, strict=True):
            for x, weight_x in zip(*source_x, strict=True):
                way = np.sqrt((mask_y - y) ** 2 + (mask_x - x) ** 2 + beam.scene_distance**2)
                wave = np.exp(1j * k * (way - beam.scene_distance))
                wave = wave * (beam.scene_distance / way) ** 1.5
                arrived, rising = (shown * wave) @ field.T, (shown * wave) @ slope.T
                flux = (arrived.conj() * rising).imag / k
                flux = flux * np.outer(sensor_y[1], sensor_x[1]).ravel()
                shape = (len(flux), light.y.pixels, nodes[1], light.x.pixels, nodes[1])
                found += share * weight_y * weight_x * flux.reshape(shape).sum((2, 4))
    return found.reshape(len(found), -1) / (light.y.scene_pixels * light.x.scene_pixels)


def _holes(axis: Axis, nodes: int) -> Nodes:
    middles = (np.arange(axis.apertures) - (axis.apertures - 1) / 2) * axis.pitch + axis.shift
    return _nodes(middles, axis.pitch * axis.open_parts / axis.parts, nodes)


def _sensor(axis: Axis, nodes: int) -> Nodes:
    side = axis.sensor / axis.pixels
    middles = (np.arange(axis.pixels) - (axis.pixels - 1) / 2) * side
    side = axis.fill * side
    at, weights = _nodes(middles, side, nodes)
    return at, weights / side


def _source(axis: Axis, nodes: int, pixel: int) -> Nodes:
    middle = (pixel - (axis.scene_pixels - 1) / 2) * axis.scene_pixel
    at, weights = _nodes(np.array([middle]), axis.scene_pixel, nodes)
    return at, weights / axis.scene_pixel


def _nodes(middles: npt.NDArray[np.floating], side: float, count: int) -> Nodes:
    at, weights = np.polynomial.legendre.leggauss(count)
    return (middles[:, None] + side / 2 * at).ravel(), np.tile(side / 2 * weights, len(middles))
