"""Rows of attacks on old forms: what each attacker holds, and the figures that come of it.

A row is a function of the setting and of the number of a mask, or of a seed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Literal

import torch
from benchmarks.privacy.legacy.setting import Setting, percent
from tests.training.attacks.legacy import FLAT, flat, white_lengths, white_with_length
from torch import Tensor

from veilcam_optics.camera.masks import quantise, random_mask
from veilcam_optics.sensor.noise import shot_noise
from veilcam_training.attacks.known_pairs import KernelRidge, Mask, Reader, hits, tuned
from veilcam_training.attacks.linkage import first_ranks, link_area, links
from veilcam_training.attacks.mask_recovery import (
    RAW,
    UNIFORM,
    Evidence,
    Form,
    KnownPictures,
    MaskPrior,
    MeanCapture,
    recover_mask,
)
from veilcam_training.attacks.networks import (
    TRIALS,
    Correlations,
    Seen,
    attackers,
    best_of,
    by_network,
    judged,
)
from veilcam_training.attacks.victim import SNR_DB, Victim, VictimMask, raw
from veilcam_training.data import Images
from veilcam_training.seeding import stream

DIGITS = 10
JUDGED = 1000
"""Captures of one mask that an attack is judged by."""
POOL = 30
"""Masks of one seed whose captures are compared by their lengths or cosines."""
MANY = 50
"""Masks behind which a class is told by lengths: to learn from, to choose by, and to be judged."""
UNLABELLED = 500
GALLERY = 50
"""Scenes that a capture is looked up in."""

Asked = Literal["digit", "presence", "skin"]
Found = dict[str, float]


@dataclass(frozen=True)
class Row:
    """One attack.

    Attributes:
        measure: figures of one mask, or one seed.
        runs: masks or seeds.
        reach: what the suite must reach, by the name of a figure.
    """

    measure: Callable[[Setting, int], Found]
    runs: int
    reach: Mapping[str, float]


# Masks by gradient.


def _recovered(
    setting: Setting,
    victim: Victim,
    number: int,
    *,
    known: int,
    prior: MaskPrior = UNIFORM,
    form: Form = RAW,
) -> float:
    """Digits read [%] behind the victim's next mask, from known pictures or from none."""
    mask = victim.mask()
    purpose = ("known", known, number)
    scenes, _ = setting.digits(setting.training, known or UNLABELLED, *purpose)
    released = victim.capture(mask, scenes)
    evidence: Evidence = KnownPictures(setting.decoding, scenes, released, form)
    if not known:
        evidence = MeanCapture(setting.decoding, released.mean(0), len(released))
    found = recover_mask(
        evidence,
        setting.camera.mask_shape,
        prior=prior,
        generator=stream(number, "starts"),
    )
    scenes, labels = setting.digits(setting.test, JUDGED, "judged", number)
    mean = setting.decoding.prepare(found.weights).mean_measurement
    return setting.accuracy(found.weights, form.undo(victim.capture(mask, scenes), mean), labels)


def raw_known(setting: Setting, number: int) -> Found:
    """``raw``, several captures of a fresh mask: one known picture, or 500 unknown ones."""
    victim = partial(setting.victim, raw, number)
    return {
        "kpa_raw_one_pair_legacy": _recovered(setting, victim(), number, known=1),
        "kpa_raw_zero_pairs_legacy": _recovered(setting, victim(), number, known=0),
    }


def learned_known(setting: Setting, number: int) -> Found:
    """``raw``, a stored learned mask; the attacker has trained five of their own."""
    masks = setting.learned_masks()
    prior = MaskPrior.of([each for place, each in enumerate(masks) if place != number])
    victim = setting.victim(raw, number, stored=masks[number])
    return {
        "kpa_learned_one_pair_legacy": _recovered(setting, victim, number, known=1, prior=prior),
        "kpa_learned_zero_pairs_legacy": _recovered(setting, victim, number, known=0, prior=prior),
    }


def flat_known(setting: Setting, number: int) -> Found:
    """``flat``, several captures of a fresh mask: one known picture, or four."""
    return {
        f"kpa_flat_{name}_legacy": _recovered(
            setting, setting.victim(flat, number), number, known=count, form=FLAT
        )
        for name, count in (("one_pair", 1), ("four_pairs", 4))
    }


# Networks that learned behind other masks.

NETWORK_MASKS, NETWORK_EACH = 12_000, 10
"""Masks are an attacker's to draw, as many as they like: none is seen in more than one epoch."""


def keyless(form: Literal["flat", "raw"], setting: Setting, seed: int) -> Found:
    """A network on correlations that learned behind other masks, one capture a mask."""
    behind = partial(_behind_many, setting, form, seed=seed)
    learned = behind(setting.learned, masks=NETWORK_MASKS, each=NETWORK_EACH)
    tuning = behind(setting.check, masks=200, each=5)
    test = behind(setting.test, masks=4 * JUDGED, each=1)
    shape = setting.decoding.operator.embedding.shape
    scores = by_network(
        learned,
        tuning,
        DIGITS,
        build=partial(Correlations, shape),
        trial=TRIALS[1],
        epochs=1,
    )
    hit = judged(scores, test.vectors).argmax(1) == test.labels
    return {f"{form}_keyless_legacy": percent(hit)}


def _behind_many(
    setting: Setting, form: str, images: Images, *, seed: int, masks: int, each: int
) -> Seen:
    """Captures of digits behind masks of their own, so bright or so flat as they leave."""
    generator = stream(seed, "many", form, masks)
    operator, statistics = setting.decoding.operator, setting.decoding.statistics
    mean = statistics.mean.reshape(1, *operator.scene.shape)
    vectors, labels = [], []
    for _ in range(masks):
        weights = quantise(random_mask(setting.camera, generator), setting.camera.panel)
        chosen = torch.randint(len(images), (each,), generator=generator)
        scenes = torch.cat([mean, images.scenes(chosen)])
        with torch.no_grad():
            light = operator.embed(scenes, weights).flatten(1)
        measured = shot_noise(light[1:], SNR_DB, generator)
        if form == "flat":
            vectors.append(FLAT.release(measured, light[0]))
        else:
            # In units of its own mean: brightness tells less of a digit than where it is.
            vectors.append(measured / measured.mean(1, keepdim=True) - 1)
        labels.append(images.labels[chosen])
    return Seen(torch.cat(vectors), torch.cat(labels))


# Cosines and lengths.


def cosine(setting: Setting, seed: int) -> Found:
    """``flat``: the cosine of two captures of one scene behind two masks."""
    own, victim = setting.victim(flat, seed, purpose="own"), setting.victim(flat, seed)
    first, second = _twins(setting, victim, seed, victim.capture)
    learned, check = (_twins(setting, own, seed + more, own.capture) for more in (100, 200))
    link = links("products", learned, check, trials=(), epochs=0)
    return {"flat_cosine_auc_legacy": link_area(link, first, second)}


def _twins(
    setting: Setting, victim: Victim, seed: int, release: Callable[[VictimMask, Tensor], Tensor]
) -> tuple[Tensor, Tensor]:
    """Blocks of ``GALLERY`` scenes, each behind two masks of a pool, (blocks, scenes, numbers)."""
    blocks = 20
    masks = [victim.mask() for _ in range(POOL)]
    scenes, _ = setting.digits(setting.test, blocks * GALLERY, "twins", seed)
    behind = torch.stack(
        [torch.randperm(POOL, generator=stream(seed, "pair", n))[:2] for n in range(len(scenes))]
    )
    found: list[Tensor] = []
    for side in (0, 1):
        released: list[tuple[Tensor, Tensor]] = []
        for place, mask in enumerate(masks):
            chosen = (behind[:, side] == place).nonzero().flatten()
            released.append((chosen, release(mask, scenes[chosen])))
        vectors = torch.cat([each for _, each in released])
        order = torch.cat([chosen for chosen, _ in released])
        found.append(vectors[order.argsort()].reshape(blocks, GALLERY, -1))
    return found[0], found[1]


def length(setting: Setting, seed: int) -> Found:
    """``white`` with its length, one capture a mask: the length alone."""
    victim = setting.victim(white_with_length, seed)
    own = setting.victim(white_with_length, seed, purpose="own")
    first, second = _twins(setting, victim, seed, partial(_lengths, victim))
    learned, check = (
        _twins(setting, own, seed + more, partial(_lengths, own)) for more in (100, 200)
    )
    link = links("length", learned, check, trials=(), epochs=0)
    figures = {
        "white_length_link_auc_legacy": link_area(link, first, second),
        "white_length_rank1_legacy": percent(first_ranks(link(first, second))),
        "white_length_digit_legacy": percent(_by_length(setting, victim, "digit", seed)),
        "white_length_presence_legacy": percent(_by_length(setting, victim, "presence", seed)),
    }
    if setting.faces is not None:
        victim = setting.victim(white_with_length, seed, decoding=setting.face_decoding())
        figures["white_length_skin_legacy"] = percent(_by_length(setting, victim, "skin", seed))
    return figures


def _lengths(victim: Victim, mask: VictimMask, scenes: Tensor) -> Tensor:
    """Lengths of ``white``, (count, 1): a rotation changes none, so it need not be made."""
    assert mask.decoder is not None, "white wants a decoder"
    return white_lengths(mask.decoder, victim.measure(mask, scenes))[:, None]


def _by_length(setting: Setting, victim: Victim, question: Asked, seed: int) -> Tensor:
    """Whether the length told the answer, of captures behind masks not learned from."""
    seen = []
    for part in ("learned", "check", "test"):
        scenes, labels = _drawn(setting, question, seed, part)
        behind = [victim.mask() for _ in range(MANY)]
        chunks = zip(behind, scenes.tensor_split(len(behind)), strict=True)
        seen.append(Seen(torch.cat([_lengths(victim, *each) for each in chunks]), labels))
    learned, check, test = seen
    classes = int(learned.labels.max()) + 1
    scores = best_of(attackers("length", None, 0))(learned, check, classes)
    return judged(scores, test.vectors).argmax(1) == test.labels


def _drawn(setting: Setting, question: Asked, seed: int, part: str) -> tuple[Tensor, Tensor]:
    """Scenes and answers, in the shares of their data set; half of the scenes are empty."""
    images = {"learned": setting.learned, "check": setting.check, "test": setting.test}[part]
    count = len(images)
    digits, labels = setting.digits(images, count, question, seed, part)
    if question == "digit":
        return digits, labels
    random = stream(seed, question, part)
    if question == "presence":
        there = torch.rand(count, generator=random) < 0.5
        return digits * there[:, None, None], there.long()
    assert setting.faces is not None, "skin is asked of faces"
    # Whoever was learned from is not asked about.
    places = setting.faces_of(judged=part == "test")
    chosen = places[torch.randint(len(places), (count,), generator=random)]
    pixels = torch.from_numpy(setting.faces.pixels)[chosen]
    return pixels.float() / 255, torch.from_numpy(setting.faces.classes)[chosen]


# Labelled captures of the current mask.

KERNELS: Mapping[str, Reader] = {
    f"{kernel} {ridge:g}": KernelRidge(kernel, ridge)
    for kernel in ("linear", "quadratic", "gaussian")
    for ridge in (1e-2, 1e-1, 1.0)
}
KNOWN = (30, 100, 1000, 2000)


def kernel_ridge(setting: Setting, number: int) -> Found:
    """``white`` with its length, many captures of one mask: kernel ridge on labelled ones."""
    victim = setting.victim(white_with_length, number)

    def mask(purpose: str) -> Mask:
        current = victim.mask()
        known, labels = setting.digits(setting.training, max(KNOWN), purpose, number)
        asked, answers = setting.digits(setting.test, JUDGED, purpose, number)
        return Mask(
            Seen(victim.capture(current, known), labels),
            Seen(victim.capture(current, asked), answers),
        )

    own, attacked = mask("own"), mask("attacked")
    figures: Found = {}
    for count in KNOWN:
        _, reader = tuned(KERNELS, [own.of_first(count)], DIGITS)
        figures[f"white_known_{count}_legacy"] = percent(
            hits(reader, [attacked.of_first(count)], DIGITS)
        )
    blocks = [_again(setting, victim, part, number) for part in ("learned", "check", "test")]
    link = links("products", blocks[0], blocks[1], trials=(), epochs=0)
    return figures | {"white_epoch_link_auc_legacy": link_area(link, *blocks[2])}


def _again(setting: Setting, victim: Victim, part: str, number: int) -> tuple[Tensor, Tensor]:
    """Two captures of each scene behind one mask, in blocks of ``GALLERY`` scenes."""
    mask = victim.mask()
    images = setting.test if part == "test" else setting.training
    scenes, _ = setting.digits(images, JUDGED, "again", part, number)
    first, second = (
        victim.capture(mask, scenes).reshape(JUDGED // GALLERY, GALLERY, -1) for _ in range(2)
    )
    return first, second


ROWS: Mapping[str, Row] = {
    "length": Row(
        length,
        3,
        {
            "white_length_digit_legacy": 23.1,
            "white_length_link_auc_legacy": 0.95,
            "white_length_rank1_legacy": 29,
            "white_length_presence_legacy": 99.9,
            "white_length_skin_legacy": 34.8,
        },
    ),
    "flat-keyless": Row(partial(keyless, "flat"), 3, {"flat_keyless_legacy": 90.8}),
    "raw-keyless": Row(partial(keyless, "raw"), 3, {"raw_keyless_legacy": 90.5}),
    "cosine": Row(cosine, 3, {"flat_cosine_auc_legacy": 0.944}),
    "raw-known": Row(
        raw_known, 5, {"kpa_raw_one_pair_legacy": 98, "kpa_raw_zero_pairs_legacy": 90}
    ),
    "learned-known": Row(
        learned_known,
        5,
        {"kpa_learned_one_pair_legacy": 98, "kpa_learned_zero_pairs_legacy": 90},
    ),
    "flat-known": Row(
        flat_known, 5, {"kpa_flat_one_pair_legacy": 87.4, "kpa_flat_four_pairs_legacy": 98.2}
    ),
    "kernel-ridge": Row(
        kernel_ridge,
        5,
        {
            "white_known_30_legacy": 14,
            "white_known_100_legacy": 28,
            "white_known_1000_legacy": 64,
            "white_known_2000_legacy": 75,
            "white_epoch_link_auc_legacy": 0.988,
        },
    ),
}
