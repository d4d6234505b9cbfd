"""A tiny bundle, and a panel and sensor whose faults a test can choose."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache, cached_property
from pathlib import Path
from typing import Any, TypeAlias

import httpx
import numpy as np
import numpy.typing as npt
import pytest
import structlog
import torch

from veilcam_client.wire.events import Event, MaskChanged, StateChanged
from veilcam_client.wire.rotation import RotationOff, RotationPolicy
from veilcam_client.wire.sealing import Release
from veilcam_client.wire.status import Device as DeviceInfo
from veilcam_client.wire.watch import OnRequest, WatchPolicy
from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.decoding import MeasurementNoise, fit_statistics
from veilcam_optics.keys.masks import MaskDistribution
from veilcam_server.api.app import create_app
from veilcam_server.bundles.loader import Identity, LoadedBundle, Opener, bundle_info
from veilcam_server.bundles.manager import BundleManager
from veilcam_server.bundles.owners import Owners
from veilcam_server.bundles.store import BundleStore
from veilcam_server.calibration.service import CalibrationService
from veilcam_server.camera.budget import ReleaseBudget
from veilcam_server.camera.camera import MaskedCamera
from veilcam_server.camera.capture import Fence
from veilcam_server.camera.epochs import Preparation
from veilcam_server.camera.self_test import Checks
from veilcam_server.demo_data import load_digits
from veilcam_server.devices import Device, DisplayError, Exposure, Shown
from veilcam_server.devices.base import Light
from veilcam_server.devices.simulated import light as simulation
from veilcam_server.devices.simulated.scenes import write_scene
from veilcam_server.masks.fresh import FreshSource
from veilcam_server.masks.pairs import load_pairs
from veilcam_server.masks.source import MaskSource, Terms
from veilcam_server.sealing.identity import DeviceKey
from veilcam_server.sealing.receivers import ReceiverStore
from veilcam_server.security.admission import Admission
from veilcam_server.service.served_camera import Releases, ServedCamera
from veilcam_server.service.service import Service
from veilcam_server.service.state import State
from veilcam_server.settings import Settings
from veilcam_server.system.state_file import make_directory
from veilcam_server.watch.policy import WatchStore
from veilcam_server.watch.watcher import WatchSetup
from veilcam_training.bundle import Bundle, Fresh, Pair, read_bundle, write_bundle
from veilcam_training.bundle.layers import (
    BatchNorm,
    Conv2d,
    Flatten,
    LayerRecord,
    Linear,
    MaxPool,
    ReLU,
    Reshape,
)
from veilcam_training.models.network import build_untrained, weights_of

LABELS = tuple("0123456789")
# A quarter of the sensor along each side: simulated light takes a sixth of the time.
CAMERA = Camera(
    panel=Panel(), window=Window(rows=9, columns=5), sensor=Sensor(rows=760, columns=1014)
)
EMBEDDING = Embedding(4, 5)
DIGEST = "b0" * 32
"""Of a bundle that was read from no file."""
OFF = RotationOff()


def make_bundle(pairs: int = 3) -> Bundle:
    """Random masks and random linear classifiers, for a small window and embedding."""
    generator = torch.Generator().manual_seed(7)

    def pair() -> Pair:
        levels = torch.randint(0, 64, CAMERA.mask_shape, generator=generator)
        return Pair(
            levels=levels.to(torch.uint8).numpy(),
            layers=(Linear(inputs=EMBEDDING.size, outputs=len(LABELS)),),
            weights={
                "0.weight": torch.randn(len(LABELS), EMBEDDING.size, generator=generator).numpy(),
                "0.bias": np.zeros(len(LABELS), np.float32),
            },
        )

    return Bundle(
        task="mnist",
        labels=LABELS,
        camera=CAMERA,
        scene=Scene(),
        embedding=EMBEDDING,
        mode="pairs",
        pairs=tuple(pair() for _ in range(pairs)),
        digest=DIGEST,
    )


def make_fresh_bundle() -> Bundle:
    """A random small CNN, and statistics of the first digits of the sample that comes along."""
    scene = Scene()
    layers: tuple[LayerRecord, ...] = (
        Reshape(shape=(1, *scene.shape)),
        Conv2d(inputs=1, outputs=3),
        BatchNorm(features=3, dimensions=2),
        ReLU(),
        MaxPool(kernel=4),
        Flatten(),
        Linear(inputs=3 * 7 * 7, outputs=len(LABELS)),
    )
    digits = load_digits().images[:300] / np.float32(255)
    with torch.random.fork_rng():
        torch.manual_seed(11)
        weights = weights_of(build_untrained(layers))
    return Bundle(
        task="mnist",
        labels=LABELS,
        camera=CAMERA,
        scene=scene,
        embedding=EMBEDDING,
        mode="fresh",
        fresh=Fresh(
            distribution=MaskDistribution.uniform(CAMERA),
            statistics=fit_statistics([digits], 24),
            noise=MeasurementNoise(40.0),
            layers=layers,
            weights=weights,
        ),
        digest=DIGEST,
    )


class FakeDisplay:
    """Remembers masks, and whether it is opaque; ``faults`` are taken one for each mask."""

    name = "fake panel"

    def __init__(self) -> None:
        self.resets = 1
        self.shown: list[npt.NDArray[np.uint8]] = []
        self.faults: list[Exception | None] = []
        self.opaque = self.closed = False

    def show(self, levels: npt.NDArray[np.uint8]) -> Shown:
        self.opaque = not levels.any()
        if self.opaque:
            return Shown(time.monotonic())
        return self._take(levels)

    def _take(self, levels: npt.NDArray[np.uint8]) -> Shown:
        fault = self.faults.pop(0) if self.faults else None
        if fault is not None:
            raise fault
        self.shown.append(levels.copy())
        return Shown(time.monotonic())

    def blank(self) -> None:
        self._take(np.zeros(CAMERA.mask_shape, np.uint8))
        self.opaque = True

    def close(self) -> None:
        self.closed = True


class FakeTest:
    """A self test that was passed, unless ``faults`` say what came of it instead."""

    def __init__(self) -> None:
        self.faults: list[BaseException | None] = []
        self.runs, self.leak = 0, 0.0

    def run(self, device: Device, fence: Fence) -> float:
        self.runs += 1
        fault = self.faults.pop(0) if self.faults else None
        if fault is not None:
            raise fault
        return self.leak


class FakeSensor:
    """Reads ones at once; ``early`` [s] makes it start before it may, ``before`` runs first.

    ``fault`` is raised instead of a capture, as long as it stands.
    """

    name = "fake sensor"
    full_scale = 1.0

    def __init__(self) -> None:
        self.measurement = np.ones(EMBEDDING.shape, np.float32)
        self.lights: Callable[[], float] = lambda: 1.0
        """Mean light of a frame that begins now."""
        self.early = 0.0
        self.fault: Exception | None = None
        self.before: Callable[[], None] = lambda: None
        self.captures = self.guards = 0
        self.closed = False

    def capture(self, not_before: float, timeout: float) -> Exposure:
        self.before()
        if self.fault is not None:
            raise self.fault
        self.captures += 1
        time.sleep(max(0.0, not_before - time.monotonic()))
        now = time.monotonic()
        started = now if not self.early else not_before - self.early
        return Exposure(self.measurement, started, max(now, started), light=self.seen())

    def light(self, not_before: float, timeout: float) -> Light:
        self.guards += 1
        time.sleep(max(0.0, not_before - time.monotonic()))
        return self.seen()

    def seen(self) -> Light:
        mean = self.lights()
        return Light(min(mean, 1.0), 1e-4, saturated=mean > 1)

    def close(self) -> None:
        self.closed = True


@dataclass
class Bench:
    """An engine with everything around it within reach."""

    bundle: Bundle
    state_dir: Path
    source: MaskSource
    release: Release = "raw"
    raw_budget: int = 1_000_000
    display: FakeDisplay = field(default_factory=FakeDisplay)
    sensor: FakeSensor = field(default_factory=FakeSensor)
    test: FakeTest = field(default_factory=FakeTest)
    epochs: list[str] = field(default_factory=list)
    states: list[tuple[str, str | None]] = field(default_factory=list)
    calibration: CalibrationService | None = None
    owners: Owners = field(default_factory=Owners)
    watch: WatchPolicy = field(default_factory=OnRequest)

    def __post_init__(self) -> None:
        # A panel that hides all when it is opaque.
        self.sensor.lights = lambda: 0.0 if self.display.opaque else 1.0

    def note(self, make: Callable[..., Event]) -> None:
        """Remember new epochs and states."""
        event = make(id="", at=datetime.now(UTC))
        if isinstance(event, MaskChanged):
            self.epochs.append(event.epoch)
        elif isinstance(event, StateChanged):
            self.states.append((event.state, event.detail))

    @cached_property
    def key(self) -> DeviceKey:
        return DeviceKey.open(self.state_dir)

    @cached_property
    def receivers(self) -> ReceiverStore:
        make_directory(self.state_dir)
        return ReceiverStore(self.state_dir)

    @property
    def terms(self) -> Terms:
        """What holds for an epoch that is prepared now."""
        return Terms(self.release, self.receivers.keys)

    def preparation(self) -> Preparation:
        make_directory(self.state_dir)
        self.budget = ReleaseBudget(self.state_dir, self.raw_budget)
        return Preparation(self.source, self.key, lambda: self.terms, self.budget)

    def unstarted(
        self,
        *,
        policy: RotationPolicy = OFF,
        settle: float = 0.0,
        test_every: float = 600.0,
        guard_every: float = 600.0,
    ) -> MaskedCamera:
        """Return an engine that has shown nothing yet."""
        camera = MaskedCamera(
            Device(self.display, self.sensor, simulated=True),
            self.preparation(),
            self.bundle.embedding.shape,
            self.test,
            fence=Fence(settle=settle),
            policy=policy,
            checks=Checks(test_every, guard_every),
        )
        camera.listen(self.note)
        return camera

    def camera(self, **given: Any) -> MaskedCamera:
        camera = self.unstarted(**given)
        try:
            camera.rotate()
        except BaseException:
            camera.preparation.close()
            raise
        return camera

    def bundles(self, *, limit: int = 2**20) -> BundleManager:
        """As the daemon makes them: of a bundle in a file."""
        path = self.state_dir / "configured.veilcam"
        self.state_dir.mkdir(exist_ok=True, mode=0o700)
        write_bundle(path, self.bundle)
        bundle = read_bundle(path)
        source = load_pairs if bundle.mode == "pairs" else lambda _: self.source
        opener = Opener(bundle, source, self.owners)
        store = BundleStore(self.state_dir / "bundles", path, bundle.digest)
        return BundleManager(
            store, opener, LoadedBundle(bundle_info(bundle), self.source), limit=limit
        )

    def service(self, camera: MaskedCamera, *, queue_limit: int = 8) -> Service:
        bundles = self.bundles()
        settings = Settings(bundle=self.state_dir / "configured.veilcam", state_dir=self.state_dir)
        state = State(self.state_dir)
        # The daemon's key and receivers are those of the bench.
        state.key, state.receivers = self.key, self.receivers
        served = ServedCamera(
            camera,
            Identity(
                DeviceInfo(
                    display="fake panel", sensor="fake sensor", simulated=True, key=self.key.public
                ),
                bundles.info,
            ),
            Releases(lambda: self.release, self.raw_budget),
            self.calibration or CalibrationService(settings, None, None),
            bundles,
            watch=WatchSetup(self.watch, WatchStore(self.state_dir, self.watch)),
        )
        service = Service(served, state, queue_limit=queue_limit, heartbeat=0.05)
        publish = camera._panel.publish

        def note(make: Callable[..., Event]) -> None:
            self.note(make)
            publish(make)

        camera.listen(note)
        return service

    def pair_shown(self) -> int | None:
        """Index of the pair on the panel, None for any other picture."""
        shown = (np.array_equal(pair.levels, self.display.shown[-1]) for pair in self.bundle.pairs)
        return next((index for index, same in enumerate(shown) if same), None)


Running: TypeAlias = Callable[..., AbstractAsyncContextManager[httpx.AsyncClient]]


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture
def bundle() -> Bundle:
    return make_bundle()


@pytest.fixture
def bench(bundle: Bundle, tmp_path: Path) -> Bench:
    return Bench(bundle, tmp_path / "state", load_pairs(bundle))


@pytest.fixture
def lone_bench(tmp_path: Path) -> Bench:
    """A bench whose bundle holds one pair."""
    lone = make_bundle(1)
    return Bench(lone, tmp_path / "state", load_pairs(lone))


@pytest.fixture(scope="session")
def fresh_bundle() -> Bundle:
    return make_fresh_bundle()


@pytest.fixture
def fresh_bench(fresh_bundle: Bundle, tmp_path: Path) -> Bench:
    """A bench whose masks are drawn from a key: one embedding leaves raw behind each."""
    source = FreshSource(fresh_bundle)
    return Bench(fresh_bundle, tmp_path / "state", source, raw_budget=1)


@pytest.fixture
def running(bench: Bench) -> Running:
    """A factory of HTTP clients of a whole application in this process."""

    @asynccontextmanager
    async def run(
        *,
        policy: RotationPolicy = OFF,
        queue_limit: int = 8,
        settle: float = 0.0,
        raising: bool = True,
        on: Bench = bench,
        admission: Admission | None = None,
    ) -> AsyncIterator[httpx.AsyncClient]:
        service = on.service(on.camera(policy=policy, settle=settle), queue_limit=queue_limit)
        app = create_app(service, admission)
        transport = httpx.ASGITransport(app, raise_app_exceptions=raising)
        async with (
            service.open(),
            httpx.AsyncClient(transport=transport, base_url="http://localhost") as client,
        ):
            yield client

    return run


@pytest.fixture
def bundle_file(bundle: Bundle, tmp_path: Path) -> Path:
    path = tmp_path / "tiny.veilcam"
    write_bundle(path, bundle)
    return path


@pytest.fixture
def fresh_file(fresh_bundle: Bundle, tmp_path: Path) -> Path:
    path = tmp_path / "fresh.veilcam"
    write_bundle(path, fresh_bundle)
    return path


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    path = tmp_path / "scene.npy"
    write_scene(path, np.random.default_rng(3).integers(0, 256, (28, 28)).astype(np.uint8))
    return path


@pytest.fixture
def display_fault() -> DisplayError:
    return DisplayError("the bus gave no answer")


_planned_once = cache(simulation.planned_light)


@pytest.fixture(autouse=True)
def _one_plan_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """Light knows nothing of masks and scenes: daemons of one camera may share it."""
    monkeypatch.setattr(simulation, "planned_light", _planned_once)


@pytest.fixture(autouse=True)
def _own_logs() -> Iterator[None]:
    yield
    structlog.reset_defaults()


@pytest.fixture(autouse=True)
def _no_settings_from_outside(monkeypatch: pytest.MonkeyPatch) -> None:
    import os

    for name in list(os.environ):
        if name.startswith("VEILCAM_") or name in ("STATE_DIRECTORY", "CREDENTIALS_DIRECTORY"):
            monkeypatch.delenv(name)
