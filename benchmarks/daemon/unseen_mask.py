"""Captures that a daemon answers as good under a mask that was not there.

    python -m benchmarks.daemon.unseen_mask --figures benchmarks/results/proof.json

A whole daemon, on the simulated camera, is asked over REST for captures and classifications in
turn, behind a panel that is broken without a word to the daemon: it loses its power (``dead``), or
its bus every ninth write (``lost``). Whenever an answer is refused, the panel is mended, a sound
capture is asked for, and the panel is broken anew, until so many captures were taken behind a
broken panel. An oracle looks into the memory of the emulated panel, which the daemon cannot: as
each capture is exposed, it compares what the panel shows with the mask that the daemon names. One
scene, one brightness, and the bundles that come along: what other light does is asked by
``benchmarks.proof``, whose optics make the light here as well.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated
from unittest.mock import patch

import httpx
import numpy as np
import typer
from benchmarks.daemon.slit_light import SlitLight
from benchmarks.figures import FiguresOption, record
from benchmarks.rig import work_folder

from veilcam_client.wire.rotation import EveryCaptures
from veilcam_client.wire.simulation import Faults, PanelFaults
from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.imperfections import Imperfections
from veilcam_server import daemon
from veilcam_server.api.app import create_app
from veilcam_server.camera.camera import MaskedCamera
from veilcam_server.camera.capture import MaskedCapture
from veilcam_server.demo_data import BUNDLE, FRESH, load_digits
from veilcam_server.devices.base import Exposure, Levels, OpenDisplay
from veilcam_server.devices.driver import EmulatedPanel
from veilcam_server.devices.registry import DISPLAYS
from veilcam_server.devices.simulated import device
from veilcam_server.devices.simulated.scenes import write_scene
from veilcam_server.devices.st7735r import DRIVER
from veilcam_server.settings import Settings

FAULTS = {"dead_panel": PanelFaults(dead=True), "lost_write": PanelFaults(lost=9)}
"""What is wrong with the panel, by the name of its figure."""
SETTLE, TURNED = 0.02, 0.05
"""What the daemon grants the panel, and a time by which its crystal has turned for certain [s]."""
ROUTES = ("/v1/captures", "/v1/classifications")
_MOST_ASKED = 20
"""Times as many captures may be asked for as are to be taken."""


@dataclass
class Oracle:
    """Knows of every capture whether its mask was there.

    Attributes:
        there: by the epoch and the number of a capture that was answered.
        last: the same of the capture that was exposed last, whatever came of it.
    """

    there: dict[tuple[str, int], bool] = field(default_factory=dict)
    last: bool = True

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Watch the panel and the camera of a daemon that is built within."""
        panels: list[tuple[Camera, EmulatedPanel]] = []

        def emulate(
            camera: Camera,
            *,
            scan: float,
            settle: float,
            read_back: bool,
            clock: Callable[[], float],
        ) -> tuple[Callable[[], OpenDisplay], EmulatedPanel]:
            if DRIVER.emulate is None:
                raise RuntimeError(f"nobody wrote an emulator for {DRIVER.name}")
            opened, emulated = DRIVER.emulate(
                camera, scan=scan, settle=settle, read_back=read_back, clock=clock
            )
            panels.append((camera, emulated))
            return opened, emulated

        oracle = self

        class Watched(MaskedCamera):
            def _exposed(self, not_before: float) -> Exposure:
                exposure = super()._exposed(not_before)
                active = self._panel.active
                oracle.last = active is not None and shows(*panels[0], active.epoch.mask.levels)
                return exposure

            def capture(self, *, release: bool) -> MaskedCapture:
                captured = super().capture(release=release)
                same = oracle.last and shows(*panels[0], captured.active.mask.levels)
                oracle.there[captured.epoch, captured.number] = same
                return captured

        with (
            patch.dict(DISPLAYS, {DRIVER.name: replace(DRIVER, emulate=emulate)}),
            patch.object(daemon, "MaskedCamera", Watched),
            patch.object(device, "planned_light", slit_light),
        ):
            yield


def slit_light(
    camera: Camera,
    scene: Scene,
    embedding: Embedding,
    imperfections: Imperfections,  # noqa: ARG001 - it is as drawn
) -> SlitLight:
    """What takes the place of the simulated camera's planned light."""
    return SlitLight(camera, scene, embedding)


def shows(camera: Camera, panel: EmulatedPanel, levels: Levels) -> bool:
    """Whether a panel shows a mask, to the last sub-pixel."""
    window = camera.window
    shown = panel.framebuffer()[
        window.first_row : window.first_row + window.rows,
        window.first_column : window.first_column + window.columns,
    ]
    return np.array_equal(shown, levels)


@dataclass
class Tally:
    """What came of the captures that were asked for behind one fault."""

    tried: int = 0
    """Taken: answered or caught. What was refused for another reason is asked for again."""
    wrong: int = 0
    """Of these, behind a mask that was not there."""
    answered: int = 0
    """As good."""
    unseen: int = 0
    """Of these, under a mask that was not there."""
    caught: int = 0
    """Refused, as they did not show their mask."""
    blamed: int = 0
    """Of these, with the mask there all the same."""
    sound: int = 0
    """Asked for behind a panel that was mended."""
    sound_refused: int = 0
    """Of these, for whatever reason."""

    def take(self, answer: httpx.Response, oracle: Oracle) -> bool:
        """Count one answer of a broken panel, and return whether it was good."""
        told = answer.json()
        if answer.status_code == 200:
            there = oracle.there[told["epoch"], told["number"]]
            self.tried, self.answered = self.tried + 1, self.answered + 1
            self.wrong, self.unseen = self.wrong + (not there), self.unseen + (not there)
            return True
        if told["code"] == "mask_not_seen":
            self.tried, self.caught = self.tried + 1, self.caught + 1
            self.wrong, self.blamed = self.wrong + (not oracle.last), self.blamed + oracle.last
        return False


@asynccontextmanager
async def served(bundle: Path, folder: Path, oracle: Oracle) -> AsyncIterator[httpx.AsyncClient]:
    """Yield a client of a daemon that sees a digit, and that the oracle watches."""
    scene = folder / "scene.npy"
    write_scene(scene, load_digits().images[0])
    settings = Settings(
        device="simulated",
        bundle=bundle,
        scenes=(str(scene),),
        scene_api=True,
        state_dir=folder / bundle.stem,
        settle=SETTLE,
        exposure=0.001,
        # A mask is written for every capture, so that a write may be lost of each.
        rotation=EveryCaptures(captures=1),
        release="raw",
        raw_budget=1_000_000,
    )
    with oracle.watching():
        service = await asyncio.to_thread(daemon.build_service, settings)
    transport = httpx.ASGITransport(create_app(service))
    async with (
        service.open(),
        httpx.AsyncClient(transport=transport, base_url="http://localhost", timeout=None) as client,
    ):
        yield client


async def set_faults(client: httpx.AsyncClient, panel: PanelFaults) -> None:
    """Break the panel, or mend it."""
    content = Faults(panel=panel).model_dump_json()
    headers = {"Content-Type": "application/json"}
    answer = await client.put("/v1/simulation/faults", content=content, headers=headers)
    answer.raise_for_status()


async def mend(client: httpx.AsyncClient) -> None:
    """Mend the panel, and wait until the camera is ready."""
    await set_faults(client, PanelFaults())
    while (await client.get("/readyz")).status_code != 200:
        # At once, not after the pause between two attempts of its own.
        await client.post("/v1/rotation/advance")


async def ask(
    client: httpx.AsyncClient, oracle: Oracle, faults: PanelFaults, *, captures: int
) -> Tally:
    """Take captures behind a panel that fails; RuntimeError if it hardly lets any be taken."""
    tally, good = Tally(), False
    for place in range(_MOST_ASKED * captures):
        if tally.tried == captures:
            return tally
        if not good:
            await mend(client)
            tally.sound += 1
            tally.sound_refused += (await client.post(ROUTES[0])).status_code != 200
            await set_faults(client, faults)
            # Until the crystal has turned, what the memory lost is still there to be seen.
            await asyncio.sleep(TURNED)
        good = tally.take(await client.post(ROUTES[place % len(ROUTES)]), oracle)
    raise RuntimeError(f"{_MOST_ASKED * captures} captures were asked for, and few taken: {tally}")


async def measure(bundle: Path, folder: Path, *, captures: int) -> dict[str, Tally]:
    """What one bundle's daemon answers behind each fault."""
    oracle = Oracle()
    async with served(bundle, folder, oracle) as client:
        return {
            name: await ask(client, oracle, faults, captures=captures)
            for name, faults in FAULTS.items()
        }


def main(
    *,
    captures: Annotated[
        int, typer.Option(min=1, help="Captures behind each fault, with each bundle.")
    ] = 100,
    figures: FiguresOption = None,
) -> None:
    """Break the panel while captures are asked for, with either bundle that comes along."""
    values: dict[str, float] = {}
    for bundle in (BUNDLE, FRESH):
        with work_folder() as folder:
            tallies = asyncio.run(measure(bundle, folder, captures=captures))
        for name, tally in tallies.items():
            print(f"{bundle.stem}, {name}: {tally}")
            for figure, count in (
                ("answered", tally.unseen),
                ("tried", tally.tried),
                ("wrong", tally.wrong),
                ("caught", tally.caught),
                ("blamed", tally.blamed),
                ("sound", tally.sound),
                ("sound_refused", tally.sound_refused),
            ):
                values[f"{name}_{figure}"] = values.get(f"{name}_{figure}", 0) + count
    record(figures, values)


if __name__ == "__main__":
    typer.run(main)
