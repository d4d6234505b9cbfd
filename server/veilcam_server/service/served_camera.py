"""Camera of a daemon, with everything that belongs to it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt
import structlog

from veilcam_client.wire.sealing import Release
from veilcam_client.wire.simulation import Faults
from veilcam_client.wire.status import Device as DeviceInfo
from veilcam_optics.pictures import PictureError
from veilcam_server.bundles.hiding import HidingCheck
from veilcam_server.bundles.loader import Identity, Opener, release_terms, rotation_policy
from veilcam_server.bundles.manager import BundleManager
from veilcam_server.bundles.owners import Owners
from veilcam_server.calibration.record import open_calibration, settle_time, source_opener
from veilcam_server.calibration.service import CalibrationService
from veilcam_server.camera.budget import ReleaseBudget
from veilcam_server.camera.camera import MaskedCamera
from veilcam_server.camera.capture import Fence
from veilcam_server.camera.engine import CameraEngine
from veilcam_server.camera.epochs import Preparation
from veilcam_server.camera.self_test import Checks, OpticalSelfTest
from veilcam_server.devices.registry import open_device
from veilcam_server.devices.simulated.images import as_scene, decoded, range_warning
from veilcam_server.devices.simulated.scenes import Scenes
from veilcam_server.errors import ProblemError
from veilcam_server.service.rotation_policy import PolicyStore
from veilcam_server.service.state import State
from veilcam_server.settings import Settings
from veilcam_server.system.logs import log_defect
from veilcam_server.watch.watcher import WatchSetup, open_watch
from veilcam_training.bundle import read_bundle

log = structlog.get_logger()


class Simulation:
    """Scenes and faults of a simulated device, for callers who may set them.

    Args:
        scenes: scenes before which pictures are held up.
        break_device: breaks and mends the device.
    """

    def __init__(self, scenes: Scenes, break_device: Callable[[Faults], None]) -> None:
        self.scenes, self.break_device = scenes, break_device

    def picture(self, content: bytes) -> tuple[npt.NDArray[np.float32], str | None]:
        """Return a picture of the scene's size, and a warning.

        Raises:
            ProblemError: it is no picture.
        """
        try:
            picture = decoded(content)
            scene, warning = as_scene(picture, self.scenes.shape), range_warning(picture)
        except PictureError as error:
            raise ProblemError("invalid_request", f"this {error}") from None
        fitted = scene if scene.ndim == 2 else np.moveaxis(scene, 0, 2)
        return fitted, None if warning is None else f"this {warning}"


class Releases(NamedTuple):
    """Releases of embeddings."""

    form: Callable[[], Release]
    """Returns the form in which embeddings leave from the next epoch on."""
    raw_budget: int = 0
    """Embeddings that may leave raw behind one mask."""


@dataclass(frozen=True, slots=True)
class ServedCamera:
    """Camera that takes captures, and its bundles, calibration and watch.

    Attributes:
        engine: takes captures and changes masks.
        identity: facts for the status.
        releases: releases of embeddings.
        calibration: calibration that measures the camera.
        bundles: bundles, of which one is in use; None: a recording is replayed.
        policies: store of the rotation policy; None: the policy ends with the daemon.
        watch: settings of the watch; None: a recording is replayed.
        simulation: scenes and faults that callers may set; None: they may set none.
    """

    engine: CameraEngine
    identity: Identity
    releases: Releases
    calibration: CalibrationService
    bundles: BundleManager | None = None
    policies: PolicyStore | None = None
    watch: WatchSetup | None = None
    simulation: Simulation | None = None

    @classmethod
    def open(cls, settings: Settings, state: State) -> Self:
        """Read the bundle, open the device and show the first mask.

        Raises:
            StartError, BundleError, BundleRefusedError, BundleOlderError, DeviceError,
            RotationImpossibleError: what stands in the way.
        """
        bundle = read_bundle(settings.bundle)
        key, report = state.key, state.report
        terms = release_terms(settings, state.receivers)
        budget = ReleaseBudget(state.directory, settings.raw_budget, report)
        signed = open_calibration(settings, bundle, key, report)
        opener = Opener(
            bundle,
            source_opener(settings, signed),
            Owners.open(settings.owner_keys),
            HidingCheck(allow=settings.allow_visible),
        )
        bundles = BundleManager.open(settings, opener, bundle, report)
        source, info = bundles.keys.source, bundles.info
        policies = PolicyStore(state.directory, settings.rotation, report)
        with ExitStack() as undo:
            device = open_device(settings, bundle)
            undo.callback(device.close)
            preparation = Preparation(source, key, terms, budget)
            undo.callback(preparation.close)
            policy = policies.at_start(
                rotation_policy(settings, bundle),
                renewable=source.renewable,
                configured=info.digest == bundle.digest,
            )
            colour, levels = bundle.channels == 3, bundle.camera.panel.levels
            engine = MaskedCamera(
                device,
                preparation,
                bundle.measurement_shape,
                OpticalSelfTest(bundle.camera, bundle.scene, bundle.embedding, colour=colour),
                fence=Fence(settle_time(settings, signed), settings.capture_timeout),
                policy=policy,
                checks=Checks(settings.self_test_every, settings.guard, levels),
                calibration=signed,
            )
            undo.pop_all()
            undo.callback(engine.stop)
            watch = open_watch(settings, signed, report)
            _begin(engine, watch.rests)
            undo.pop_all()
        bundles.note_start(report)
        simulation = None
        if settings.scene_api and device.scenes is not None and device.set_faults is not None:
            simulation = Simulation(device.scenes, device.set_faults)
        return cls(
            engine,
            Identity(
                DeviceInfo(
                    display=device.display.name,
                    sensor=device.sensor.name,
                    simulated=device.simulated,
                    key=key.public,
                ),
                info,
                experiment="wrong-classifier" if settings.wrong_classifier else None,
            ),
            Releases(lambda: terms().form, settings.raw_budget),
            CalibrationService(settings, bundle, key, signed),
            bundles,
            policies,
            watch,
            simulation,
        )


def _begin(engine: MaskedCamera, rests: str | None) -> None:
    """Test the panel and show the first mask; or be opaque, and test nothing, for a reason.

    What stands in the way of that is no reason to end: in a dark room nothing can be told before
    there is light, and a cable can be put back. The state says why no capture is taken, and it is
    tried again.
    """
    try:
        if rests is None:
            engine.rotate()
        else:
            engine.rest(rests)
    except ProblemError as error:
        log.warning("no capture yet", reason=str(error), remedy=error.remedy)
    except Exception as error:
        log_defect(error, during="first self test")
