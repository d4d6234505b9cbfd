"""The three doors that pictures come in by: a fit, a folder of scenes, and the REST API."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

import httpx
import numpy as np
import numpy.typing as npt
import structlog
from anyio.from_thread import start_blocking_portal
from PIL import Image
from tests.pictures.samples import SIDE
from tests.unit.server.conftest import make_bundle

from veilcam_server.api.app import create_app
from veilcam_server.daemon import build_service
from veilcam_server.devices.errors import LightError
from veilcam_server.devices.simulated.scene_files import open_scenes
from veilcam_server.security.admission import Admission
from veilcam_server.settings import Settings
from veilcam_training.bundle import write_bundle
from veilcam_training.data import open_source
from veilcam_training.data.summary import summarise
from veilcam_training.errors import TrainingError

Door: TypeAlias = Callable[[str, bytes], "npt.NDArray[np.float64] | str"]
"""Takes a file's name and content; gives gray pixels in [0, 1], or the words of a refusal.

What it warns of goes to ``warnings`` of :class:`Doors`.
"""
DOORS = ("fit", "scenes", "rest")
MEDIA_TYPES = {f".{kind}": f"image/{kind}" for kind in ("png", "webp", "bmp", "gif", "tiff")}
MEDIA_TYPES |= {".jpg": "image/jpeg", ".tif": "image/tiff"}
FILLER = np.tile(np.linspace(0, 255, SIDE).astype(np.uint8), (SIDE, 1))


class Doors:
    def __init__(
        self,
        folder: Path,
        put: Callable[[bytes, str], httpx.Response],
        held: Callable[[], npt.NDArray[np.float32]],
    ) -> None:
        self._folder, self._put, self._held = folder, put, held
        self.warnings: list[str] = []
        self._own = folder / "own"
        for label in "ab":
            (self._own / label).mkdir(parents=True)
            for number in range(4):
                Image.fromarray(FILLER).save(self._own / label / f"{number}.png")
        (self._own / "dataset.toml").write_text(f"rows = {SIDE}\ncolumns = {SIDE}")
        (folder / "scenes").mkdir()

    def __call__(self, door: str, name: str, content: bytes) -> npt.NDArray[np.float64] | str:
        self.warnings = []
        doors: dict[str, Door] = {"fit": self._fit, "scenes": self._scenes, "rest": self._rest}
        return doors[door](name, content)

    def _fit(self, name: str, content: bytes) -> npt.NDArray[np.float64] | str:
        path = self._own / "a" / name
        path.write_bytes(content)
        try:
            source = open_source("image-folder", self._own)
            self.warnings = list(summarise(source).warnings)
            pixels = np.concatenate([source.training().pixels, source.test().pixels]).astype(float)
        except TrainingError as error:
            return str(error) if f"a/{name} " in str(error) else f"UNNAMED {error}"
        finally:
            path.unlink()
        values = pixels / (255 if pixels.max() <= 255 else 65535)
        if values.ndim == 4:
            values = np.tensordot(values, (0.299, 0.587, 0.114), axes=([1], [0]))
        others = [value for value in values if np.abs(value - FILLER / 255).max() > 1e-3]
        assert len(others) == 1
        return np.asarray(others[0])

    def _scenes(self, name: str, content: bytes) -> npt.NDArray[np.float64] | str:
        path = self._folder / "scenes" / name
        path.write_bytes(content)
        settings = Settings.model_validate(
            {"device": "simulated", "bundle": "none.veilcam", "scenes": (str(path.parent),)}
        )
        try:
            with structlog.testing.capture_logs() as logs:
                (scene,) = open_scenes(settings, (SIDE, SIDE))
            self.warnings = [str(line["detail"]) for line in logs]
            return scene.read().astype(float)
        except LightError as error:
            return str(error) if str(path) in str(error) else f"UNNAMED {error}"
        finally:
            path.unlink()

    def _rest(self, name: str, content: bytes) -> npt.NDArray[np.float64] | str:
        answer = self._put(content, MEDIA_TYPES[Path(name).suffix])
        told: dict[str, Any] = answer.json()
        if answer.status_code == 200:
            self.warnings = [told["warning"]] if told["warning"] else []
            return self._held().astype(float)
        if answer.status_code in (413, 422) and told["code"] != "internal":
            return str(told["detail"])
        return f"UNNAMED {answer.status_code} {told}"


@contextmanager
def open_doors(folder: Path) -> Iterator[Doors]:
    bundle = folder / "tiny.veilcam"
    write_bundle(bundle, make_bundle())
    scene = folder / "first.png"
    Image.fromarray(FILLER).save(scene)
    settings = Settings.model_validate(
        {
            "device": "simulated",
            "bundle": bundle,
            "scenes": (str(scene),),
            "scene_api": True,
            "state_dir": folder / "state",
            "settle": 0.0,
            "exposure": 0.0,
            "rotation": {"mode": "off"},
            "callers": 1024,
        }
    )
    with start_blocking_portal() as portal:
        service = portal.call(build_service, settings)
        transport = httpx.ASGITransport(create_app(service, Admission()))
        http = httpx.AsyncClient(transport=transport, base_url="http://localhost")

        async def put(content: bytes, media_type: str) -> httpx.Response:
            headers = {"Content-Type": media_type}
            return await http.put("/v1/simulation/scene", content=content, headers=headers)

        with portal.wrap_async_context_manager(service.open()):
            scenes = service.simulation.scenes
            yield Doors(folder, lambda content, kind: portal.call(put, content, kind), scenes.read)
            portal.call(http.aclose)
