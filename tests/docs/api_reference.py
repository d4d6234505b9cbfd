"""Page of every operation with a line of curl, one of Python, and an answer.

python -m tests.docs.api_reference, and docs/api-reference.md is that of the API as it is.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from veilcam_server.api.app import create_app
from veilcam_server.api.openapi import document
from veilcam_server.daemon import build_service
from veilcam_server.demo_data import BUNDLE, load_digits
from veilcam_server.devices.simulated.scenes import write_scene
from veilcam_server.settings import Settings

PAGE = Path(__file__).resolve().parents[2] / "docs" / "api-reference.md"
OPENING = """# Every operation, with a line of curl and one of Python

`python -m tests.docs.api_reference` writes this page from the OpenAPI document of the daemon, which
also shows it under `/docs`, offline and to who is logged in. Both lines of each operation are run
against a simulated camera, and answers are checked against the document
(`tests/app/server/api/test_samples.py`). What an answer means, and what can go wrong:
[the API](api.md).

`$TOKEN` is a token of `veilcamd token create`. In Python:

```python
import httpx
from pathlib import Path
from veilcam_client import Camera
from veilcam_client.models import EverySeconds, Faults, PanelFaults, Watching

camera = Camera(token=token)
```
"""
LONGEST = 1200


def page(found: Mapping[str, Any]) -> str:
    parts = [OPENING]
    for tag in found["tags"]:
        parts.append(f"## {tag['name']}\n\n{tag['description']}\n")
        parts.extend(_operations(found, tag["name"]))
    return "\n".join(parts)


def _operations(found: Mapping[str, Any], tag: str) -> Iterator[str]:
    for path, operations in found["paths"].items():
        for method, operation in operations.items():
            if operation["tags"] == [tag]:
                yield _operation(f"{method.upper()} {path}", operation)


def _operation(name: str, operation: Mapping[str, Any]) -> str:
    lines = {each["lang"]: each["source"] for each in operation["x-codeSamples"]}
    status = next(status for status in operation["responses"] if status < "300")
    about = operation["description"].split("\n\n")[0].replace("\n", " ")
    parts = [f"### {operation['operationId']}\n", f"`{name}`: {about}\n"]
    parts += [f"```sh\n{lines['curl']}\n```\n", f"```python\n{lines['Python']}\n```\n"]
    answer = _answer(operation["responses"][status].get("content", {}))
    parts.append(f"It answers {status}" + (f":\n\n{answer}\n" if answer else ".\n"))
    return "\n".join(parts)


def _answer(content: Mapping[str, Any]) -> str:
    for media_type, told in content.items():
        for example in told.get("examples", {}).values():
            text = json.dumps(example["value"], indent=2)
            cut = text if len(text) <= LONGEST else text[:LONGEST].rpartition("\n")[0] + "\n  ..."
            return f"```json\n{cut}\n```"
        if "example" in told:
            return f"```\n{told['example'].strip()}\n```"
        if media_type == "application/json":
            return "the OpenAPI document."
    return ""


def present() -> dict[str, Any]:
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_scene(folder / "scene.npy", load_digits().images[0])
        settings = Settings(
            device="simulated",
            bundle=BUNDLE,
            scenes=(str(folder / "scene.npy"),),
            state_dir=folder / "state",
            settle=0.0,
            exposure=0.0,
        )
        service = build_service(settings)
        try:
            return document(create_app(service))
        finally:
            service.stop()


if __name__ == "__main__":
    PAGE.write_text(page(present()))
