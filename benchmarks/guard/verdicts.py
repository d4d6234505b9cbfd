"""Verdicts of the guard on drawn light: broken panels, sound cameras, and the time to detection."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress

import numpy as np
import torch

from benchmarks.guard.world import FAULTS, Array, Lamp, Optics, Pattern, Rig, scenes, shipped
from veilcam_optics.camera.imperfections import Imperfections
from veilcam_server.camera.guard import WATCHABLE, expected_ratio
from veilcam_server.demo_data import BUNDLE, FRESH
from veilcam_server.errors import PanelNotHidingError, UnsteadyLightError

LIGHTS = (1.0, 0.1, 0.01)
MASKS, SCENES = 6, 20
Scene = tuple[str, Array]


def optics_of(random: np.random.Generator) -> list[Optics]:
    """Return both shipped cameras."""
    torch.set_num_threads(1)
    return [Optics(*shipped(path, random, MASKS)) for path in (BUNDLE, FRESH)]


def drawn(random: np.random.Generator) -> Iterator[Scene]:
    """Yield scenes of all kinds without end."""
    kinds = scenes(random, SCENES)
    names = list(kinds)
    while True:
        name = names[int(random.integers(len(names)))]
        yield name, kinds[name][random.integers(SCENES)]


def _rig(optics: Optics, scene: Array, random: np.random.Generator, *, lamp: Lamp) -> Rig:
    shading = random.uniform(0, 0.4)

    def light_of(pattern: Pattern) -> float:
        return pattern.light(scene, shading)

    offset = random.uniform(-1, 1) * 1e-4
    return Rig(optics, light_of, lamp, bypass=random.uniform(0, 0.2), offset=offset)


def _flickering(random: np.random.Generator) -> Lamp:
    return Lamp(random, flicker=random.uniform(0, 0.2), mains=float(random.choice((50.0, 60.0))))


def faults(
    optics: Sequence[Optics], random: np.random.Generator, changes: int, lights: Sequence[float]
) -> Counter[tuple[str, float, str]]:
    """Count answers behind broken panels: by fault, light, and what came of the first capture.

    Args:
        optics: of sound cameras.
        random: of everything.
        changes: mask changes, for each fault.
        lights: brightness of the scene.
    """
    found: Counter[tuple[str, float, str]] = Counter()
    sources = drawn(random)
    for fault in FAULTS:
        for change in range(changes):
            light = lights[change % len(lights)]
            for _ in range(100):
                camera = optics[int(random.integers(len(optics)))]
                rig = _rig(camera, next(sources)[1], random, lamp=_flickering(random))
                rig.now = random.uniform(0, 1)
                one, other = random.choice(len(camera.masks), 2, replace=False)
                if max(_ratio(rig, one), _ratio(rig, other)) <= WATCHABLE:
                    break
            # A verdict in full light, which holds in the dark for ten minutes.
            for rig.brightness in (1.0, light):
                with suppress(UnsteadyLightError):
                    rig.capture(one)
            if random.random() < 0.5:
                rig.guard.show(camera.masks[other])
            rig.now += random.exponential(0.3)
            rig.fault = fault
            for turn in range(3):
                try:
                    seen = rig.capture(other)
                except PanelNotHidingError:
                    found[fault, light, "accused"] += 1
                    break
                except UnsteadyLightError:
                    found[fault, light, "refused"] += 1
                else:
                    # A saturated capture is no answer: it is refused for its light.
                    name = "too dark" if seen.dark else "answered"
                    name = "saturated" if seen.saturated else name
                    found[fault, light, name if turn else f"{name} first"] += 1
    return found


def _ratio(rig: Rig, mask: int) -> float:
    return expected_ratio(rig.guard.leak, rig.optics.masks[mask], 64)


def answered(found: Counter[tuple[str, float, str]]) -> int:
    """Return answers behind a panel that does not hide, but in the dark."""
    return sum(count for (_, _, name), count in found.items() if name.startswith("answered"))


class Sound:
    """Sound cameras, drawn: floor to .2, gamma .8 to 1.6, bypass to .2, whose masks can be watched.

    Args:
        random: of everything.
        cameras: so many.
    """

    def __init__(self, random: np.random.Generator, cameras: int) -> None:
        self._random = random
        self.rigs: list[tuple[Rig, list[int], str]] = []
        self.worst, self.worst_camera, self.unwatchable = 0.0, "", 0
        sources = drawn(random)
        torch.set_num_threads(1)
        bundles = [shipped(path, random, MASKS) for path in (BUNDLE, FRESH)]
        while len({name for _, _, name in self.rigs}) < cameras:
            bundle, masks = bundles[int(random.integers(2))]
            built = Imperfections(
                contrast_floor=random.uniform(0, 0.2), gamma=random.uniform(0.8, 1.6)
            )
            pair = [masks[place] for place in random.choice(len(masks), 2, replace=False)]
            optics, bypass = Optics(bundle, pair, built), random.uniform(0, 0.2)
            name = (
                f"{bundle.mode}, floor {built.contrast_floor:.2f}, gamma {built.gamma:.2f}, "
                f"bypass {bypass:.2f}"
            )
            rigs = []
            for _ in range(10):
                rig = _rig(optics, next(sources)[1], random, lamp=_flickering(random))
                rig.bypass = bypass
                rig.__post_init__()
                rigs.append(rig)
            # One self test for all: its scene is not theirs.
            for rig in rigs:
                rig.guard.leak = rigs[0].guard.leak
            able = [mask for mask in (0, 1) if _ratio(rigs[0], mask) <= WATCHABLE]
            if not able:
                self.unwatchable += 1
                continue
            for rig in rigs:
                self.rigs.append((rig, able, name))
                for mask in able:
                    self._compare(rig, mask, name)

    def _compare(self, rig: Rig, mask: int, name: str) -> None:
        past = rig.bypass * rig.light_of(rig.optics.opened)
        ratio = (rig.light_of(rig.optics.opaque) + past) / (
            rig.light_of(rig.optics.shown[mask]) + past
        )
        if ratio > self.worst:
            self.worst, self.worst_camera = ratio, name

    def changes(self, count: int, rates: Sequence[float]) -> Counter[str]:
        """Take ``count`` captures with a mask each, under lamps switched at these rates [1/s]."""
        came: Counter[str] = Counter()
        random = self._random
        each = math.ceil(count / len(self.rigs))
        for place, (rig, able, _) in enumerate(self.rigs):
            rate = rates[place % len(rates)]
            steady = rig.lamp
            low = float(np.exp(random.uniform(np.log(1 / 30), np.log(0.5))))
            rig.lamp = Lamp(random, rate=rate, low=low, flicker=steady.flicker, mains=steady.mains)
            rig.now = 0.0
            for _ in range(min(each, count - sum(came.values()))):
                if random.random() < 0.5:
                    # A request that comes while the mask is shown; else it waits for the mask.
                    rig.guard.show(rig.optics.masks[able[-1]])
                    rig.now += random.exponential(0.5)
                try:
                    rig.capture(able[-1])
                    came[f"answered {rate}"] += 1
                except PanelNotHidingError:
                    came[f"accused {rate}"] += 1
                except UnsteadyLightError:
                    came[f"refused {rate}"] += 1
            rig.lamp = steady
        return came


def dark_curve(
    optics: Sequence[Optics], random: np.random.Generator, changes: int
) -> Mapping[float, float]:
    """Return the share of first captures behind a dead panel that are answered, by light."""
    curve = {}
    for light in np.geomspace(1e-4, 1, 9):
        found = faults(optics, random, changes, [float(light)])
        dark = sum(found[fault, float(light), "too dark first"] for fault in FAULTS)
        curve[float(light)] = dark / (changes * len(FAULTS))
    return curve


def detection(
    optics: Optics, random: np.random.Generator, every: float, tries: int
) -> tuple[Array, float]:
    """Return times from a fault to its refusal [s], and captures a second, of one guard interval.

    Requests come one after the other; masks do not change by themselves.

    Args:
        optics: of a sound camera.
        random: of everything.
        every: guard interval [s].
        tries: faults.
    """
    times: list[float] = []
    captures, took = 0, 0.0
    gray = np.full(784, 0.5)

    def light_of(pattern: Pattern) -> float:
        return pattern.light(gray, 0.0)

    for _ in range(tries):
        rig = Rig(optics, light_of, Lamp(random), every=every)
        rig.capture(0, last=False)
        begun = rig.now
        until = begun + random.uniform(1, 2) * max(every, 1.0)
        while rig.now < until:
            rig.capture(0, last=False)
            captures += 1
        took += rig.now - begun
        rig.fault, failed = "dead", rig.now
        try:
            while True:
                rig.capture(0, last=False)
        except PanelNotHidingError:
            times.append(rig.now - failed)
    return np.array(times), captures / took
