"""One broker, kept told for ever: retained messages as they should be, events as they happen."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections import deque
from collections.abc import Callable

import aiomqtt

from veilcam_mqtt.discovery import BRIDGE, BUTTONS, OFFLINE, ONLINE, PRESS
from veilcam_mqtt.settings import Attempts, Broker, Names
from veilcam_mqtt.view import AGE_STEP, View

KEEPALIVE = 15
"""Longest silence on the connection [s]: a broker that hangs is noticed within 1.5 of it."""
TIMEOUT = 5.0
"""For an answer of the broker [s]."""
EVENTS = 64
"""That may wait to be sent; older ones are dropped."""
REFUSED = 128
"""Answer to a subscription that is not allowed (MQTT 3.1.1, 3.9.3)."""

log = logging.getLogger("veilcam.mqtt")


class Publisher:
    """Tells a broker what is known of a camera, and hears its buttons.

    What the broker was told is forgotten with each connection, and when Home Assistant comes up: a
    broker that was killed has lost it. Events wait for no broker.

    Args:
        broker: address of the broker.
        names: names of the topics.
        on_press: called with the name of a button that was pressed.
        clock: monotonic time [s].
    """

    def __init__(
        self,
        broker: Broker,
        names: Names,
        on_press: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._broker, self._names, self._on_press, self._clock = broker, names, on_press, clock
        self._tls = broker.tls()
        self._view: View | None = None
        self._held: dict[str, str] = {}
        self._events: deque[tuple[str, str]] = deque(maxlen=EVENTS)
        self._connected = False
        self._news = asyncio.Event()

    def show(self, view: View) -> None:
        """Have the retained messages say this from now on."""
        self._view = view
        self._news.set()

    def tell(self, topic: str, payload: str) -> None:
        """Send an event, which is not retained; to a broker that is not there it is not sent."""
        if self._connected:
            self._events.append((topic, payload))
            self._news.set()

    async def run(self) -> None:
        """Keep the broker told for ever; one that goes is waited for."""
        attempts = Attempts("broker")
        while True:
            connected: float | None = None
            try:
                async with self._client() as client:
                    log.info("broker: connected to %s", self._broker.host)
                    connected = self._clock()
                    await self._session(client)
            except* (aiomqtt.MqttError, OSError) as errors:
                reason = str(errors.exceptions[0])
            finally:
                self._connected = False
                self._events.clear()
            lasted = None if connected is None else self._clock() - connected
            await attempts.failed(reason, lasted=lasted)

    def _client(self) -> aiomqtt.Client:
        return aiomqtt.Client(
            self._broker.host,
            self._broker.port,
            username=self._broker.username,
            password=self._broker.password,
            # One name: a connection that lingers ends, and says its last will, when this one comes.
            identifier=self._names.node,
            will=aiomqtt.Will(self._names.topic(BRIDGE), OFFLINE, qos=1, retain=True),
            keepalive=KEEPALIVE,
            timeout=TIMEOUT,
            tls_context=self._tls,
            max_queued_incoming_messages=EVENTS,
        )

    async def _session(self, client: aiomqtt.Client) -> None:
        """Until the broker goes, or nobody wants to tell it anything any more."""
        self._held.clear()
        self._connected = True
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._receive(client))
                tasks.create_task(self._publish(client))
        except asyncio.CancelledError:
            with contextlib.suppress(aiomqtt.MqttError):
                await client.publish(self._names.topic(BRIDGE), OFFLINE, qos=1, retain=True)
            raise

    async def _receive(self, client: aiomqtt.Client) -> None:
        buttons = {self._names.topic(name): name for name in BUTTONS}
        topics = [self._names.birth, *buttons]
        granted = await client.subscribe([(topic, 1) for topic in topics])
        for topic, code in zip(topics, granted, strict=True):
            if code == REFUSED:
                log.warning("broker: %s may not be read: see its access rules", topic)
        async for message in client.messages:
            topic, payload = message.topic.value, message.payload
            if topic == self._names.birth and payload == ONLINE.encode():
                self._held.clear()
                self._news.set()
            # What is retained was pressed some other day.
            elif topic in buttons and payload == PRESS.encode() and not message.retain:
                self._on_press(buttons[topic])

    async def _publish(self, client: aiomqtt.Client) -> None:
        while True:
            self._news.clear()
            for topic, payload in self._wanted().items():
                if self._held.get(topic) != payload:
                    # First, so that what is forgotten meanwhile stays forgotten.
                    self._held[topic] = payload
                    await client.publish(topic, payload, qos=1, retain=True)
            while self._events:
                await client.publish(*self._events.popleft(), qos=1, retain=False)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(AGE_STEP):
                    await self._news.wait()

    def _wanted(self) -> dict[str, str]:
        if self._view is None:
            return {}
        told = self._view.messages(self._names, self._clock())
        return {**told, self._names.topic(BRIDGE): ONLINE}
