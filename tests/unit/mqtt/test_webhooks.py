"""Events that are posted to somebody else's server."""

from __future__ import annotations

import asyncio
import base64
import json
from collections.abc import Iterable

import httpx
import pytest

from veilcam_mqtt.webhooks import PAUSES, WAITING, Delivery, Webhook

SECRET = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"
URL = "https://house.example/hook?key=hidden"


def test_signature_is_that_of_standard_webhooks() -> None:
    # The example of the specification's libraries.
    headers = Webhook(URL, SECRET).headers(
        "msg_p5jXN8AQM9LWM0D4loKWxJek", 1614265330, b'{"test": 2432232314}'
    )
    assert headers == {
        "Content-Type": "application/json",
        "webhook-id": "msg_p5jXN8AQM9LWM0D4loKWxJek",
        "webhook-timestamp": "1614265330",
        "webhook-signature": "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE=",
    }


@pytest.mark.parametrize(
    ("url", "secret"),
    [
        ("house.example", SECRET),
        ("ftp://house.example", SECRET),
        (URL, "MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"),
        (URL, "whsec_no base64"),
        (URL, f"whsec_{base64.b64encode(bytes(23)).decode()}"),
        (URL, f"whsec_{base64.b64encode(bytes(65)).decode()}"),
        (URL, ""),
    ],
)
def test_invalid_webhook_is_refused_without_its_secret(url: str, secret: str) -> None:
    with pytest.raises(ValueError, match="not valid") as refused:
        Webhook(url, secret)
    assert not secret or secret not in str(refused.value)
    assert "hidden" not in str(refused.value)


class Receiver:
    """Answers with what it is told to, and then with 204."""

    def __init__(self, answers: Iterable[int | Exception]) -> None:
        self._answers = list(answers)
        self.got: list[httpx.Request] = []
        self.paused: list[float] = []
        self.now = 1000.0

    def __call__(self, request: httpx.Request) -> httpx.Response:
        self.got.append(request)
        answer = self._answers.pop(0) if self._answers else 204
        if isinstance(answer, Exception):
            raise answer
        return httpx.Response(answer, headers={"location": "https://elsewhere.example"})

    async def sleep(self, seconds: float) -> None:
        self.paused.append(seconds)
        self.now += seconds

    def deliver(self, *events: object) -> None:
        async def run() -> None:
            async with httpx.AsyncClient(transport=httpx.MockTransport(self)) as client:
                delivery = Delivery(Webhook(URL, SECRET), client, self.sleep, lambda: self.now)
                for event in events:
                    delivery.put(event)
                task = asyncio.create_task(delivery.run())
                await delivery._waiting.join()
                task.cancel()

        asyncio.run(run())


def test_event_is_posted_once_where_it_is_taken() -> None:
    receiver = Receiver([])
    receiver.deliver({"type": "seen"}, {"type": "gone"})
    told = [json.loads(request.content) for request in receiver.got]
    assert told == [{"type": "seen"}, {"type": "gone"}]
    assert receiver.paused == []
    assert len({request.headers["webhook-id"] for request in receiver.got}) == 2


@pytest.mark.parametrize("failure", [500, 503, 429, httpx.ConnectError("no"), TimeoutError()])
def test_failed_event_is_repeated_under_its_id(failure: int | Exception) -> None:
    receiver = Receiver([failure, failure])
    receiver.deliver({"type": "seen"})
    assert receiver.paused == list(PAUSES[:2])
    assert len({request.headers["webhook-id"] for request in receiver.got}) == 1
    # Signed anew: receivers refuse what is old.
    times = [request.headers["webhook-timestamp"] for request in receiver.got]
    assert times == ["1000", "1001", "1006"]


def test_repetitions_have_an_end(caplog: pytest.LogCaptureFixture) -> None:
    receiver = Receiver([500] * 20)
    receiver.deliver({"type": "seen"}, {"type": "gone"})
    assert receiver.paused == [*PAUSES, *PAUSES]
    assert len(receiver.got) == 2 * (len(PAUSES) + 1)
    assert [record.getMessage() for record in caplog.records] == 2 * [
        "webhook house.example: HTTP 500: an event is dropped"
    ]


@pytest.mark.parametrize("status", [301, 400, 401, 404, 410])
def test_refused_event_is_not_repeated_and_no_redirection_followed(status: int) -> None:
    receiver = Receiver([status])
    receiver.deliver({"type": "seen"})
    assert [request.url.host for request in receiver.got] == ["house.example"]


def test_oldest_event_is_dropped_where_too_many_wait() -> None:
    receiver = Receiver([])
    receiver.deliver(*range(WAITING + 3))
    assert [json.loads(request.content) for request in receiver.got] == list(range(3, WAITING + 3))
