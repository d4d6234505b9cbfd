"""REST API of pairing: an owner's offer, and the claim of whoever has its line."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated
from urllib.parse import urlsplit

from fastapi import APIRouter, Depends, Request
from fastapi.concurrency import run_in_threadpool

from veilcam_client.wire.pairing import (
    Paired,
    PairingClaim,
    PairingOffer,
    PairingRequest,
    is_loopback,
)
from veilcam_client.wire.tokens import ROLES
from veilcam_server.api.dependencies import (
    BODY,
    CHANGE,
    AdmissionDep,
    CallerDep,
    OnceDep,
    ServiceDep,
    open_problems,
    problems,
    requires,
)
from veilcam_server.errors import ProblemError
from veilcam_server.sealing.receivers import Pairing, parse_receiver
from veilcam_server.security.pairing import PairingOffers, WrongClaimError

PREFIX = "/v1/pairing"
CLAIM = f"{PREFIX}/claim"


async def _pairing(service: ServiceDep) -> Pairing:
    return service.pairing


async def _offers(admission: AdmissionDep) -> PairingOffers:
    if admission.offers is None:
        raise ProblemError(
            "not_enabled", "this daemon pairs nobody: start it without --release none"
        )
    return admission.offers


OffersDep = Annotated[PairingOffers, Depends(_offers)]
PairingDep = Annotated[Pairing, Depends(_pairing)]
router = APIRouter(prefix=PREFIX, redirect_slashes=False, tags=["Receivers"])


@router.post(
    "",
    status_code=201,
    dependencies=[requires("admin:receivers"), requires("admin:tokens"), Depends(_pairing)],
    responses=problems(*BODY, *CHANGE, "not_enabled", "conflict"),
)
async def offer_pairing(
    request: Request,
    offers: OffersDep,
    caller: CallerDep,
    once: OnceDep,
    question: PairingRequest,
) -> PairingOffer:
    """Offer to pair one receiver, for five minutes. It ends the offer that was open before.

    Its token allows no more than the caller's own, and lasts no longer.
    """
    for scope in ROLES[question.role]:
        caller.require(scope)
    place = _place(request, offers)
    made = await once(lambda: run_in_threadpool(offers.make, place, question.role, caller.id))
    request.state.noted = {"role": made.role}
    return made


@router.post(
    "/claim",
    status_code=201,
    responses=open_problems(
        *("unauthorized", "too_many_requests", "body_too_large", "invalid_request"),
        *(*CHANGE, "not_enabled", "conflict"),
    ),
)
async def claim_pairing(
    request: Request, offers: OffersDep, pairing: PairingDep, question: PairingClaim
) -> Paired:
    """Pair the receiver of whoever has the line of an open offer; it wants no token.

    Three wrong claims end the offer. One that fails for another reason leaves it open.
    """
    # First of all: a wrong key is told whether an offer is open or not.
    parse_receiver(question.key)
    try:
        paired, token = await run_in_threadpool(_pair, offers, pairing, question)
    except WrongClaimError as error:
        if error.ended:
            request.state.noted = {"offer": "ended"}
        raise
    noted = {"receiver": paired.receiver.id, "named": paired.receiver.label, "role": paired.role}
    request.state.noted = noted if token is None else {**noted, "token": token}
    return paired


def _pair(
    offers: PairingOffers, pairing: Pairing, question: PairingClaim
) -> tuple[Paired, str | None]:
    """Return what the claim is answered with, and the id of its token."""
    with offers.claimed(question.secret) as offer:
        with offer.token(question.label) as token:
            made = pairing.pair(question)
        pairing.renew()
    secret, token_id = (None, None) if token is None else (token.secret, token.id)
    paired = Paired(device=pairing.device, receiver=made, role=offer.role, token=secret)
    return paired, token_id


def _place(request: Request, offers: PairingOffers) -> str:
    """Return the place that a line leads to: the one that this request came to."""
    server = (request.scope.get("server") or ("",))[0]
    if server.startswith("/"):
        return str(Path(server).resolve())
    tls = request.url.scheme == "https"
    host = request.headers["host"].lower()
    # A browser names the place that it asks, also where a proxy asks in its stead.
    origins = [urlsplit(each).netloc for each in request.headers.getlist("origin")]
    if not (tls and offers.certificate) and not all(map(is_loopback, (host, *origins))):
        raise ProblemError(
            "conflict",
            "this request came over plain HTTP, maybe from a proxy, and a line would name no "
            "certificate: use 'veilcam receiver add', or 'veilcamd pair' on the camera's machine",
        )
    return host if re.search(r":\d+$", host) else f"{host}:{443 if tls else 80}"
