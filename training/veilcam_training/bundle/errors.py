"""The one way a bundle is refused."""

from __future__ import annotations


class BundleError(ValueError):
    """A bundle that cannot be used; one line that says why and what to do."""
