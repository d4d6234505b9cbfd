"""Sizes and times of a daemon's encrypted answers and events: what they tell of the scene.

    python -m benchmarks.privacy.listener --figures benchmarks/results/privacy.json

A relay notes the time and the size of each TLS record. Its attacker learns on the first half of the
notes and is judged on the second. Another one asks every route with a token of each scope but
``classify``. Digits, CIFAR-10's names for the same classes, and two classes are served.
"""

from __future__ import annotations

import dataclasses
import io
import ssl
import threading
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any

import httpx
import numpy as np
import numpy.typing as npt
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.privacy.relay import Relay, certified
from benchmarks.rig import work_folder
from PIL import Image
from scipy.stats import norm

from veilcam_client.wire.tokens import SCOPES, Scope
from veilcam_server.demo.daemon import running
from veilcam_server.demo_data import FRESH, load_digits
from veilcam_server.devices.simulated.scenes import write_scene
from veilcam_server.security.tokens import TokenStore
from veilcam_training.attacks.intervals import area
from veilcam_training.bundle import Bundle, read_bundle, write_bundle

CIFAR = ("airplane", "automobile", "bird", "cat", "deer", "dog", "frog", "horse", "ship", "truck")
TWO = ("nobody", "a person")
EMPTY = np.full((28, 28), 64, np.uint8)
"""A lit wall."""
RATE, SECONDS = 2, 2.0
"""Looks in a second, and length of a window [s]."""
BEST = 4
"""Features that an attacker uses, the best of its first half."""
OWNER: tuple[Scope, ...] = ("read:status", "classify", "read:embedding", "mask:rotate", "simulate")
ASKED = {
    "classification": ("POST", "/v1/classifications", {}),
    "classification with embedding": (
        *("POST", "/v1/classifications"),
        {"include_embedding": True},
    ),
    "capture": ("POST", "/v1/captures", None),
    "watch": ("GET", "/v1/watch", None),
    "status": ("GET", "/v1/status", None),
    "diagnostics": ("GET", "/v1/diagnostics", None),
}

Floats = npt.NDArray[np.float64]
app = typer.Typer(pretty_exceptions_enable=False)


class Camera:
    """A daemon as shipped, behind TLS, and its owner, who holds scenes before it.

    Args:
        url: URL of the daemon.
        store: store of its tokens.
        clients: end of its clients.
    """

    def __init__(self, url: str, store: TokenStore, clients: ExitStack) -> None:
        self.url, self._store, self._clients = url, store, clients
        self.owner = self.client(OWNER)

    def client(self, scopes: Sequence[Scope], url: str | None = None) -> httpx.Client:
        """Return a client with a token of these scopes, through a relay if its URL is given."""
        token = self._store.create("listener", tuple(scopes), None).secret
        context = ssl.create_default_context()
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        headers = {"Authorization": f"Bearer {token}"}
        made = httpx.Client(base_url=url or self.url, verify=context, headers=headers, timeout=60)
        return self._clients.enter_context(made)

    def hold(self, image: npt.NDArray[np.uint8]) -> None:
        """Hold a picture before the camera."""
        held, headers = io.BytesIO(), {"Content-Type": "image/png"}
        Image.fromarray(image).save(held, "PNG")
        put = self.owner.put("/v1/simulation/scene", content=held.getvalue(), headers=headers)
        put.raise_for_status()


@contextmanager
def served(folder: Path, bundle: Bundle, *options: str) -> Iterator[Camera]:
    """Yield a camera that serves a bundle, with further options of the daemon."""
    folder.mkdir()
    file, scene = folder / "served.veilcam", folder / "scene.npy"
    write_bundle(file, bundle)
    write_scene(scene, EMPTY)
    paths = certified(folder)
    given = ("--auth", "tokens", "--scene-api", "--settle", "0", "--exposure", "0", *options)
    tls = ("--tls-certificate", str(paths[0]), "--tls-key", str(paths[1]))
    with ExitStack() as clients, running(file, scene, folder, *given, *tls) as url:
        yield Camera(url, TokenStore(folder / "state"), clients)


def bundles() -> dict[str, Bundle]:
    """Return the bundles that are served: the demo's, under three lists of names."""
    digits = dataclasses.replace(read_bundle(FRESH), card=None)
    fresh = digits.fresh
    if fresh is None:
        raise ValueError(f"{FRESH} holds no fresh masks")
    layers, weights = list(fresh.layers), dict(fresh.weights)
    place = max(at for at, layer in enumerate(layers) if "outputs" in vars(layer))
    layers[place] = layers[place].model_copy(update={"outputs": len(TWO)})
    weights[f"{place}.weight"] = weights[f"{place}.weight"][: len(TWO)]
    two = dataclasses.replace(fresh, layers=tuple(layers), weights=weights)
    return {
        "digits": digits,
        "cifar": dataclasses.replace(digits, labels=CIFAR),
        "two": dataclasses.replace(digits, labels=TWO, fresh=two),
    }


def attacked(features: Floats, kinds: npt.NDArray[np.int64]) -> Floats:
    """Return scores of the second half, (half, kinds), by a linear discriminant of the first.

    Args:
        features: features of each sample, (samples, features).
        kinds: true kind of each sample, from 0 on.
    """
    half = len(kinds) // 2
    low, middle, high = np.quantile(features[:half], (0.1, 0.5, 0.9), axis=0)
    scaled = np.clip((features - middle) / (high - low + 1e-9), -5, 5)
    learned = scaled[:half]
    groups = [learned[kinds[:half] == kind] for kind in range(int(kinds.max()) + 1)]
    means = np.array([group.mean(0) if len(group) else learned.mean(0) for group in groups])
    within = np.mean([(learned - means[kinds[:half]]) ** 2], axis=(0, 1))
    best = np.argsort(-means.var(0) / (within + 1e-6))[:BEST]
    spread = np.atleast_2d(np.cov((learned - means[kinds[:half]])[:, best], rowvar=False))
    inverse, chosen = np.linalg.inv(spread + 1e-3 * np.eye(len(best))), means[:, best]
    shares = np.log([(len(group) + 0.1) / half for group in groups])
    constant = shares - np.einsum("ki,ij,kj->k", chosen, inverse, chosen) / 2
    scores: Floats = scaled[half:][:, best] @ inverse @ chosen.T + constant
    return scores


def area_upper(features: Floats, kinds: npt.NDArray[np.bool_]) -> float:
    """Return the upper 95 % end of the attacker's area under the curve."""
    scores = attacked(features, kinds.astype(np.int64))
    value, error = area(scores[:, 1] - scores[:, 0], kinds[len(kinds) // 2 :])
    return float(value + norm.isf(0.05) * error)


def answers(camera: Camera, count: int, random: np.random.Generator) -> tuple[int, float]:
    """Return the most sizes of a route, and the attacker's gain from times, upper end [points].

    Args:
        camera: camera that is asked.
        count: classifications.
        random: generator of scenes.
    """
    relay, digits = Relay(camera.url), load_digits()
    client = camera.client((*OWNER, "read:scores"), relay.url)
    sizes: dict[str, set[tuple[int, ...]]] = defaultdict(set)
    times, labels = list[list[float]](), list[str]()

    def ask(*routes: str) -> None:
        for route in routes:
            method, path, body = ASKED[route]
            relay.taken()
            begun = time.monotonic()
            answer = client.request(method, path, json=body)
            records = relay.taken()
            sizes[route].add(tuple(size for _, size in records))
            if route == "classification" and answer.is_success:
                times.append([np.log(at - begun) for at, _ in (records[0], records[-1])])
                labels.append(answer.json()["label"])

    client.get("/healthz")
    for number in range(count):
        place = int(random.integers(len(digits)))
        camera.hold(digits.images[place] if random.random() < 0.9 else EMPTY)
        ask(*list(ASKED)[: None if number % 20 == 0 else 1])
    # While the sensor is unplugged, and in the dark.
    for broken in ({"sensor": {"gone": True}}, {}):
        camera.owner.put("/v1/simulation/faults", json=broken).raise_for_status()
        camera.hold(0 * EMPTY)
        ask(*ASKED)
    relay.close()
    for route, found in sizes.items():
        print(f"  {route:32}{len(found):3} sizes, as {min(found)}", flush=True)
    known = sorted(set(labels))
    kinds = np.array([known.index(label) for label in labels])
    truth = kinds[len(kinds) // 2 :]
    right, chance = attacked(np.array(times), kinds).argmax(1) == truth, np.bincount(truth).max()
    share, chance = float(right.mean()), float(chance / len(truth))
    print(f"  label from times: {share:.1%}, by chance {chance:.1%}", flush=True)
    error = np.sqrt(chance * (1 - chance) / len(truth))
    return max(map(len, sizes.values())), 100 * (share - chance + float(norm.isf(0.05) * error))


class Reader:
    """Reader of all that a token of each scope but ``classify`` may read.

    Args:
        camera: camera that is read.
    """

    def __init__(self, camera: Camera) -> None:
        self._asked, self._events = list[tuple[str, httpx.Client]](), list[float]()
        self._before: dict[str, float] = {}
        document = camera.owner.get("/v1/openapi.json").json()
        clients = {scope: camera.client([scope]) for scope in SCOPES if scope != "classify"}
        for path, operations in document["paths"].items():
            needed = operations.get("get", {}).get("security", ())
            scopes = [scope for each in needed for scope in each["token"] if scope in clients]
            if path not in ("/v1/events", "/v1/openapi.json", "/v1/doctor") and "{" not in path:
                self._asked += [(path, clients[scope]) for scope in scopes]
        follow(clients["read:status"], self._events)

    def features(self) -> dict[str, float]:
        """Return every number that can be read, and its change since the last call."""
        found: dict[str, float] = {}
        for path, client in self._asked:
            answer = client.get(path)
            if "json" in answer.headers["content-type"]:
                found |= _numbers(path, answer.json())
            else:
                lines = (line.rsplit(" ", 1) for line in answer.text.splitlines() if line[0] != "#")
                found |= {f"{path} {name}": float(value) for name, value in lines}
        times, self._events[:] = np.array(self._events), []
        found |= {f"events {place}": value for place, value in enumerate(_gaps(times))}
        before, self._before = self._before, found
        return found | {f"d {name}": value - before.get(name, 0) for name, value in found.items()}


def follow(client: httpx.Client, times: list[float]) -> None:
    """Note the time of each event on a thread, until the daemon ends."""

    def listen() -> None:
        with suppress(httpx.HTTPError), client.stream("GET", "/v1/events", timeout=None) as answer:
            for line in answer.iter_lines():
                times.extend([time.monotonic()] if line.startswith("event:") else ())

    threading.Thread(target=listen, daemon=True).start()


def _numbers(name: str, value: Any) -> dict[str, float]:
    if isinstance(value, dict):
        return {
            k: v for key, one in value.items() for k, v in _numbers(f"{name} {key}", one).items()
        }
    return {name: float(value or 0) if isinstance(value, int | float) else float(len(value or ()))}


def _gaps(times: Floats) -> tuple[float, float, float, float]:
    """Return the number of times, and deviation, mean and maximum of the gaps between them."""
    gaps = np.diff(times) if len(times) > 1 else np.zeros(1)
    return float(len(times)), float(gaps.std()), float(gaps.mean()), float(gaps.max())


def windows(camera: Camera, count: int, random: np.random.Generator) -> dict[str, float]:
    """Return what a listener to a stream, and tokens without ``classify``, learn of presence.

    Args:
        camera: camera that looks by itself.
        count: windows, each with a digit or an empty wall.
        random: generator of scenes.
    """
    relay, digits, reader, events = Relay(camera.url), load_digits(), Reader(camera), list[float]()
    follow(camera.client(("read:status", "classify"), relay.url), events)
    time.sleep(3.0)
    present = random.random(count) < 0.5
    heard, read = list[list[float]](), list[dict[str, float]]()
    sizes, began = list[int](), time.monotonic()
    relay.taken()
    for there in present:
        # No picture comes twice in a row: the simulation may remember one.
        wall = EMPTY + random.integers(8, size=EMPTY.shape, dtype=np.uint8)
        camera.hold(digits.images[int(random.integers(len(digits)))] if there else wall)
        time.sleep(SECONDS)
        read.append(reader.features())
        times, noted = zip(*(relay.taken() or [(0.0, 0)]), strict=True)
        sizes += noted
        heard.append([*_gaps(np.array(times)), *np.diff(times, prepend=times[0])[:8].tolist()])
        heard[-1] += [0.0] * (12 - len(heard[-1])) + [float(sum(noted)), float(max(noted))]
    lasted = time.monotonic() - began
    relay.close()
    changed = np.diff(present.astype(int), prepend=int(present[0])) != 0
    names = sorted(set.intersection(*(set(each) for each in read)))
    told = np.array([[each[name] for name in names] for each in read])
    print(f"events: sizes {sorted(set(sizes))}, {len(sizes)} records; {len(names)} numbers read")
    return {
        "listener, presence": area_upper(np.array(heard), present),
        "listener, changes": area_upper(np.array(heard), changed),
        "tokens, presence": area_upper(told, present),
        "tokens, changes": area_upper(told, changed),
        "event sizes": len(set(sizes)),
        "a day": sum(sizes) / lasted * 86400 / 1e6,
    }


@app.command()
def measure(
    *,
    requests: Annotated[int, typer.Option(help="Classifications of all bundles together.")] = 4000,
    count: Annotated[int, typer.Option("--windows", help="Windows with or without a digit.")] = 400,
    beat: Annotated[str, typer.Option(help="Setting of the daemon: on or off.")] = "on",
    quick: Annotated[bool, typer.Option("--quick", help="A few requests and windows.")] = False,
    seed: Annotated[int, typer.Option(help="Seed of scenes.")] = 1,
    figures: FiguresOption = None,
) -> None:
    """Listen to daemons behind TLS."""
    random, made = np.random.default_rng(seed), bundles()
    requests, count = (60, 12) if quick else (requests, count)
    most, gains = 0, list[float]()
    watch = ("--watch", f"{RATE}/s", "--beat", beat)
    with work_folder() as folder:
        for name, bundle in made.items() if requests else ():
            print(name, flush=True)
            with served(folder / name, bundle) as camera:
                sizes, gain = answers(camera, requests // len(made), random)
            most, gains = max(most, sizes), [*gains, gain]
        with served(folder / "watch", made["digits"], *watch) as camera:
            told = windows(camera, count, random)
    print("\n".join(f"{name:20}{value:9.3f}" for name, value in told.items()))
    found = {
        "listener_sizes_a_route": max(most, told["event sizes"]),
        "listener_label_advantage_upper": max(gains, default=0.0),
        "listener_presence_auc_upper": max(told["listener, presence"], told["listener, changes"]),
        "status_presence_auc_upper": max(told["tokens, presence"], told["tokens, changes"]),
        "beat_mb_per_day": told["a day"],
    }
    print("\n".join(f"{name:32}{value:9.3f}" for name, value in found.items()))
    record(figures, {name: round(value, 3) for name, value in found.items()})


if __name__ == "__main__":
    app()
