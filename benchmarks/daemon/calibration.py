"""Accuracy of the simulated camera with every knob turned, before and after it measured itself.

    python -m benchmarks.daemon.calibration measure RECORD
    python -m benchmarks.daemon.calibration chart RECORD docs/images/calibration.png
    python -m benchmarks.daemon.calibration picture docs/images/calibration-record.png

where RECORD is ``benchmarks/results/daemon-calibration.json``.

The bundle of fresh masks that comes along, held-out digits, a new mask for every five of them.
What is read came through bytes on the bus, the panel's memory, light that takes another route than
decoders, 12-bit frames and binning. The same measurements are decoded twice: for the nominal camera
and for the camera as ``calibrate`` found it, with the black level and gain that it found. Where a
calibration is refused, there is no "after".
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import torch
import typer
from benchmarks.figures import record_figures
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from veilcam_client.keys.epoch_key import KEY_BYTES, EpochKey
from veilcam_optics.camera.imperfections import Imperfections
from veilcam_server.calibration.measurements import Budget
from veilcam_server.calibration.plot import write_picture
from veilcam_server.calibration.procedure import Calibrated, calibrate
from veilcam_server.calibration.record import imperfections_of
from veilcam_server.calibration.rig import CalibrationScene, Geometry
from veilcam_server.demo_data import FRESH, load_digits
from veilcam_server.devices.base import Device, Measurement
from veilcam_server.devices.corrected import CalibratedSensor
from veilcam_server.devices.simulated.device import Conditions, simulated_device
from veilcam_server.devices.simulated.light import planned_light
from veilcam_server.errors import CalibrationError
from veilcam_server.masks.fresh import FreshReader, FreshSource
from veilcam_training.bundle import Bundle, read_bundle

SETTLE, SCAN, EXPOSURE = 0.05, 0.0123, 0.01
"""Of the simulated panel and sensor [s]."""
BUDGET = Budget(repeats=1, samples=3)
PER_MASK = 5


@dataclass(frozen=True)
class Knob:
    """What is wrong with a camera."""

    title: str
    optical: Mapping[str, Any] = field(default_factory=dict)
    hardware: Mapping[str, Any] = field(default_factory=dict)
    leakage: float = 0.0
    headroom: float = 1.1
    """What saturates a pixel, over the brightest one behind the open panel."""


KNOBS: Mapping[str, Knob] = {
    "drawn": Knob("nominal"),
    "shift_y_37um": Knob("mask 37 um (1/2 row) off along y", {"shift_y": 36.5e-6}),
    "shift_y_150um": Knob("mask 150 um (2 rows) off along y", {"shift_y": 150e-6}),
    "shift_x_55um": Knob("mask 55 um (1/4 column) off along x", {"shift_x": 55e-6}),
    "rotation_3mrad": Knob("mask turned by 3 mrad", {"rotation": 3e-3}),
    "rotation_10mrad": Knob("mask turned by 10 mrad", {"rotation": 10e-3}),
    "distance_200um": Knob("sensor 0.2 mm too far", {"distance_error": 200e-6}),
    "gamma_1.4": Knob("gamma 1.4", {"gamma": 1.4}),
    "gamma_2.2": Knob("gamma 2.2", {"gamma": 2.2}),
    "floor_0.15": Knob("contrast floor 0.15", {"contrast_floor": 0.15}),
    "dead_lines": Knob(
        "a row and a column stuck open",
        {"dead_rows": (20,), "dead_columns": (8,), "dead_transmittance": 1.0},
    ),
    "dark_light": Knob("exposed for 0.7 of the light", hardware={"full_scale": 0.7}),
    "everything": Knob(
        "several of these at once",
        {
            "shift_y": 80e-6,
            "shift_x": -60e-6,
            "rotation": 4e-3,
            "distance_error": 100e-6,
            "gamma": 1.4,
            "contrast_floor": 0.08,
            "dead_rows": (20,),
            "dead_transmittance": 0.08,
        },
    ),
    "leakage_0.2": Knob("filters leak 20 % of the amplitude", leakage=0.2),
    "stray_0.1": Knob("10 % stray light", {"stray_light": 0.1}),
    "warm_up_0.1": Knob("10 % of the light missing at first", hardware={"warm_up": 0.1}),
    "warm_up_0.3": Knob("30 % of the light missing at first", hardware={"warm_up": 0.3}),
    # Noise of a pixel is four times that of a measurement: at the usual headroom some saturate.
    "noise_30db": Knob("signal to noise 30 dB, not 40", hardware={"snr_db": 30.0}, headroom=2.0),
}
"""Leakage, warm-up and noise are not measured by a calibration."""


BADLY_BUILT = Knob(
    "built badly",
    {
        "shift_y": 60e-6,
        "shift_x": -90e-6,
        "rotation": 4e-3,
        "distance_error": 120e-6,
        "gamma": 1.3,
        "contrast_floor": 0.08,
        "dead_rows": (20,),
        "dead_transmittance": 1.0,
    },
)


class Clock:
    """Time that passes only when somebody waits."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        """Now [s]."""
        return self.now

    def sleep(self, seconds: float) -> None:
        """Wait."""
        self.now += seconds


class Held:
    """What is in front of the camera."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.image: npt.NDArray[np.float32] = np.zeros(shape, np.float32)

    def read(self) -> npt.NDArray[np.float32]:
        """Return it."""
        return self.image

    def present(self, scene: CalibrationScene) -> None:
        """Hold up what a calibration asks for."""
        self.image = scene.image


@dataclass
class Tally:
    """Right labels and errors of decoded scenes."""

    right: int = 0
    error: float = 0.0
    power: float = 0.0
    count: int = 0

    def add(
        self,
        reader: FreshReader,
        measurement: Measurement,
        image: npt.NDArray[np.float32],
        label: str,
    ) -> None:
        """Classify a measurement, and compare its decoded scene with the image."""
        self.right += reader.classify(measurement).label == label
        estimate = reader.decoder(measurement[None])[0]
        self.error += float(np.square(estimate - image).sum())
        self.power += float(np.square(image - reader.decoder.mean.reshape(image.shape)).sum())
        self.count += 1

    @property
    def accuracy(self) -> float:
        """Share of right labels."""
        return self.right / self.count

    @property
    def unexplained(self) -> float:
        """Error of the decoded scenes, relative to what tells them from the mean scene."""
        return math.sqrt(self.error / self.power)


class Bench:
    """One simulated camera with one knob turned."""

    def __init__(self, bundle: Bundle, knob: Knob) -> None:
        self.bundle, self.clock, self.held = bundle, Clock(), Held(bundle.scene.shape)
        hardware = dict(knob.hardware)
        brighter = hardware.pop("full_scale", 1.0)
        panel = replace(bundle.camera.panel, filter_leakage=knob.leakage)
        camera = replace(bundle.camera, panel=panel)
        light = planned_light(camera, bundle.scene, bundle.embedding, Imperfections(**knob.optical))
        with torch.no_grad():
            opened = light.response(torch.ones(camera.mask_shape))
            white = light.collect(torch.ones((1, *bundle.scene.shape)), opened)
        self.device: Device = simulated_device(
            light,
            self.held,
            camera=camera,
            embedding=bundle.embedding,
            conditions=Conditions(
                **{"settle": SETTLE, "scan": SCAN, "exposure": EXPOSURE} | hardware
            ),
            full_scale=knob.headroom * float(white.max()),
            seed=1,
            clock=self.clock,
            sleep=self.clock.sleep,
        )
        if brighter != 1:
            # A converter that gives other numbers for the same light.
            sensor = CalibratedSensor(
                self.device.sensor, black_level=0.0, gain=1 / brighter, stray_light=0.0
            )
            self.device = replace(self.device, sensor=sensor)

    def calibrate(self, budget: Budget = BUDGET) -> Calibrated:
        """Measure the camera with itself; raises :class:`CalibrationError`."""
        bundle = self.bundle
        return calibrate(
            self.device,
            Geometry(bundle.camera, bundle.scene, bundle.embedding),
            self.held.present,
            longest=0.2,
            exposure=EXPOSURE,
            budget=budget,
            clock=self.clock,
        )

    def read(self, masks: int, found: Calibrated | None) -> tuple[Tally, Tally | None]:
        """Read digits behind fresh masks, decoded as nominal and as found."""
        digits, random = load_digits(), np.random.default_rng(7)
        drawn = FreshSource(self.bundle)
        before = Tally()
        settle = SETTLE + SCAN
        built, after = None, None
        if found is not None:
            record = found.record
            built = FreshSource(self.bundle, imperfections=imperfections_of(record))
            after = Tally()
            settle = record.settling_s.value + record.settling_s.uncertainty
        chosen = iter(random.choice(len(digits), masks * PER_MASK, replace=False))
        for _ in range(masks):
            key = EpochKey(random.bytes(KEY_BYTES), device="0" * 64, bundle=drawn.bundle)
            mask = drawn.make(key, frozenset())
            assert isinstance(mask.reader, FreshReader)
            other = built.make(key, frozenset()).reader if built is not None else None
            shown = self.device.display.show(mask.levels).completed_at
            for index in [next(chosen) for _ in range(PER_MASK)]:
                image = digits.images[index] / np.float32(255)
                label = str(digits.labels[index])
                self.held.image = image
                measurement = self.device.sensor.capture(shown + settle, 5.0).embedding
                before.add(mask.reader, measurement, image, label)
                if found is not None and after is not None and isinstance(other, FreshReader):
                    record = found.record
                    corrected = CalibratedSensor.of(self.device.sensor, record).corrected(
                        measurement
                    )
                    after.add(other, corrected, image, label)
        return before, after


app = typer.Typer(pretty_exceptions_enable=False)


@app.command()
def measure(
    figures: Annotated[Path, typer.Argument(help="Record to write into.")],
    *,
    masks: Annotated[int, typer.Option(min=1, help="Fresh masks for each knob.")] = 60,
    knob: Annotated[
        list[str] | None, typer.Option(help="One knob, or several; all if none.")
    ] = None,
) -> None:
    """Turn every knob, calibrate, and read digits."""
    torch.set_num_threads(1)
    bundle = read_bundle(FRESH)
    for name in knob or list(KNOBS):
        bench = Bench(bundle, KNOBS[name])
        found: Calibrated | None
        try:
            found = bench.calibrate()
        except CalibrationError as error:
            found = None
            print(f"{name}: refused: {error}", flush=True)
        before, after = bench.read(masks, found)
        values = {
            f"{name}_before": before.accuracy,
            f"{name}_before_unexplained": before.unexplained,
        }
        line = f"{name}: {before.accuracy:.4f}, scene {before.unexplained:.3f}"
        if after is not None and found is not None:
            values |= {
                f"{name}_after": after.accuracy,
                f"{name}_after_unexplained": after.unexplained,
                f"{name}_psf_residual": found.record.psf_residual,
            }
            line += f" -> {after.accuracy:.4f}, {after.unexplained:.3f}; {_summary(found)}"
        else:
            values[f"{name}_refused"] = 1.0
        print(line, flush=True)
        record_figures(figures, values)


def _summary(found: Calibrated) -> str:
    record = found.record
    return (
        f"shift {1e6 * record.shift_y_m.value:.1f} {1e6 * record.shift_x_m.value:.1f} um, "
        f"rotation {1e3 * record.rotation_rad.value:.2f} mrad, "
        f"distance {1e6 * record.distance_error_m.value:.0f} um, gamma {record.gamma.value:.3f}, "
        f"floor {record.contrast_floor.value:.3f}, gain {record.gain.value:.3f}, "
        f"stray {100 * record.stray_light.value:.2f} %, "
        f"dead {record.dead_rows} {record.dead_columns}, lamp {record.psf_residual:.3f}"
    )


@app.command()
def picture(
    out: Annotated[Path, typer.Argument(help="PNG to draw.")],
) -> None:
    """Draw the calibration of a camera that was built badly."""
    torch.set_num_threads(1)
    found = Bench(read_bundle(FRESH), BADLY_BUILT).calibrate(Budget(repeats=1))
    write_picture(out, found)
    print(_summary(found))


@app.command()
def chart(
    figures: Annotated[Path, typer.Argument(help="Record to draw.")],
    picture: Annotated[Path, typer.Argument(help="PNG to draw.")],
) -> None:
    """Draw accuracy and error of decoded scenes before and after, one line for each knob."""
    values = {name: entry["value"] for name, entry in json.loads(figures.read_text()).items()}
    known = [name for name in KNOBS if f"{name}_before" in values]
    figure = Figure(figsize=(11, 1.2 + 0.36 * len(known)), facecolor="white", dpi=120)
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, sharey=True)
    figure.subplots_adjust(left=0.28, right=0.98, top=0.9, bottom=0.1, wspace=0.06)
    for axes, suffix, scale, label in (
        (left, "", 100, "digits read right [%]"),
        (right, "_unexplained", 1, "error of the decoded scene, over its contrast"),
    ):
        for height, name in enumerate(known):
            before = scale * values[f"{name}_before{suffix}"]
            after = values.get(f"{name}_after{suffix}")
            if after is not None:
                axes.plot([before, scale * after], [height] * 2, color="#c8c8c8", lw=2, zorder=1)
                axes.plot(scale * after, height, "o", color="#1b7f5c", ms=7, zorder=3)
            axes.plot(before, height, "o", color="#d9622b", ms=7, mfc="white", mew=2, zorder=2)
        axes.set_xlabel(label)
        axes.grid(axis="x", color="#eeeeee")
        axes.set_axisbelow(True)
        for side in ("top", "right", "left"):
            axes.spines[side].set_visible(False)
    left.set_yticks(range(len(known)), list(_titles(known, values)))
    left.invert_yaxis()
    left.tick_params(axis="y", length=0)
    right.tick_params(axis="y", length=0)
    left.plot([], [], "o", color="#d9622b", mfc="white", mew=2, label="decoded as nominal")
    left.plot([], [], "o", color="#1b7f5c", label="decoded as calibrated")
    figure.legend(loc="upper right", ncols=2, frameon=False)
    figure.text(0.02, 0.955, "One knob turned at a time", fontsize=13, weight="bold")
    figure.savefig(picture)


def _titles(names: list[str], values: Mapping[str, float]) -> Iterator[str]:
    for name in names:
        refused = " (refused)" if f"{name}_refused" in values else ""
        yield KNOBS[name].title + refused


if __name__ == "__main__":
    app()
