"""Effects of the sensor: colours, photons, electrons, numbers. All after the optics."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from veilcam_optics.effects.base import Comparison
from veilcam_optics.effects.model import Model
from veilcam_optics.sensor.readout import bayer_shares, converter_range


def _gray(comparison: Comparison) -> Tensor:
    shares = torch.tensor(comparison.model.camera.sensor.channel_weights, dtype=torch.float64)
    return torch.einsum("c,cmyx->myx", shares, comparison.values())


def _rms(values: Tensor) -> float:
    return max(float(values.square().mean().sqrt()), 1e-300)


class Bayer:
    """Every sensor pixel reads one colour, and embedding pixels cut through the pattern."""

    name = "Bayer pattern"
    free = False

    def present(self, model: Model) -> bool:
        """Where it is asked for."""
        return model.conditions.bayer

    def without(self, model: Model) -> Model:
        """Every embedding pixel holds the same share of each colour."""
        return replace(model, conditions=replace(model.conditions, bayer=False))

    def error(self, comparison: Comparison) -> float:
        """Unequal shares times the channels' embeddings."""
        sensor = comparison.model.camera.sensor
        rows, columns = comparison.kept()
        shares = bayer_shares(sensor, comparison.model.embedding)[:, rows][:, :, columns]
        values = comparison.values()
        plain = torch.tensor(sensor.channel_weights, dtype=torch.float64)[:, None, None]
        difference = torch.einsum("cyx,cmyx->myx", shares - plain, values)
        return _rms(difference) / _rms(torch.einsum("cyx,cmyx->myx", shares, values))

    def reason(self, model: Model) -> str:
        """Pixels per pixel."""
        sensor, embedding = model.camera.sensor, model.embedding
        return (
            f"an embedding pixel is {sensor.rows / embedding.rows:.4g} x "
            f"{sensor.columns / embedding.columns:.4g} sensor pixels"
        )

    def absent(self) -> str:
        """Not asked for."""
        return "colours in equal shares everywhere"


class ShotNoise:
    """Photons arrive at random."""

    name = "shot noise"
    free = True

    def present(self, model: Model) -> bool:
        """Where photons or a signal-to-noise ratio are given."""
        counted = model.conditions.electrons > 0 or model.conditions.snr_db != math.inf
        return counted and model.sampling.shot

    def without(self, model: Model) -> Model:
        """Exactly as many as expected."""
        return replace(model, sampling=replace(model.sampling, shot=False))

    def error(self, comparison: Comparison) -> float:
        """Noise over signal."""
        conditions = comparison.model.conditions
        if not conditions.electrons:
            return float(10 ** (-conditions.snr_db / 20))
        values = _gray(comparison)
        mean = float(values.mean().clamp_min(0))
        return math.sqrt(mean / conditions.electrons) / _rms(values)

    def reason(self, model: Model) -> str:
        """How many."""
        conditions = model.conditions
        if not conditions.electrons:
            return f"signal to noise {conditions.snr_db:.3g} dB"
        return f"{conditions.electrons:.3g} electrons at white without a mask"

    def absent(self) -> str:
        """Not asked for."""
        return "photons not counted"


class ReadNoise:
    """Reading a value adds noise."""

    name = "read noise"
    free = True

    def present(self, model: Model) -> bool:
        """Where it is given."""
        return model.conditions.read_noise > 0

    def without(self, model: Model) -> Model:
        """None."""
        return replace(model, conditions=replace(model.conditions, read_noise=0.0))

    def error(self, comparison: Comparison) -> float:
        """Noise over signal."""
        conditions = comparison.model.conditions
        return conditions.read_noise / conditions.electrons / _rms(_gray(comparison))

    def reason(self, model: Model) -> str:
        """How much."""
        conditions = model.conditions
        return f"{conditions.read_noise:.3g} of {conditions.electrons:.3g} electrons"

    def absent(self) -> str:
        """Not asked for."""
        return "noiseless reading"


class FullWell:
    """A pixel holds a limited number of electrons."""

    name = "full well"
    free = True

    def present(self, model: Model) -> bool:
        """Where it is given."""
        return model.conditions.full_well > 0

    def without(self, model: Model) -> Model:
        """No limit; the converter, if any, keeps its range."""
        conditions = replace(
            model.conditions,
            full_well=0.0,
            adc_range=converter_range(model.conditions) if model.conditions.adc_bits else 0.0,
        )
        return replace(model, conditions=conditions)

    def error(self, comparison: Comparison) -> float:
        """What a white scene loses."""
        conditions = comparison.model.conditions
        values = _gray(comparison)
        lost = (values - conditions.full_well / conditions.electrons).clamp_min(0)
        return _rms(lost) / _rms(values) if float(lost.max()) > 0 else 0.0

    def reason(self, model: Model) -> str:
        """Where it ends."""
        limit = model.conditions.full_well / model.conditions.electrons
        return f"saturates at an embedding value of {limit:.3g}"

    def absent(self) -> str:
        """Not asked for."""
        return "never saturates"


class Converter:
    """Readings are whole numbers of a limited range."""

    name = "ADC"
    free = True

    def present(self, model: Model) -> bool:
        """Where its bits are given."""
        return model.conditions.adc_bits > 0

    def without(self, model: Model) -> Model:
        """Any number can be read."""
        return replace(model, conditions=replace(model.conditions, adc_bits=0, adc_range=0.0))

    def error(self, comparison: Comparison) -> float:
        """Rounding (a twelfth of a step squared) and what lies beyond the range."""
        conditions = comparison.model.conditions
        values = _gray(comparison)
        step = converter_range(conditions) / (2**conditions.adc_bits - 1)
        lost = (values + conditions.black_level - converter_range(conditions)).clamp_min(0)
        return math.hypot(step / math.sqrt(12), float(lost.square().mean().sqrt())) / _rms(values)

    def reason(self, model: Model) -> str:
        """Its range and step."""
        conditions = model.conditions
        ends = converter_range(conditions)
        return f"{conditions.adc_bits} bits up to an embedding value of {ends:.3g}"

    def absent(self) -> str:
        """Not asked for."""
        return "readings are not rounded"


class BlackLevel:
    """The camera adds an offset."""

    name = "black level"
    free = True

    def present(self, model: Model) -> bool:
        """Where it is given."""
        return model.conditions.black_level > 0

    def without(self, model: Model) -> Model:
        """Dark reads zero."""
        return replace(model, conditions=replace(model.conditions, black_level=0.0))

    def error(self, comparison: Comparison) -> float:
        """Offset over signal."""
        return comparison.model.conditions.black_level / _rms(_gray(comparison))

    def reason(self, model: Model) -> str:
        """How much."""
        return f"dark reads {model.conditions.black_level:.3g}"

    def absent(self) -> str:
        """Not asked for."""
        return "dark reads zero"
