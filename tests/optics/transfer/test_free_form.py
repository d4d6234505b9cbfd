"""Masks of any layout against exact light, by the oracle's own code."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
import torch
from tests.oracle import physics
from torch import Tensor

from veilcam_optics.apertures import phase_plate
from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Sensor
from veilcam_optics.errors import OpticsError
from veilcam_optics.plan import plan
from veilcam_optics.transfer.free_form import FreeFormMask, free_form_transfer

Values = npt.NDArray[np.float64]

PITCH = 20e-6
CAMERA = replace(
    Camera(), sensor=Sensor(rows=40, columns=48, pixel=6e-6), distance=2e-3
).monochrome(550e-9)
SCENE = Scene(rows=2, columns=3, height=6e-3, distance=0.4)
EMBEDDING = Embedding(rows=3, columns=2)


def values(kind: str) -> Tensor:
    generator = torch.Generator().manual_seed(0)
    size = torch.rand(8, 6, dtype=torch.float64, generator=generator)
    turns = torch.rand(8, 6, dtype=torch.float64, generator=generator)
    phase = torch.polar(torch.ones_like(size), 2 * math.pi * turns)
    return {
        "amplitude": size,
        "binary": (size > 0.5).double(),
        "phase": phase,
        "both": size * phase,
    }[kind]


def exact(transmittance: Tensor) -> Values:
    """Rayleigh and Sommerfeld's integral over every cell, in NumPy."""
    sensor = CAMERA.sensor
    y, x = (
        physics.Axis(cells, PITCH, 1, 1, side, pixels, scene_pixels, SCENE.pixel, 0.0)
        for cells, side, pixels, scene_pixels in (
            (8, sensor.height, EMBEDDING.rows, SCENE.rows),
            (6, sensor.width, EMBEDDING.columns, SCENE.columns),
        )
    )
    beam = physics.Beam(1, CAMERA.wavelengths[1], SCENE.distance, 1.0)
    light = physics.Light(y, x, CAMERA.distance, (beam,), 0.0, None, 1)
    seen = transmittance.numpy()[None, None].repeat(3, axis=1)
    found: Values = physics.transfer(light, seen, times=2)[0]
    return found


def off(found: Tensor, truth: Values) -> float:
    return float(np.linalg.norm(found.numpy() - truth) / np.linalg.norm(truth))


@pytest.mark.parametrize("kind", ["amplitude", "binary", "phase", "both"])
def test_transfer_is_that_of_exact_light(kind: str) -> None:
    """The oracle takes a scene pixel for a point, whose image is a box of 15 um: of pixels of 80 um
    that changes the second moment by (15 / 80)^2 / 12, half of which is the light's."""
    found = free_form_transfer(CAMERA, SCENE, EMBEDDING, FreeFormMask(values(kind), PITCH))
    assert off(found, exact(values(kind))) <= (15 / 80) ** 2 / 24


def test_cells_cut_beforehand_are_the_same_mask() -> None:
    """At this distance whole cells are cut into eight parts a side, and halves into four."""
    camera = replace(CAMERA, distance=2.2e-3)
    whole = values("phase")
    halves = whole.repeat_interleave(2, 0).repeat_interleave(2, 1)
    one, other = (
        free_form_transfer(camera, SCENE, EMBEDDING, FreeFormMask(cells, pitch))
        for cells, pitch in ((whole, PITCH), (halves, PITCH / 2))
    )
    torch.testing.assert_close(one, other, rtol=1e-9, atol=1e-15)


def test_a_turn_of_all_phases_changes_nothing_and_of_some_it_does() -> None:
    mask = values("amplitude")
    turned = mask * torch.polar(torch.ones(8, 6), torch.full((8, 6), 1.0)).to(torch.complex128)
    some = mask + 0j
    some[:4] = -some[:4]
    plain, alike, other = (
        free_form_transfer(CAMERA, SCENE, EMBEDDING, FreeFormMask(cells, PITCH))
        for cells in (mask, turned, some)
    )
    torch.testing.assert_close(alike, plain, rtol=1e-6, atol=1e-9)
    assert off(other, plain.numpy()) > 1e-2


def test_a_relief_has_a_phase_for_each_colour() -> None:
    """Light of three colours adds up, each with its own mask and share."""
    height = 1e-6 * values("amplitude")
    colours = (640e-9, 550e-9, 460e-9)
    planes = torch.stack([phase_plate(height, colour) for colour in colours])
    coloured = replace(
        CAMERA,
        wavelengths=colours,
        sensor=replace(CAMERA.sensor, channel_weights=(0.25, 0.5, 0.25)),
    )
    found = free_form_transfer(coloured, SCENE, EMBEDDING, FreeFormMask(planes, PITCH))
    parts = [
        free_form_transfer(CAMERA.monochrome(colour), SCENE, EMBEDDING, FreeFormMask(plane, PITCH))
        for colour, plane in zip(colours, planes, strict=True)
    ]
    # Cells are cut as the shortest wave asks, so the others' are coarser when they are alone:
    # what that leaves out goes by more than the sensor.
    assert off(found, (parts[0] / 4 + parts[1] / 2 + parts[2] / 4).numpy()) < 2e-3


def test_the_gradient_is_the_slope() -> None:
    """Quadratic in the mask: a central difference is exact, but for rounding."""
    mask = values("both") / 2
    direction = (values("phase") / 4).conj()
    learned = mask.clone().requires_grad_()
    transfer = free_form_transfer(CAMERA, SCENE, EMBEDDING, FreeFormMask(learned, PITCH))
    (gradient,) = torch.autograd.grad(transfer.sum(), learned)
    low, high = (
        free_form_transfer(CAMERA, SCENE, EMBEDDING, FreeFormMask(mask + sign * direction, PITCH))
        for sign in (-1, 1)
    )
    slope = float((high - low).sum()) / 2
    assert float((gradient.conj() * direction).real.sum()) == pytest.approx(slope, rel=1e-9)


@pytest.mark.parametrize(
    ("transmittance", "pitch", "message"),
    [
        (torch.ones(4), PITCH, "transmittance.shape"),
        (torch.ones(2, 4, 4), PITCH, "transmittance.shape"),
        (torch.ones(0, 4), PITCH, "transmittance.shape"),
        (torch.ones(4, 4, dtype=torch.int64), PITCH, "real or complex numbers"),
        (torch.full((4, 4), torch.nan), PITCH, "NaN"),
        (torch.full((4, 4), 1.5), PITCH, "amplitudes from 0 to 1"),
        (torch.full((4, 4), -0.5), PITCH, "amplitudes from 0 to 1"),
        (torch.full((4, 4), 1 + 1j), PITCH, "complex ones of that size"),
        (torch.ones(4, 4), 0.0, "pitch"),
        (torch.ones(4, 4), torch.inf, "pitch"),
    ],
)
def test_what_no_mask_can_be_is_refused(transmittance: Tensor, pitch: float, message: str) -> None:
    with pytest.raises(OpticsError, match=message) as refusal:
        FreeFormMask(transmittance, pitch)
    assert "1.5" not in str(refusal.value)


def test_a_grid_that_does_not_fit_in_memory_is_refused() -> None:
    vast = replace(CAMERA, sensor=Sensor(rows=40, columns=48, pixel=0.05))
    with pytest.raises(OpticsError, match=r"mask\.sides.*bytes"):
        free_form_transfer(vast, SCENE, EMBEDDING, FreeFormMask(torch.ones(2, 2), PITCH))


def test_no_plan_is_made_of_complex_weights() -> None:
    """It could not know: plans judge amplitudes of a panel."""
    chosen = plan(CAMERA, SCENE, EMBEDDING, 0.1)
    with pytest.raises(OpticsError, match=r"weights\.dtype"):
        chosen.transfer(torch.ones(CAMERA.mask_shape, dtype=torch.complex128))
