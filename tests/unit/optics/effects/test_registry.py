"""An effect is a class and one line in the registry: plans and light know it from there."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from types import MappingProxyType

import pytest
import torch
from torch import Tensor

from veilcam_optics import effects
from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.camera.imperfections import Conditions
from veilcam_optics.effects import EFFECTS, Effect, Model, Sampling
from veilcam_optics.plan import plan
from veilcam_optics.simulation.operator import LightOperator
from veilcam_optics.transfer.tables import Beam

CAMERA = Camera(panel=Panel(filter_cycle=()), window=Window(6, 4), sensor=Sensor(401, 480))
SCENE, EMBEDDING = Scene(3, 4, height=0.06), Embedding(4, 5)


@dataclass(frozen=True)
class Aged(Conditions):
    yellowing: float = 0.0


class Yellowing(Effect):
    name = "yellowing"
    absent = "as new"
    neutral = MappingProxyType({"yellowing": 0.0})

    def reason(self, model: Model) -> str:
        return f"yellow by {_share(model):g}"

    def shown(self, weights: Tensor, model: Model) -> Tensor:
        return weights * (1 - _share(model))

    def beams(self, beams: list[Beam], model: Model) -> list[Beam]:
        return [replace(beam, share=beam.share * (1 - _share(model)) ** 2) for beam in beams]

    def collected(self, values: Tensor, axes: tuple[int, ...], model: Model) -> Tensor:
        assert {values.shape[axis] for axis in axes} & {*EMBEDDING.shape, EMBEDDING.size, 12, 8}
        return values * (1 - _share(model)) ** 4

    def electrons(
        self, electrons: Tensor, model: Model, generator: torch.Generator | None
    ) -> Tensor:
        return electrons * (1 - _share(model)) ** 5

    def measurement(
        self, values: Tensor, model: Model, generator: torch.Generator | None
    ) -> Tensor:
        return values * (1 - _share(model)) ** 6


def _share(model: Model) -> float:
    assert isinstance(model.conditions, Aged)
    return model.conditions.yellowing


def embed(conditions: Conditions, method: str) -> Tensor:
    sampling = Sampling(method, oversampling=0.5, shot=False, dtype=torch.float64)  # type: ignore[arg-type]
    operator = LightOperator(Model(CAMERA, SCENE, EMBEDDING, conditions, sampling))
    generator = torch.Generator().manual_seed(0)
    weights = torch.rand(CAMERA.mask_shape, generator=generator, dtype=torch.float64)
    return operator.embed(torch.ones(1, *SCENE.shape, dtype=torch.float64), weights)


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(effects, "EFFECTS", (*EFFECTS, Yellowing()))


@pytest.mark.usefixtures("registered")
@pytest.mark.parametrize("method", ["transfer", "factors", "grid"])
def test_new_effect_is_computed_at_every_stage(method: str) -> None:
    """Powers of 0.9: the mask's counts twice, light's once each."""
    powers = 2 + 2 + 4 + 5 + 6
    ratio = embed(Aged(electrons=1e3, yellowing=0.1), method) / embed(Aged(electrons=1e3), method)
    torch.testing.assert_close(ratio, torch.full_like(ratio, 0.9**powers))


@pytest.mark.usefixtures("registered")
def test_plan_weighs_it() -> None:
    found = plan(CAMERA, SCENE, EMBEDDING, 1e-2, Aged(yellowing=0.1))
    own = found.assessments[-1]
    assert (own.name, own.matters, own.reason) == ("yellowing", True, "yellow by 0.1")
    # Amplitudes squared, beams and light: the 8th power; measurements are not probed.
    assert own.error == pytest.approx(1 / 0.9**8 - 1, rel=1e-6)
    assert "yellow by 0.1" in found.explain()
    faint = plan(CAMERA, SCENE, EMBEDDING, 1e-2, Aged(yellowing=1e-5))
    assert faint.assessments[-1].matters, "it costs nothing"
    assert not math.isclose(faint.assessments[-1].error, 0)
    absent = plan(CAMERA, SCENE, EMBEDDING, 1e-2, Aged()).assessments[-1]
    assert (absent.matters, absent.error, absent.reason) == (False, 0, "as new")


def test_without_its_line_nothing_is_computed() -> None:
    aged = Aged(electrons=1e3, yellowing=0.1)
    assert embed(aged, "transfer").equal(embed(Conditions(electrons=1e3), "transfer"))
