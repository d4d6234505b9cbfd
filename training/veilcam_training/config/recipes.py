"""Recipes by name: values of settings that suit a fit, the paper's and ours."""

from collections.abc import Callable, Mapping

from veilcam_training.config.settings import FitSettings, FreshMasks
from veilcam_training.encoders.fresh import Misalignment
from veilcam_training.errors import require
from veilcam_training.models.classifiers import reads_scenes
from veilcam_training.transforms.augmentation import Augmentation

Changes = Mapping[str, object]
"""Values by the names of :class:`FitSettings`; the others stay as they are."""


def find_recipe(name: str, settings: FitSettings, *, colour: bool = False) -> FitSettings:
    """Return ``settings`` with the values of recipe ``name``.

    Args:
        name: name of the recipe.
        settings: settings whose names (data, encoder, embedding, classifier, ...) it goes by.
        colour: True where the data set has colour.

    Raises:
        TrainingError: an unknown name, or one that fresh masks do not have.
    """
    require(name in RECIPES, f"recipe {name!r} is unknown: use one of {', '.join(RECIPES)}")
    if settings.fresh is not None:
        require(name == "default", f"fresh masks have no recipe {name!r}: leave it out")
        settings = settings.model_copy(update={"fresh": _fresh(settings, settings.fresh)})
    changes = dict(RECIPES[name](settings))
    if colour and reads_scenes(settings.classifier):
        changes["jitter"] = PHOTOGRAPHS
    return settings.model_copy(update=changes)


DIGITS = Augmentation(rotation=10.0, scale=0.1, shift=0.05)
"""Digits changed by this much are still the digits they were."""
SHIFTED_DIGITS = Augmentation(rotation=10.0, scale=0.1, crop=2)
"""The same, moved by whole pixels of the estimated scene."""
SCENES: Changes = {
    "epochs": 6,
    "batch": 500,
    "optimiser": "nesterov",
    "rate": 0.6,
    "weight_decay": 1.6e-3,
    "warm_up": 0.23,
    "label_smoothing": 0.2,
    "averaging": 0.98,
    "precision": "mixed",
}
"""``Scene<width>``, which reads the estimated scene."""
PHOTOGRAPHS = Augmentation(mirror=True, crop=2)
"""Photographs show the same in a mirror."""


def _scenes(settings: FitSettings) -> Changes:
    faces = settings.data.startswith(("faces", "celeba"))
    changes = {**SCENES, "jitter": PHOTOGRAPHS if faces else SHIFTED_DIGITS}
    if faces and "@" not in settings.embedding:  # a whole box blurs what is smaller
        changes["pooling"] = 2
    if settings.data == "image-folder":  # some thousand at most
        changes |= {"epochs": 30, "batch": 100, "rate": 0.25}
    if settings.fresh is not None and settings.fresh.placement == "anywhere":
        changes |= {"pooling": 2, "jitter": SHIFTED_DIGITS}
    return changes


def _default(settings: FitSettings) -> Changes:
    """Large batches and one cycle. A linear classifier stands, and needs, a higher rate."""
    if settings.classifier == "LR":
        return {"epochs": 15, "batch": 256, "rate": 4e-2, "mask_rate": 5e-2}
    if reads_scenes(settings.classifier):
        return _scenes(settings)
    if settings.classifier in ("VGG11",) or settings.classifier.startswith("CNN"):
        return {"epochs": 15, "batch": 128, "rate": 2e-3, "mask_rate": 5e-2, "weight_decay": 0.05}
    return {"epochs": 15, "batch": 256, "rate": 3e-3, "mask_rate": 5e-2}


def _long(settings: FitSettings) -> Changes:
    """As the default, for as many epochs as the paper."""
    return {**_default(settings), "epochs": 50}


BEST_LINEAR: Mapping[str, Changes] = {
    "24x32": {"epochs": 30, "batch": 256, "rate": 4e-2, "mask_rate": 5e-2},
    "12x16": {"epochs": 30, "batch": 256, "rate": 4e-2, "mask_rate": 0.1},
    "6x8": {"epochs": 120, "batch": 256, "rate": 5e-2, "mask_rate": 0.1},
    "3x4": {"epochs": 100, "batch": 256, "rate": 0.3, "mask_rate": 3e-2},
}
"""``LR`` by embedding, behind an encoder that learns."""

BEST_LINEAR_FIXED: Mapping[str, Changes] = {
    "24x32": {"epochs": 60, "batch": 256, "rate": 4e-2},
}
"""``LR`` behind an encoder that does not, at every size."""

STEADY = Augmentation(rotation=5.0, shift=1 / 28)
"""Less of it, for classifiers that hardly learn their images by heart."""

BEST_HIDDEN: Mapping[str, Changes] = {
    "24x32": {
        "epochs": 120,
        "batch": 256,
        "mask_rate": 0.1,
        "normalisation": "white",
        "dropout": 0.2,
        "jitter": DIGITS,
    },
    "12x16": {
        "epochs": 60,
        "batch": 256,
        "mask_rate": 0.1,
        "normalisation": "white",
        "dropout": 0.2,
        "jitter": STEADY,
    },
    "6x8": {
        "epochs": 100,
        "batch": 256,
        "mask_rate": 0.2,
        "normalisation": "white",
        "dropout": 0.2,
        "jitter": Augmentation(shift=1 / 28),
    },
    "3x4": {"epochs": 120, "batch": 256, "mask_rate": 0.2, "normalisation": "white"},
}
"""``FC<width>`` by embedding, behind an encoder that learns."""

_FIXED: Changes = {"epochs": 30, "batch": 256, "normalisation": "white", "dropout": 0.2}
_FIXED_JITTERED: Changes = {**_FIXED, "epochs": 40, "jitter": STEADY}
BEST_HIDDEN_FIXED: Mapping[str, Changes] = {
    "24x32": _FIXED_JITTERED,
    "12x16": _FIXED_JITTERED,
    "6x8": _FIXED,
    "3x4": _FIXED,
}
"""``FC<width>`` by embedding, behind an encoder that does not learn."""


def _best(settings: FitSettings) -> Changes:
    """Return the settings for each kind of fit on MNIST; for everything else as ``long``.

    Chosen on the validation part, in runs of 30 epochs or more: LR at 12x16, 6x8 and 3x4 and behind
    fixed cameras, FC at every size, and at 12x16 behind a fixed mask; in runs of 20 or fewer: FC
    behind other fixed cameras, FC and CNN where objects are changed. The others carry over, not
    tried at length.

    Few pixels need many steps, which cost little there. Behind many, a classifier learns its images
    by heart unless they are jittered. Behind twelve, mask and scene classifier learn together.
    """
    if reads_scenes(settings.classifier):
        together = _learned(settings) and _size(settings) == "3x4" and settings.fresh is None
        return {**_scenes(settings), "end_to_end": together}
    if settings.data != "mnist":
        return _long(settings)
    if settings.change != "none":
        return _best_of_changed(settings)
    linear = settings.classifier == "LR"
    if not linear and not settings.classifier.startswith("FC"):
        return _long(settings)
    if _learned(settings):
        recipes = BEST_LINEAR if linear else BEST_HIDDEN
    else:
        recipes = BEST_LINEAR_FIXED if linear else BEST_HIDDEN_FIXED
    return recipes.get(_size(settings), recipes["24x32"])


def _best_of_changed(settings: FitSettings) -> Changes:
    """No jitter: a change of the scene is one. Objects anywhere are first found by a pinhole."""
    hidden = settings.classifier.startswith("FC")
    changes: dict[str, object] = {"epochs": 30}
    if hidden:
        changes = {"epochs": 50, "normalisation": "white", "exposure": "automatic"}
    if settings.change == "shift" and settings.classifier != "LR":
        # Half of a step goes into the transfers of its places, however many images share them.
        changes |= {"batch": 512 if hidden else 256, "rate": 3e-3, "mask_rate": 0.1}
        changes |= {"weight_decay": 0.0, "precision": "full" if hidden else "mixed"}
        if settings.encoder == "learned":
            changes["mask_start"] = "pinhole"
    return {**_default(settings), **changes}


def _paper(settings: FitSettings) -> Changes:
    """Return the paper's settings: Adam at 1e-3 for mask and classifier, 50 epochs.

    The rate is divided by 10 every ``steps_every`` epochs, but not for LR. CIFAR-10 has SGD at
    0.01, images moved by up to the padding of the paper's crops, and mirrored.
    """
    learned = _learned(settings)
    if settings.data == "cifar10":
        return {
            "epochs": 50,
            "batch": 32,
            "optimiser": "sgd",
            "rate": 1e-2,
            "mask_rate": 1e-2,
            "schedule": "steps",
            "steps_every": 20 if learned else 10,
            "normalisation": "shared",
            "jitter": Augmentation(shift=_cifar_padding(settings), mirror=True),
        }
    if settings.classifier == "LR":
        batch, steps_every = 100 if learned else 64, None
    elif settings.data.startswith(("celeba", "faces")):
        batch, steps_every = 64, 20 if learned else 10
    else:
        batch, steps_every = 64 if learned else 32, 20
    return {
        "epochs": 50,
        "batch": batch,
        "rate": 1e-3,
        "mask_rate": 1e-3,
        "schedule": "constant" if steps_every is None else "steps",
        "steps_every": steps_every or 20,
        "normalisation": "shared",
    }


CIFAR_PADDING: Mapping[str, tuple[int, int, int, int]] = {
    "lens": (4, 4, 2, 0),
    "fixed": (1, 1, 1, 0),
    "learned": (2, 1, 1, 0),
}
"""Embedding pixels of padding at 27x36, 13x17, 6x8 and 3x4 (the paper)."""


def _cifar_padding(settings: FitSettings) -> float:
    """Return the padding as a share of the image's sides."""
    kind = "learned" if _learned(settings) else "fixed"
    sizes = {"27x36": 27, "13x17": 13, "6x8": 6, "3x4": 3}
    if _size(settings) not in sizes:
        return 0.0
    padding = CIFAR_PADDING.get(settings.encoder, CIFAR_PADDING[kind])
    return padding[list(sizes).index(_size(settings))] / sizes[_size(settings)]


RECIPES: Mapping[str, Callable[[FitSettings], Changes]] = {
    "default": _default,
    "long": _long,
    "best": _best,
    "paper": _paper,
}

FRESH: Mapping[str, Changes] = {
    "mnist 12x16": {"exponent": 4.0},
    "mnist 6x8": {"exponent": 4.0, "spread": 0.25},
    "mnist 3x4": {"exponent": 4.0, "spread": 0.25},
    "fashion 24x32": {"exponent": 4.0},
}
"""Fresh masks by data set and embedding; others are uniform."""


def _fresh(settings: FitSettings, masks: FreshMasks) -> FreshMasks:
    if masks.placement == "anywhere":
        return masks.model_copy(update={"misalignment": Misalignment(panels=4)})
    return masks.model_copy(update={**FRESH.get(f"{settings.data} {_size(settings)}", {})})


def _size(settings: FitSettings) -> str:
    """Return rows and columns of the embedding, of any fill."""
    return settings.embedding.partition("@")[0]


def _learned(settings: FitSettings) -> bool:
    return settings.encoder in ("learned", "digital")
