"""Camera in this process, which programs of the SDK cannot tell from one on a Raspberry Pi."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self, get_args

import httpx
from anyio.from_thread import start_blocking_portal

from veilcam_client import AsyncCamera, Camera
from veilcam_client.wire.rotation import RotationOff, RotationPolicy
from veilcam_client.wire.simulation import Faults
from veilcam_client.wire.tokens import Scope
from veilcam_server.api.app import create_app
from veilcam_server.daemon import build_service
from veilcam_server.demo_data import load_digits
from veilcam_server.devices.simulated.scenes import write_scene
from veilcam_server.security.admission import Admission, open_admission
from veilcam_server.settings import GivenSettings
from veilcam_server.system import logs
from veilcam_server.system.state_file import make_directory
from veilcam_server.testing.transport import AppTransport, AsyncAppTransport, Door

_PROMPT: Mapping[str, object] = {
    "device": "simulated",
    "scene_api": True,
    "settle": 0.0,
    "exposure": 0.0,
    "heartbeat": 1.0,
}
"""A simulated device that tests may break, and that waits for nothing."""


class FakeCamera:
    """A whole daemon within a context: gate, tokens, masks, simulated panel and sensor, events.

    It sees a handwritten digit. ``camera().simulation`` holds up another scene, or breaks it:
    ``hold_scene(...)``, ``set_faults(...)``. It logs as ``logging`` is told to.

    Args:
        settings: settings of ``veilcamd serve``, by the names of the environment in lower case, as
            ``{"auth": "tokens"}``. What the environment says does not count.

    Raises:
        ValueError: settings that cannot be (on creation).
        StartError: the daemon does not start (on entering).
    """

    def __init__(self, settings: Mapping[str, object] | None = None) -> None:
        self._settings = GivenSettings.model_validate({**_PROMPT, **(settings or {})})
        self._stack = ExitStack()
        self._door: Door | None = None
        self._admission: Admission | None = None
        self._rotation: RotationPolicy = RotationOff()

    def __enter__(self) -> Self:
        with ExitStack() as undo:
            undo.enter_context(logs.within_a_program())
            settings = self._settings
            if "state_dir" not in settings.model_fields_set:
                folder = undo.enter_context(tempfile.TemporaryDirectory(prefix="veilcam-fake-"))
                settings = settings.model_copy(update={"state_dir": Path(folder) / "state"})
            if not settings.scenes and not settings.scene_file.exists():
                make_directory(settings.state_dir)
                write_scene(settings.scene_file, load_digits().images[0])
            service = build_service(settings)
            undo.callback(service.stop)
            self._admission = undo.enter_context(open_admission(settings, service.report))
            app = create_app(service, self._admission)
            portal = undo.enter_context(start_blocking_portal())
            undo.enter_context(portal.wrap_async_context_manager(app.router.lifespan_context(app)))
            undo.callback(portal.call, service.end_streams)
            self._door = Door(app, portal)
            with self.camera(token=self._any_token) as camera:
                self._rotation = camera.rotation.get().policy
            self._stack = undo.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._door = None
        self._stack.close()

    def camera(self, **options: Any) -> Camera:
        """Return a ``Camera`` of this one; ``options`` are those of :class:`Camera`."""
        return Camera("http://localhost", http_client=self.http_client(), **options)

    def async_camera(self, **options: Any) -> AsyncCamera:
        """Return an ``AsyncCamera`` of this one; ``options`` are those of :class:`AsyncCamera`."""
        return AsyncCamera("http://localhost", http_client=self.async_http_client(), **options)

    def put_back(self) -> None:
        """Undo what tests do most: a scene, faults, another rotation policy, a lease.

        Masks that were shown, tokens, receivers and bundles stay as they are.
        """
        with self.camera(token=self._any_token) as camera:
            camera.lease.revoke()
            camera.simulation.hold_scene(None)
            camera.simulation.set_faults(Faults())
            camera.rotation.set(self._rotation)

    def http_client(self) -> httpx.Client:
        """Return an HTTP client for a ``Camera(http_client=...)`` of one's own."""
        return httpx.Client(transport=AppTransport(self._open_door), base_url="http://localhost")

    def async_http_client(self) -> httpx.AsyncClient:
        """Return an HTTP client for an ``AsyncCamera(http_client=...)`` of one's own."""
        return httpx.AsyncClient(
            transport=AsyncAppTransport(self._open_door), base_url="http://localhost"
        )

    def token(self, scopes: Sequence[Scope], label: str = "test") -> str:
        """Secret of a new token; for a camera with ``{"auth": "tokens"}``."""
        tokens = None if self._admission is None else self._admission.tokens
        if tokens is None:
            raise ValueError('this camera wants no tokens: FakeCamera({"auth": "tokens"})')
        return tokens.create(label, tuple(scopes), None).secret

    @property
    def _any_token(self) -> str | None:
        """One that may do everything, where a token is wanted."""
        return self.token(get_args(Scope)) if self._settings.auth == "tokens" else None

    @property
    def _open_door(self) -> Door:
        if self._door is None:
            raise ValueError("this camera is off: use it within its context")
        return self._door
