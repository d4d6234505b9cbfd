"""Errors of the daemon, and the table of problem codes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, NamedTuple

from veilcam_client.wire.status import Remedy


class ProblemKind(NamedTuple):
    """Row of the table of problems.

    Attributes:
        code: stable, machine-readable.
        status: status of the answer in HTTP.
        title: meaning of the code, always the same.
        retryable: True where the same request may succeed later.
        remedy: advice that helps, unless an error has another one.
    """

    code: str
    status: int
    title: str
    retryable: bool = False
    remedy: Remedy = "wait"


_BUNDLE: Remedy = "install_bundle"
_DISK: Remedy = "check_disk"
_PANEL: Remedy = "check_panel_wiring"
PROBLEMS: Mapping[str, ProblemKind] = {
    kind.code: kind
    for kind in (
        ProblemKind("bad_request", 400, "The request cannot be read"),
        ProblemKind("unauthorized", 401, "A valid token is wanted"),
        ProblemKind("cross_site", 403, "A page of another site asks"),
        ProblemKind("embedding_withheld", 403, "Embeddings are not released"),
        ProblemKind("forbidden", 403, "The token does not allow this"),
        ProblemKind("not_found", 404, "There is no such thing"),
        ProblemKind("method_not_allowed", 405, "This path does not take this method"),
        ProblemKind("not_acceptable", 406, "None of the accepted media types can be given"),
        ProblemKind("answer_lost", 409, "The answer to this key is not kept"),
        ProblemKind("bundle_older", 409, "A newer bundle was in use", remedy=_BUNDLE),
        ProblemKind("calibration_impossible", 409, "This camera cannot be calibrated"),
        ProblemKind("conflict", 409, "The request does not fit the present state"),
        ProblemKind("masks_spent", 409, "No mask may release anything more", remedy=_BUNDLE),
        ProblemKind("not_enabled", 409, "This daemon was started without it"),
        ProblemKind("not_looking", 409, "The camera does not look"),
        ProblemKind("body_too_large", 413, "The body is too large"),
        ProblemKind("unsupported_media_type", 415, "The body's media type is not taken here"),
        ProblemKind("host_refused", 421, "This host name is not served"),
        ProblemKind("bundle_refused", 422, "The bundle cannot be used here", remedy=_BUNDLE),
        ProblemKind("idempotency_key_reused", 422, "The key came with another request"),
        ProblemKind("invalid_request", 422, "The request is not valid"),
        ProblemKind("leased", 423, "Somebody else holds the camera", retryable=True),
        ProblemKind("queue_full", 429, "Too many captures are waiting", retryable=True),
        ProblemKind("too_many_requests", 429, "Too much is asked at once", retryable=True),
        ProblemKind("internal_error", 500, "The daemon has a defect"),
        ProblemKind("state_damaged", 500, "A file was damaged, and its copy is used", remedy=_DISK),
        ProblemKind("state_lost", 500, "A part of the state is damaged", remedy=_DISK),
        ProblemKind("display_failed", 503, "The panel failed", True, _PANEL),
        ProblemKind("inference_failed", 503, "The classifier gave no numbers", remedy=_BUNDLE),
        ProblemKind("light_unsteady", 503, "The light changed meanwhile", True, "adjust_light"),
        ProblemKind("not_ready", 503, "The camera takes no captures now", retryable=True),
        ProblemKind("panel_not_hiding", 503, "The panel does not hide the scene", True, _PANEL),
        ProblemKind("sensor_failed", 503, "No capture can be used", True, "check_camera_cable"),
        ProblemKind("storage_failed", 503, "The state's disk fails", True, _DISK),
    )
}
"""Every problem by its code."""


class ProblemError(Exception):
    """Problem that a caller is told of.

    Args:
        code: code of its row in the table.
        detail: cause and advice, in one line.
        remedy: advice that helps better than that of the table.
        retry_after: pause before the same request may succeed [s].
    """

    def __init__(
        self, code: str, detail: str, *, remedy: Remedy | None = None, retry_after: int = 1
    ) -> None:
        super().__init__(detail)
        self.kind = PROBLEMS[code]
        self.remedy, self.retry_after = remedy or self.kind.remedy, retry_after

    @property
    def code(self) -> str:
        """Code of its row in the table."""
        return self.kind.code


class NamedError(ProblemError):
    """Problem with a class of its own, by which the daemon itself catches it.

    Args:
        detail: cause and advice, in one line.
        remedy: advice that helps better than that of its class.
    """

    _code: ClassVar[str]
    _remedy: ClassVar[Remedy | None] = None

    def __init_subclass__(cls, *, code: str = "", remedy: Remedy | None = None) -> None:
        cls._code, cls._remedy = code or cls._code, remedy or cls._remedy

    def __init__(self, detail: str, *, remedy: Remedy | None = None) -> None:
        super().__init__(self._code, detail, remedy=remedy or self._remedy)


def remedy_for(error: BaseException) -> Remedy:
    """Return what helps against an error; one that nobody foresaw is a defect."""
    return error.remedy if isinstance(error, ProblemError) else "report_defect"


class StartError(Exception):
    """The daemon cannot start; one line that says what to do."""


class StorageError(NamedError, StartError, code="storage_failed"):
    """The state directory cannot be read or written; what it held before holds on."""


class CalibrationError(NamedError, code="calibration_impossible"):
    """A measurement or a record that cannot be used, or made; the message says what to do."""


class RotationImpossibleError(NamedError, code="conflict", remedy="install_bundle"):
    """There is no other mask to change to."""


class BundleRefusedError(NamedError, code="bundle_refused"):
    """A bundle that is damaged, of another camera, of no owner, or whose masks show the scene."""


class BundleOlderError(NamedError, code="bundle_older"):
    """A bundle of an older version than one that was in use."""


class UnknownBundleError(NamedError, code="not_found"):
    """There is no bundle of this digest."""


class UnauthorizedError(NamedError, code="unauthorized"):
    """No valid token came with the request; why it is not valid stays here."""

    def __init__(self) -> None:
        super().__init__(
            "this daemon wants a valid token as Authorization: Bearer; 'sudo veilcamd token first' "
            "on its machine makes the first"
        )


class ReplayingError(NamedError, code="not_enabled"):
    """Request that needs a camera, where there is a recording only."""

    def __init__(
        self, detail: str = "there is no panel and no sensor: this daemon replays a recording"
    ) -> None:
        super().__init__(detail)


class FenceError(NamedError, code="sensor_failed", remedy="wait"):
    """A measurement that was not wholly exposed under one settled mask; it is thrown away."""


class NotReadyError(NamedError, code="not_ready"):
    """The camera is in no state to take a capture."""


class SelfTestError(NotReadyError, remedy="check_panel_wiring"):
    """The panel does not hide the scene, or does not show what it is told."""


class UndecidedError(SelfTestError, remedy="adjust_light"):
    """The self test cannot tell, for want of light or of steady light."""


class UnwatchableError(SelfTestError, remedy="shield_light"):
    """Too much light comes past the masks to tell a panel that hides from one that does not."""


class UnsteadyLightError(UndecidedError, code="light_unsteady"):
    """The guard cannot tell whether the panel hid the scene; nothing failed."""


class PanelNotHidingError(NamedError, code="panel_not_hiding"):
    """The opaque panel lets as much light through as the mask; the panel was made safe."""


class InferenceError(NamedError, code="inference_failed"):
    """A classifier gave no numbers for a measurement."""
