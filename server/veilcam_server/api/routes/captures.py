"""REST API of captures and classifications."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Header, Request
from fastapi.responses import Response

from veilcam_client.wire.captures import (
    NPY_MEDIA_TYPE,
    Capture,
    Classification,
    ClassificationRequest,
    Embedding,
)
from veilcam_client.wire.sealing import Release
from veilcam_server.api.dependencies import (
    BODY,
    DEVICE,
    CallerDep,
    OnceDep,
    ServiceDep,
    problems,
    requires,
    scores_for,
    unleased,
)
from veilcam_server.errors import ProblemError
from veilcam_server.security.tokens import Caller
from veilcam_server.service.service import Service

_REFUSALS = (*BODY, "leased", *DEVICE, "not_enabled", "embedding_withheld", "masks_spent")

router = APIRouter(prefix="/v1", redirect_slashes=False, tags=["Captures"])


@router.post(
    "/captures",
    dependencies=[requires("read:embedding"), unleased()],
    response_model=Capture,
    responses={
        200: {"content": {NPY_MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}}}},
        **problems(*_REFUSALS, "not_acceptable"),
    },
)
async def capture(
    request: Request,
    service: ServiceDep,
    caller: CallerDep,
    once: OnceDep,
    accept: Annotated[str, Header()] = "*/*",
) -> Response:
    """Take one embedding; ``Accept: application/x-npy`` gives the array alone, as float32.

    A sealed embedding is no array: it comes as JSON, where that is accepted too.
    """
    _require_embedding(caller, service)
    media_type = preferred(accept, ("application/json", NPY_MEDIA_TYPE))
    if media_type is None:
        raise ProblemError(
            "not_acceptable", f"captures come as application/json or {NPY_MEDIA_TYPE}"
        )
    array_alone = preferred(accept, ("application/json",)) is None
    request.state.embedding = service.release == "sealed" or media_type != NPY_MEDIA_TYPE
    if array_alone:
        _require_array(service.release)
    taken = await once(lambda: service.capture(caller.id))
    # Another receiver may have been paired since, or one before the mask that is shown.
    if media_type == NPY_MEDIA_TYPE and isinstance(taken.embedding, Embedding):
        return _array(taken, taken.embedding)
    if array_alone:
        _require_array(taken.embedding.form)
    return Response(taken.model_dump_json(), media_type="application/json")


def _array(taken: Capture, embedding: Embedding) -> Response:
    """Return the array of a capture as the body, and all else in headers."""
    buffer = io.BytesIO()
    np.save(buffer, np.asarray(embedding), allow_pickle=False)
    names = {
        "Veilcam-Capture": taken.id,
        "Veilcam-Epoch": taken.epoch,
        "Veilcam-Number": str(taken.number),
        "Veilcam-Taken-At": taken.taken_at.isoformat(),
        "Veilcam-Form": embedding.form,
    }
    if taken.replay is not None:
        names["Veilcam-Replay"] = str(taken.replay.place)
        names["Veilcam-Replay-Capture"] = taken.replay.capture
    return Response(buffer.getvalue(), headers=names, media_type=NPY_MEDIA_TYPE)


@router.post(
    "/classifications",
    dependencies=[requires("classify"), unleased()],
    responses=problems(*_REFUSALS, "inference_failed"),
)
async def classify(
    request: Request,
    service: ServiceDep,
    caller: CallerDep,
    once: OnceDep,
    question: ClassificationRequest | None = None,
) -> Classification:
    """Take one embedding and classify it with what reads behind its own mask.

    Scores are told for `read:scores`, in tenths unless the daemon tells them in full.
    """
    include_embedding = question is not None and question.include_embedding
    request.state.embedding = include_embedding
    if include_embedding:
        _require_embedding(caller, service)
    scores = scores_for(caller)
    return await once(
        lambda: service.classify(
            include_embedding=include_embedding, scores=scores, caller=caller.id
        )
    )


def _require_array(form: Release) -> None:
    if form == "sealed":
        raise ProblemError(
            "not_acceptable",
            "embeddings leave sealed, which are no arrays: accept application/json, and open them "
            "with a receiver's private key",
        )


def _require_embedding(caller: Caller, service: Service) -> None:
    """Before anything is captured: what leaves here must not leave for this caller otherwise."""
    caller.require("read:embedding")
    if service.release == "raw":
        caller.require("read:embedding:raw")


def preferred(accept: str, offers: Sequence[str]) -> str | None:
    """Return the offer with the highest quality, the first of equals, or None if none will do.

    Args:
        accept: the Accept header, e.g. ``application/x-npy, application/json;q=0.5``.
        offers: media types in order of the server's own preference.
    """
    ranges = [_parse(item) for item in accept.split(",")]
    best, best_quality = None, 0.0
    for offer in offers:
        # The most specific range decides, whatever its quality.
        matches = [
            (specific, quality)
            for pattern, quality in ranges
            if (specific := _match(pattern, offer))
        ]
        quality = max(matches, default=(0, 0.0))[1]
        if quality > best_quality:
            best, best_quality = offer, quality
    return best


def _parse(item: str) -> tuple[str, float]:
    media_type, *parameters = (part.strip().lower() for part in item.split(";"))
    for parameter in parameters:
        if parameter.startswith("q="):
            try:
                return media_type, min(1.0, max(0.0, float(parameter[2:])))
            except ValueError:
                return media_type, 0.0
    return media_type, 1.0


def _match(pattern: str, offer: str) -> int:
    """3 for the type itself, 2 for its family, 1 for anything, 0 for no match."""
    if pattern == offer:
        return 3
    if pattern == f"{offer.partition('/')[0]}/*":
        return 2
    return 1 if pattern == "*/*" else 0
