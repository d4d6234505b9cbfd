"""Client SDK for Veilcam: ask a privacy camera what it sees.

from veilcam_client import Camera

with Camera("http://127.0.0.1:8787") as camera:
    answer = camera.classify(include_embedding=True)
    print(answer.label, np.asarray(answer).shape)

Models of questions and answers are in ``veilcam_client.models``, events in ``.events``, errors in
``.errors``.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from veilcam_client import errors, events, models
    from veilcam_client.async_camera import AsyncCamera
    from veilcam_client.camera import Camera
    from veilcam_client.collecting import Shot, collect, held_before, labelled_pictures
    from veilcam_client.decoding import SceneDecoder
    from veilcam_client.discovery import FoundCamera
    from veilcam_client.errors import VeilcamError
    from veilcam_client.http.answers import RawResponse
    from veilcam_client.http.async_streams import AsyncEventStream
    from veilcam_client.http.options import DEFAULT_URL
    from veilcam_client.http.streams import EventStream
    from veilcam_client.keys.log import verify_log
    from veilcam_client.log_file import fetch_log
    from veilcam_client.recording import Recording, read_recording, record

    __version__: str

_MODULES = ("errors", "events", "models")
_OWNERS = {
    "AsyncCamera": "async_camera",
    "Camera": "camera",
    "Shot": "collecting",
    "collect": "collecting",
    "held_before": "collecting",
    "labelled_pictures": "collecting",
    "SceneDecoder": "decoding",
    "FoundCamera": "discovery",
    "VeilcamError": "errors",
    "RawResponse": "http.answers",
    "AsyncEventStream": "http.async_streams",
    "DEFAULT_URL": "http.options",
    "EventStream": "http.streams",
    "fetch_log": "log_file",
    "verify_log": "keys.log",
    "Recording": "recording",
    "read_recording": "recording",
    "record": "recording",
}
"""Modules of the public names, which are imported when a name is asked for (PEP 562): whoever needs
the words of the wire alone, as the daemon does, need not wait for HTTP."""

__all__ = [
    "DEFAULT_URL",
    "AsyncCamera",
    "AsyncEventStream",
    "Camera",
    "EventStream",
    "FoundCamera",
    "RawResponse",
    "Recording",
    "SceneDecoder",
    "Shot",
    "VeilcamError",
    "__version__",
    "collect",
    "errors",
    "events",
    "fetch_log",
    "held_before",
    "labelled_pictures",
    "models",
    "read_recording",
    "record",
    "verify_log",
]


def __getattr__(name: str) -> object:
    if name == "__version__":
        return import_module(f"{__name__}.wire.base").installed_version()
    if name in _MODULES:
        return import_module(f"{__name__}.{name}")
    if name in _OWNERS:
        return getattr(import_module(f"{__name__}.{_OWNERS[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
