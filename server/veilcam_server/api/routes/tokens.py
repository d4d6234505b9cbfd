"""REST API of tokens. Their methods touch the disk, hence plain functions on the thread pool."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from fastapi import APIRouter, Depends, Path, Query
from fastapi.concurrency import run_in_threadpool

from veilcam_client.wire.tokens import (
    MOST_TOKENS,
    TOKENS_AT_ONCE,
    NewToken,
    Token,
    TokenRequest,
    Tokens,
)
from veilcam_server.api.dependencies import (
    BODY,
    CHANGE,
    AdmissionDep,
    CallerDep,
    OnceDep,
    problems,
    requires,
)
from veilcam_server.errors import ProblemError
from veilcam_server.security.tokens import Caller, TokenStore


async def _store(admission: AdmissionDep) -> TokenStore:
    if admission.tokens is None:
        raise ProblemError(
            "not_enabled",
            "this daemon wants no tokens: start it with --auth tokens, or use 'veilcamd token'",
        )
    return admission.tokens


StoreDep = Annotated[TokenStore, Depends(_store)]
ID = r"^[0-9a-f]{12}$"
TokenId = Annotated[str, Path(pattern=ID, examples=["0123456789ab"])]

router = APIRouter(
    prefix="/v1/tokens",
    dependencies=[requires("admin:tokens")],
    redirect_slashes=False,
    tags=["Tokens"],
)


@router.get("", responses=problems("invalid_request", "not_found", "not_enabled"))
def tokens(
    store: StoreDep,
    limit: Annotated[int, Query(ge=1, le=MOST_TOKENS)] = TOKENS_AT_ONCE,
    after: Annotated[str | None, Query(pattern=ID)] = None,
) -> Tokens:
    """Tokens without their secrets, the oldest first, revoked and expired ones included.

    `next` of one answer is `after` of the request for those that follow.
    """
    every = store.tokens()
    begin = 0 if after is None else _place(every, after) + 1
    page = every[begin : begin + limit]
    more = begin + limit < len(every)
    return Tokens(tokens=page, next=page[-1].id if more else None)


@router.post("", status_code=201, responses=problems(*BODY, *CHANGE, "not_enabled"))
async def create_token(
    store: StoreDep,
    caller: CallerDep,
    once: OnceDep,
    question: TokenRequest,
) -> NewToken:
    """Make a token. It allows no more than the caller's own, and lasts no longer."""

    async def work() -> NewToken:
        return await run_in_threadpool(
            store.create, question.label, question.allowed, question.seconds
        )

    _require_no_more(question, caller, store)
    return await once(work)


@router.delete(
    "/{token_id}", responses=problems(*CHANGE, "invalid_request", "not_found", "not_enabled")
)
def revoke_token(store: StoreDep, token_id: TokenId) -> Token:
    """Let a token do nothing any more, from the next request on."""
    return store.revoke(token_id)


def _place(tokens: Sequence[Token], token_id: str) -> int:
    for place, token in enumerate(tokens):
        if token.id == token_id:
            return place
    raise ProblemError("not_found", "there is no token of this id any more: begin without 'after'")


def _require_no_more(question: TokenRequest, caller: Caller, store: TokenStore) -> None:
    for scope in question.allowed:
        caller.require(scope)
    left = store.lifetime(caller)
    if left is not None and (question.seconds is None or question.seconds > left):
        raise ProblemError(
            "forbidden", f"this token ends in {left:.0f} s and makes none that lasts longer"
        )
