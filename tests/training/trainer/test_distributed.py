"""Several processes fit one model: the same result as one, but for the noise that each draws."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import distributed

from veilcam_optics.camera.geometry import Camera
from veilcam_training.bundle import read_bundle
from veilcam_training.config.recipes import Recipe
from veilcam_training.config.settings import Settings
from veilcam_training.data import Images, Source, Split, open_source, split
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.executors import LocalExecutor
from veilcam_training.experiments.fit import FitResult, run_fit
from veilcam_training.experiments.model import make_model
from veilcam_training.seeding import derive
from veilcam_training.trainer.callbacks import Epoch
from veilcam_training.trainer.distributed import ALONE, Ranks
from veilcam_training.trainer.loop import Fit, fit

ROOT = Path(__file__).resolve().parents[3]
NOISELESS = Recipe(epochs=1, batch=90, rate=1e-2, mask_rate=1e-2, snr_db=None)
WHITE = NOISELESS.model_copy(update={"normalisation": "white"})
NOISY = NOISELESS.model_copy(update={"epochs": 2, "snr_db": 40.0, "dropout": 0.2})


@dataclass(frozen=True)
class Member:
    """One rank of two; ``work`` holds the file through which they meet."""

    rank: int
    data: Path
    work: Path


@dataclass(frozen=True)
class Quiet:
    """Result of a fit without noise: its epoch's losses, and the model's tensors by name."""

    loss: float
    validation_loss: float
    tensors: dict[str, torch.Tensor]


@dataclass(frozen=True)
class Seen:
    """What a rank has to tell."""

    quiet: dict[str, Quiet]
    unbroken: torch.Tensor
    resumed: torch.Tensor
    first_steps: list[tuple[int, int]]


class InterruptionError(Exception):
    pass


class StopAfter:
    """Breaks a fit off in the middle of an epoch."""

    def __init__(self, epoch: int, step: int) -> None:
        self._at = (epoch, step)
        self.seen: list[tuple[int, int]] = []

    def step(self, epoch: int, done: int, steps: int) -> None:
        self.seen.append((epoch, done))
        if (epoch, done) == self._at:
            raise InterruptionError

    def epoch(self, epoch: Epoch) -> None:
        pass


def settings(recipe: Recipe, encoder: str = "learned") -> Settings:
    return Settings(embedding="6x8", classifier="FC20", encoder=encoder, recipe=recipe)


QUIET = {
    "learned": settings(NOISELESS),
    "lens": settings(NOISELESS, "lens"),
    "decorrelated": settings(WHITE),
}


class PreciseImages(Images):
    """Images whose scenes are in double precision."""

    def scenes(self, indices: torch.Tensor | slice = slice(None)) -> torch.Tensor:
        return super().scenes(indices).double()


def fit_precisely(source: Source, chosen: Settings, ranks: Ranks) -> Quiet:
    """Nine steps in double precision."""
    parts = split(source.training())
    training, validation = (
        PreciseImages(images.pixels, images.labels) for images in (parts.training, parts.validation)
    )
    model = make_model(chosen, source, Camera()).double()
    result: Fit = fit(model, Split(training, validation), chosen.recipe, chosen.seed, ranks=ranks)
    return Quiet(result.best.loss, result.best.validation_loss, result.model.state_dict())


def run(source: Source, chosen: Settings, ranks: Ranks, **options: Any) -> FitResult:
    return run_fit(chosen, source, Camera(), ranks=ranks, **options)


def weights_of(outcome: FitResult) -> torch.Tensor:
    tensors = outcome.fit.model.state_dict().values()
    return torch.cat([tensor.flatten().double() for tensor in tensors])


def take_part(member: Member) -> Seen:
    """Fits without noise; then one with noise, unbroken and resumed."""
    meeting = f"file://{member.work / 'meeting'}"
    distributed.init_process_group("gloo", meeting, rank=member.rank, world_size=2)
    ranks, source = Ranks(member.rank, 2), open_source("mnist", member.data)
    quiet = {name: fit_precisely(source, chosen, ranks) for name, chosen in QUIET.items()}
    unbroken = run(source, settings(NOISY), ranks)
    checkpoint = member.work / str(member.rank) / "fit.checkpoint"
    with contextlib.suppress(InterruptionError):
        stop = StopAfter(1, 2)
        run(source, settings(NOISY), ranks, checkpoint=checkpoint, callbacks=[stop])
    watch = StopAfter(-1, -1)
    resumed = run(source, settings(NOISY), ranks, checkpoint=checkpoint, callbacks=[watch])
    return Seen(quiet, weights_of(unbroken), weights_of(resumed), watch.seen[:1])


@pytest.fixture(scope="module", autouse=True)
def importable() -> Iterator[None]:
    """Let other processes import the function above."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT)
        yield


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("ranks")


@pytest.fixture(scope="module")
def members(digit_folder: Path, work: Path, importable: None) -> dict[int, Seen]:
    tasks = [Member(rank, digit_folder, work) for rank in (0, 1)]
    return dict(LocalExecutor(2).run(take_part, tasks))


@pytest.mark.slow
@pytest.mark.parametrize("name", QUIET)
def test_two_processes_do_what_one_does(
    source: Source, members: dict[int, Seen], name: str
) -> None:
    """In double precision: half batches round differently, and in float32 nine steps magnify that.

    A weight near the middle of two levels falls to the other one, a ReLU opens or closes, Adam's
    first step takes the sign of a gradient that is hardly there, and decorrelated coordinates are
    scaled by deviations below the rounding of what they are computed from. With 1e-16 instead of
    1e-7, a value so near an edge is a matter of one in a million fits. Adam divides rounding by
    1e-8 at the least, times a rate of 1e-2: 1e-10. Decorrelation divides a variance's, 48 inputs
    times 1e-16, by 1e-6 at the least: 5e-9. So 1e-6 leaves a factor of 200 to nine steps, on any
    processor. A wrong factor in a running variance, the smallest defect that was tried, moves a
    loss by 1e-5; coordinates, moments or gradients of a rank's own move one by 5e-3.
    """
    alone = fit_precisely(source, QUIET[name], ALONE)
    for seen in members.values():
        quiet = seen.quiet[name]
        assert quiet.loss == pytest.approx(alone.loss, abs=1e-6)
        assert quiet.validation_loss == pytest.approx(alone.validation_loss, abs=1e-6)
        torch.testing.assert_close(quiet.tensors, alone.tensors, rtol=1e-6, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", QUIET)
def test_all_ranks_have_the_same_precise_model(members: dict[int, Seen], name: str) -> None:
    """To the bit: every rank takes the same step, by the same gradient and the same moments."""
    first, second = (members[rank].quiet[name] for rank in (0, 1))
    assert first.loss == second.loss
    torch.testing.assert_close(first.tensors, second.tensors, rtol=0, atol=0)


@pytest.mark.slow
def test_all_ranks_have_the_same_model(members: dict[int, Seen]) -> None:
    assert torch.equal(members[0].unbroken, members[1].unbroken)
    assert torch.isfinite(members[0].unbroken).all()


@pytest.mark.slow
def test_resumed_is_the_same_as_unbroken(members: dict[int, Seen]) -> None:
    for seen in members.values():
        assert seen.first_steps == [(1, 1)]
        assert torch.equal(seen.resumed, seen.unbroken)


@pytest.mark.slow
def test_the_first_rank_alone_writes(members: dict[int, Seen], work: Path) -> None:
    assert members.keys() == {0, 1}
    assert sorted(path.name for path in work.iterdir() if path.is_dir()) == ["0"]


@pytest.mark.slow
def test_a_checkpoint_of_another_number_of_ranks_is_refused(
    source: Source, members: dict[int, Seen], work: Path
) -> None:
    assert members.keys() == {0, 1}
    with pytest.raises(TrainingError, match="of another fit"):
        run(source, settings(NOISY), ALONE, checkpoint=work / "0" / "fit.checkpoint")


def test_shares_make_up_the_batch_and_streams_differ() -> None:
    batch, ranks = torch.arange(12), [Ranks(rank, 3) for rank in range(3)]
    assert torch.equal(torch.cat([rank.share(batch) for rank in ranks]), batch)
    assert {len(rank.share(batch)) for rank in ranks} == {4}
    with pytest.raises(TrainingError, match="batch = 10 cannot be divided over 3 processes"):
        ranks[0].share(torch.arange(10))
    assert ALONE.purpose == ranks[0].purpose == ()
    assert len({derive(0, "noise", 1, *rank.purpose) for rank in ranks}) == 3


@pytest.mark.slow
def test_torchrun(digit_folder: Path, tmp_path: Path) -> None:
    out, binaries = tmp_path / "a.veilcam", Path(sys.executable).parent
    launch = (binaries / "torchrun", "--standalone", "--nproc-per-node", 2, "--no-python")
    fit = ("fit", "--data", digit_folder, "--embedding", "6x8", "--epochs", 1, "--batch", 90)
    command = [*launch, binaries / "veilcam-train", *fit, "--device", "cpu", "--out", out]
    done = subprocess.run(
        [str(word) for word in command], check=True, capture_output=True, text=True
    )
    assert done.stdout.count("validation") == 2  # one bar, one table
    assert done.stdout.count("wrote") == 1
    bundle = read_bundle(out)
    assert bundle.provenance["processes"] == 2
    assert len(bundle.pairs) == 1
