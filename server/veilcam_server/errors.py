"""Errors of the daemon and their problem codes; those of devices live in ``devices/errors.py``."""

from __future__ import annotations

from typing import ClassVar

from veilcam_client.wire.status import Remedy


class ProblemError(Exception):
    """Problem that a caller is told of. Every kind has a stable code of its own.

    Attributes:
        code: stable, machine-readable.
        status: status of the answer in HTTP.
        title: meaning of the code, always the same.
        detail: text where nothing more is known.
        retryable: True where the same request may succeed later.
        remedy: advice that helps.
        retry_after: pause before that [s].
    """

    code: ClassVar[str]
    status: ClassVar[int]
    title: ClassVar[str]
    detail: ClassVar[str]
    retryable: ClassVar[bool]
    remedy: Remedy = "wait"
    retry_after: int = 1

    def __init_subclass__(
        cls,
        *,
        code: str | None = None,
        status: int = 500,
        title: str = "",
        detail: str = "",
        retryable: bool = False,
        remedy: Remedy | None = None,
    ) -> None:
        if code is not None:  # another cause of what its base is called
            cls.code, cls.status, cls.title, cls.retryable = code, status, title, retryable
            cls.detail = detail
        if remedy is not None:
            cls.remedy = remedy

    def __init__(self, detail: str | None = None, *, remedy: Remedy | None = None) -> None:
        super().__init__(self.detail if detail is None else detail)
        if remedy is not None:  # another than that of its kind
            self.remedy = remedy


def remedy_for(error: BaseException) -> Remedy:
    """Return what helps against an error; one that nobody foresaw is a defect."""
    return error.remedy if isinstance(error, ProblemError) else "report_defect"


class StartError(Exception):
    """The daemon cannot start; one line that says what to do."""


class StorageError(
    ProblemError,
    StartError,
    code="storage_failed",
    status=503,
    title="The state directory's disk fails",
    retryable=True,
    remedy="check_disk",
):
    """The state directory cannot be read or written; what it held before holds on."""


class StateDamagedError(
    ProblemError,
    code="state_damaged",
    status=500,
    title="A file of the state was damaged, and its copy is used",
    remedy="check_disk",
):
    """One of the two copies of a state file is damaged or gone; nothing is lost."""


class StateLostError(
    ProblemError,
    code="state_lost",
    status=500,
    title="A file of the state and its copy are damaged",
    remedy="check_disk",
):
    """Both copies of a state file are damaged or gone; the message says what follows."""


class AuditError(
    ProblemError,
    code="audit_not_written",
    status=503,
    title="The audit log cannot be written",
    retryable=True,
    remedy="check_disk",
):
    """Record of a change that cannot be written: the change is not made, or not acknowledged."""


class CaptureLogError(
    ProblemError,
    code="log_not_written",
    status=503,
    title="The capture log cannot be written",
    retryable=True,
    remedy="check_disk",
):
    """Nothing can be made durable in the capture log; answers leave, and it will say how many."""


class LogDamagedError(
    ProblemError,
    code="log_damaged",
    status=500,
    title="Records of the capture log are damaged",
    remedy="check_disk",
):
    """Records of the capture log do not hold any more; the message says which part."""


class MasksSpentError(
    ProblemError,
    code="masks_spent",
    status=409,
    title="No mask may release anything more",
    detail=(
        "as many embeddings left behind every mask of this bundle as may: labels go on; install "
        "another bundle for more"
    ),
    remedy="install_bundle",
):
    """The budget of released embeddings of all masks is used up."""


class FenceError(
    ProblemError,
    code="fence_violated",
    status=503,
    title="The measurement could not be trusted",
    retryable=True,
):
    """A measurement that was not wholly exposed under one settled mask; it is thrown away."""


class NotReadyError(
    ProblemError,
    code="not_ready",
    status=503,
    title="The camera takes no captures now",
    retryable=True,
):
    """The camera is in no state to take a capture."""


class NotLookingError(
    NotReadyError,
    code="not_looking",
    status=409,
    title="The camera does not look",
):
    """The panel is opaque because that is wanted now; the message says by what."""


class SelfTestError(NotReadyError, remedy="check_panel_wiring"):
    """The panel does not hide the scene, or does not show what it is told."""


class UndecidedError(SelfTestError, remedy="adjust_light"):
    """The self test cannot tell, for want of light or of steady light."""


class UnwatchableError(SelfTestError, remedy="shield_light"):
    """Too much light comes past the masks to tell a panel that hides from one that does not."""


class UnsteadyLightError(
    UndecidedError,
    code="light_unsteady",
    status=503,
    title="The light changed around the capture",
    retryable=True,
    detail="the light changed around this capture, which was thrown away: try again",
):
    """The guard cannot tell whether the panel hid the scene; nothing failed."""


class PanelNotHidingError(
    ProblemError,
    code="panel_not_hiding",
    status=503,
    title="The panel does not hide the scene",
    retryable=True,
    remedy="check_panel_wiring",
):
    """The opaque panel lets as much light through as the mask; the panel was made safe."""


class RotationImpossibleError(
    ProblemError,
    code="rotation_impossible",
    status=409,
    title="There is no other mask",
    remedy="install_bundle",
):
    """There is no other mask to change to."""


class WithheldError(
    ProblemError,
    code="embedding_withheld",
    status=403,
    title="Embeddings are not released",
    detail="this daemon releases no embeddings: ask for a classification, pair a receiver with "
    "'veilcam receiver add', or start it with --release",
):
    """An embedding was asked for, and this daemon lets none out."""


class QueueFullError(
    ProblemError,
    code="queue_full",
    status=429,
    title="Too many captures are waiting",
    retryable=True,
):
    """Too many captures are waiting already; ``retry_after`` [s]."""

    def __init__(self, limit: int, retry_after: int) -> None:
        super().__init__(f"{limit} captures are waiting: try again in {retry_after} s")
        self.retry_after = retry_after


class IdempotencyError(
    ProblemError,
    code="idempotency_key_reused",
    status=422,
    title="The idempotency key belongs to another request",
    detail="this Idempotency-Key came before with another request: use a new key",
):
    """An idempotency key that came before with another request."""


class DoneBeforeRestartError(
    ProblemError,
    code="done_before_restart",
    status=409,
    title="This was done before the daemon was restarted",
    detail=(
        "what this Idempotency-Key asks for was done, and its answer was lost when the daemon was "
        "restarted: look what is the case now, or ask again with a new key"
    ),
):
    """Request that was carried out, whose answer a restart lost."""


class AnswerNotKeptError(
    ProblemError,
    code="answer_not_kept",
    status=409,
    title="The answer is not kept any more",
    detail=(
        "what this Idempotency-Key asks for was done, and its answer made room for later ones: "
        "look what is the case now, or ask again with a new key"
    ),
):
    """Request that was carried out, whose answer is not kept any more."""


class TooManyKeysError(
    ProblemError,
    code="too_many_keys",
    status=429,
    title="Too many idempotency keys in a short time",
    retryable=True,
):
    """A caller used more idempotency keys than are remembered; ``retry_after`` [s]."""

    def __init__(self, capacity: int, retry_after: int) -> None:
        super().__init__(
            f"{capacity} of your idempotency keys are remembered: try again in {retry_after} s"
        )
        self.retry_after = retry_after


class HostRefusedError(
    ProblemError,
    code="host_refused",
    status=421,
    title="This host name is not served",
    detail="this daemon has no such name: use localhost, or start it with --hosts NAME",
):
    """The ``Host`` of a request is not this daemon."""


class CrossSiteError(
    ProblemError, code="cross_site", status=403, title="A page of another site asks"
):
    """A page of another site makes a browser ask."""

    def __init__(self) -> None:
        super().__init__("this daemon answers to no page of another site: ask without a browser")


class UnauthorizedError(
    ProblemError,
    code="unauthorized",
    status=401,
    title="A valid token is wanted",
    detail=(
        "this daemon wants a valid token: make one with 'veilcamd token create' and send it "
        "as Authorization: Bearer"
    ),
):
    """No valid token came with the request; why it is not valid stays here."""


class ForbiddenError(
    ProblemError, code="forbidden", status=403, title="The token does not allow this"
):
    """The caller may not do this."""


class CalibratingError(
    NotReadyError,
    code="calibrating",
    status=503,
    title="The camera is being calibrated",
    retryable=True,
    detail="the camera is being calibrated: see GET /v1/calibration",
):
    """The camera is being measured, and takes no captures meanwhile."""


class NotCalibratingError(
    ProblemError,
    code="not_calibrating",
    status=409,
    title="No calibration is under way",
    detail="no calibration is under way: begin one with POST /v1/calibration",
):
    """No calibration is under way."""


class SceneNotWantedError(
    ProblemError, code="scene_not_wanted", status=409, title="This scene is not waited for"
):
    """Another scene is waited for, or none."""

    def __init__(self, given: str, wanted: str | None) -> None:
        what = "no scene is" if wanted is None else f"the scene {wanted!r} is"
        super().__init__(f"{what} waited for, not {given!r}: see GET /v1/calibration")


class CalibrationError(
    ProblemError,
    code="calibration_impossible",
    status=409,
    title="This camera cannot be calibrated",
):
    """A measurement or a record that cannot be used, or made; the message says what to do."""


class ReplayingError(
    ProblemError,
    code="replaying",
    status=409,
    title="A recording cannot do this",
    detail="there is no panel and no sensor: this daemon replays a recording",
):
    """Request that needs a camera, where there is a recording only."""


class ReplayOverError(
    ReplayingError, code="replay_over", status=409, title="The recording is over"
):
    """The recording has come to its end."""

    def __init__(self, count: int) -> None:
        super().__init__(f"all {count} captures were replayed: start the daemon again")


class SceneApiOffError(
    ProblemError,
    code="scene_api_off",
    status=409,
    title="No scenes are held up by program",
    detail="this daemon takes no scenes and no faults: start it with --simulate --scene-api",
):
    """Scenes are not held up by program before this camera."""


class SceneInvalidError(ProblemError, code="scene_invalid", status=422, title="This is no picture"):
    """Scene that is no picture."""


class UnknownTokenError(
    ProblemError, code="unknown_token", status=404, title="There is no such token"
):
    """There is no token of this id."""


class TokensOffError(
    ProblemError,
    code="tokens_off",
    status=409,
    title="This daemon wants no tokens",
    detail="this daemon wants no tokens: start it with --auth tokens, or use 'veilcamd token'",
):
    """Tokens are asked about, and this daemon wants none."""


class NoReceiverError(
    ProblemError,
    code="no_receiver",
    status=409,
    title="There is nobody to seal embeddings to",
    detail="embeddings leave sealed, and no receiver is paired: pair one with 'veilcam receiver "
    "add'",
):
    """A sealed embedding was asked for, and there is nobody who could open it."""


class ReceiverInvalidError(
    ProblemError, code="receiver_invalid", status=422, title="This is no receiver's key"
):
    """Receiver whose public key is none."""


class ReceiverKnownError(
    ProblemError,
    code="receiver_known",
    status=409,
    title="The receiver is paired already",
    detail="this key is paired already: see GET /v1/receivers",
):
    """A receiver that is paired already, perhaps under another label."""


class TooManyReceiversError(
    ProblemError, code="too_many_receivers", status=409, title="Too many receivers are paired"
):
    """As many receivers are paired as there may be."""

    def __init__(self, limit: int) -> None:
        super().__init__(f"{limit} receivers are paired: remove one first")


class UnknownReceiverError(
    ProblemError,
    code="unknown_receiver",
    status=404,
    title="There is no such receiver",
    detail="there is no receiver of this id: see GET /v1/receivers",
):
    """There is no receiver of this id."""


class RateLimitError(
    ProblemError,
    code="rate_limited",
    status=429,
    title="Too many requests in a short time",
    retryable=True,
):
    """A caller asks too often; ``retry_after`` [s]."""

    def __init__(self, rate: float, retry_after: int) -> None:
        super().__init__(f"more than {rate:g} requests a second: try again in {retry_after} s")
        self.retry_after = retry_after


class TooManyRequestsError(
    ProblemError,
    code="too_many_requests",
    status=429,
    title="Too many requests at once",
    retryable=True,
):
    """A caller has too many requests under way."""

    def __init__(self, limit: int) -> None:
        super().__init__(f"{limit} of your requests are under way: wait for one of them to end")


class TooManyStreamsError(
    ProblemError,
    code="too_many_streams",
    status=429,
    title="Too many event streams are open",
    retryable=True,
):
    """Too many event streams are open."""

    def __init__(self, limit: int) -> None:
        super().__init__(f"{limit} event streams are open: close one that nobody reads")


class TooManyStreamsOfOneError(TooManyStreamsError):
    """One caller has too many event streams open."""

    def __init__(self, limit: int) -> None:
        ProblemError.__init__(self, f"{limit} of your event streams are open: close one of them")


class TooManyUploadsError(
    ProblemError,
    code="too_many_uploads",
    status=429,
    title="Too many uploads at once",
    retryable=True,
):
    """Too many uploads are under way."""

    def __init__(self, limit: int) -> None:
        super().__init__(f"{limit} uploads are under way: wait for one of them to end")


class TooManyUploadsOfOneError(TooManyUploadsError):
    """One caller has too many uploads under way."""

    def __init__(self, limit: int) -> None:
        ProblemError.__init__(self, f"{limit} of your uploads are under way: wait for one to end")


class LeasedError(
    ProblemError, code="leased", status=423, title="Somebody else holds the camera", retryable=True
):
    """Somebody else holds the camera; ``retry_after`` [s]."""

    def __init__(self, owner: str, retry_after: int) -> None:
        super().__init__(f"the camera is leased to {owner!r} for another {retry_after} s")
        self.retry_after = retry_after


class UnknownBundleError(
    ProblemError,
    code="unknown_bundle",
    status=404,
    title="There is no such bundle",
    detail="there is no bundle of this digest: see GET /v1/bundles",
):
    """There is no bundle of this digest."""


class BundleInvalidError(
    ProblemError,
    code="bundle_invalid",
    status=422,
    title="This is no bundle that can be used",
    remedy="install_bundle",
):
    """A file that is no whole bundle."""


class BundleUnfitError(
    ProblemError,
    code="bundle_unfit",
    status=409,
    title="The bundle does not fit this camera",
    remedy="install_bundle",
):
    """A bundle for another camera than the one that is there."""


class BundleUntrustedError(
    ProblemError,
    code="bundle_untrusted",
    status=403,
    title="The bundle is not of this camera's owner",
    remedy="install_bundle",
):
    """A bundle that no owner of this camera signed."""


class BundleRevealsError(
    ProblemError,
    code="bundle_reveals",
    status=422,
    title="The bundle's masks show pictures of the scene",
    remedy="install_bundle",
):
    """A bundle with a mask behind which the embedding is a picture."""


class BundleOlderError(
    ProblemError,
    code="bundle_older",
    status=409,
    title="A newer bundle was in use",
    remedy="install_bundle",
):
    """A bundle of an older version than one that was in use."""


class BundleInUseError(
    ProblemError,
    code="bundle_in_use",
    status=409,
    title="The bundle is in use",
    detail="this bundle is in use, or the daemon was started with it: it stays",
):
    """A bundle that cannot be removed."""


class BundlesFullError(
    ProblemError, code="bundles_full", status=409, title="Too many bundles are installed"
):
    """Too many bundles are installed."""

    def __init__(self, capacity: int) -> None:
        super().__init__(f"{capacity} bundles are installed: remove one first")


class BundlesBusyError(
    ProblemError,
    code="bundles_busy",
    status=503,
    title="The bundles are being changed",
    retryable=True,
    detail="another change of bundles is under way: try again when it is done",
):
    """Another change of bundles is under way."""


class InferenceError(
    ProblemError,
    code="inference_failed",
    status=503,
    title="The classifier gave no probabilities",
    remedy="install_bundle",
    detail="the classifier gave no probabilities for this measurement: train it again",
):
    """A classifier gave no numbers for a measurement."""
