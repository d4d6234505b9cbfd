"""The one way training refuses bad input."""


class TrainingError(ValueError):
    """Input that training cannot use; one line that says what would be valid or what to do."""


def require(condition: bool, refusal: str) -> None:
    """Raise :class:`TrainingError` with ``refusal`` unless ``condition`` is met."""
    if not condition:
        raise TrainingError(refusal)
