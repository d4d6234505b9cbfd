"""Released white embeddings of masks of their own, with what each question's answer was.

Every mask is drawn, prepared and read as the daemon does it. It answers each question with scenes
of that question's own, so that every question sees one capture a mask, or ``CAPTURES`` of them to
be guessed one by one: more captures tell more of a network that was fitted to one of every mask.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from benchmarks.privacy.keys.scenes import Question, Scene, Scenes

from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.wire.sealing import Release
from veilcam_optics.camera.geometry import Embedding
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.tables import Reach
from veilcam_server.masks.fresh import FreshSource
from veilcam_server.masks.source import Mask
from veilcam_training.bundle import Bundle

CHUNK = 250
"""Masks of one file."""
CAPTURES: dict[Question, int] = {"digit": 2, "presence": 1, "kind": 4, "skin": 4, "linkage": 1}
"""Captures of one mask to guess at. With four answers, one capture of each of 25,000 masks has a
standard error of .27 points: too much to prove that a gain is at most one."""
SNR_DB = 40.0
DEVICE = "d7" * 32
"""Public key that keys are derived for; nothing is signed here."""

Floats32 = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Released:
    """Captures of one question.

    Attributes:
        vectors: float32 (masks, captures of each, pixels).
        labels: the answers, int64 (masks, captures of each).
    """

    vectors: Floats32
    labels: npt.NDArray[np.int64]


class Camera:
    """Draws masks as the daemon does, and reads scenes behind them with noise.

    The light has interference of terms that the decoder does not know of, and noise at 40 dB.

    Args:
        bundle: of mode fresh.
        shape: rows and columns of an embedding; None: the bundle's.
    """

    def __init__(self, bundle: Bundle, shape: tuple[int, int] | None = None) -> None:
        if bundle.fresh is None:
            raise ValueError("a bundle of mode pairs has no fresh masks")
        if shape is not None:
            # The classifier reads decoded scenes: it takes any embedding.
            bundle = replace(bundle, embedding=Embedding(*shape))
        self.bundle, self._source = bundle, FreshSource(bundle)
        self._light = TransferOperator(
            bundle.camera, bundle.scene, bundle.embedding, reach=Reach(6, 1), dtype=torch.float32
        )

    def mask(self) -> Mask:
        """A new mask, prepared to release white."""
        key = EpochKey.generate(device=DEVICE, bundle=self.bundle.digest)
        return self.mask_of(key, "white")

    def mask_of(self, key: EpochKey, form: Release) -> Mask:
        """The mask of an epoch, prepared to release a form."""
        return self._source.make(key, form, frozenset())

    def read(self, mask: Mask, scenes: list[Scene], noise: torch.Generator) -> Floats32:
        """Measurements of scenes, (count, rows, columns) float32."""
        weights = torch.from_numpy(to_weights(mask.levels, self.bundle.camera.panel)).float()
        with torch.no_grad():
            light = self._light.embed(torch.from_numpy(np.stack(scenes)), weights)
        measured: Floats32 = shot_noise(light, SNR_DB, noise).numpy()
        return measured


def collect(
    camera: Camera, scenes: Scenes, *, masks: int, seed: int
) -> dict[str, npt.NDArray[np.generic]]:
    """Release what ``masks`` new masks see.

    Args:
        camera: that sees it.
        scenes: to draw from.
        masks: how many; with an even number, pairs of neighbours see the same scene for linkage.
        seed: of scenes and noise; keys come from the kernel.

    Returns:
        For each question, ``QUESTION`` as :attr:`Released.vectors` and ``QUESTION_label``; and
        ``seconds`` of the processor for a mask, (masks,).
    """
    random, noise = np.random.default_rng(seed), torch.Generator().manual_seed(seed)
    plan = {question: CAPTURES[question] for question in scenes.classes}
    made: dict[str, list[npt.NDArray[np.generic]]] = {"seconds": []}
    twin: tuple[Scene, int] | None = None
    for _ in range(masks):
        begun = time.process_time()
        drawn = {q: [scenes.draw(q, random) for _ in range(count)] for q, count in plan.items()}
        twin = drawn["linkage"][0] if twin is None else twin
        drawn["linkage"], twin = [twin], None if len(made["seconds"]) % 2 else twin
        mask = camera.mask()
        measured = camera.read(mask, [scene for each in drawn.values() for scene, _ in each], noise)
        white = np.stack([mask.reader.whiten(each).ravel() for each in measured])
        mask.erase()
        place = 0
        for question, each in drawn.items():
            part = slice(place, place + len(each))
            made.setdefault(question, []).append(white[part])
            made.setdefault(f"{question}_label", []).append(np.array([label for _, label in each]))
            place += len(each)
        made["seconds"].append(np.array(time.process_time() - begun))
    return {name: np.stack(parts) for name, parts in made.items()}


def chunk_path(work: Path, number: int) -> Path:
    """File of one chunk."""
    return work / f"chunk-{number:05d}.npz"


def write_chunk(path: Path, arrays: dict[str, npt.NDArray[np.generic]]) -> None:
    """Write a chunk so that a file that is there is whole."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{path.stem}.part.npz")
    np.savez(part, allow_pickle=False, **arrays)
    part.replace(path)


def load(work: Path, question: Question, masks: int) -> Released:
    """Captures of one question, of the first ``masks`` masks of a work folder.

    Raises:
        FileNotFoundError: there are not as many.
    """
    parts: dict[str, list[npt.NDArray[np.generic]]] = {}
    for number in range(-(-masks // CHUNK)):
        with np.load(chunk_path(work, number), allow_pickle=False) as chunk:
            for name in (question, f"{question}_label"):
                parts.setdefault(name, []).append(chunk[name])
    whole = {name: np.concatenate(each)[:masks] for name, each in parts.items()}
    if len(whole[question]) < masks:
        raise FileNotFoundError(f"{work} holds {len(whole[question])} masks: collect more")
    return Released(whole[question].astype(np.float32), whole[f"{question}_label"].astype(np.int64))
