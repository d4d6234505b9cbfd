"""The wire contract of keyrings: what is installed, and which one is in use."""

from __future__ import annotations

from veilcam_client.wire.captures import Answer, BundleInfo

BUNDLE_MEDIA_TYPE = "application/octet-stream"


class Keyring(Answer):
    """One bundle that the daemon can use, without its secrets."""

    digest: str
    """SHA-256 of the file: its name."""
    size: int
    """[bytes]"""
    active: bool
    """Whether masks and classifiers come from it now."""
    configured: bool
    """Whether the daemon was started with it; it cannot be removed."""
    bundle: BundleInfo | None = None
    """What it holds; None for a file that was damaged on the disk."""


class Keyrings(Answer):
    """All of them."""

    keyrings: tuple[Keyring, ...]
