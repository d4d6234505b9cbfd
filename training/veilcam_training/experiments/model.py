"""Models as settings describe them: camera and classifier, not fitted yet."""

import torch

from veilcam_optics.camera.geometry import Camera, Scene
from veilcam_optics.decoding import MeasurementNoise, SceneFrame, SceneStatistics
from veilcam_optics.keys.masks import MaskDistribution
from veilcam_training.config.settings import FitSettings, FreshMasks, parse_embedding
from veilcam_training.data import Images, Source
from veilcam_training.encoders import LearnedMask, LinearEncoder, Setup, make_encoder
from veilcam_training.encoders.estimate import SceneEstimate
from veilcam_training.encoders.fresh import (
    FreshCamera,
    LearnedRange,
    MaskSchedule,
    pooled,
    scene_statistics,
)
from veilcam_training.errors import TrainingError, require
from veilcam_training.models.classifiers import SceneTask, Task, make_layers, reads_scenes
from veilcam_training.models.lensless import FreshClassifier, LenslessClassifier
from veilcam_training.seeding import seeded, stream
from veilcam_training.transforms.scene import Anywhere, Identity, Transform, make_transform


def make_model(settings: FitSettings, source: Source, camera: Camera) -> LenslessClassifier:
    """Return the model that ``settings`` describe, not fitted yet.

    One that reads the estimated scene knows nothing of scenes yet, see :func:`prepare`.

    Raises:
        TrainingError: an unknown encoder or classifier, or an embedding that is none.
    """
    embedding = parse_embedding(settings.embedding)
    change = make_transform(settings.change, source.scene, camera)
    setup = Setup(
        camera,
        change.scene,
        embedding,
        colour=source.colour,
        point_binning=settings.binning == "point",
        finer=change.finer,
        tolerance=settings.tolerance,
    )
    encoder = make_encoder(
        settings.encoder,
        setup,
        stream(settings.seed, "encoder"),
        psf=settings.psf_file,
        errors=settings.panel_errors,
        pinhole=settings.mask_start == "pinhole",
    )
    snr_db = settings.noise_db(camera, colour=source.colour)
    estimate: SceneEstimate | None = None
    classes = len(source.labels)
    if reads_scenes(settings.classifier) and not setup.finer:
        estimate = SceneEstimate(encoder, snr_db, settings.rank, settings.pooling)
    task = Task(
        channels=setup.channels,
        rows=embedding.rows,
        columns=embedding.columns,
        classes=classes,
        rectified=encoder.trainable,
        normalisation=settings.normalisation,
        gain=white_gain(encoder),
        exposure=settings.exposure,
        estimate=None
        if estimate is None
        else (_scene_task(estimate.scene, setup.channels, classes), estimate.layers),
    )
    require(
        estimate is None or not settings.panel_errors.any,
        "a Scene classifier is fitted behind an ideal panel: leave out panel_errors, or use "
        "another classifier",
    )
    require(
        not settings.end_to_end or estimate is not None,
        "only a Scene classifier has a second stage: leave out end_to_end",
    )
    layers = make_layers(settings.classifier, task, dropout=settings.dropout)
    with seeded(settings.seed, "classifier"):
        return LenslessClassifier(
            encoder,
            layers,
            snr_db,
            change=change,
            mixed_precision=settings.precision == "mixed",
            whitened=settings.normalisation == "white",
            estimate=estimate,
        )


def prepare(
    model: LenslessClassifier,
    settings: FitSettings,
    training: Images,
    known: SceneStatistics | None = None,
) -> SceneStatistics | None:
    """Prepare a fit: a model that reads the estimate of scenes is told their statistics.

    Then its mask is learned, and held.

    Args:
        model: model of :func:`make_model`.
        settings: settings of its fit.
        training: images to fit it to.
        known: statistics of the same images, from an earlier call.

    Returns:
        Statistics of the scenes; None where the model has no use for them.
    """
    if model.estimate is None:
        return None
    statistics = known or scene_statistics(
        training,
        model.change,
        pooling=1,
        rank=model.estimate.rank,
        seed=settings.seed,
        mirrored=settings.jitter.mirror,
    )
    model.estimate.learn(statistics)
    if isinstance(model.encoder, LearnedMask):
        model.estimate.learn_mask()
        model.encoder.hold()
    return statistics


def _scene_task(scene: Scene, channels: int, classes: int) -> SceneTask:
    return SceneTask(channels, scene.rows, scene.columns, classes)


def white_gain(encoder: LinearEncoder) -> float:
    """Factor that brings a white scene's measurement to a root mean square of 1, to 3 digits."""
    encoder.eval()  # without the errors of a panel, which are drawn at random
    with torch.no_grad():
        white = encoder.transfer().sum(-2).square().mean().sqrt().item()
    encoder.train()
    return float(f"{1 / white:.3g}") if white > 0 else 1.0


def make_fresh_camera(
    settings: FitSettings,
    camera: Camera,
    image: Scene,
    statistics: SceneStatistics,
    *,
    colour: bool = False,
) -> FreshCamera:
    """Return the camera that ``settings`` describe, its masks not learned yet.

    Args:
        settings: settings of the fit.
        camera: the device.
        image: size and distance at which the images are shown.
        statistics: public statistics of the decoded scenes; see :func:`fresh_statistics`.
        colour: True for images in colour.
    """
    shown, fresh = _fresh_change(settings, camera, image).scene, fresh_masks(settings)
    snr_db = settings.noise_db(camera, colour=colour)
    require(snr_db is not None, "a decoder expects noise: give snr_db a number")
    frame = SceneFrame(
        camera,
        pooled(shown, settings.pooling),
        parse_embedding(settings.embedding),
        statistics,
        MeasurementNoise(snr_db or 0.0, fresh.model_error),
    )
    source: MaskDistribution | LearnedRange
    if fresh.spread is None:
        source = MaskDistribution.power(camera, fresh.exponent)
    else:
        centres = stream(settings.seed, "centres")
        source = LearnedRange(camera, fresh.exponent, fresh.spread, centres)
    schedule = MaskSchedule(settings.seed, fresh.misalignment)
    setup = Setup(camera, shown, frame.embedding, colour=colour, tolerance=settings.tolerance)
    return FreshCamera(frame, source, setup, schedule)


def make_fresh_model(
    settings: FitSettings, source: Source, camera: Camera, statistics: SceneStatistics
) -> FreshClassifier:
    """Return the model for fresh masks that ``settings`` describe, not fitted yet.

    Raises:
        TrainingError: an unknown classifier, or an embedding that is none.
    """
    encoder = make_fresh_camera(settings, camera, source.scene, statistics, colour=source.colour)
    task = _scene_task(encoder.frame.scene, encoder.setup.channels, len(source.labels))
    layers = make_layers(settings.classifier, task)
    with seeded(settings.seed, "classifier"):
        return FreshClassifier(
            encoder,
            layers,
            _fresh_change(settings, camera, source.scene),
            mixed_precision=settings.precision == "mixed",
        )


def fresh_statistics(
    settings: FitSettings, camera: Camera, image: Scene, training: Images
) -> SceneStatistics:
    """Statistics of decoded scenes, from training images placed as they will be."""
    return scene_statistics(
        training,
        _fresh_change(settings, camera, image),
        pooling=settings.pooling,
        rank=settings.rank,
        seed=settings.seed,
        mirrored=settings.jitter.mirror,
    )


def no_statistics(
    settings: FitSettings, camera: Camera, image: Scene, *, colour: bool
) -> SceneStatistics:
    """Statistics of the same shape of black scenes, for a model that is not fitted."""
    scene = pooled(_fresh_change(settings, camera, image).scene, settings.pooling)
    black = torch.zeros((3 if colour else 1) * scene.rows * scene.columns)
    return SceneStatistics(black, black[:, None], black + 1)


def _fresh_change(settings: FitSettings, camera: Camera, image: Scene) -> Transform:
    if fresh_masks(settings).placement == "centred":
        return Identity(image)
    return Anywhere(image, camera, settings.pooling)


def fresh_masks(settings: FitSettings) -> FreshMasks:
    """Return the masks of a fit for fresh masks.

    Raises:
        TrainingError: the fit has one mask that stays.
    """
    if settings.fresh is None:
        raise TrainingError("the settings have no fresh masks: give them a table [fresh]")
    return settings.fresh
