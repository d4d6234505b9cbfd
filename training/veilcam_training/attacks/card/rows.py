"""The ten rows: what the worst attacker of each threat gains."""

import math
from collections.abc import Callable, Mapping

import numpy as np
import torch
from torch import Tensor

from veilcam_training.attacks.card.pools import CAPTURES
from veilcam_training.attacks.card.shots import Found, known_pairs, of_masks, recovered
from veilcam_training.attacks.card.study import Study, by_pairs
from veilcam_training.attacks.card.threats import KNOWN
from veilcam_training.attacks.clustering import adjusted_rand_index, by_directions
from veilcam_training.attacks.intervals import Gain, accuracy_gain, area_gain, linkage_gain
from veilcam_training.attacks.linkage import link_area, links
from veilcam_training.attacks.mask_recovery import MeanCapture
from veilcam_training.attacks.metrics import mean_picture_advantage, psnr, ssim
from veilcam_training.attacks.networks import Seen, by_network, judged, linear, perceptron
from veilcam_training.seeding import stream

FOLDS = 2
SORTED = 20
"""Masks whose captures are sorted."""
FLOOR = 1e-2
"""Singular values count from this share of the largest on: 40 dB, the noise of a measurement."""


def with_the_key(study: Study) -> Found:
    """T0: the attackers of every other row, given the key."""
    found, seen = study.read, study.seen
    gain = _points(study, found.scores)
    # The share itself, and not what it is above chance.
    share = Gain(gain.shown, gain.error, 0.0, gain.count, gain.shown)
    others = {name: 100 * value for name, value in found.shares.items()}
    return Found(threat="T0", attack=found.name, gain=share, masks=seen.masks, others=others)


def ciphertext_only(study: Study) -> Found:
    """T1: what leaves, by attackers who learned from cameras of their own."""
    contest = study.blind
    found = _read(study, "T1", contest.name, contest.scores, contest.shares)
    notes = _sorted_by_mask(study)
    if study.subject.form == "raw" and not study.plan.recovered:
        notes += ("Masks are looked for by gradient in a full card alone: it finds more.",)
    found = found.model_copy(update={"notes": notes})
    given = dict(study.in_sets)
    if study.plan.recovered and study.subject.form == "raw":
        given["mask by gradient from the mean of captures"] = recovered(
            study,
            lambda shots: MeanCapture(
                study.subject.decoding,
                shots.captures.known.vectors.mean(0),
                len(shots.captures.known.labels),
            ),
        )
    other = of_masks(study, "T1", given, "many captures of a mask, none known")
    worse = other if other.gain.value > found.gain.value else found
    return worse.model_copy(update={"others": found.others | other.others, "notes": found.notes})


def _sorted_by_mask(study: Study) -> tuple[str, ...]:
    """Return a note: how well captures are grouped by mask without the names of their epochs."""
    some = study.seen.take(torch.arange(SORTED))
    fresh = torch.arange(SORTED) + len(some.places)
    _, masks = torch.unique(torch.where(some.places < 0, fresh, some.places), return_inverse=True)
    count = int(masks.max()) + 1
    if count == 1:
        return ()
    groups = by_directions(some.released.flatten(0, 1), count, stream(study.seed, "sorted"))
    index = adjusted_rand_index(groups, masks.repeat_interleave(CAPTURES))
    return (f"Sorted by mask without the names of epochs: adjusted Rand index {index:.2f}.",)


def wrong_key(study: Study) -> Found:
    """T2: decoded with the key of another mask, by attackers who learned from such pictures."""
    own, seen = study.own, study.seen
    found = study.contest(
        study.of_pictures(),
        (own.wrong.flatten(2), own.labels),
        seen.wrong.flatten(2).flatten(0, 1),
        seen.labels.flatten(),
    )
    return _read(study, "T2", found.name, found.scores, found.shares)


def other_epochs(study: Study) -> Found:
    """T3: labelled captures of this camera's other epochs; every epoch is judged once."""
    seen = study.seen
    folds = _folds(study)
    scores = torch.zeros(seen.labels.numel(), study.classes)
    names, shares = [], dict[str, float]()
    for fold in range(FOLDS):
        judging, knowing = folds == fold, folds != fold
        found = study.contest(
            study.of_release(),
            (seen.released[knowing], seen.labels[knowing]),
            seen.released[judging].flatten(0, 1),
            seen.labels[judging].flatten(),
        )
        scores[judging.repeat_interleave(CAPTURES)] = found.scores.float()
        names.append(found.name)
        for name, share in found.shares.items():
            shares[name] = shares.get(name, 0.0) + share / FOLDS
    return _read(study, "T3", " / ".join(dict.fromkeys(names)), scores, shares)


def this_mask(study: Study) -> Found:
    """T4: labelled captures of the very mask."""
    return known_pairs(study, "T4", KNOWN)


def leaked_list(study: Study) -> Found:
    """T5: decoded with what a leaked list has that fits best."""
    own, seen = study.own, study.seen
    found = study.contest(
        study.of_pictures(),
        (own.right.flatten(2), own.labels),
        seen.listed.flatten(2).flatten(0, 1),
        seen.labels.flatten(),
    )
    return _read(study, "T5", found.name, found.scores, found.shares)


def full_leak(study: Study) -> Found:
    """T6: decoded with mask and key, in dB over the mean picture."""
    seen = study.seen
    truth = study.ours.scenes(seen.chosen.flatten())
    estimate, mean = seen.right.flatten(0, 1), study.theirs.scenes().mean(0)
    nearer = mean_picture_advantage(estimate, truth, mean)
    blocks = by_pairs(nearer).double().mean(1).numpy()
    value = float(blocks.mean())
    error = float(blocks.std(ddof=1)) / math.sqrt(len(blocks))
    read = 100 * float((study.read.scores.argmax(1) == seen.labels.flatten()).double().mean())
    notes = (
        f"PSNR {float(psnr(estimate, truth).mean()):.1f} dB and SSIM "
        f"{float(ssim(estimate, truth).mean()):.2f}, data range 1; {read:.1f} % of the digits.",
        f"The transfer matrix of a mask has {_directions(study)} singular values above 1 % of its "
        f"largest, of {min(study.subject.bundle.embedding.size, truth[0].numel())}.",
    )
    return Found(
        threat="T6",
        attack="linear decoding with the key",
        gain=Gain(value, error, 0.0, len(nearer), value),
        masks=seen.masks,
        others={"linear decoding with the key": value},
        notes=notes,
    )


def _directions(study: Study) -> int:
    """Return the participation ratio of one mask's columns less their means."""
    transfer = study.subject.camera(own=False, generator=stream(study.seed, "T")).mask().transfer
    values = torch.linalg.svdvals((transfer - transfer.mean(0)).double())
    return int((values > FLOOR * values[0]).sum())


def many_shots(study: Study) -> Found:
    """T7: hundreds of labelled captures of the very mask."""
    return known_pairs(study, "T7", study.plan.known)


def scores_of_answers(study: Study) -> Found:
    """T8: whether there is much ink, from scores; the median is that of each class."""
    seen = study.seen
    scores = seen.scores
    source = "scores of the bundle's classifier"
    if not scores.shape[-1]:
        scores = study.read.scores.reshape(*seen.labels.shape, -1)
        source = "scores of whoever reads with the key"
    ink = study.ours.scenes(seen.chosen.flatten()).mean((1, 2)).reshape(seen.labels.shape)
    every = study.theirs.scenes().mean((1, 2))
    middle = torch.stack(
        [every[study.theirs.labels == label].median() for label in range(study.classes)]
    )
    much = (ink > middle[seen.labels]).long()
    folds, builds = _folds(study), {"linear": linear, "perceptron": perceptron}
    given = {name: torch.zeros(much.shape, dtype=torch.float64) for name in builds}
    areas: dict[str, float] = {}
    for fold in range(FOLDS):
        judging, knowing = folds == fold, (folds != fold).nonzero().flatten()
        check, kept = knowing[: len(knowing) // 5], knowing[len(knowing) // 5 :]
        for name, build in builds.items():
            answer = by_network(
                Seen(scores[kept].flatten(0, 1), much[kept].flatten()),
                Seen(scores[check].flatten(0, 1), much[check].flatten()),
                2,
                build=build,
                trial=study.plan.trials[0],
                epochs=study.plan.epochs,
            )
            logits = judged(answer, scores[judging].flatten(0, 1)).double()
            given[name][judging] = (logits[:, 1] - logits[:, 0]).reshape(-1, CAPTURES)
    spread = folds[:, None].expand_as(much).flatten().numpy()
    gains = {
        name: area_gain(each.flatten().numpy(), (much == 1).flatten().numpy(), spread)
        for name, each in given.items()
    }
    areas = {name: gain.value for name, gain in gains.items()}
    name = max(areas, key=lambda each: areas[each])
    return Found(
        threat="T8",
        attack=f"{name}, on {source}",
        gain=gains[name],
        masks=seen.masks,
        others=areas,
        notes=("The worst of two attackers as they were judged: nothing is claimed here.",),
    )


def linkage(study: Study) -> Found:
    """T9: whether what left behind two masks shows the same scene."""
    own, seen = study.own, study.seen
    first, second = own.released[::2], own.released[1::2]
    held = max(2, round(0.2 * len(first)))
    learned, check = (first[:-held], second[:-held]), (first[-held:], second[-held:])
    asked = seen.released[::2], seen.released[1::2]
    tried = {}
    for family in ("length", "products", "networks"):
        link = links(family, learned, check, trials=study.plan.trials, epochs=study.plan.epochs)
        with torch.no_grad():
            scores = link(*asked).double()
        tried[family] = (abs(link_area(link, *check) - 0.5), linkage_gain(scores.numpy()))
    name = max(tried, key=lambda each: tried[each][0])
    return Found(
        threat="T9",
        attack=name,
        gain=tried[name][1],
        masks=seen.masks,
        others={each: gain.value for each, (_, gain) in tried.items()},
    )


ROWS: Mapping[str, Callable[[Study], Found]] = {
    "T0": with_the_key,
    "T1": ciphertext_only,
    "T2": wrong_key,
    "T3": other_epochs,
    "T4": this_mask,
    "T5": leaked_list,
    "T6": full_leak,
    "T7": many_shots,
    "T8": scores_of_answers,
    "T9": linkage,
}


def _read(
    study: Study, threat: str, attack: str, scores: Tensor, shares: Mapping[str, float]
) -> Found:
    chance = 100 / study.classes
    return Found(
        threat=threat,
        attack=attack,
        gain=_points(study, scores),
        masks=study.seen.masks,
        others={name: 100 * share - chance for name, share in shares.items()},
    )


def _points(study: Study, scores: Tensor) -> Gain:
    """Return the mean scores of all captures that were seen."""
    right = by_pairs(scores.argmax(1) == study.seen.labels.flatten()).numpy()
    return accuracy_gain(right, study.classes, 0.0)


def _folds(study: Study) -> Tensor:
    """Return the fold of each mask; two that saw the same scenes are in one."""
    pairs = study.seen.masks // 2
    order = np.random.default_rng(study.seed).permutation(pairs)
    return torch.from_numpy(order % FOLDS).repeat_interleave(2)
