"""Subject of an attack: a camera made of a bundle, in one mode and one form of release."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from torch import Tensor

from veilcam_optics.camera.masks import to_weights
from veilcam_optics.decoding import SceneDecoding, fit_statistics
from veilcam_optics.keys.masks import MaskDistribution
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.tables import Reach
from veilcam_training.attacks.victim import (
    FORMS,
    FreshMasks,
    MaskSource,
    Prepared,
    ReleaseRule,
    StoredMasks,
    Victim,
    VictimMask,
    unsealed,
)
from veilcam_training.bundle import Bundle, classifier_inputs
from veilcam_training.errors import TrainingError, require
from veilcam_training.models.network import build_classifier
from veilcam_training.seeding import stream

LIGHT = Reach(6, 1)
"""Interference that the light has, and decoders do not know of."""
RANK = 256
"""Of an attacker's own scene statistics, where the bundle has none."""

Opening = Callable[[VictimMask, Tensor], Tensor]
"""From a mask with its key, and what left, to measurements (count, E) to decode."""
Reading = Callable[[VictimMask, Tensor], Tensor]
"""From a mask and measurements to the scores of the bundle's own classifier, (count, labels)."""


def open_raw(mask: VictimMask, released: Tensor) -> Tensor:
    """Measurements as they are."""
    del mask
    return released


def open_sealed(mask: VictimMask, released: Tensor) -> Tensor:
    """Measurements, or what the mean scene gives: without its key a block does not open."""
    opened = unsealed(mask, released)
    if opened is None and mask.decoder is not None:
        opened = mask.decoder.mean_measurement.expand(len(released), -1)
    if opened is None:
        raise TrainingError("a camera without scene statistics decodes nothing: give it some")
    return opened


OPENINGS: dict[str, Opening] = {"raw": open_raw, "sealed": open_sealed}


@dataclass(frozen=True)
class Subject:
    """A camera under attack, and what everybody knows of it."""

    bundle: Bundle
    mode: str
    """``fresh``, ``random`` or ``pairs`` and how many."""
    form: str
    source: MaskSource
    own: MaskSource
    """What attackers draw the masks of their own cameras from."""
    light: TransferOperator
    decoding: SceneDecoding
    release: ReleaseRule
    opening: Opening
    reading: Reading | None
    """None where masks have no classifier of the bundle."""
    prepared: dict[int, Prepared] = field(default_factory=dict, repr=False)
    """Stored masks that were met."""

    def camera(self, *, own: bool, generator: torch.Generator) -> Victim:
        """Return the camera itself, or one of an attacker's own."""
        return Victim(
            self.light,
            self.own if own else self.source,
            self.release,
            decoding=self.decoding,
            generator=generator,
            prepared=None if own else self.prepared,
        )


def make_subject(
    bundle: Bundle, scenes: Tensor, *, mode: str | None = None, form: str | None = None, seed: int
) -> Subject:
    """Return a camera with the masks of a bundle, or with others in its place.

    Args:
        bundle: gray, of either mode.
        scenes: (count, rows, columns) that attackers know, for statistics where there are none.
        mode: ``fresh``, ``random`` (as many masks as the bundle has, ten for a fresh one) or
            ``pairsN`` (the first N of the bundle); None: all that the bundle holds.
        form: ``raw`` or ``sealed``; None: ``sealed`` of fresh masks, ``raw`` of others.
        seed: seed of a random keyring.

    Raises:
        TrainingError: a mode that the bundle has no masks for, another form, or scenes of another
            shape.
    """
    mode = mode or ("fresh" if bundle.fresh is not None else f"pairs{len(bundle.pairs)}")
    form = form or ("sealed" if mode == "fresh" else "raw")
    require(form in FORMS, f"form {form!r} is not valid: use one of {', '.join(FORMS)}")
    require(
        tuple(scenes.shape[1:]) == bundle.scene.shape,
        f"pictures are {tuple(scenes.shape[1:])} and the bundle's scenes {bundle.scene.shape}: "
        "give the data that it was trained for",
    )
    camera, uniform = bundle.camera, MaskDistribution.uniform(bundle.camera)
    source, reading = _source(bundle, mode, seed)
    own = source if isinstance(source, FreshMasks) else FreshMasks(camera, uniform)
    geometry = (camera, bundle.scene, bundle.embedding)
    if mode == "fresh" and bundle.fresh is not None:
        decoding = bundle.fresh.frame(*geometry).in_torch().decoding()
    else:
        rank = min(RANK, len(scenes) - 1, bundle.scene.rows * bundle.scene.columns)
        decoding = SceneDecoding(TransferOperator(*geometry), fit_statistics([scenes], rank))
    return Subject(
        bundle,
        mode,
        form,
        source,
        own,
        TransferOperator(*geometry, reach=LIGHT),
        decoding,
        FORMS[form],
        OPENINGS[form],
        reading,
    )


def _source(bundle: Bundle, mode: str, seed: int) -> tuple[MaskSource, Reading | None]:
    if mode == "fresh":
        if bundle.fresh is None:
            raise TrainingError("the bundle holds pairs: mode fresh wants one of fresh masks")
        return FreshMasks(bundle.camera, bundle.fresh.distribution), _read_fresh(bundle)
    if mode == "random":
        count = len(bundle.pairs) or 10
        return StoredMasks.random(bundle.camera, count, stream(seed, "random keyring")), None
    found = re.fullmatch(r"pairs([1-9]\d{0,3})", mode)
    require(found is not None, f"mode {mode!r} is not valid: use fresh, random or pairsN")
    count = int(found[1]) if found else 0
    require(
        count <= len(bundle.pairs),
        f"mode {mode} wants {count} masks and the bundle holds {len(bundle.pairs)}: use a larger",
    )
    pairs = bundle.pairs[:count]
    readers = [build_classifier(pair.layers, pair.weights).eval() for pair in pairs]

    @torch.no_grad()
    def read(mask: VictimMask, measurements: Tensor) -> Tensor:
        scores: Tensor = readers[mask.place](measurements)
        return scores

    return StoredMasks(
        [torch.from_numpy(to_weights(pair.levels, bundle.camera.panel)) for pair in pairs]
    ), read


def _read_fresh(bundle: Bundle) -> Reading:
    fresh = bundle.fresh
    if fresh is None:
        raise TrainingError("the bundle holds pairs: it has no reader of fresh masks")
    reader = build_classifier(fresh.layers, fresh.weights).eval()

    @torch.no_grad()
    def read(mask: VictimMask, measurements: Tensor) -> Tensor:
        if mask.decoder is None:
            raise TrainingError("a mask without a decoder is not read: give scene statistics")
        scores: Tensor = reader(classifier_inputs(mask.decoder, measurements))
        return scores

    return read
