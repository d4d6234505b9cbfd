"""Epochs: one showing of one mask each, and the next one, made ready in the background."""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field

from veilcam_client.keys.blocks import Sealer
from veilcam_client.keys.commitments import mask_commitment
from veilcam_client.keys.envelopes import Signer, seal_key
from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.keys.receivers import Receiver
from veilcam_client.wire.sealing import Release
from veilcam_server.camera.budget import ReleaseBudget
from veilcam_server.errors import NotReadyError
from veilcam_server.masks.source import Mask, MaskSource, Terms

LONGEST = 60.0
"""Longest wait for one epoch [s]."""


@dataclass(eq=False, slots=True)
class Epoch:
    """One showing of one mask: made of a key that is gone, and gone itself once nobody uses it.

    It is erased when it is retired and the last capture behind it is done with, whatever comes
    last. Any thread may hold it, let it go or retire it.
    """

    name: str
    """128 random bits, 32 hexadecimal digits: what goes over the wire."""
    mask: Mask = field(repr=False)
    form: Release
    """In which embeddings leave, from its preparation to its end."""
    commitment: str
    """To its mask, under a key that is gone; what the log says of it."""
    sealer: Sealer | None = field(default=None, repr=False)
    """Seals embeddings to the receivers; None: to nobody."""
    receivers: tuple[Receiver, ...] = field(default=(), repr=False)
    """Who was paired when it was prepared."""
    erased: bool = field(default=False, init=False)
    """Whether mask, readers and keys were overwritten."""
    _uses: int = field(default=0, init=False, repr=False)
    _retired: bool = field(default=False, init=False, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, init=False, repr=False)

    def hold(self) -> None:
        """Keep it from being erased until :meth:`let_go` is called as often."""
        with self._lock:
            self._uses += 1

    def let_go(self) -> None:
        """End one use."""
        with self._lock:
            self._uses -= 1
            self._erase_if_over()

    def retire(self) -> None:
        """Give the epoch up: it will not be shown any more. Twice does no harm."""
        with self._lock:
            self._retired = True
            self._erase_if_over()

    @contextmanager
    def retired_on_failure(self) -> Iterator[None]:
        """Give the epoch up where it could not be shown."""
        try:
            yield
        except BaseException:
            self.retire()
            raise

    def _erase_if_over(self) -> None:
        if self._retired and not self._uses and not self.erased:
            self.erased = True
            self.mask.erase()
            if self.sealer is not None:
                self.sealer.erase()


class Preparation:
    """Prepares one epoch ahead. All but the properties is called by one thread at a time.

    Args:
        source: source of masks.
        signer: the device, whose key signs envelopes and is part of every key's context.
        terms: terms of an epoch that is prepared now; called on a thread of its own.
        budget: budget of embeddings that may leave behind one mask.
    """

    def __init__(
        self,
        source: MaskSource,
        signer: Signer,
        terms: Callable[[], Terms],
        budget: ReleaseBudget,
    ) -> None:
        self._source, self._signer, self._terms, self.budget = source, signer, terms, budget
        self._thread = ThreadPoolExecutor(1, "preparation")
        self._next: Future[Epoch] | None = None
        self.last_mark = ""
        """Of the mask shown last, which does not come again if there is another."""
        self.count = 0
        """How many epochs were prepared."""
        self.took = 0.0
        """How long the last preparation took [s]; 0 before the first."""

    @property
    def renewable(self) -> bool:
        """Return whether there is another mask to change to."""
        return self._source.renewable

    @property
    def spent(self) -> bool:
        """Return whether all masks are stored, and none of them may release anything more."""
        marks = self._source.marks
        return bool(marks) and marks == self.budget.spent(marks, self._terms().form)

    @property
    def under_way(self) -> bool:
        """Return whether taking the next epoch means waiting for it."""
        future = self._next
        return future is not None and not future.done()

    @property
    def ready(self) -> bool:
        """Return whether the next epoch is prepared."""
        future = self._next
        return future is not None and future.done() and not future.exception()

    def begin(self) -> Future[Epoch]:
        """Start to prepare the next epoch, if none is prepared or under way, and return it."""
        if self._next is None:
            self._next = self._thread.submit(self._prepare, self._source)
        return self._next

    def wait(self) -> None:
        """Wait until none is under way, whatever came of it."""
        future = self._next
        if future is not None:
            # Unlike `futures.wait`, this also ends where the future was called off in the queue.
            with suppress(CancelledError):
                future.exception()

    def take(self) -> Epoch:
        """Return the next epoch; waits for it if need be. It is gone from here, come what may.

        Raises:
            NotReadyError: it takes too long.
        """
        future = self.begin()
        wait([future], LONGEST)
        if not future.done():
            raise NotReadyError("the next mask is still being prepared: try again")
        self._next = None
        return future.result()

    def first_of(self, source: MaskSource) -> Epoch:
        """Prepare an epoch of another source, while this one goes on; any thread may ask.

        Whoever does not show it retires it.

        Raises:
            NotReadyError: it takes too long.
        """
        future = self._thread.submit(self._prepare, source)
        try:
            return future.result(LONGEST)
        except TimeoutError:
            _abandon(future)
            raise NotReadyError("the first mask is still being prepared: try again") from None

    def is_current(self, epoch: Epoch) -> bool:
        """Return whether an epoch would be prepared on the same terms now."""
        return Terms(epoch.form, epoch.receivers) == self._terms()

    def serve(self, source: MaskSource) -> None:
        """Take epochs from another source from now on; one prepared before is discarded."""
        self._source = source
        self.discard()

    def discard(self) -> None:
        """Erase the epoch that was prepared in advance, or is just being prepared."""
        future, self._next = self._next, None
        if future is not None:
            _abandon(future)

    def close(self) -> None:
        """End the background thread and erase what it prepared; twice does no harm."""
        self.discard()
        self._thread.shutdown(cancel_futures=True)

    def _prepare(self, source: MaskSource) -> Epoch:
        begun = time.perf_counter()
        epoch = self._epoch(source, self._terms())
        self.took = time.perf_counter() - begun
        self.count += 1
        return epoch

    def _epoch(self, source: MaskSource, terms: Terms) -> Epoch:
        name = secrets.token_hex(16)
        key = EpochKey.generate(device=self._signer.public, bundle=source.bundle)
        try:
            with ExitStack() as undo:
                mask = source.make(key, self._avoided(source, terms.form))
                undo.callback(mask.erase)
                commitment = mask_commitment(key, mask.levels)
                sealer = self._sealer(key, name, source.bundle, terms)
                undo.pop_all()
            return Epoch(name, mask, terms.form, commitment, sealer, terms.receivers)
        finally:
            key.erase()

    def _sealer(self, key: EpochKey, name: str, bundle: str, terms: Terms) -> Sealer | None:
        if terms.form != "sealed" or not terms.receivers:
            return None
        envelope = seal_key(key, self._signer, epoch=name, bundle=bundle, receivers=terms.receivers)
        return Sealer(key, envelope)

    def _avoided(self, source: MaskSource, form: Release) -> frozenset[str]:
        """Return the marks of the mask shown last, and of those that are spent."""
        last = frozenset((self.last_mark,)) & source.marks
        spent = self.budget.spent(source.marks, form)
        return last if source.marks == last | spent else last | spent


def _abandon(future: Future[Epoch]) -> None:
    """Erase what comes of a preparation that nobody waits for any more."""

    def erase(done: Future[Epoch]) -> None:
        if not done.cancelled() and done.exception() is None:
            done.result().retire()

    future.cancel()
    future.add_done_callback(erase)
