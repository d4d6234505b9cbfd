"""From a bundle to what serves its masks, where it fits the camera that is there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from veilcam_client.wire.captures import BundleInfo
from veilcam_server.errors import (
    KeyringInvalidError,
    KeyringUnfitError,
    StartError,
    UnknownKeyringError,
)
from veilcam_server.identity import bundle_info
from veilcam_server.keyring_store import KeyringStore
from veilcam_server.masks import MaskSource
from veilcam_training.bundle import Bundle, BundleError, read_bundle


@dataclass(frozen=True, slots=True)
class Keys:
    """A keyring that can be used."""

    info: BundleInfo
    source: MaskSource = field(repr=False)


class Opener:
    """Opens keyrings for a camera that stands as it is.

    Args:
        configured: the bundle that the daemon was started with.
        open_source: makes a bundle's source of masks, or raises :class:`StartError`.
    """

    def __init__(self, configured: Bundle, open_source: Callable[[Bundle], MaskSource]) -> None:
        self._configured, self._open_source = configured, open_source

    def read(self, path: Path) -> Bundle:
        """Read a bundle that fits this camera.

        Raises:
            KeyringInvalidError: it cannot be read, or it is not a whole bundle.
            KeyringUnfitError: it is for another camera, or of another mode.
        """
        try:
            bundle = read_bundle(path)
        except BundleError as error:
            # Where the daemon keeps its files is nobody's business.
            reason = str(error).removeprefix(f"{path}: ")
            raise KeyringInvalidError(f"this keyring cannot be used: {reason}") from None
        for name in ("mode", "camera", "scene", "embedding", "channels"):
            if getattr(bundle, name) != getattr(self._configured, name):
                raise KeyringUnfitError(
                    f"this keyring is for another {name}: start the daemon with it, as --bundle"
                )
        return bundle

    def open(self, path: Path, digest: str) -> Keys:
        """Open the keyring of this digest; raises as :meth:`read`."""
        bundle = self.read(path)
        if bundle.digest != digest:
            raise KeyringInvalidError("this keyring was changed on the disk: install it again")
        return self.keys(bundle)

    def keys(self, bundle: Bundle) -> Keys:
        """What serves the masks of a bundle; raises :class:`KeyringUnfitError`."""
        try:
            return Keys(bundle_info(bundle), self._open_source(bundle))
        except (StartError, BundleError) as error:
            raise KeyringUnfitError(str(error)) from None


def last_good(store: KeyringStore, opener: Opener) -> tuple[Keys | None, Sequence[str]]:
    """The keyring that was in use last and still can be; None for the configured one.

    Returns:
        That, and a line on each that cannot be used.
    """
    faults: list[str] = []
    for digest in store.candidates():
        if digest == store.configured:
            break
        try:
            return opener.open(store.path(digest), digest), faults
        except (UnknownKeyringError, KeyringInvalidError, KeyringUnfitError) as error:
            faults.append(f"keyring {digest[:12]} is not in use any more: {error}")
    return None, faults
