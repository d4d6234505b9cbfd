"""The one way a bundle is refused."""


class BundleError(ValueError):
    """A bundle that cannot be used; one line that says why and what to do."""


def require(condition: bool, refusal: str) -> None:
    """Raise :class:`BundleError` with ``refusal`` unless ``condition`` is met."""
    if not condition:
        raise BundleError(refusal)
