"""Scenes planted before a simulated camera, and all that a real daemon answers over REST."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from http.client import HTTPConnection
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import numpy.typing as npt

from veilcam_client.keys.receivers import Receiver
from veilcam_client.wire.captures import NPY_MEDIA_TYPE
from veilcam_client.wire.rotation import RotationPolicy
from veilcam_client.wire.sealing import ReceiverRequest
from veilcam_client.wire.simulation import picture_bytes
from veilcam_server.demo.daemon import running
from veilcam_server.demo_data import load_digits
from veilcam_server.devices.simulated.scenes import write_scene

Picture = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Answer:
    """What came over the wire for one capture.

    Attributes:
        label: what was planted.
        waited: for the answer [s].
        headers: with the status line as the first, in their order.
        body: as it came.
    """

    label: int
    waited: float
    headers: tuple[tuple[str, str], ...]
    body: str


class Daemon:
    """A daemon that is asked over one connection, as a client does that does nothing else."""

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        self._connection = HTTPConnection(str(parts.hostname), parts.port)

    def ask(
        self, method: str, path: str, body: bytes = b"", media_type: str = "application/json"
    ) -> tuple[tuple[tuple[str, str], ...], str]:
        """Headers and body of an answer; raises RuntimeError where it is a refusal."""
        headers = {"Content-Type": media_type} if body else {}
        self._connection.request(method, path, body or None, headers)
        answer = self._connection.getresponse()
        text = answer.read().decode()
        if answer.status >= 400:
            raise RuntimeError(f"{method} {path}: {answer.status} {text}")
        return (("status", f"{answer.status} {answer.reason}"), *answer.getheaders()), text

    def show(self, picture: Picture) -> None:
        """Put a scene before the camera."""
        self.ask("PUT", "/v1/simulation/scene", picture_bytes(picture), NPY_MEDIA_TYPE)

    def pair(self, receiver: Receiver) -> None:
        """Seal to a receiver from the next mask on, and show that."""
        request = ReceiverRequest(label="proof", key=str(receiver))
        self.ask("POST", "/v1/receivers", request.model_dump_json().encode())
        self.ask("POST", "/v1/rotation/advance")

    def rotate(self, policy: RotationPolicy) -> None:
        """Change the policy, and show another mask."""
        self.ask("PUT", "/v1/rotation", policy.model_dump_json().encode())
        self.ask("POST", "/v1/rotation/advance")

    def capture(self, label: int = 0) -> Answer:
        """Take one capture."""
        begun = time.perf_counter()
        headers, body = self.ask("POST", "/v1/captures")
        return Answer(label, time.perf_counter() - begun, headers, body)

    def close(self) -> None:
        """Leave."""
        self._connection.close()


@contextmanager
def fresh_daemon(bundle: Path, folder: Path, receiver: Receiver) -> Iterator[Daemon]:
    """Yield a simulated daemon that releases ``sealed`` to a receiver.

    Every capture has a mask of its own; neither panel nor exposure takes any time.
    """
    folder.mkdir(parents=True, exist_ok=True)
    scene = folder / "scene.npy"
    write_scene(scene, load_digits().images[0])
    options = (
        "--scene-api",
        "--settle",
        "0",
        "--exposure",
        "0",
        "--every-captures",
        "1",
        "--release",
        "sealed",
    )
    with running(bundle, scene, folder, *options) as url:
        daemon = Daemon(url)
        try:
            daemon.pair(receiver)
            yield daemon
        finally:
            daemon.close()


def planted(
    daemon: Daemon, pictures: Sequence[Picture], labels: Sequence[int], record: Path
) -> Iterator[int]:
    """Show one picture after the other, and write what is answered for each.

    Args:
        daemon: that is asked.
        pictures: one for each capture.
        labels: of the pictures.
        record: JSON lines; what is in it already is not asked again.

    Yields:
        How many are done.
    """
    done = len(read_answers(record)) if record.exists() else 0
    record.parent.mkdir(parents=True, exist_ok=True)
    with record.open("a") as lines:
        for number in range(done, len(labels)):
            daemon.show(pictures[number])
            answer = daemon.capture(labels[number])
            lines.write(f"{json.dumps(asdict(answer))}\n")
            lines.flush()
            yield number + 1


def read_answers(record: Path) -> list[Answer]:
    """Read what :func:`planted` wrote; a last line that was cut off is taken away."""
    text = record.read_text()
    if not text.endswith("\n"):
        text = text[: text.rfind("\n") + 1]
        record.write_text(text)
    found = []
    for line in text.splitlines():
        content = json.loads(line)
        headers = tuple((name, value) for name, value in content.pop("headers"))
        found.append(Answer(**content, headers=headers))
    return found


def two_scenes(count: int, seed: int) -> list[int]:
    """Which of two scenes each capture sees: ``count`` times either, in a random order."""
    order = np.repeat([0, 1], count)
    np.random.default_rng(seed).shuffle(order)
    return [int(each) for each in order]
