"""Simulated camera for tests: a daemon in a thread of this process, on a unix socket."""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Self, get_args

import uvicorn
from starlette.types import ASGIApp

from veilcam_client import AsyncCamera, Camera
from veilcam_client.wire.rotation import RotationOff, RotationPolicy
from veilcam_client.wire.simulation import Faults
from veilcam_client.wire.tokens import Scope
from veilcam_server.api.app import create_app
from veilcam_server.daemon import build_service
from veilcam_server.demo_data import load_digits
from veilcam_server.devices.simulated.scenes import write_scene
from veilcam_server.errors import StartError
from veilcam_server.security.admission import Admission, open_admission
from veilcam_server.settings import GivenSettings
from veilcam_server.system import logs
from veilcam_server.system.state_file import make_directory

_PROMPT: Mapping[str, object] = {
    "device": "simulated",
    "scene_api": True,
    "settle": 0.0,
    "exposure": 0.0,
}
"""A simulated device that tests may break, and that waits for nothing."""


class FakeCamera:
    """Whole daemon within a context: tokens, masks, simulated panel and sensor, events.

    It sees a handwritten digit. ``camera().simulation`` holds up another scene, or breaks it:
    ``hold_scene(...)``, ``set_faults(...)``. It logs as ``logging`` is told to.

    Args:
        settings: settings of ``veilcamd serve``, by the names of the environment in lower case, as
            ``{"auth": "tokens"}``. The environment itself does not count.

    Raises:
        ValueError: settings that cannot be (on creation).
        StartError: the daemon does not start (on entering).
    """

    def __init__(self, settings: Mapping[str, object] | None = None) -> None:
        self._settings = GivenSettings.model_validate({**_PROMPT, **(settings or {})})
        self._stack = ExitStack()
        self._url: str | None = None
        self._admission: Admission | None = None
        self._rotation: RotationPolicy = RotationOff()

    def __enter__(self) -> Self:
        with ExitStack() as undo:
            undo.enter_context(logs.within_a_program())
            settings = self._settings
            folder = Path(undo.enter_context(tempfile.TemporaryDirectory(prefix="veilcam-fake-")))
            if "state_dir" not in settings.model_fields_set:
                settings = settings.model_copy(update={"state_dir": folder / "state"})
            if not settings.scenes and not settings.scene_file.exists():
                make_directory(settings.state_dir)
                write_scene(settings.scene_file, load_digits().images[0])
            service = build_service(settings)
            undo.callback(service.stop)
            self._admission = undo.enter_context(
                open_admission(settings, service.log, service.report)
            )
            app = create_app(service, self._admission)
            self._url = undo.enter_context(_served(app, folder / "api.sock"))
            undo.callback(service.end_streams)
            with self.camera(token=self._any_token) as camera:
                self._rotation = camera.rotation.get().policy
            self._stack = undo.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._url = None
        self._stack.close()

    @property
    def url(self) -> str:
        """URL of the camera; raises :class:`ValueError` outside its context."""
        if self._url is None:
            raise ValueError("this camera is off: use it within its context")
        return self._url

    def camera(self, **options: Any) -> Camera:
        """Return a ``Camera`` of this one; ``options`` are those of :class:`Camera`."""
        return Camera(self.url, **options)

    def async_camera(self, **options: Any) -> AsyncCamera:
        """Return an ``AsyncCamera`` of this one; ``options`` are those of :class:`AsyncCamera`."""
        return AsyncCamera(self.url, **options)

    def put_back(self) -> None:
        """Undo what tests do most: a scene, faults, another rotation policy, a lease.

        Masks that were shown, tokens, receivers and bundles stay as they are.
        """
        with self.camera(token=self._any_token) as camera:
            camera.lease.revoke()
            camera.simulation.hold_scene(None)
            camera.simulation.set_faults(Faults())
            camera.rotation.set(self._rotation)

    def token(self, scopes: Sequence[Scope], label: str = "test") -> str:
        """Return the secret of a new token, for a camera with ``{"auth": "tokens"}``."""
        tokens = None if self._admission is None else self._admission.tokens
        if tokens is None:
            raise ValueError('this camera wants no tokens: FakeCamera({"auth": "tokens"})')
        return tokens.create(label, tuple(scopes), None).secret

    @property
    def _any_token(self) -> str | None:
        """Token with every scope, where a token is wanted."""
        return self.token(get_args(Scope)) if self._settings.auth == "tokens" else None


@contextmanager
def _served(app: ASGIApp, path: Path) -> Iterator[str]:
    """Serve an application on a unix socket, in a thread, and yield its URL."""
    config = uvicorn.Config(
        app,
        uds=str(path),
        http="h11",
        ws="none",
        log_config=None,
        access_log=False,
        timeout_graceful_shutdown=1,
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, name="fake camera")
    thread.start()
    try:
        while thread.is_alive() and not server.started:
            time.sleep(0.01)
        if not server.started:
            raise StartError("the application does not start: its log says why")
        yield f"unix://{path}"
    finally:
        server.should_exit = True
        thread.join()
