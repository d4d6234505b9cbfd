"""A camera, a broker and webhooks, brought together."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Sequence
from dataclasses import replace

import httpx

from veilcam_client import AsyncCamera, VeilcamError
from veilcam_client.wire.events import Event, Fault, Gone, Seen, StateChanged
from veilcam_client.wire.watch import WatchOff
from veilcam_mqtt.discovery import BUTTONS, EVENT, ROTATE
from veilcam_mqtt.follower import Follower
from veilcam_mqtt.publisher import Publisher
from veilcam_mqtt.settings import Broker, Names
from veilcam_mqtt.view import View, event_payload
from veilcam_mqtt.webhooks import TIMEOUT, Delivery, Webhook

DIGITS = 12
"""Of the camera's key, in its name in the house."""

log = logging.getLogger("veilcam.mqtt")


class CameraChangedError(Exception):
    """Another camera answers at the same address: start anew, under its name."""


class Bridge:
    """Tells a house of a camera until it is cancelled.

    Args:
        camera: camera that repeats nothing by itself.
        broker: broker of the house.
        hooks: webhooks that get events.
        names: names of the camera in the house.
    """

    def __init__(
        self,
        camera: AsyncCamera,
        broker: Broker,
        hooks: Sequence[Webhook],
        names: Names,
    ) -> None:
        self._camera, self._broker, self._hooks, self._names = camera, broker, hooks, names
        self._first: asyncio.Future[View] = asyncio.get_running_loop().create_future()
        self._key: str | None = None
        self._publisher: Publisher | None = None
        self._deliveries: list[Delivery] = []
        self._pressed = {name: asyncio.Event() for name in BUTTONS}

    async def run(self) -> None:
        """Run until cancelled.

        Raises:
            CameraChangedError: another camera answers.
            ValueError: a certificate that cannot be used.
        """
        try:
            async with (
                httpx.AsyncClient(timeout=TIMEOUT, trust_env=False) as client,
                asyncio.TaskGroup() as tasks,
            ):
                self._deliveries = [Delivery(hook, client) for hook in self._hooks]
                for delivery in self._deliveries:
                    tasks.create_task(delivery.run())
                follower = Follower(self._camera, self._on_view, self._on_event)
                tasks.create_task(follower.run())
                for name in BUTTONS:
                    tasks.create_task(self._serve_button(name))
                view = await self._first
                self._key = view.status.device.key
                node = self._names.node or f"veilcam_{self._key[:DIGITS]}"
                self._names = replace(self._names, node=node)
                self._publisher = Publisher(self._broker, self._names, self._press)
                self._publisher.show(view)
                tasks.create_task(self._publisher.run())
        except* (CameraChangedError, ValueError) as errors:
            raise errors.exceptions[0] from None

    def _on_view(self, view: View) -> None:
        if not self._first.done():
            self._first.set_result(view)
        if self._publisher is None:
            return
        if view.status.device.key != self._key:
            raise CameraChangedError("another camera answers")
        self._publisher.show(view)

    def _on_event(self, event: Event) -> None:
        if isinstance(event, Seen | Gone) and self._publisher is not None:
            self._publisher.tell(self._names.topic(EVENT), event_payload(event))
        if isinstance(event, Seen | Gone | StateChanged | Fault):
            # The form of Standard Webhooks: type, timestamp, data.
            told = event.model_dump(mode="json", exclude={"kind", "at"})
            message = {"type": event.kind, "timestamp": event.at.isoformat(), "data": told}
            for delivery in self._deliveries:
                delivery.put(message)

    def _press(self, name: str) -> None:
        log.info("button %s", name)
        self._pressed[name].set()

    async def _serve_button(self, name: str) -> None:
        """Do what a button says; pressed again meanwhile, once more and no oftener."""
        pressed = self._pressed[name]
        while True:
            await pressed.wait()
            pressed.clear()
            try:
                if name == ROTATE:
                    await self._camera.rotation.advance()
                else:
                    await self._camera.watch.set(WatchOff())
            except VeilcamError as error:
                log.warning("button %s: %s", name, error)
