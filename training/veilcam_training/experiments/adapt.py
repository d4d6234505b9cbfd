"""A bundle whose classifiers were fine-tuned to measurements of one camera."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy.typing as npt
import torch
from pydantic import JsonValue
from torch import Tensor

from veilcam_optics.camera.geometry import Scene
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.decoding import Precision, SceneFrame
from veilcam_optics.keys.masks import draw_levels
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_training.bundle import Accuracy, Bundle, Fresh, Pair, classifier_inputs
from veilcam_training.data.measurements import Measurements
from veilcam_training.errors import TrainingError, require
from veilcam_training.models.network import build_classifier, weights_of
from veilcam_training.trainer.adaptation import Adapted, Trial, adapt

Values: TypeAlias = npt.NDArray[Any]

CORRELATED = 2.0
"""How far neighbours resemble each other in scenes that masks are told apart by [scene pixels]."""
MISBUILT = 0.3
"""What a camera's measurements may be off its drawing there, relative to their root mean square."""


@dataclass(frozen=True)
class AdaptedBundle:
    """A bundle after it was adapted, and what the measurements said."""

    bundle: Bundle
    before: float
    """Share of the measurements that the former classifiers read right, in [0, 1]."""
    after: float
    """The same of the new ones, each measurement read by one that was not fitted to it."""
    chosen: Mapping[int, Trial]
    """How freely each classifier was fitted, by its place in the bundle."""


def adapt_bundle(
    bundle: Bundle,
    measurements: Measurements,
    *,
    frame: SceneFrame[Values] | None = None,
    seed: int = 0,
) -> AdaptedBundle:
    """Fine-tune the classifiers of a bundle.

    An epoch's name does not say which stored mask was shown, see :func:`pairs_shown`; a mask
    without measurements keeps its classifier.

    Args:
        bundle: bundle that the camera used, read from its file.
        measurements: measurements of that camera.
        frame: frame of the camera as built, for fresh masks; None: as designed.
        seed: seed of the draws.

    Raises:
        TrainingError: the measurements are of another bundle, or too few.
    """
    require(
        measurements.header.bundle == bundle.digest,
        f"the measurements were taken with bundle {measurements.header.bundle[:12]}, and this is "
        f"{bundle.digest[:12]}: give the file that the camera used",
    )
    require(
        bundle.channels == 1, "a bundle of colours is not adapted: use one with gray embeddings"
    )
    if bundle.fresh is not None:
        inputs = fresh_inputs(bundle, bundle.fresh, measurements, frame)
        known: list[Pair | Fresh] = [bundle.fresh]
        shown = torch.zeros(len(measurements), dtype=torch.int64)
    else:
        require(frame is None, "stored masks are not decoded: leave out --frame")
        inputs, known = measurements.values, list(bundle.pairs)
        shown = pairs_shown(bundle, measurements)
    adapted: dict[int, Adapted] = {}
    for number in sorted(set(shown.tolist())):
        own = shown == number
        former = build_classifier(known[number].layers, known[number].weights)
        adapted[number] = adapt(former, inputs[own], measurements.labels[own], seed=seed)
        known[number] = replace(known[number], weights=weights_of(adapted[number].classifier))
    shares = {number: float((shown == number).float().mean()) for number in adapted}
    before, after = (
        sum(shares[number] * accuracy for number, accuracy in each.items())
        for each in (
            {number: found.trials[0].accuracy for number, found in adapted.items()},
            {number: found.chosen.accuracy for number, found in adapted.items()},
        )
    )
    record = {**bundle.provenance, "adapted": _record(bundle, measurements, adapted, before, seed)}
    pairs = tuple(each for each in known if isinstance(each, Pair))
    fresh = next((each for each in known if isinstance(each, Fresh)), None)
    accuracy = Accuracy(after, "measurements left out in turn", len(measurements))
    return AdaptedBundle(
        replace(
            bundle,
            pairs=pairs,
            fresh=fresh,
            provenance=record,
            accuracy=accuracy,
            version=0,
            owner=None,
            card=None,
        ),
        before,
        after,
        {number: found.chosen for number, found in adapted.items()},
    )


def pairs_shown(bundle: Bundle, measurements: Measurements) -> Tensor:
    """Return the stored mask that each measurement was probably taken behind, int64 (count,).

    An epoch's measurements are taken for those of the mask behind which smooth scenes would most
    likely have given them: a camera may be built so badly that labels say nothing of the mask.
    """
    shown = torch.zeros(len(measurements), dtype=torch.int64)
    if len(bundle.pairs) == 1:
        return shown
    operator = TransferOperator(bundle.camera, bundle.scene, bundle.embedding)
    smooth = _smooth_scenes(bundle.scene)
    likelihoods = torch.stack(
        [
            _likelihood(
                operator(torch.from_numpy(to_weights(pair.levels, bundle.camera.panel))),
                smooth,
                measurements.values,
            )
            for pair in bundle.pairs
        ]
    )
    for epoch in dict.fromkeys(measurements.epochs):
        own = torch.tensor([each == epoch for each in measurements.epochs])
        shown[own] = likelihoods[:, own].sum(1).argmax()
    return shown


def _smooth_scenes(scene: Scene) -> Tensor:
    """Covariance of scenes whose pixels resemble their neighbours, float64 (pixels, pixels)."""
    rows, columns = (torch.arange(count, dtype=torch.float64) for count in scene.shape)
    places = torch.cartesian_prod(rows, columns)
    return torch.exp(-torch.cdist(places, places).square() / (2 * CORRELATED**2))


def _likelihood(transfer: Tensor, scenes: Tensor, values: Tensor) -> Tensor:
    """Log likelihood of measurements, however bright, less what all masks share, (count,)."""
    transfer = transfer.double()
    covariance = transfer.T @ scenes @ transfer
    covariance /= covariance.diagonal().mean()
    size = len(covariance)
    factor = torch.linalg.cholesky(covariance + MISBUILT**2 * torch.eye(size, dtype=torch.float64))
    white = torch.linalg.solve_triangular(factor, values.double().T, upper=False)
    found: Tensor = -(size / 2 * white.square().sum(0).log() + factor.diagonal().log().sum())
    return found


def fresh_inputs(
    bundle: Bundle, fresh: Fresh, measurements: Measurements, frame: SceneFrame[Values] | None
) -> Tensor:
    """Return the classifier's inputs for measurements behind fresh masks, float32 (count, inputs).

    Raises:
        TrainingError: the frame is of another camera.
    """
    own = fresh.frame(bundle.camera, bundle.scene, bundle.embedding)
    used = own if frame is None else frame
    if (used.camera, used.scene, used.embedding) != (own.camera, own.scene, own.embedding):
        raise TrainingError("the frame is of another camera than the bundle: give this camera's")
    used = replace(used, distribution=own.distribution)
    decoding = used.decoding(precision=Precision.DOUBLE)  # as the daemon does
    inputs = torch.empty(len(measurements), bundle.inputs)
    for epoch, key in measurements.mask_keys.items():
        own_places = torch.tensor([each == epoch for each in measurements.epochs])
        levels = draw_levels(key, camera=used.camera, distribution=fresh.distribution)
        decoder = decoding.prepare(used.shown(levels))
        values = measurements.values[own_places].numpy()
        decoded = classifier_inputs(decoder, values)
        inputs[own_places] = torch.from_numpy(decoded).float()
    return inputs


def _record(
    bundle: Bundle,
    measurements: Measurements,
    adapted: Mapping[int, Adapted],
    before: float,
    seed: int,
) -> dict[str, JsonValue]:
    """Return the origin of the new classifiers; nothing of the measurements is in it."""
    return {
        "bundle": bundle.digest,
        "device": measurements.header.device,
        "measurements": measurements.digest,
        "count": len(measurements),
        "accuracy_before": before,
        "classifiers": {str(number): str(each.chosen.freedom) for number, each in adapted.items()},
        "seed": seed,
    }
