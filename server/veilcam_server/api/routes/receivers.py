"""REST API of receivers: to whom the keys of epochs are sealed."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path, Request
from fastapi.responses import Response

from veilcam_client.wire.sealing import PairedReceiver, ReceiverRequest, Receivers
from veilcam_server.api.dependencies import BODY, CHANGE, OnceDep, ServiceDep, problems, requires

_CHANGE = (*CHANGE, "not_enabled")

ReceiverId = Annotated[str, Path(pattern=r"^[0-9a-f]{64}$", examples=["0f" * 32])]

router = APIRouter(prefix="/v1/receivers", redirect_slashes=False, tags=["Receivers"])


@router.get("", dependencies=[requires("read:status")], responses=problems("not_enabled"))
async def receivers(service: ServiceDep) -> Receivers:
    """Every receiver, and the device, whose key receivers check."""
    return service.pairing.all()


@router.post(
    "",
    status_code=201,
    dependencies=[requires("admin:receivers")],
    responses=problems(*BODY, *_CHANGE, "conflict"),
)
async def add_receiver(
    request: Request, service: ServiceDep, once: OnceDep, question: ReceiverRequest
) -> PairedReceiver:
    """Seal to this receiver, too, from the next epoch on."""
    made = await once(lambda: service.pairing.add(question))
    request.state.noted = {"receiver": made.id, "named": made.label}
    return made


@router.delete(
    "/{receiver_id}",
    status_code=204,
    response_class=Response,  # JSON's would name a media type of nothing
    dependencies=[requires("admin:receivers")],
    responses=problems(*_CHANGE, "invalid_request", "not_found"),
)
async def remove_receiver(service: ServiceDep, receiver_id: ReceiverId) -> None:
    """Seal nothing more to this receiver, from the next epoch on; what it has it can open."""
    await service.pairing.remove(receiver_id)
