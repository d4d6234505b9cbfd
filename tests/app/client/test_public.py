"""What the SDK promises to the outside."""

from __future__ import annotations

import copy
import inspect
import pickle
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import veilcam_client
from veilcam_client import (
    AsyncCamera,
    AsyncEventStream,
    Camera,
    EventStream,
    VeilcamError,
    errors,
    events,
    models,
)
from veilcam_client.cli.terminal import EXIT_CODES, FORGED
from veilcam_client.errors import ApiError, FieldError
from veilcam_client.resources import Resource

PACKAGE = Path(veilcam_client.__file__).parent


SNAPSHOT = Path(__file__).with_name("public_api.txt")


def public_api() -> str:
    """Every public name, with the signatures of functions, and methods and fields of classes."""
    lines = []
    for module in (veilcam_client, errors, events, models):
        lines.append(f"[{module.__name__}]")
        defined = [name for name in vars(module) if name[0].isupper()]
        for name in sorted(getattr(module, "__all__", defined)):
            thing = getattr(module, name)
            lines.append(f"{name}{signature(thing) if inspect.isfunction(thing) else ''}")
            if inspect.isclass(thing):
                lines += [f"    {member}" for member in members(thing)]
    for kind in resources():
        lines += [f"[{kind.__name__}]", *(f"    {member}" for member in members(kind))]
    return "\n".join(lines) + "\n"


def resources() -> list[type]:
    """Classes of the resources of a synchronous camera."""
    found = vars(Camera("http://camera.local")).values()
    return [type(each) for each in found if isinstance(each, Resource)]


def members(kind: type) -> list[str]:
    fields = [f"{each}: {of}" for each, of in inspect.get_annotations(kind).items()]
    own = {name: value for name, value in vars(kind).items() if name[0] != "_"}
    methods = [
        name + (signature(getattr(kind, name)) if inspect.isroutine(value) else "")
        for name, value in own.items()
        if inspect.isroutine(value) or isinstance(value, property)
    ]
    return sorted(each for each in (*fields, *methods) if each[0] != "_")


def signature(function: Callable[..., object]) -> str:
    return re.sub(r" at 0x[0-9a-f]+", "", str(inspect.signature(function)))


def test_public_api_is_that_of_the_snapshot() -> None:
    # Changed on purpose? Then: python -m tests.app.client.test_public
    assert public_api() == SNAPSHOT.read_text()


def surface(kind: type) -> dict[str, list[str]]:
    return {
        name: [
            f"{each.name}:{each.kind}:{each.default}"
            for each in inspect.signature(member).parameters.values()
        ]
        for name, member in inspect.getmembers(kind, inspect.isfunction)
        if not name.startswith("_") or name == "__init__"
    }


@pytest.mark.parametrize("kinds", [(Camera, AsyncCamera), (EventStream, AsyncEventStream)])
def test_sync_and_async_have_the_same_surface(kinds: tuple[type, type]) -> None:
    sync, of_asyncio = kinds
    assert surface(sync) == surface(of_asyncio)
    assert properties(sync) == properties(of_asyncio)


def test_sync_and_async_have_the_same_resources() -> None:
    own, of_asyncio = vars(Camera("http://x")), vars(AsyncCamera("http://x"))
    assert set(own) == set(of_asyncio)
    found = {name: type(each) for name, each in own.items() if isinstance(each, Resource)}
    assert set(found) == {
        *("bundles", "tokens", "receivers", "calibration", "rotation", "watch", "log"),
        *("lease", "simulation"),
    }
    for name, kind in found.items():
        assert surface(kind) == surface(type(of_asyncio[name]))
        assert type(of_asyncio[name]).__name__ == f"Async{kind.__name__}"


def properties(kind: type) -> set[str]:
    return {name for name, _ in inspect.getmembers(kind, lambda each: isinstance(each, property))}


@pytest.mark.parametrize("kind", [Camera, *resources()])
def test_every_method_that_asks_takes_a_timeout(kind: type) -> None:
    asking = {
        name
        for name, parameters in surface(kind).items()
        if any(each.startswith("timeout:") for each in parameters)
    } - {"__init__"}
    assert asking == set(surface(kind)) - {"__init__", "close", "events", "raw"}


def test_generated_files_are_up_to_date() -> None:
    # Changed a file of async_*? Then: python client/unasync.py
    command = [sys.executable, str(PACKAGE.parent / "unasync.py"), "--check"]
    assert subprocess.run(command, check=False).returncode == 0


def test_httpx_is_known_to_one_room() -> None:
    imported = re.compile(r"^\s*(import|from) (httpx|httpcore)\b", re.MULTILINE)
    importers = (path for path in PACKAGE.rglob("*.py") if imported.search(path.read_text()))
    assert {path.parent.name for path in importers} == {"http"}


def every(kind: type[VeilcamError]) -> list[type[VeilcamError]]:
    return [kind, *(each for below in kind.__subclasses__() for each in every(below))]


def error_of(kind: type[VeilcamError]) -> VeilcamError:
    told: dict[str, Any] = {
        "code": "c",
        "status": 429,
        "request_id": "r1",
        "retryable": True,
        "retry_after": 1.5,
    }
    if issubclass(kind, ApiError):
        return kind("why", **told, errors=(FieldError("body.seconds", "too small"),))
    return kind("why", **(told if kind is VeilcamError else {}))


@pytest.mark.parametrize("kind", every(VeilcamError))
def test_error_survives_pickling_and_copying(kind: type[VeilcamError]) -> None:
    error = error_of(kind)
    for again in (pickle.loads(pickle.dumps(error)), copy.deepcopy(error)):
        assert type(again) is kind
        assert (str(again), vars(again)) == ("why", vars(error))


def test_every_error_has_one_of_at_most_eight_exit_codes() -> None:
    assert set(every(VeilcamError)) == {kind for kind, _ in EXIT_CODES}
    assert {0, FORGED, *(code for _, code in EXIT_CODES)} <= set(range(8))
    for kind, code in EXIT_CODES:
        assert next(code for each, code in EXIT_CODES if issubclass(kind, each)) == code


def test_tree_of_errors_is_drawn() -> None:
    drawn = re.findall(r"^ *``(\w+)``", errors.__doc__ or "", re.MULTILINE)
    assert set(drawn) == {kind.__name__ for kind in every(VeilcamError)}
    assert len(drawn) <= 12


def test_top_of_the_package_has_forty_names_at_most() -> None:
    assert len(veilcam_client.__all__) <= 40


def test_package_is_typed() -> None:
    assert (PACKAGE / "py.typed").exists()


if __name__ == "__main__":
    SNAPSHOT.write_text(public_api())
