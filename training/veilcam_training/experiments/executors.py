"""Executors: they run one function on many tasks, here, in processes, or on a Ray cluster."""

import logging
import multiprocessing
import os
import pickle
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Protocol, TypeVar

import torch

from veilcam_training.errors import TrainingError, require

TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")
Function = Callable[[TaskT], ResultT]
Results = Iterator[tuple[int, ResultT]]

ATTEMPTS = 3
"""Number of times that a task is begun whose worker is lost each time."""


class Executor(Protocol):
    """Runner of tasks. Function, tasks and results must be picklable, unless all runs here."""

    def run(self, function: Function[TaskT, ResultT], tasks: Sequence[TaskT]) -> Results[ResultT]:
        """Yield results as they finish, each with the index of its task.

        A task whose worker was lost is run again. Closing the iterator ends what still runs.

        Raises:
            TrainingError: workers were lost ``ATTEMPTS`` times, or there is no cluster.
            Exception: what a task raised; the other tasks are ended.
        """


class LocalExecutor:
    """Processes of this machine, which end with their parent; one process is this one.

    Args:
        processes: number of tasks that run at a time.
        threads: number of torch's threads in each; this process keeps those that it has.
    """

    def __init__(self, processes: int = 1, *, threads: int = 1) -> None:
        self._processes, self._threads = processes, threads

    def run(self, function: Function[TaskT, ResultT], tasks: Sequence[TaskT]) -> Results[ResultT]:
        """See :meth:`Executor.run`."""
        if self._processes == 1:
            yield from ((index, function(task)) for index, task in enumerate(tasks))
            return
        left, lost = dict(enumerate(tasks)), 0
        while left:
            before = len(left)
            for index, result in self._run_once(function, left):
                del left[index]
                yield index, result
            lost = lost + 1 if len(left) == before else 1
            if left and lost == ATTEMPTS:
                raise _lost("a process ended")

    def _run_once(
        self, function: Function[TaskT, ResultT], tasks: Mapping[int, TaskT]
    ) -> Results[ResultT]:
        """Yield results; a lost worker ends all of them."""
        others = multiprocessing.active_children()
        pool = ProcessPoolExecutor(
            min(self._processes, len(tasks)), multiprocessing.get_context("spawn"), _begin_worker
        )
        try:
            futures = {
                pool.submit(_attempt, function, task, self._threads, sys.argv): index
                for index, task in tasks.items()
            }
            for future in as_completed(futures):
                if not isinstance(future.exception(), BrokenProcessPool):
                    yield futures[future], pickle.loads(future.result())  # noqa: S301 - ours
        finally:
            for process in multiprocessing.active_children():
                if process not in others:
                    process.kill()
            pool.shutdown(cancel_futures=True)


HERE = LocalExecutor()
"""This process alone."""


class RayExecutor:
    """Tasks on a Ray cluster; needs the extra ``scale``, on the cluster too.

    Args:
        address: HOST:PORT of the cluster; ``"local"`` starts one for as long as the tasks run. A
            connection that the caller has made is used and left alone.
        threads: number of torch's threads in each task, which asks the cluster for as many cores.
        gpus: number of GPUs that each task asks the cluster for.

    Raises:
        TrainingError: Ray is not installed.
    """

    def __init__(self, address: str, *, threads: int = 1, gpus: int = 0) -> None:
        try:
            import ray  # noqa: PLC0415 - of an extra, and slow to import
        except ImportError:
            raise TrainingError(
                "Ray is not installed: run pip install -e '.[scale]' in the checkout"
            ) from None
        self._ray, self._address, self._threads, self._gpus = ray, address, threads, gpus

    def run(self, function: Function[TaskT, ResultT], tasks: Sequence[TaskT]) -> Results[ResultT]:
        """See :meth:`Executor.run`."""
        ray = self._ray
        connected = ray.is_initialized()
        if not connected:
            self._connect()
        attempt = ray.remote(num_cpus=self._threads, num_gpus=self._gpus, max_retries=ATTEMPTS - 1)(
            _attempt
        )
        running = {
            attempt.remote(function, task, self._threads, sys.argv): index
            for index, task in enumerate(tasks)
        }
        try:
            while running:
                (ready,), _ = ray.wait(list(running))
                index = running.pop(ready)
                yield index, pickle.loads(ray.get(ready))  # noqa: S301 - of our worker
        except ray.exceptions.RayTaskError as error:
            raise error.cause from error
        except ray.exceptions.RayError as error:
            raise _lost(type(error).__name__) from None
        finally:
            for reference in running:
                ray.cancel(reference, force=True)
            if not connected:
                ray.shutdown()

    def _connect(self) -> None:
        os.environ["RAY_USAGE_STATS_ENABLED"] = "0"  # Ray has no other way to say so in a program
        try:
            if self._address != "local":  # Ray itself would try for minutes
                host, _, port = self._address.rpartition(":")
                socket.create_connection((host, int(port)), timeout=10).close()
            self._ray.init(
                address=self._address, include_dashboard=False, logging_level=logging.WARNING
            )
        except (OSError, ValueError, RuntimeError) as error:
            raise TrainingError(
                f"Ray address {self._address!r} cannot be used ({error}): use HOST:PORT of a "
                "running cluster, or local"
            ) from error


def make_executor(
    processes: int | None, ray: str | None, *, threads: int | None = None, gpus: int = 0
) -> Executor:
    """Return the executor that a command line asks for: this process, several, or a cluster.

    Raises:
        TrainingError: both processes and a cluster are asked for, or Ray is not installed.
    """
    if ray is None:
        return LocalExecutor(processes or 1, threads=threads or 1)
    require(processes is None, "--workers and --ray are both given: use one of them")
    return RayExecutor(ray, threads=threads or 1, gpus=gpus)


def _attempt(
    function: Function[TaskT, ResultT], task: TaskT, threads: int, arguments: Sequence[str]
) -> bytes:
    """Run one task in a worker, under the command line that asked for it.

    Plain pickle copies tensors; multiprocessing would lend the worker's memory.
    """
    sys.argv[:] = arguments
    torch.set_num_threads(threads)
    return pickle.dumps(function(task))


def _begin_worker() -> None:
    """End this process with its parent, who alone hears Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End this worker with its parent: it would write into the folders of the next run."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _lost(reason: str) -> TrainingError:
    return TrainingError(
        f"workers were lost {ATTEMPTS} times ({reason}): if memory ran out, use fewer workers"
    )
