"""Recipes by name: the paper's, and ours; and the tasks of fresh masks."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, Field, model_validator

from veilcam_training.encoders.imperfections import PanelErrors
from veilcam_training.errors import require
from veilcam_training.models.classifiers import Exposure, Normalisation
from veilcam_training.transforms.augmentation import Augmentation

Rate = Annotated[float, Field(gt=0, le=10, allow_inf_nan=False)]
Tolerance = Annotated[float, Field(gt=0, lt=1, allow_inf_nan=False)]


def one_cycle(progress: float, *, warm_up: float, lowest: float) -> float:
    """Factor on a learning rate: it rises at first, and then falls as a cosine.

    Args:
        progress: share of the fit that is done, in [0, 1).
        warm_up: share of the fit in which the rate rises.
        lowest: factor that it does not fall below.
    """
    if progress < warm_up:
        return 0.04 + 0.96 * progress / warm_up
    falling = (progress - warm_up) / (1 - warm_up)
    return max(lowest, 0.5 * (1 + math.cos(math.pi * falling)))


class Recipe(BaseModel, frozen=True, extra="forbid", strict=True):
    """One way of fitting. The default values are not tuned to any task."""

    epochs: Annotated[int, Field(ge=1, le=10_000)] = 50
    batch: Annotated[int, Field(ge=2, le=65_536)] = 512
    """Images in one step."""
    optimiser: Literal["adam", "sgd", "nesterov"] = "adam"
    """``nesterov`` is for ``Scene<width>``: momentum 0.85, and faster biases."""
    rate: Rate = 3e-3
    """Learning rate of the classifier, at its highest."""
    mask_rate: Rate = 3e-2
    """Learning rate of the encoder, at its highest: mask weights have a range of 1."""
    mask_start: Literal["random", "pinhole"] = "random"
    """What a learned mask starts from: random weights, or one open pixel before a dim ground."""
    hidden: bool = True
    """Keep the copies of the scene behind a learned mask many, so that no eye sees one."""
    end_to_end: bool = False
    """Learn mask and ``Scene<width>`` together in a second stage, half as long as the first; other
    classifiers are always learned so."""
    weight_decay: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Decoupled weight decay of the classifier (AdamW); the encoder has none."""
    schedule: Literal["one_cycle", "steps", "constant"] = "one_cycle"
    """``one_cycle`` warms up and then falls as a cosine; ``steps`` divides by 10."""
    warm_up: Annotated[float, Field(ge=0, lt=1)] = 0.15
    """Share of a ``one_cycle`` schedule in which the rate rises."""
    steps_every: Annotated[int, Field(ge=1)] = 20
    """Epochs between two divisions of a ``steps`` schedule."""
    normalisation: Normalisation = "per_pixel"
    """How a classifier takes a measurement, see :mod:`veilcam_training.models.classifiers`."""
    exposure: Exposure = "fixed"
    """Of a measurement, see :data:`veilcam_training.models.classifiers.Exposure`."""
    label_smoothing: Annotated[float, Field(ge=0, lt=1)] = 0.0
    averaging: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Decay per step of the running mean of the classifier's weights, which takes their place in
    validation and after the fit; 0 keeps the weights themselves."""
    pooling: Annotated[int, Field(ge=1, le=16)] = 1
    """Side, in scene pixels, of a pixel of the estimated scene, for classifiers that read one."""
    rank: Annotated[int, Field(ge=1, le=2**12)] = 512
    """Principal components of the scene that its estimate uses."""
    dropout: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Of the classifier's hidden layers."""
    patience: Annotated[int, Field(ge=1)] | None = None
    """Epochs without a better validation accuracy after which fitting stops; None: never."""
    precision: Literal["full", "mixed"] = "full"
    """``mixed`` fits the classifier in bfloat16 on a processor that has it."""
    jitter: Augmentation = Augmentation()
    """Random changes of the training images."""
    panel_errors: PanelErrors = PanelErrors()
    """How the panel errs in training."""
    snr_db: Annotated[float, Field(allow_inf_nan=False, ge=-20, le=200)] | None = 40.0
    """Signal-to-noise ratio of a measurement [dB]; None for no noise."""
    tolerance: Tolerance = 3e-3
    """Relative L2 error that the light is planned to, at the embedding: a third of the noise at
    40 dB."""

    @model_validator(mode="after")
    def _fit_together(self) -> Self:
        if self.normalisation == "white" and self.precision == "mixed":
            raise ValueError(
                "normalisation 'white' tells apart what bfloat16 rounds away: use precision 'full'"
            )
        if self.normalisation == "white" and self.averaging:
            raise ValueError(
                "normalisation 'white' changes its coordinates in a fit, and weights in different "
                "coordinates have no mean: use averaging 0"
            )
        return self

    def rate_factor(self, progress: float) -> float:
        """Factor on both learning rates when ``progress``, in [0, 1), of the fit is done."""
        if self.schedule == "constant":
            return 1.0
        if self.schedule == "steps":
            return float(0.1 ** (math.floor(progress * self.epochs + 1e-9) // self.steps_every))
        return one_cycle(progress, warm_up=self.warm_up, lowest=1e-4)

    @property
    def transform(self) -> Augmentation | None:
        """Augmentation of the training images; None if there is none."""
        return self.jitter if self.jitter.any else None

    @property
    def without_mirror(self) -> Augmentation | None:
        """Augmentation of estimates, of which mirror images are measured; None if there is none."""
        left = self.jitter.model_copy(update={"mirror": False})
        return left if left.any else None


@dataclass(frozen=True)
class Situation:
    """Facts that a recipe may depend on; names as in the settings of a fit."""

    data: str = "mnist"
    encoder: str = "learned"
    embedding: str = "24x32"
    classifier: str = "LR"
    change: str = "none"
    colour: bool = False

    @property
    def learned(self) -> bool:
        """True if the encoder learns."""
        return self.encoder in ("learned", "digital")


def find_recipe(name: str, situation: Situation) -> Recipe:
    """Recipe ``name`` as it is in ``situation``.

    Raises:
        TrainingError: an unknown name.
    """
    require(name in RECIPES, f"recipe {name!r} is unknown: use one of {', '.join(RECIPES)}")
    return RECIPES[name](situation)


OWN_CLASSIFIER = "Scene32"
"""Of somebody's own pictures, unless another is named."""
DIGITS = Augmentation(rotation=10.0, scale=0.1, shift=0.05)
"""Digits changed by this much are still the digits they were."""
SHIFTED_DIGITS = Augmentation(rotation=10.0, scale=0.1, crop=2)
"""The same, moved by whole pixels of the estimated scene."""
SCENES = Recipe(
    epochs=6,
    batch=500,
    optimiser="nesterov",
    rate=0.6,
    weight_decay=1.6e-3,
    warm_up=0.23,
    label_smoothing=0.2,
    averaging=0.98,
    precision="mixed",
)
"""``Scene<width>``, which reads the estimated scene."""
PHOTOGRAPHS = Augmentation(mirror=True, crop=2)
"""Photographs show the same in a mirror."""


def scenes(data: str, *, colour: bool) -> Recipe:
    """Return the recipe of a ``Scene<width>``.

    Args:
        data: name of the data set.
        colour: True for images in colour, which are taken for photographs.
    """
    jitter = PHOTOGRAPHS if colour or data.startswith(("faces", "celeba")) else SHIFTED_DIGITS
    changes: dict[str, object] = {"jitter": jitter}
    if data.startswith(("faces", "celeba")):
        changes["pooling"] = 2
    if data == "image-folder":  # some thousand at most
        changes |= {"epochs": 30, "batch": 100, "rate": 0.25}
    return SCENES.model_copy(update=changes)


def _default(situation: Situation) -> Recipe:
    """Large batches and one cycle. A linear classifier stands, and needs, a higher rate."""
    if situation.classifier == "LR":
        return Recipe(epochs=15, batch=256, rate=4e-2, mask_rate=5e-2)
    if situation.classifier.startswith("Scene"):
        return scenes(situation.data, colour=situation.colour)
    if situation.classifier in ("VGG11",) or situation.classifier.startswith("CNN"):
        return Recipe(epochs=15, batch=128, rate=2e-3, mask_rate=5e-2, weight_decay=0.05)
    return Recipe(epochs=15, batch=256, rate=3e-3, mask_rate=5e-2)


def _long(situation: Situation) -> Recipe:
    """As the default, for as many epochs as the paper."""
    return _default(situation).model_copy(update={"epochs": 50})


BEST_LINEAR: Mapping[str, Recipe] = {
    "24x32": Recipe(epochs=30, batch=256, rate=4e-2, mask_rate=5e-2),
    "12x16": Recipe(epochs=30, batch=256, rate=4e-2, mask_rate=0.1),
    "6x8": Recipe(epochs=120, batch=256, rate=5e-2, mask_rate=0.1),
    "3x4": Recipe(epochs=100, batch=256, rate=0.3, mask_rate=3e-2),
}
"""``LR`` by embedding, behind an encoder that learns."""

BEST_LINEAR_FIXED: Mapping[str, Recipe] = {
    "24x32": Recipe(epochs=60, batch=256, rate=4e-2),
}
"""``LR`` behind an encoder that does not, at every size."""

STEADY = Augmentation(rotation=5.0, shift=1 / 28)
"""Less of it, for classifiers that hardly learn their images by heart."""

BEST_HIDDEN: Mapping[str, Recipe] = {
    "24x32": Recipe(
        epochs=120, batch=256, mask_rate=0.1, normalisation="white", dropout=0.2, jitter=DIGITS
    ),
    "12x16": Recipe(
        epochs=60, batch=256, mask_rate=0.1, normalisation="white", dropout=0.2, jitter=STEADY
    ),
    "6x8": Recipe(
        epochs=100,
        batch=256,
        mask_rate=0.2,
        normalisation="white",
        dropout=0.2,
        jitter=Augmentation(shift=1 / 28),
    ),
    "3x4": Recipe(epochs=120, batch=256, mask_rate=0.2, normalisation="white"),
}
"""``FC<width>`` by embedding, behind an encoder that learns."""

_FIXED = Recipe(epochs=30, batch=256, normalisation="white", dropout=0.2)
_FIXED_JITTERED = _FIXED.model_copy(update={"epochs": 40, "jitter": STEADY})
BEST_HIDDEN_FIXED: Mapping[str, Recipe] = {
    "24x32": _FIXED_JITTERED,
    "12x16": _FIXED_JITTERED,
    "6x8": _FIXED,
    "3x4": _FIXED,
}
"""``FC<width>`` by embedding, behind an encoder that does not learn."""


def _best(situation: Situation) -> Recipe:
    """Return the settings for each kind of fit on MNIST; for everything else as ``long``.

    Chosen on the validation part, in runs of 30 epochs or more: LR at 12x16, 6x8 and 3x4 and behind
    fixed cameras, FC at every size, and at 12x16 behind a fixed mask; in runs of 20 or fewer: FC
    behind other fixed cameras, FC and CNN where objects are changed. The others carry over, not
    tried at length.

    Few pixels need many steps, which cost little there. Behind many, a classifier learns its images
    by heart unless they are jittered.
    """
    if situation.data != "mnist":
        return _long(situation)
    if situation.change != "none":
        return _best_of_changed(situation)
    linear = situation.classifier == "LR"
    if not linear and not situation.classifier.startswith("FC"):
        return _long(situation)
    if situation.learned:
        recipes = BEST_LINEAR if linear else BEST_HIDDEN
    else:
        recipes = BEST_LINEAR_FIXED if linear else BEST_HIDDEN_FIXED
    return recipes.get(situation.embedding, recipes["24x32"])


def _best_of_changed(situation: Situation) -> Recipe:
    """No jitter: a change of the scene is one. Objects anywhere are first found by a pinhole."""
    hidden = situation.classifier.startswith("FC")
    changes: dict[str, object] = {"epochs": 30}
    if hidden:
        changes = {"epochs": 50, "normalisation": "white", "exposure": "automatic"}
    if situation.change == "shift" and situation.classifier != "LR":
        # Half of a step goes into the transfers of its places, however many images share them.
        changes |= {"batch": 512 if hidden else 256, "rate": 3e-3, "mask_rate": 0.1}
        changes |= {"weight_decay": 0.0, "precision": "full" if hidden else "mixed"}
        if situation.encoder == "learned":
            changes["mask_start"] = "pinhole"
    return _default(situation).model_copy(update=changes)


def _paper(situation: Situation) -> Recipe:
    """Return the paper's settings: Adam at 1e-3 for mask and classifier, 50 epochs.

    The rate is divided by 10 every ``steps_every`` epochs, but not for LR. CIFAR-10 has SGD at
    0.01, images moved by up to the padding of the paper's crops, and mirrored.
    """
    learned = situation.learned
    if situation.data == "cifar10":
        return Recipe(
            epochs=50,
            batch=32,
            optimiser="sgd",
            rate=1e-2,
            mask_rate=1e-2,
            schedule="steps",
            steps_every=20 if learned else 10,
            normalisation="shared",
            jitter=Augmentation(shift=_cifar_padding(situation), mirror=True),
        )
    if situation.classifier == "LR":
        batch, steps_every = 100 if learned else 64, None
    elif situation.data.startswith(("celeba", "faces")):
        batch, steps_every = 64, 20 if learned else 10
    else:
        batch, steps_every = 64 if learned else 32, 20
    return Recipe(
        epochs=50,
        batch=batch,
        rate=1e-3,
        mask_rate=1e-3,
        schedule="constant" if steps_every is None else "steps",
        steps_every=steps_every or 20,
        normalisation="shared",
    )


CIFAR_PADDING: Mapping[str, tuple[int, int, int, int]] = {
    "lens": (4, 4, 2, 0),
    "fixed": (1, 1, 1, 0),
    "learned": (2, 1, 1, 0),
}
"""Embedding pixels of padding at 27x36, 13x17, 6x8 and 3x4 (the paper)."""


def _cifar_padding(situation: Situation) -> float:
    """Return the padding as a share of the image's sides."""
    kind = "learned" if situation.learned else "fixed"
    sizes = {"27x36": 27, "13x17": 13, "6x8": 6, "3x4": 3}
    if situation.embedding not in sizes:
        return 0.0
    padding = CIFAR_PADDING.get(situation.encoder, CIFAR_PADDING[kind])
    return padding[list(sizes).index(situation.embedding)] / sizes[situation.embedding]


RECIPES: Mapping[str, Callable[[Situation], Recipe]] = {
    "default": _default,
    "long": _long,
    "best": _best,
    "paper": _paper,
}

TASKS: Mapping[str, Mapping[str, Any]] = {
    "mnist_24x32": {"classifier": "Scene16"},
    "mnist_12x16": {"classifier": "Scene16", "embedding": "12x16", "exponent": 4.0},
    "mnist_6x8": {"classifier": "Scene16", "embedding": "6x8", "exponent": 4.0, "spread": 0.25},
    "mnist_3x4": {"classifier": "Scene16", "embedding": "3x4", "exponent": 4.0, "spread": 0.25},
    "mnist_shift": {
        "placement": "anywhere",
        "misalignment": {"panels": 4},
        "recipe": {"pooling": 2, "jitter": {"crop": 2}},
    },
    "fashion_24x32": {"data": "fashion", "classifier": "Scene16", "exponent": 4.0},
    "faces_gender_24x32": {"data": "faces-gender"},
    "cifar10_27x36": {"data": "cifar10", "embedding": "27x36"},
}
"""Settings of fits for fresh masks, by task; see :mod:`veilcam_training.config.settings`."""
