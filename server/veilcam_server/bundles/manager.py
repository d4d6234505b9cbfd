"""Bundle manager of the API. One change at a time; the camera goes on meanwhile."""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import AsyncIterable, AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Self

from veilcam_client.wire.bundles import BundleInfo, InstalledBundle, InstalledBundles
from veilcam_server.bundles.loader import LoadedBundle, Opener, OpenSource, bundle_info, last_good
from veilcam_server.bundles.owners import Used
from veilcam_server.bundles.store import BundleStore, append
from veilcam_server.errors import BundleRefusedError, ProblemError, StorageError
from veilcam_server.settings import Settings
from veilcam_server.system.state_file import Report
from veilcam_training.bundle import Bundle

Change = Callable[[LoadedBundle], Awaitable[None]]
"""Makes the camera use other keys, or raises and leaves it with those that it has."""


UPLOAD = 64 * 2**20
"""Largest upload [bytes]."""


class BundleManager:
    """Installed bundles, and the one in use. Lives on one event loop.

    Args:
        store: store of the bundles.
        opener: makes them usable.
        keys: keys in use.
        limit: largest upload [bytes].
    """

    def __init__(
        self,
        store: BundleStore,
        opener: Opener,
        keys: LoadedBundle,
        *,
        limit: int = UPLOAD,
    ) -> None:
        self._store, self._opener, self.keys = store, opener, keys
        self.limit = limit
        self._infos: dict[str, BundleInfo | None] = {keys.info.digest: keys.info}
        self._changing = asyncio.Lock()

    @classmethod
    def open(cls, settings: Settings, opener: Opener, configured: Bundle, report: Report) -> Self:
        """Open the bundle that was in use last and still can be; raises as :func:`last_good`.

        Args:
            settings: settings of the daemon.
            opener: makes bundles usable.
            configured: bundle of the settings.
            report: takes why one cannot be used any more.
        """
        folder = settings.state_dir / "bundles"
        store = BundleStore(folder, settings.bundle, configured.digest, report)
        allow_older = settings.allow_older
        return cls(
            store, opener, last_good(store, opener, configured, report, allow_older=allow_older)
        )

    def note_start(self, report: Report) -> None:
        """Write down which bundle the daemon starts with, unless it is one that had to stand in.

        Args:
            report: takes that it cannot be made durable.
        """
        store, info = self._store, self.keys.info
        # After a loss nothing is written: every start says it again until a bundle is activated.
        if info.digest != store.candidates()[0] or store.lost:
            return
        try:
            store.settle(info.digest, self._opener.owners.remember(info, store.used))
        except StorageError as error:
            report(StorageError(f"which bundle is in use is not remembered: {error}"))

    @property
    def info(self) -> BundleInfo:
        """Contents of the bundle in use."""
        return self.keys.info

    async def all(self) -> InstalledBundles:
        """Every bundle, the configured one first."""
        digests = await asyncio.to_thread(self._store.digests)
        return InstalledBundles(bundles=tuple([await self._response(digest) for digest in digests]))

    async def install(self, chunks: AsyncIterable[bytes]) -> InstalledBundle:
        """Take in a bundle; it is checked, and not used.

        Raises:
            BundleRefusedError: it cannot be used here, is no owner's, or shows the scene.
            BundleOlderError: it is not of a higher version.
            ProblemError, StorageError: it cannot be stored now.
        """
        with self._store.incoming() as (path, stream):
            async for chunk in chunks:
                await asyncio.to_thread(append, stream, chunk)
            # Whoever sends slowly is waited for before this, and holds up no change.
            async with self._changing:
                info = await asyncio.to_thread(self._take, path)
                await asyncio.to_thread(self._store.install, path, info.digest)
                self._infos[info.digest] = info
                return await self._response(info.digest)

    async def activate(
        self, digest: str, change: Change, *, allow_older: bool = False
    ) -> InstalledBundle:
        """Use another bundle, also after a restart; when that fails, the one before goes on.

        Args:
            digest: digest of the bundle.
            change: makes the camera use it.
            allow_older: True: an older version may be used, where bundles need no signature.

        Raises:
            UnknownBundleError: there is none of this digest.
            BundleRefusedError: it cannot be used (any more), is no owner's, or shows the scene.
            BundleOlderError: it is older and may not be.
            StorageError, ProblemError: it cannot be made durable now.
        """
        async with self._alone():
            before = self.keys
            keys, used = await asyncio.to_thread(self._open, digest, allow_older)
            staged = await asyncio.to_thread(self._store.stage, digest, before.info.digest, used)
            try:
                if keys is not before:
                    await change(keys)
                    self.keys, self._infos[digest] = keys, keys.info
                try:
                    await asyncio.to_thread(staged.commit)
                except StorageError:
                    # What runs must be what a restart would bring.
                    if self.keys is not before:
                        await change(before)
                        self.keys = before
                    raise
            finally:
                staged.close()
            return await self._response(digest)

    async def reopen(self, open_source: OpenSource, change: Change) -> None:
        """Open the bundle in use anew, and all others from now on.

        Args:
            open_source: makes a bundle's source of masks from now on.
            change: makes the camera use the keys; what it raises leaves everything as it is.

        Raises:
            BundleRefusedError: it cannot be used (any more).
        """
        async with self._changing:
            digest, opener = self.keys.info.digest, self._opener.with_source(open_source)
            path = await asyncio.to_thread(self._store.path, digest)
            keys = await asyncio.to_thread(opener.open, path, digest)
            await change(keys)
            self._opener, self.keys = opener, keys

    async def remove(self, digest: str) -> InstalledBundles:
        """Remove a bundle for good; raises as :meth:`BundleStore.remove`."""
        async with self._alone():
            await asyncio.to_thread(self._store.remove, digest, self.keys.info.digest)
            self._infos.pop(digest, None)
        return await self.all()

    def _take(self, path: Path) -> BundleInfo:
        """Read an uploaded file that may be used later."""
        info = bundle_info(self._opener.take(path))
        if self._opener.owners.keys:  # else an older one may be allowed when it is activated
            self._opener.owners.check_version(info, self._store.used)
        return info

    def _open(self, digest: str, allow_older: bool) -> tuple[LoadedBundle, Used]:
        """Open a bundle that may be used now, and return the record that is kept of it."""
        owners, keys = self._opener.owners, self.keys
        used = dataclasses.replace(self._store.used, version=keys.info.version)
        if digest != keys.info.digest:
            keys = self._opener.open(self._store.path(digest), digest)
            owners.check_version(keys.info, used, allow_older=allow_older)
        return keys, owners.remember(keys.info, used)

    async def _response(self, digest: str) -> InstalledBundle:
        path = self._store.path(digest)
        if digest not in self._infos:
            self._infos[digest] = await asyncio.to_thread(self._look, digest)
        return InstalledBundle(
            digest=digest,
            size=path.stat().st_size,
            active=digest == self.keys.info.digest,
            configured=digest == self._store.configured,
            bundle=self._infos[digest],
        )

    def _look(self, digest: str) -> BundleInfo | None:
        try:
            bundle = self._opener.read(self._store.path(digest))
        except BundleRefusedError:
            return None
        return bundle_info(bundle) if bundle.digest == digest else None

    @asynccontextmanager
    async def _alone(self) -> AsyncIterator[None]:
        if self._changing.locked():
            raise ProblemError(
                "too_many_requests",
                "another change of bundles is under way: try again when it is done",
            )
        async with self._changing:
            yield
