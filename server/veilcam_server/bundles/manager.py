"""What the API does with bundles. One change at a time; the camera goes on meanwhile."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterable, AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

from veilcam_client.wire.bundles import BundleInfo, InstalledBundle, InstalledBundles
from veilcam_server.bundles.loader import LoadedBundle, Opener, bundle_info
from veilcam_server.bundles.store import BundleStore, append
from veilcam_server.errors import (
    BundleInvalidError,
    BundlesBusyError,
    BundleStoreError,
    BundleUnfitError,
)

Change = Callable[[LoadedBundle], Awaitable[None]]
"""Makes the camera use other keys, or raises and leaves it with those that it has."""


class BundleManager:
    """Installed bundles, and the one in use. Lives on one event loop.

    Args:
        store: where they are.
        opener: makes them usable.
        keys: in use.
        limit: of an upload [bytes].
    """

    def __init__(
        self,
        store: BundleStore,
        opener: Opener,
        keys: LoadedBundle,
        *,
        limit: int,
    ) -> None:
        self._store, self._opener, self._keys = store, opener, keys
        self.limit = limit
        self._infos: dict[str, BundleInfo | None] = {keys.info.digest: keys.info}
        self._changing = asyncio.Lock()

    @property
    def info(self) -> BundleInfo:
        """What the bundle in use holds."""
        return self._keys.info

    async def all(self) -> InstalledBundles:
        """Every bundle, the configured one first."""
        digests = await asyncio.to_thread(self._store.digests)
        return InstalledBundles(bundles=tuple([await self._response(digest) for digest in digests]))

    async def install(self, chunks: AsyncIterable[bytes]) -> InstalledBundle:
        """Take in a bundle; it is checked, and not used.

        Raises:
            BundleInvalidError, BundleUnfitError: it cannot be used here.
            BundlesFullError, BundleStoreError, BundlesBusyError: it cannot be stored now.
        """
        async with self._alone():
            with self._store.incoming() as (path, stream):
                async for chunk in chunks:
                    await asyncio.to_thread(append, stream, chunk)
                bundle = await asyncio.to_thread(self._opener.read, path)
                await asyncio.to_thread(self._store.install, path, bundle.digest)
            self._infos[bundle.digest] = bundle_info(bundle)
            return await self._response(bundle.digest)

    async def activate(self, digest: str, change: Change) -> InstalledBundle:
        """Use another bundle, also after a restart; when that fails, the one before goes on.

        Raises:
            UnknownBundleError: there is none of this digest.
            BundleInvalidError, BundleUnfitError: it cannot be used (any more).
            BundleStoreError, BundlesBusyError: it cannot be made durable now.
        """
        async with self._alone():
            before = self._keys
            path = await asyncio.to_thread(self._store.path, digest)
            staged = await asyncio.to_thread(self._store.stage, digest, before.info.digest)
            try:
                if digest != before.info.digest:
                    keys = await asyncio.to_thread(self._opener.open, path, digest)
                    await change(keys)
                    self._keys, self._infos[digest] = keys, keys.info
                try:
                    await asyncio.to_thread(self._store.commit, staged)
                except BundleStoreError:
                    # What runs must be what a restart would bring.
                    if self._keys is not before:
                        await change(before)
                        self._keys = before
                    raise
            finally:
                staged.close()
            return await self._response(digest)

    async def reopen(self, opener: Opener, change: Change) -> None:
        """Open the bundle in use anew, and all others from now on.

        Args:
            opener: that makes them usable from now on.
            change: makes the camera use the keys; what it raises leaves everything as it is.

        Raises:
            BundleInvalidError, BundleUnfitError: it cannot be used (any more).
        """
        async with self._changing:
            digest = self._keys.info.digest
            path = await asyncio.to_thread(self._store.path, digest)
            keys = await asyncio.to_thread(opener.open, path, digest)
            await change(keys)
            self._opener, self._keys = opener, keys

    async def remove(self, digest: str) -> InstalledBundles:
        """Remove a bundle for good; raises as :meth:`BundleStore.remove`."""
        async with self._alone():
            await asyncio.to_thread(self._store.remove, digest, self._keys.info.digest)
            self._infos.pop(digest, None)
        return await self.all()

    async def _response(self, digest: str) -> InstalledBundle:
        path = self._store.path(digest)
        if digest not in self._infos:
            self._infos[digest] = await asyncio.to_thread(self._look, digest)
        return InstalledBundle(
            digest=digest,
            size=path.stat().st_size,
            active=digest == self._keys.info.digest,
            configured=digest == self._store.configured,
            bundle=self._infos[digest],
        )

    def _look(self, digest: str) -> BundleInfo | None:
        try:
            bundle = self._opener.read(self._store.path(digest))
        except (BundleInvalidError, BundleUnfitError):
            return None
        return bundle_info(bundle) if bundle.digest == digest else None

    @asynccontextmanager
    async def _alone(self) -> AsyncIterator[None]:
        if self._changing.locked():
            raise BundlesBusyError
        async with self._changing:
            yield
