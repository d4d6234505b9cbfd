"""Effects of the sensor: colours, photons, electrons, numbers. All after the optics."""

import math
from dataclasses import replace
from types import MappingProxyType

import torch
from torch import Tensor

from veilcam_optics.camera.imperfections import Conditions
from veilcam_optics.effects.base import Comparison, Effect
from veilcam_optics.effects.model import Model
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.sensor.readout import bayer_shares, counted, digitised


def channel_shares(model: Model) -> Tensor:
    """Share of R, G and B in each embedding pixel, float64 (3, rows, columns)."""
    if model.conditions.bayer:
        return bayer_shares(model.camera.sensor, model.embedding)
    shares = torch.tensor(model.camera.sensor.channel_weights, dtype=torch.float64)
    return shares[:, None, None].expand(-1, *model.embedding.shape)


def mean_shares(model: Model) -> tuple[float, ...]:
    """Shares of R, G and B in a gray measurement, over all of the sensor."""
    if not model.conditions.bayer:
        return model.camera.sensor.channel_weights
    return tuple(channel_shares(model).mean((1, 2)).tolist())


def converter_range(conditions: Conditions) -> float:
    """Embedding value at which the converter ends."""
    if conditions.adc_range:
        return conditions.adc_range
    if conditions.full_well:
        return conditions.full_well / conditions.electrons
    return 1.0


def over_light(part: Tensor, values: Tensor) -> float:
    """Root mean square over masks of the relative L2 of a part of what embeddings say.

    Of few weights a mask may leave the sensor almost dark, where a step of a converter is much.

    Args:
        part: (masks, rows, columns), or alike for all.
        values: embeddings, (masks, rows, columns).

    Returns:
        1 where no mask passes any light.
    """
    shares = part.expand_as(values).square().mean((-2, -1)), values.square().mean((-2, -1))
    lit = shares[1] > 0
    return float((shares[0][lit] / shares[1][lit]).mean().sqrt()) if lit.any() else 1.0


class Bayer(Effect):
    """Every sensor pixel reads one colour, and embedding pixels cut through the pattern."""

    name = "Bayer pattern"
    free = False
    absent = "colours in equal shares everywhere"
    neutral = MappingProxyType({"bayer": False})

    def reason(self, model: Model) -> str:
        """Pixels per pixel."""
        sensor = model.camera.sensor
        rows, columns = (side / sensor.pixel for side in model.embedding.box(sensor))
        return f"an embedding value averages {rows:.4g} x {columns:.4g} sensor pixels"


class ShotNoise(Effect):
    """Photons arrive at random."""

    name = "shot noise"
    absent = "photons not counted"

    def present(self, model: Model) -> bool:
        """Return whether photons or a signal-to-noise ratio are given."""
        conditions = model.conditions
        return model.sampling.shot and (conditions.electrons > 0 or conditions.snr_db != math.inf)

    def without(self, model: Model) -> Model:
        """Exactly as many as expected."""
        return replace(model, sampling=replace(model.sampling, shot=False))

    def error(self, comparison: Comparison) -> float:
        """Noise over signal."""
        conditions = comparison.model.conditions
        if not conditions.electrons:
            return float(10 ** (-conditions.snr_db / 20))
        values = comparison.white()
        return over_light((values.clamp_min(0) / conditions.electrons).sqrt(), values)

    def reason(self, model: Model) -> str:
        """Say how many photons there are."""
        conditions = model.conditions
        if not conditions.electrons:
            return f"signal to noise {conditions.snr_db:.3g} dB"
        return f"{conditions.electrons:.3g} electrons at white without a mask"

    def electrons(
        self,
        electrons: Tensor,
        model: Model,  # noqa: ARG002 - part of the interface
        generator: torch.Generator | None,
    ) -> Tensor:
        """Count photons, where their number is given."""
        return counted(electrons, generator)

    def measurement(
        self, values: Tensor, model: Model, generator: torch.Generator | None
    ) -> Tensor:
        """As much noise as the signal-to-noise ratio says, where that is given."""
        return shot_noise(values, model.conditions.snr_db, generator)


class ReadNoise(Effect):
    """Reading a value adds noise."""

    name = "read noise"
    absent = "noiseless measurement"
    neutral = MappingProxyType({"read_noise": 0.0})

    def error(self, comparison: Comparison) -> float:
        """Noise over signal."""
        conditions = comparison.model.conditions
        noise = torch.tensor(conditions.read_noise / conditions.electrons, dtype=torch.float64)
        return over_light(noise, comparison.white())

    def reason(self, model: Model) -> str:
        """Say how much noise there is."""
        conditions = model.conditions
        return f"{conditions.read_noise:.3g} of {conditions.electrons:.3g} electrons"

    def electrons(
        self, electrons: Tensor, model: Model, generator: torch.Generator | None
    ) -> Tensor:
        """Add normal noise, alike for every pixel."""
        noise = torch.randn(
            electrons.shape, generator=generator, dtype=electrons.dtype, device=electrons.device
        )
        return electrons + model.conditions.read_noise * noise


class FullWell(Effect):
    """A pixel holds a limited number of electrons."""

    name = "full well"
    absent = "never saturates"
    neutral = MappingProxyType({"full_well": 0.0})

    def without(self, model: Model) -> Model:
        """No limit; the converter, if any, keeps its range."""
        conditions = replace(
            model.conditions,
            full_well=0.0,
            adc_range=converter_range(model.conditions) if model.conditions.adc_bits else 0.0,
        )
        return replace(model, conditions=conditions)

    def error(self, comparison: Comparison) -> float:
        """Return the error that a white scene would have without it."""
        conditions = comparison.model.conditions
        values = comparison.white()
        lost = (values - conditions.full_well / conditions.electrons).clamp_min(0)
        return over_light(lost, values) if float(lost.max()) > 0 else 0.0

    def reason(self, model: Model) -> str:
        """Say at which number of electrons a pixel is full."""
        limit = model.conditions.full_well / model.conditions.electrons
        return f"saturates at an embedding value of {limit:.3g}"

    def electrons(
        self,
        electrons: Tensor,
        model: Model,
        generator: torch.Generator | None,  # noqa: ARG002 - part of the interface
    ) -> Tensor:
        """Clipped: what overflows is lost."""
        return electrons.clamp_max(model.conditions.full_well)


class BlackLevel(Effect):
    """The camera adds an offset."""

    name = "black level"
    absent = "dark reads zero"
    neutral = MappingProxyType({"black_level": 0.0})

    def error(self, comparison: Comparison) -> float:
        """Offset over signal."""
        offset = torch.tensor(comparison.model.conditions.black_level, dtype=torch.float64)
        return over_light(offset, comparison.white())

    def reason(self, model: Model) -> str:
        """Say how large the offset is."""
        return f"dark reads {model.conditions.black_level:.3g}"

    def measurement(
        self,
        values: Tensor,
        model: Model,
        generator: torch.Generator | None,  # noqa: ARG002 - part of the interface
    ) -> Tensor:
        """Add the offset to every measurement."""
        return values + model.conditions.black_level


class Converter(Effect):
    """Measurements are whole numbers of a limited range."""

    name = "ADC"
    absent = "measurements are not rounded"
    neutral = MappingProxyType({"adc_bits": 0})

    def error(self, comparison: Comparison) -> float:
        """Return the rounding error (a twelfth of a step squared) and that beyond the range.

        What is below half a step is read as nothing: all of it is lost.
        """
        conditions = comparison.model.conditions
        values = comparison.white()
        lifted = values + conditions.black_level
        step = converter_range(conditions) / (2**conditions.adc_bits - 1)
        rounded = torch.full_like(values, step / math.sqrt(12))
        rounded = torch.where(lifted < step / 2, lifted, rounded)
        lost = (lifted - converter_range(conditions)).clamp_min(0)
        return over_light(torch.hypot(rounded, lost), values)

    def reason(self, model: Model) -> str:
        """Its range and step."""
        conditions = model.conditions
        ends = converter_range(conditions)
        return f"{conditions.adc_bits} bits up to an embedding value of {ends:.3g}"

    def measurement(
        self,
        values: Tensor,
        model: Model,
        generator: torch.Generator | None,  # noqa: ARG002 - part of the interface
    ) -> Tensor:
        """Round, with the gradient of the identity."""
        return digitised(values, model.conditions.adc_bits, converter_range(model.conditions))
