"""Owners of bundles: whose are taken, and of which version."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from veilcam_client.wire.bundles import BundleInfo
from veilcam_server.errors import BundleOlderError, BundleRefusedError, StartError
from veilcam_training.bundle import Bundle, BundleError, OwnerKey


@dataclass(frozen=True, slots=True)
class Used:
    """Record of the bundles that were in use."""

    version: int = 0
    """Of the last one."""
    highest: int = 0
    """Version of the newest one that an owner had signed."""
    newest: str = ""
    """Digest of that."""


@dataclass(frozen=True, slots=True)
class Owners:
    """Those whose bundles are taken; where there are none, everybody's are."""

    keys: Collection[OwnerKey] = ()

    @classmethod
    def open(cls, path: Path | None) -> Owners:
        """Read a file of public keys, one ``veilcam-owner:BASE64`` a line; the rest is a comment.

        Raises:
            StartError: it cannot be read, or holds something else, or no key.
        """
        if path is None:
            return cls()
        try:
            lines = [line.split() for line in path.read_text("ascii", "replace").splitlines()]
        except OSError as error:
            raise StartError(
                f"--owner-keys {path} cannot be read ({error.strerror}): check it"
            ) from None
        keys = []
        for number, words in enumerate(lines, 1):
            if not words or words[0].startswith("#"):
                continue
            try:
                keys.append(OwnerKey.parse(words[0]))
            except BundleError as error:
                raise StartError(f"--owner-keys {path}, line {number}: {error}") from None
        if not keys:
            raise StartError(
                f"--owner-keys {path} holds no key: make one with 'veilcam-train bundle keygen'"
            )
        return cls(frozenset(keys))

    def check(self, bundle: Bundle) -> None:
        """Raise :class:`BundleRefusedError` for one that no owner signed."""
        if not self.keys or bundle.owner in self.keys:
            return
        signed = "is not signed" if bundle.owner is None else f"is signed by {bundle.owner.short}"
        raise BundleRefusedError(
            f"this bundle {signed}: this camera takes bundles that "
            f"{' or '.join(sorted(key.short for key in self.keys))} signed"
        )

    def check_version(self, info: BundleInfo, used: Used, *, allow_older: bool = False) -> bool:
        """Refuse what is older than what was in use.

        Args:
            info: description of a bundle that :meth:`check` let through.
            used: before it.
            allow_older: holds where bundles need no signature alone.

        Returns:
            Whether it is older all the same.

        Raises:
            BundleOlderError: it is.
        """
        if self.keys:
            if info.version > used.highest or info.digest == used.newest:
                return False
            raise BundleOlderError(
                f"this bundle is of version {info.version}, and version {used.highest} was in use "
                "already: sign it again under a higher one"
            )
        older = info.version < used.version
        if older and not allow_older:
            raise BundleOlderError(
                f"this bundle is of version {info.version}, and version {used.version} is in use: "
                "take it with --allow-older (allow_older=true)"
            )
        return older

    def remember(self, info: BundleInfo, used: Used) -> Used:
        """Return the record to keep once this bundle is in use."""
        if self.keys and info.version > used.highest:
            return Used(info.version, info.version, info.digest)
        return Used(info.version, used.highest, used.newest)
