"""The next epoch, made ready in the background while the present one is in use."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeoutError
from dataclasses import dataclass, field

from veilcam_server.epochs import Epoch, EpochStore
from veilcam_server.errors import NotReadyError
from veilcam_server.masks import Mask, MaskSource

LONGEST = 60.0
"""Longest wait for one epoch [s]."""


@dataclass(frozen=True, eq=False, slots=True)
class Prepared:
    """An epoch that is durable, its mask, and what reads behind it."""

    epoch: Epoch
    mask: Mask = field(repr=False)


class Preparation:
    """Prepares one epoch ahead. All but the properties is called by one thread at a time.

    An epoch is committed to the disk before anything is drawn for it. One that is prepared and not
    shown, because the daemon ended, is left out for ever.

    Args:
        source: of masks.
        epochs: where epochs are recorded; closed with this.
    """

    def __init__(self, source: MaskSource, epochs: EpochStore) -> None:
        self._source, self._epochs = source, epochs
        self._thread = ThreadPoolExecutor(1, "preparation")
        self._next: Future[Prepared] | None = None
        self._count, self._took = 0, 0.0
        self.on_ready: Callable[[], None] = lambda: None
        """Called, on another thread, when a preparation has ended, well or badly."""

    @property
    def renewable(self) -> bool:
        """Whether there is another mask to change to."""
        return self._source.renewable

    @property
    def under_way(self) -> bool:
        """Whether to take the next epoch means to wait for it."""
        future = self._next
        return future is not None and not future.done()

    @property
    def ready(self) -> bool:
        """Whether the next epoch is prepared."""
        future = self._next
        return future is not None and future.done() and not future.exception()

    @property
    def count(self) -> int:
        """How many epochs were prepared."""
        return self._count

    @property
    def took(self) -> float:
        """How long the last preparation took [s]; 0 before the first."""
        return self._took

    def begin(self) -> None:
        """Start to prepare the next epoch, if none is prepared or under way."""
        if self._next is None:
            self._next = self._thread.submit(self._prepare, self._source)
            self._next.add_done_callback(lambda _: self.on_ready())

    def take(self) -> Prepared:
        """Return the next epoch; waits for it if need be. It is gone from here, come what may.

        Raises:
            NotReadyError: it takes too long.
            EpochError: it could not be made durable.
        """
        self.begin()
        assert self._next is not None  # noqa: S101 - it has just begun
        try:
            prepared = self._next.result(LONGEST)
        except FutureTimeoutError:
            if self._next.done():
                self._next = None
                raise
            raise NotReadyError("the next mask is still being prepared: try again") from None
        except BaseException:
            self._next = None
            raise
        self._next = None
        return prepared

    def first_of(self, source: MaskSource) -> Prepared:
        """Prepare an epoch of another source, while this one goes on; any thread may ask.

        Raises:
            NotReadyError: it takes too long.
            EpochError: it could not be made durable.
        """
        try:
            return self._thread.submit(self._prepare, source).result(LONGEST)
        except FutureTimeoutError:
            raise NotReadyError("the first mask is still being prepared: try again") from None

    def serve(self, source: MaskSource) -> None:
        """Take epochs from another source from now on; one prepared before is left out."""
        self._source, self._next = source, None

    def record(self, mask: Mask) -> None:
        """Make durable that ``mask`` is about to be shown; raises :class:`EpochError`."""
        self._epochs.mark = mask.mark

    def close(self) -> None:
        """End the background thread and close the epochs; twice does no harm."""
        self._thread.shutdown(cancel_futures=True)
        self._epochs.close()

    def _prepare(self, source: MaskSource) -> Prepared:
        begun = time.perf_counter()
        counter = self._epochs.next()
        epoch = Epoch(counter, source.name(counter))
        prepared = Prepared(epoch, source.make(counter, self._epochs.mark))
        self._took = time.perf_counter() - begun
        self._count += 1
        return prepared
