"""What the daemon itself refuses or fails at; device errors live in ``devices/errors.py``."""

from __future__ import annotations


class StartError(Exception):
    """The daemon cannot start; one line that says what to do."""


class StoppedError(Exception):
    """The daemon cannot go on and ended; one line that says what to do."""


class EpochError(Exception):
    """A mask epoch could not be recorded, so no mask may be shown under it."""


class FenceError(Exception):
    """A reading that was not wholly exposed under one settled mask; it is thrown away."""


class NotReadyError(Exception):
    """The camera is in no state to take a capture."""


class SelfTestError(NotReadyError):
    """The panel does not hide the scene, or does not show what it is told."""


class UndecidedError(SelfTestError):
    """The self test cannot tell, for want of light or of steady light."""


class RotationImpossibleError(Exception):
    """There is no other mask to change to."""


class WithheldError(Exception):
    """An embedding was asked for, and this daemon lets none out."""


class QueueFullError(Exception):
    """Too many captures are waiting already; ``retry_after`` [s]."""

    def __init__(self, limit: int, retry_after: int) -> None:
        super().__init__(f"{limit} captures are waiting: try again in {retry_after} s")
        self.retry_after = retry_after


class IdempotencyError(Exception):
    """An idempotency key that came before with another request."""


class HostRefusedError(Exception):
    """The ``Host`` of a request is not this machine."""

    def __init__(self) -> None:
        super().__init__("this daemon answers to localhost only: use http://localhost:PORT")


class UnauthorizedError(Exception):
    """No valid token came with the request; why it is not valid stays here."""

    def __init__(self) -> None:
        super().__init__(
            "this daemon wants a valid token: make one with 'veilcamd token create' and send it "
            "as Authorization: Bearer"
        )


class ForbiddenError(Exception):
    """The caller may not do this."""


class CalibratingError(NotReadyError):
    """The camera is being measured, and takes no captures meanwhile."""

    def __init__(self) -> None:
        super().__init__("the camera is being calibrated: see GET /v1/calibration")


class NotCalibratingError(Exception):
    """No calibration is under way."""

    def __init__(self) -> None:
        super().__init__("no calibration is under way: begin one with POST /v1/calibration")


class SceneNotWantedError(Exception):
    """Another scene is waited for, or none."""

    def __init__(self, given: str, wanted: str | None) -> None:
        what = "no scene is" if wanted is None else f"the scene {wanted!r} is"
        super().__init__(f"{what} waited for, not {given!r}: see GET /v1/calibration")


class CalibrationError(Exception):
    """A measurement or a record that cannot be used, or made; the message says what to do."""


class ReplayingError(Exception):
    """What is asked for needs a camera, and there is a recording only."""

    def __init__(
        self, why: str = "there is no panel and no sensor: this daemon replays a recording"
    ) -> None:
        super().__init__(why)


class ReplayOverError(ReplayingError):
    """The recording has come to its end."""

    def __init__(self, count: int) -> None:
        super().__init__(f"all {count} captures were replayed: start the daemon again")


class SceneApiOffError(Exception):
    """Scenes are not held up by program before this camera."""

    def __init__(self) -> None:
        super().__init__("this daemon takes no scenes: start it with --simulate --scene-api")


class SceneInvalidError(Exception):
    """What should be held up is no picture."""


class UnknownTokenError(Exception):
    """There is no token of this id."""


class TokenStoreError(Exception):
    """The tokens cannot be read or written."""


class TokensOffError(Exception):
    """Tokens are asked about, and this daemon wants none."""

    def __init__(self) -> None:
        super().__init__(
            "this daemon wants no tokens: start it with --auth tokens, or use 'veilcamd token'"
        )


class RateLimitError(Exception):
    """A caller asks too often; ``retry_after`` [s]."""

    def __init__(self, rate: float, retry_after: int) -> None:
        super().__init__(f"more than {rate:g} requests a second: try again in {retry_after} s")
        self.retry_after = retry_after


class TooManyRequestsError(Exception):
    """A caller has too many requests under way."""

    def __init__(self, limit: int) -> None:
        super().__init__(f"{limit} of your requests are under way: wait for one of them to end")


class TooManyStreamsError(Exception):
    """Too many event streams are open."""

    def __init__(self, limit: int) -> None:
        super().__init__(f"{limit} event streams are open: close one that nobody reads")


class LeasedError(Exception):
    """Somebody else holds the camera; ``retry_after`` [s]."""

    def __init__(self, owner: str, retry_after: int) -> None:
        super().__init__(f"the camera is leased to {owner!r} for another {retry_after} s")
        self.retry_after = retry_after


class UnknownKeyringError(Exception):
    """There is no keyring of this digest."""

    def __init__(self) -> None:
        super().__init__("there is no keyring of this digest: see GET /v1/keyrings")


class KeyringInvalidError(Exception):
    """A file that is no whole bundle."""


class KeyringUnfitError(Exception):
    """A bundle for another camera than the one that is there."""


class KeyringInUseError(Exception):
    """A keyring that cannot be removed."""

    def __init__(self) -> None:
        super().__init__("this keyring is in use, or the daemon was started with it: it stays")


class KeyringsFullError(Exception):
    """Too many keyrings are installed."""

    def __init__(self, capacity: int) -> None:
        super().__init__(f"{capacity} keyrings are installed: remove one first")


class KeyringsBusyError(Exception):
    """Another change of keyrings is under way."""

    def __init__(self) -> None:
        super().__init__("another change of keyrings is under way: try again when it is done")


class KeyringStoreError(Exception):
    """A keyring could not be made durable."""


class InferenceError(Exception):
    """A classifier gave no numbers for a reading."""

    def __init__(self) -> None:
        super().__init__("the classifier gave no probabilities for this reading: train it again")
