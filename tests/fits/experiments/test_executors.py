"""Executors give the results of a plain loop, outlive lost processes, and end with their parent."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tests.fits.conftest import Call
from tests.unit.training.experiments.tasks import gpus, kill, kill_once, place, refuse

from veilcam_training.bundle import Bundle, read_bundle
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.executors import (
    ATTEMPTS,
    HERE,
    Executor,
    LocalExecutor,
    RayExecutor,
    make_executor,
)

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module", autouse=True)
def importable() -> Iterator[None]:
    """Let other processes import the tasks."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT)
        patch.setenv("PYTHONPATH", str(ROOT))
        yield


@pytest.fixture(scope="module")
def cluster(importable: None) -> Iterator[str]:
    """Address of a real Ray cluster on this machine, with a connection; its GPU is but a number."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.setenv("RAY_AUTH_TOKEN", os.urandom(32).hex())  # Ray would write one to the home
        # Else its workers stand behind all others, and on a busy machine never come to work.
        patch.setenv("RAY_worker_niceness", "0")
        import ray
        from ray.cluster_utils import Cluster

        options = {"num_cpus": 2, "num_gpus": 1, "object_store_memory": 100_000_000}
        running = Cluster(initialize_head=True, head_node_args=options)
        ray.init(address=running.address)
        yield running.address
        ray.shutdown()
        running.shutdown()  # type: ignore[no-untyped-call]


@pytest.fixture(params=["local", "ray"])
def workers(request: pytest.FixtureRequest) -> Executor:
    """Two, of two threads each."""
    if request.param == "local":
        return LocalExecutor(2, threads=2)
    return RayExecutor(request.getfixturevalue("cluster"), threads=2)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "folder"
    made.mkdir()
    return made


def test_executor_here_runs_in_this_process() -> None:
    ((index, (process, _, _)),) = HERE.run(place, [0])
    assert (index, process) == (0, os.getpid())
    assert list(LocalExecutor(2).run(place, [])) == []
    with pytest.raises(TrainingError, match="not valid"):
        list(HERE.run(refuse, [1]))


@pytest.mark.thorough
def test_results_come_with_their_task_s_index(workers: Executor) -> None:
    results = dict(workers.run(place, range(3)))
    assert sorted(results) == [0, 1, 2]
    assert os.getpid() not in {process for process, _, _ in results.values()}
    assert {threads for _, threads, _ in results.values()} == {2}
    assert all(np.array_equal(tensor, torch.ones(1000)) for _, _, tensor in results.values())


@pytest.mark.slow
def test_lost_task_is_run_again(workers: Executor, folder: Path) -> None:
    assert list(workers.run(kill_once, [folder])) == [(0, 2)]
    assert len(list(folder.iterdir())) == 2


@pytest.mark.slow
def test_task_that_kills_every_worker(workers: Executor, folder: Path) -> None:
    with pytest.raises(TrainingError, match=r"workers were lost 3 times .* use fewer"):
        list(workers.run(kill, [folder]))
    assert len(list(folder.iterdir())) == ATTEMPTS


@pytest.mark.slow
def test_error_of_a_task_is_raised(workers: Executor) -> None:
    with pytest.raises(TrainingError) as caught:
        list(workers.run(refuse, [1]))
    assert str(caught.value) == "value = 1 is not valid"
    assert "in refuse" in str(caught.value.__cause__)  # where, in the worker


@pytest.mark.slow
def test_gpus(cluster: str) -> None:
    assert list(RayExecutor(cluster, gpus=1).run(gpus, [0])) == [(0, [0])]


PARENT = """
import signal
import sys
from pathlib import Path
from tests.fits.conftest import Call
from tests.unit.training.experiments.tasks import linger
from veilcam_training.experiments.executors import LocalExecutor

# A shell's background jobs ignore Ctrl-C, and what they start does, too.
signal.signal(signal.SIGINT, signal.default_int_handler)
if __name__ == "__main__":
    list(LocalExecutor(2).run(linger, [Path(sys.argv[1])]))
"""


@pytest.mark.thorough
@pytest.mark.parametrize("cause", [signal.SIGINT, signal.SIGKILL])
def test_workers_end_with_their_parent(tmp_path: Path, folder: Path, cause: signal.Signals) -> None:
    script = tmp_path / "parent.py"
    script.write_text(PARENT)
    parent = subprocess.Popen(
        [sys.executable, str(script), str(folder)],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,  # a group of its own, as a terminal gives one to a command
    )
    try:
        while not list(folder.iterdir()):
            assert parent.poll() is None
            time.sleep(0.1)
        if cause is signal.SIGINT:
            os.killpg(parent.pid, cause)  # as Ctrl-C does
        else:
            parent.kill()
        _, errors = parent.communicate(timeout=60)  # to the end of all that have this stderr
    finally:
        parent.kill()
    assert parent.returncode == -cause
    assert errors.count("Traceback") == (1 if cause is signal.SIGINT else 0)


def fit_pairs(call: Call, data: Path, out: Path, *options: object) -> Bundle:
    recipe = ("--embedding", "3x4", "--epochs", "1", "--batch", "90", "--pairs", "2", "--seed", "1")
    # One thread, as a worker has: another number adds up in another order.
    call("keyring", "--data", data, *recipe, "--threads", "1", "--out", out, *options)
    return read_bundle(out)


@pytest.mark.slow
def test_keyring_is_the_same_everywhere(
    call: Call, digit_folder: Path, tmp_path: Path, cluster: str
) -> None:
    bundles, out = [], tmp_path / "a.veilcam"
    for index, options in enumerate([(), ("--workers", 2), ("--ray", cluster)]):
        work = tmp_path / str(index)
        bundles.append(fit_pairs(call, digit_folder, out, "--work", work, *options))
        assert len(list(work.iterdir())) == 2
    alone, *others = bundles
    for other in others:
        assert other.provenance["pairs"] == alone.provenance["pairs"]
        for ours, theirs in zip(alone.pairs, other.pairs, strict=True):
            assert np.array_equal(ours.levels, theirs.levels)
            assert all(np.array_equal(ours.weights[n], theirs.weights[n]) for n in ours.weights)


@pytest.mark.slow
def test_cluster_is_started_for_local_alone(monkeypatch: pytest.MonkeyPatch, cluster: str) -> None:
    import ray

    ray.shutdown()  # what the fixture connected
    asked: list[dict[str, Any]] = []
    real = ray.init

    def init(**options: Any) -> None:
        asked.append(options)
        real(**{**options, "address": cluster})  # one on this machine is enough

    monkeypatch.setattr(ray, "init", init)
    for address in (cluster, "local"):
        ((index, (_, threads, _)),) = RayExecutor(address).run(place, [0])
        assert (index, threads) == (0, 1)
        assert not ray.is_initialized()
    assert [options["address"] for options in asked] == [cluster, "local"]
    assert all(options["include_dashboard"] is False for options in asked)
    assert os.environ["RAY_USAGE_STATS_ENABLED"] == "0"


@pytest.mark.slow
@pytest.mark.parametrize("address", ["127.0.0.1:1", "nowhere", ""])
def test_address_without_a_cluster(monkeypatch: pytest.MonkeyPatch, address: str) -> None:
    import ray

    monkeypatch.setattr(ray, "is_initialized", lambda: False)
    with pytest.raises(TrainingError, match="use HOST:PORT of a running cluster, or local"):
        list(RayExecutor(address).run(place, [1]))


@pytest.mark.slow
def test_without_ray(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(TrainingError, match=r"pip install -e '\.\[scale\]'"):
        RayExecutor("local")


@pytest.mark.thorough
def test_workers_of_the_command_line() -> None:
    assert isinstance(make_executor(None, None), LocalExecutor)
    assert isinstance(make_executor(None, "local"), RayExecutor)
    with pytest.raises(TrainingError, match="use one of them"):
        make_executor(2, "local")
