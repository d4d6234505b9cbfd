"""Errors of the panel: drawn in training, absent in evaluation, and what they say they are."""

from __future__ import annotations

import pytest
import torch

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.imperfections import Imperfections
from veilcam_training.encoders import (
    ENCODERS,
    FixedMask,
    LearnedMask,
    PanelErrors,
    Setup,
    make_encoder,
)
from veilcam_training.encoders.imperfections import make_operators
from veilcam_training.errors import TrainingError
from veilcam_training.seeding import seeded, stream

SETUP = Setup(Camera(), Scene(7, 9), Embedding(3, 4))
ERRORS = PanelErrors(gamma=0.2, floor=0.1, shift=5e-5, distance=5e-5, places=3)


def test_gamma_and_floor() -> None:
    weights = torch.linspace(0.01, 1, 50)
    with seeded(0, "panel"):
        exponents = [
            float((PanelErrors(gamma=0.2).shown(weights).log() / weights.log())[10])
            for _ in range(500)
        ]
        floors = [float(PanelErrors(floor=0.1).shown(torch.zeros(1))) for _ in range(500)]
        lifted = PanelErrors(floor=0.1).shown(weights)
    assert (min(exponents), max(exponents)) == pytest.approx((0.8, 1.2), abs=0.01)
    assert (min(floors), max(floors)) == pytest.approx((0, 0.1), abs=0.005)
    assert float(lifted[-1]) == pytest.approx(1)
    assert bool((lifted >= weights).all())


@pytest.mark.slow
@pytest.mark.parametrize("kind", [LearnedMask, FixedMask])
def test_drawn_in_training_alone(kind: type[LearnedMask | FixedMask]) -> None:
    ideal = kind(SETUP, stream(0, "encoder")).eval()
    encoder = kind(SETUP, stream(0, "encoder"), ERRORS)
    assert not encoder.constant
    with torch.no_grad(), seeded(0, "panel"):
        torch.testing.assert_close(encoder.eval().transfer(), ideal.transfer())
        draws = torch.stack([encoder.train().transfer() for _ in range(6)])
    assert len({float(draw.sum()) for draw in draws}) == 6
    error = (draws - ideal.transfer().detach()).norm(dim=(1, 2)) / ideal.transfer().detach().norm()
    assert bool((error > 0.01).all())
    assert bool((error < 0.5).all())
    if isinstance(encoder, LearnedMask):
        encoder(torch.rand(2, 7, 9, generator=stream(0, "x"))).square().sum().backward()
        assert encoder.weights.grad is not None
        assert bool((encoder.weights.grad != 0).all())


def test_panel_that_is_shifted_shifts_the_picture() -> None:
    """To first order the transfer moves by the gradient along the axis: check with two shifts."""
    weights = torch.rand(SETUP.camera.mask_shape, generator=stream(0, "weights"))
    fine = Setup(SETUP.camera, SETUP.scene, Embedding(76, 1))
    pixel = fine.camera.sensor.height / 76
    magnified = pixel / (1 + SETUP.camera.distance / SETUP.scene.distance)
    ideal = make_operators(fine)[0](weights).reshape(63, 76)
    moved = make_operators(fine, Imperfections(shift_y=magnified))[0](weights).reshape(63, 76)
    # A panel moved by one pixel's shadow moves what is seen by one pixel.
    torch.testing.assert_close(moved[:, 6:-5], ideal[:, 5:-6], rtol=0.02, atol=1e-6)
    further = Setup(Camera(distance=4.2e-3), SETUP.scene, SETUP.embedding)
    erring = make_operators(SETUP, Imperfections(distance_error=2e-4))[0]
    torch.testing.assert_close(erring(weights), make_operators(further)[0](weights))


@pytest.mark.parametrize("name", [n for n in ENCODERS if n not in ("learned", "fixed_simulated")])
def test_only_a_panel_has_errors(name: str) -> None:
    with pytest.raises(TrainingError, match="has no panel"):
        make_encoder(name, SETUP, stream(0, "encoder"), errors=ERRORS)
