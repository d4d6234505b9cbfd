"""Executors: they run the same function on many tasks, here or on a cluster, and outlive lost ones.

``concurrent.futures`` and ``loky`` give up a whole pool when one process dies, and cannot say which
task was at fault; so each local worker is a plain ``multiprocessing`` process with its own pipe.
"""

import contextlib
import logging
import multiprocessing
import os
import pickle
import signal
import socket
import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection, wait
from types import ModuleType
from typing import Generic, Protocol, TypeVar

import torch

from veilcam_training.errors import TrainingError, require

TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")

ATTEMPTS = 3
"""How often a task is begun whose worker is lost each time."""


class Executor(Protocol):
    """Runs tasks. Function, tasks and results must be picklable, unless it is one here."""

    def run(
        self, function: Callable[[TaskT], ResultT], tasks: Sequence[TaskT]
    ) -> Iterator[tuple[int, ResultT]]:
        """Results as they finish, each with the index of its task.

        A task whose worker was lost is run again. Closing the iterator ends what still runs.

        Raises:
            TrainingError: a task's worker was lost ``ATTEMPTS`` times.
            Exception: what a task raised, as it raised it; the other tasks are ended.
        """


def _at_least_one(name: str, value: int) -> int:
    require(value >= 1, f"{name} = {value} is not valid: use at least 1")
    return value


class LocalExecutor:
    """Processes of this machine.

    One process is this one: no other is started, and tasks run in their order. More are started
    anew ("spawn"), so a script that uses them needs its ``if __name__ == "__main__":``. They end
    with their parent, even when that is killed.

    Args:
        processes: how many tasks run at a time.
        threads: of torch in each, if there are several; one process keeps those that it has.

    Raises:
        TrainingError: less than one process or thread.
    """

    def __init__(self, processes: int = 1, *, threads: int = 1) -> None:
        self._processes = _at_least_one("workers", processes)
        self._threads = _at_least_one("threads", threads)

    def run(
        self, function: Callable[[TaskT], ResultT], tasks: Sequence[TaskT]
    ) -> Iterator[tuple[int, ResultT]]:
        """See :meth:`Executor.run`."""
        if self._processes == 1:
            for index, task in enumerate(tasks):
                yield index, function(task)
            return
        waiting = deque((index, 1) for index in range(len(tasks)))
        idle: list[_Process[TaskT, ResultT]] = []
        busy: dict[Connection, tuple[_Process[TaskT, ResultT], int, int]] = {}
        try:
            while waiting or busy:
                while waiting and len(busy) < self._processes:
                    index, attempt = waiting.popleft()
                    process = idle.pop() if idle else _Process(function, self._threads)
                    process.send(tasks[index])
                    busy[process.connection] = process, index, attempt
                for ready in wait(list(busy)):
                    assert isinstance(ready, Connection)  # noqa: S101 - for mypy
                    process, index, attempt = busy.pop(ready)
                    try:
                        answer = process.receive()
                    except (EOFError, OSError):
                        status = process.end()
                        if attempt == ATTEMPTS:
                            raise _lost(index, len(tasks), f"exit status {status}") from None
                        waiting.appendleft((index, attempt + 1))
                    else:
                        idle.append(process)
                        yield index, answer.result()
        finally:
            for process in (*idle, *(entry[0] for entry in busy.values())):
                process.end()


HERE = LocalExecutor()
"""This process alone."""


class RayExecutor:
    """Tasks on a Ray cluster; needs the extra ``scale``, on the cluster too.

    A connection that the caller has made is used and left alone.

    Args:
        address: of the cluster, e.g. ``"10.0.0.1:6379"``; ``"local"`` starts one on this machine,
            for as long as the tasks run.
        threads: of torch in each task, which asks the cluster for as many cores.
        gpus: that each task asks the cluster for.

    Raises:
        TrainingError: Ray is not installed, or less than one thread.
    """

    def __init__(self, address: str, *, threads: int = 1, gpus: int = 0) -> None:
        _import_ray()
        self._address, self._gpus = address, gpus
        self._threads = _at_least_one("threads", threads)

    def run(
        self, function: Callable[[TaskT], ResultT], tasks: Sequence[TaskT]
    ) -> Iterator[tuple[int, ResultT]]:
        """See :meth:`Executor.run`; also a TrainingError if there is no cluster at the address."""
        ray = _import_ray()
        connected = ray.is_initialized()
        if not connected:
            self._connect(ray)
        attempt = ray.remote(num_cpus=self._threads, num_gpus=self._gpus, max_retries=ATTEMPTS - 1)(
            _attempt_on_cluster
        )
        running: dict[object, int] = {}
        try:
            shared = ray.put(function)
            for index, task in enumerate(tasks):
                running[attempt.remote(shared, task, self._threads, sys.argv)] = index
            while running:
                (ready,), _ = ray.wait(list(running))
                index = running.pop(ready)
                try:
                    answer: _Answer[ResultT] = ray.get(ready)
                except ray.exceptions.RayTaskError as error:
                    raise TrainingError(
                        f"task {index + 1} of {len(tasks)} could not be passed to Ray or back "
                        f"({type(error.cause).__name__}): use the same veilcam on the cluster"
                    ) from error
                except ray.exceptions.RayError as error:
                    raise _lost(index, len(tasks), type(error).__name__) from None
                yield index, answer.result()
        finally:
            for reference in running:
                ray.cancel(reference, force=True)
            if not connected:
                ray.shutdown()

    def _connect(self, ray: ModuleType) -> None:
        if self._address != "local":
            _check_reachable(self._address)  # Ray itself would try for minutes
        os.environ["RAY_USAGE_STATS_ENABLED"] = "0"  # Ray has no other way to say so in a program
        try:
            ray.init(
                address=self._address,
                include_dashboard=False,
                logging_level=logging.WARNING,
            )
        except (ConnectionError, ValueError, RuntimeError) as error:
            raise TrainingError(
                f"Ray address {self._address!r} cannot be used ({type(error).__name__}): use "
                "HOST:PORT of a running cluster, or local"
            ) from error


def _check_reachable(address: str) -> None:
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host, int(port)), timeout=10).close()
    except (OSError, ValueError) as error:
        raise TrainingError(
            f"Ray address {address!r} cannot be reached ({error}): use HOST:PORT of a running "
            "cluster, or local"
        ) from None


def make_executor(
    processes: int | None, ray: str | None, *, threads: int | None = None, gpus: int = 0
) -> Executor:
    """The executor that a command line asks for.

    Args:
        processes: of this machine; None for this one alone.
        ray: address of a cluster instead.
        threads: of torch in each worker; None for one.
        gpus: that a task needs.

    Raises:
        TrainingError: both are asked for, or what they cannot be.
    """
    if ray is None:
        return LocalExecutor(1 if processes is None else processes, threads=threads or 1)
    if processes is not None:
        raise TrainingError("--workers and --ray are both given: use one of them")
    return RayExecutor(ray, threads=threads or 1, gpus=gpus)


class _Answer(Generic[ResultT]):
    """What came out of a task: a result, or the exception that it raised."""

    def __init__(self, value: ResultT | None, error: Exception | None = None) -> None:
        self._value, self._error = value, error

    def result(self) -> ResultT:
        if self._error is not None:
            raise self._error
        return self._value  # type: ignore[return-value]


def _attempt(function: Callable[[TaskT], ResultT], task: TaskT, threads: int) -> _Answer[ResultT]:
    """Run one task in a worker."""
    torch.set_num_threads(threads)
    try:
        return _Answer(function(task))
    except Exception as error:
        error.add_note("".join(traceback.format_exception(error)))  # of the worker
        return _Answer(None, error)


def _attempt_on_cluster(
    function: Callable[[TaskT], ResultT], task: TaskT, threads: int, arguments: Sequence[str]
) -> _Answer[ResultT]:
    """Run one task in a worker of Ray, under the command line that asked for it.

    What is made there says which command made it. Processes of multiprocessing have it already.
    """
    sys.argv[:] = arguments
    return _attempt(function, task, threads)


class _Process(Generic[TaskT, ResultT]):
    """A process that runs one task after another."""

    def __init__(self, function: Callable[[TaskT], ResultT], threads: int) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, other = context.Pipe()
        self._process = context.Process(target=_serve, args=(other, function, threads), daemon=True)
        self._process.start()
        other.close()

    def send(self, task: TaskT) -> None:
        with contextlib.suppress(BrokenPipeError):  # it died: there will be no answer either
            self.connection.send_bytes(pickle.dumps(task))

    def receive(self) -> _Answer[ResultT]:
        # Plain pickle copies tensors: that of a Connection lends their memory, which goes with the
        # worker.
        answer: _Answer[ResultT] = pickle.loads(self.connection.recv_bytes())  # noqa: S301 - ours
        return answer

    def end(self) -> int | None:
        """Kill it, if it still runs; its exit status."""
        self._process.kill()
        self._process.join()
        self.connection.close()
        return self._process.exitcode


def _serve(connection: Connection, function: Callable[[TaskT], ResultT], threads: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's, who ends its workers
    threading.Thread(target=_end_with_parent, daemon=True).start()
    while True:
        try:
            task: TaskT = pickle.loads(connection.recv_bytes())  # noqa: S301 - of the parent
        except EOFError:
            return
        answer = _attempt(function, task, threads)
        try:
            data = pickle.dumps(answer)
        except (pickle.PicklingError, TypeError, AttributeError) as error:
            data = pickle.dumps(_Answer(None, TrainingError(f"a result cannot be sent: {error}")))
        connection.send_bytes(data)


def _end_with_parent() -> None:
    """A worker that outlived a killed parent would write into the folders of the next run."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _lost(index: int, count: int, reason: str) -> TrainingError:
    return TrainingError(
        f"task {index + 1} of {count} lost its worker {ATTEMPTS} times ({reason}): "
        "if memory ran out, use fewer workers"
    )


def _import_ray() -> ModuleType:
    try:
        import ray  # noqa: PLC0415 - of an extra, and slow to import
        import ray.exceptions  # noqa: PLC0415
    except ImportError:
        raise TrainingError(
            "Ray is not installed: run pip install -e '.[scale]' in the checkout"
        ) from None
    return ray
