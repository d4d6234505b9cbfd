"""Faces behind the camera of a card: an attribute of theirs, and the same person behind two masks.

What comes of it stands as notes beside T8 and T9. Persons whom attackers know are never those
before the camera.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from veilcam_optics.camera.geometry import Scene
from veilcam_training.attacks.card.pools import CAPTURES, PART, Pool, collect
from veilcam_training.attacks.card.study import ATTACKERS, Study
from veilcam_training.attacks.face_match import FaceMatch, fit_face_match
from veilcam_training.attacks.metrics import auc, true_accept_rate
from veilcam_training.attacks.networks import Seen, by_network, convolutions, judged, linear
from veilcam_training.data import Images, open_source
from veilcam_training.errors import TrainingError
from veilcam_training.seeding import derive, stream

Captures = tuple[Tensor, Tensor]
"""Of masks: vectors or pictures (masks, captures, ...), and labels (masks, captures)."""

TASK = "faces-gender"
"""Attribute that is asked for."""
EPOCHS = 8
"""Of the network that matches faces."""
MOST = 6000
"""Faces that it learns from."""
STRANGERS = 20_000
"""Pairs of different persons."""
FAR = 1e-2


def load_faces(folder: Path, scene: Scene) -> Images:
    """Drawn faces as a scene shows them: their middle square, with gender and person.

    Raises:
        TrainingError: there are none, or they are damaged.
    """
    faces = open_source(TASK, folder).training()
    rows, columns = faces.pixels.shape[1:]
    side = min(rows, columns)
    top, left = (rows - side) // 2, (columns - side) // 2
    square = faces.pixels[:, None, top : top + side, left : left + side].float()
    small = interpolate(square, size=scene.shape, mode="area")[:, 0]
    return replace(faces, pixels=small.round().byte())


def face_notes(study: Study, faces: Images) -> dict[str, str]:
    """Sentences for T8 and T9.

    Args:
        study: study whose camera sees the faces.
        faces: faces of :func:`load_faces`.

    Raises:
        TrainingError: faces that belong to nobody.
    """
    if faces.groups is None:
        raise TrainingError("faces have no persons: give drawn faces with identities")
    known = torch.unique(faces.groups)
    order = torch.randperm(len(known), generator=stream(study.seed, "persons"))
    theirs = torch.isin(faces.groups, known[order[: round(ATTACKERS * len(known))]])
    match = _match(study, faces.take(theirs.nonzero().flatten()[:MOST]))
    ours = faces.take((~theirs).nonzero().flatten())
    own = _pool(study, faces.take(theirs.nonzero().flatten()), own=True)
    seen = _pool(study, ours, own=False)
    return {"T8": _attribute(study, own, seen), "T9": _persons(study, match, ours, seen)}


def _match(study: Study, faces: Images) -> FaceMatch:
    if faces.groups is None:
        raise TrainingError("faces have no persons: give drawn faces with identities")
    tell = partial(study.tell, "matching faces")
    seed = derive(study.seed, "face match")
    return fit_face_match(faces.scenes(), faces.groups, epochs=EPOCHS, seed=seed, progress=tell)


def _pool(study: Study, faces: Images, *, own: bool) -> Pool:
    """Half as many masks as there are digits behind."""
    masks = (study.plan.own if own else study.plan.seen) // 2 // PART * PART
    return collect(
        study.subject,
        faces,
        masks=masks,
        own=own,
        seed=derive(study.seed, "faces"),
        folder=None,
        progress=partial(study.tell, "masks before attackers' faces" if own else "before faces"),
    )


def _attribute(study: Study, own: Pool, seen: Pool) -> str:
    shape = study.subject.bundle.scene.shape
    leaves = _area(study, (own.released, own.labels), (seen.released, seen.labels), None)
    opened = _area(study, (own.right, own.labels), (seen.right, seen.labels), shape)
    return (
        f"Faces, gender by a network: AUC {leaves:.2f} from what leaves, {opened:.2f} with the "
        f"key, chance 0.50 (n = {seen.labels.numel():,})."
    )


def _area(study: Study, learned: Captures, asked: Captures, shape: tuple[int, int] | None) -> float:
    held = max(2, len(learned[0]) // 5)
    kept, check = (
        Seen(learned[0][part].flatten(0, 1).flatten(1), learned[1][part].flatten())
        for part in (slice(None, -held), slice(-held, None))
    )
    answer = by_network(
        kept,
        check,
        2,
        build=linear if shape is None else partial(convolutions, shape),
        trial=study.plan.trials[0],
        epochs=study.plan.epochs,
    )
    logits = judged(answer, asked[0].flatten(0, 1).flatten(1))
    return auc(logits[:, 1] - logits[:, 0], asked[1].flatten() == 1)


def _persons(study: Study, match: FaceMatch, faces: Images, seen: Pool) -> str:
    """Pairs of captures of different masks, and of different pictures where the person is one."""
    if faces.groups is None:
        raise TrainingError("faces have no persons: give drawn faces with identities")
    chosen = seen.chosen.flatten()
    persons, masks = faces.groups[chosen], torch.arange(len(chosen)) // (2 * CAPTURES)
    same = (persons[:, None] == persons) & (chosen[:, None] != chosen)
    # Neighbours saw the same pictures: they are one place.
    one, other = (same & (masks[:, None] < masks)).nonzero().T
    random = stream(study.seed, "strangers")
    pairs = torch.randint(len(chosen), (2, STRANGERS), generator=random)
    apart = (persons[pairs[0]] != persons[pairs[1]]) & (masks[pairs[0]] != masks[pairs[1]])
    first, second = torch.cat([one, pairs[0, apart]]), torch.cat([other, pairs[1, apart]])
    is_same = torch.arange(len(first)) < len(one)
    rates = {}
    for name, pictures in (
        ("of the pictures themselves", faces.scenes(chosen)),
        ("with the key", seen.right.flatten(0, 1)),
        ("with a wrong key", seen.wrong.flatten(0, 1)),
    ):
        features = match.features(pictures)
        scores = (features[first] * features[second]).sum(1)
        rates[name] = true_accept_rate(scores, is_same, FAR)
    said = ", ".join(f"{100 * rate:.1f} % {name}" for name, rate in rates.items())
    return (
        f"Faces, the same person behind two masks, accepted by face match where 1 % of strangers "
        f"are: {said} (n = {len(one):,} pairs)."
    )
