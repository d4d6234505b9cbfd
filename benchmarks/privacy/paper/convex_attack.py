"""Convex recovery of scenes from embeddings behind a known point spread function.

For a picture ``y`` of a scene ``x`` it solves

    minimise  1/2 |y - D H x|^2 + weight TV(x)   over  x >= 0,

``H`` the convolution with the point spread function (PSF), ``D`` the sensor's binning, ``TV`` the
isotropic total variation: the attack of E. Bezzam, M. Vetterli and M. Simeoni (2022), by
accelerated projected gradient (FISTA; Beck and Teboulle 2009) with a step that is proven short
enough, and a duality gap that says how far from the minimum it ended.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from veilcam_optics.propagation.sampling import fast_length
from veilcam_training.attacks.networks import Progress
from veilcam_training.errors import require

PICTURES_AT_ONCE = 8
COLUMNS_AT_ONCE = 8192
PANELS = 4
POWER_STEPS = 100
ROUNDING = 1e-5
"""Float32 errors that the bound on the step allows for, relative."""
INNER_STEPS = 10
"""Of the dual problem of total variation, in each gradient step; they go on where they ended."""
CLOSING_STEPS = 100
"""Of it, before a gap is told: the bound is as good as the dual variables are."""

VARIATIONS = (0.0, 1e-4, 3e-4, 1e-3, 1e-2)
STOPS = (10, 30, 100, 300)
"""What :func:`tune` tries: 1,000 iterations gained nothing at 24 x 32 and at 48 x 64."""

Shape = tuple[int, int]


class BinnedConvolution:
    """D H: a scene convolved with a PSF, and averaged over the pixels of an embedding.

    A scene pixel is ``side`` samples of the PSF wide on the sensor, an embedding pixel ``binning``
    samples; both are centred on the axis, and the image is inverted. Nothing is rounded: the two
    boxes are added up in the PSF, so that one Fourier transform is a whole measurement.

    Args:
        psf: (rows, columns), not negative: ``binning * embedding + side * scene - 1`` samples, all
            offsets that occur. See :func:`psf_samples`.
        scene: shape of the scene in pixels.
        embedding: shape of the embedding in pixels.
        side: samples along a scene pixel.
        binning: samples along an embedding pixel, (along y, along x).

    Raises:
        TrainingError: a PSF of another shape, or one that is negative somewhere.
    """

    def __init__(
        self, psf: Tensor, scene: Shape, embedding: Shape, *, side: int, binning: Shape
    ) -> None:
        wanted = psf_samples(scene, embedding, side=side, binning=binning)
        require(
            tuple(psf.shape) == wanted,
            f"psf has shape {tuple(psf.shape)}: use {wanted}, all offsets that occur",
        )
        require(bool((psf >= 0).all()), "psf is negative or NaN somewhere: use an irradiance")
        self.scene, self.embedding, self.side, self.binning = scene, embedding, side, binning
        # In units of what an all-white scene sends without a mask, as all embeddings are.
        kernel = psf.double()[None] / math.prod(scene)
        for box in ((side, 1), (1, side), (binning[0], 1), (1, binning[1])):
            kernel = avg_pool2d(kernel, box, 1)
        self.kernel = kernel[0].float().contiguous()
        """Response of an embedding pixel to a scene pixel, by their distance in samples."""
        self._lengths = tuple(fast_length(count) for count in self.kernel.shape)
        self._spectrum = torch.fft.rfft2(self.kernel, s=self._lengths)

    def forward(self, scenes: Tensor) -> Tensor:
        """Embeddings (count, rows, columns) of scenes (count, rows, columns)."""
        return self._correlated(scenes, (self.side, self.side), self.binning, self.embedding)

    def adjoint(self, embeddings: Tensor) -> Tensor:
        """Scenes (count, rows, columns), of embeddings: the transpose of :meth:`forward`."""
        return self._correlated(embeddings, self.binning, (self.side, self.side), self.scene)

    def _correlated(self, values: Tensor, placed: Shape, read: Shape, shape: Shape) -> Tensor:
        """Values put ``placed`` samples apart, correlated with the kernel, read ``read`` apart."""
        parts = [values.new_zeros(0, *shape)]
        for some in torch.split(values, PICTURES_AT_ONCE) if len(values) else ():
            plane = some.new_zeros(len(some), *self._lengths)
            rows, columns = some.shape[-2:]
            plane[:, : rows * placed[0] : placed[0], : columns * placed[1] : placed[1]] = some
            product = torch.fft.rfft2(plane).conj() * self._spectrum
            seen = torch.fft.irfft2(product, s=self._lengths)
            seen = seen[:, : shape[0] * read[0] : read[0], : shape[1] * read[1] : read[1]]
            parts.append(seen.clone())
        return torch.cat(parts)

    def matrix(self, rows: slice = slice(None)) -> Tensor:
        """D H itself, (scene pixels, embedding pixels), for some ``rows`` of the embedding."""
        (high, wide), (down, along) = self.kernel.stride(), self.binning
        strides = (self.side * high, self.side * wide, down * high, along * wide)
        pixels = self.kernel.as_strided((*self.scene, *self.embedding), strides)
        return pixels[:, :, rows].reshape(math.prod(self.scene), -1)

    def gram(self, progress: Progress | None = None) -> Tensor:
        """D H with its transpose, (scene pixels, scene pixels)."""
        pixels = math.prod(self.scene)
        total = self.kernel.new_zeros(pixels, pixels)
        step = max(1, COLUMNS_AT_ONCE // self.embedding[1])
        panel = math.ceil(pixels / PANELS)
        for first in range(0, self.embedding[0], step):
            some = self.matrix(slice(first, first + step))
            for start in range(0, pixels, panel):  # the lower half: it is symmetric
                end = min(start + panel, pixels)
                total[start:end, :end].addmm_(some[start:end], some[:end].T)
            if progress is not None:
                progress(min(first + step, self.embedding[0]), self.embedding[0])
        return total.tril() + total.tril(-1).T


def psf_samples(scene: Shape, embedding: Shape, *, side: int, binning: Shape) -> Shape:
    """Return the samples (rows, columns) that a PSF needs for all offsets that occur."""
    rows, columns = (binning[axis] * embedding[axis] + side * scene[axis] - 1 for axis in range(2))
    return rows, columns


class Normal:
    """``A^T A`` of a measurement, and all else that an attacker needs of it.

    Args:
        camera: A, that is D H.
        progress: function that is told the number of parts done, and of all.
    """

    def __init__(self, camera: BinnedConvolution, progress: Progress | None = None) -> None:
        self.camera = camera
        # The thinner of the two is the cheaper: A for small embeddings, its Gram matrix for others.
        self._thin = 2 * math.prod(camera.embedding) <= math.prod(camera.scene)
        self._matrix = camera.matrix().contiguous() if self._thin else camera.gram(progress)
        self.of_white = camera.adjoint(torch.ones(1, *camera.embedding)).clamp_min(0)
        """A^T 1, (1, rows, columns): the share of each scene pixel in all that is measured."""
        self.bound = self._bound()
        """An upper bound on the largest eigenvalue of A^T A: 1 / bound is a certified step."""

    def __call__(self, scenes: Tensor) -> Tensor:
        """A^T A scenes, (count, rows, columns)."""
        product = scenes.flatten(1) @ self._matrix
        if self._thin:
            product = product @ self._matrix.T
        return product.reshape(scenes.shape)

    def _bound(self) -> float:
        """By Collatz and Wielandt: for a matrix and a vector v with no negative number.

        The largest eigenvalue is at most ``max_i (A^T A v)_i / v_i``, for every v > 0; steps of the
        power method make that bound tight, and it holds wherever they stop.
        """
        vector = torch.ones(1, *self.camera.scene)
        bound = math.inf
        for _ in range(POWER_STEPS):
            product = self(vector)
            bound = min(bound, float((product / vector).max()))
            # What no light reaches stays positive, or the bound would not hold.
            vector = (product / product.max()).clamp_min(1e-3)
        return bound * (1 + ROUNDING)


@dataclass(frozen=True)
class Recovery:
    """Scenes, and how far they are from the minimum."""

    scenes: Tensor
    """(count, rows, columns), not negative, in the unit of the scenes that were seen."""
    gap: Tensor
    """(count,): at most so much above the minimum the objective is, as a share of what it is for a
    black scene, ``|y|^2 / 2``."""


@dataclass(frozen=True)
class ConvexAttack:
    """Settings, as an attacker tunes them on pictures of its own."""

    variation: float = 0.0
    """Weight of the total variation, as a share of the largest slope at a black scene."""
    iterations: int = 300
    brightness: float = 1.0
    """What recovered scenes are multiplied by."""
    psnr: float = field(default=math.nan, compare=False)
    """Of the pictures that it was tuned on [dB]."""

    def __call__(
        self, normal: Normal, embeddings: Tensor, progress: Progress | None = None
    ) -> Recovery:
        """Recover the scenes of embeddings (count, rows, columns); estimates are in [0, 1]."""
        stops = (self.iterations,)
        (found,) = descend(normal, embeddings, self.variation, stops, progress)
        return Recovery((self.brightness * found.scenes).clamp(0, 1), found.gap)


def descend(
    normal: Normal,
    embeddings: Tensor,
    variation: float,
    stops: Sequence[int],
    progress: Progress | None = None,
    *,
    inner: int = INNER_STEPS,
) -> Iterator[Recovery]:
    """FISTA, restarted where it overshoots (O'Donoghue and Candes 2015); what it has at each stop.

    Args:
        normal: normal equations of the camera that the attacker assumes.
        embeddings: (count, rows, columns).
        variation: see :class:`ConvexAttack`.
        stops: counts of iterations, rising.
        progress: function that is told the number of iterations done, and of all.
        inner: steps of the dual problem of total variation, in each of these; the gap closes no
            further than they are exact.
    """
    # In units of each picture's own light, so that settings hold for all of them.
    power = embeddings.square().sum((1, 2), keepdim=True).clamp_min(torch.finfo().tiny)
    slope = normal.camera.adjoint(embeddings)
    weight = variation * slope.amax((1, 2), keepdim=True).clamp_min(0)
    scenes = ahead = torch.zeros_like(slope)
    dual = torch.zeros(2, *slope.shape)
    momentum = torch.ones(len(slope), 1, 1)
    for count in range(1, stops[-1] + 1):
        stepped = ahead - (normal(ahead) - slope) / normal.bound
        if variation:
            new, dual = denoise(stepped, weight / normal.bound, dual, inner)
        else:
            new = stepped.clamp_min(0)
        overshot = ((ahead - new) * (new - scenes)).sum((1, 2), keepdim=True) > 0
        momentum = torch.where(overshot, 1.0, momentum)
        following = (1 + (1 + 4 * momentum.square()).sqrt()) / 2
        ahead = new + torch.where(overshot, 0.0, (momentum - 1) / following) * (new - scenes)
        scenes, momentum = new, following
        if progress is not None:
            progress(count, stops[-1])
        if count in stops:
            stepped = scenes - (normal(scenes) - slope) / normal.bound
            _, closing = denoise(stepped, weight / normal.bound, dual, CLOSING_STEPS)
            gap = duality_gap(normal, scenes, slope, weight, closing)
            yield Recovery(scenes, gap / (power[:, 0, 0] / 2))


def denoise(scenes: Tensor, weight: Tensor, dual: Tensor, steps: int) -> tuple[Tensor, Tensor]:
    """Proximal step of total variation over scenes that are not negative.

    The fast gradient projection of Beck and Teboulle ("Fast gradient-based algorithms for
    constrained total variation image denoising", 2009), from ``dual`` on.

    Args:
        scenes: (count, rows, columns).
        weight: (count, 1, 1), of the variation beside half the squared distance.
        dual: (2, count, rows, columns), vectors of length 1 at most.
        steps: number of steps of the gradient projection.

    Returns:
        The scenes, and the dual variables that they belong to.
    """
    step = 1 / (8 * weight.clamp_min(torch.finfo().tiny))
    ahead, momentum = dual, 1.0
    for _ in range(steps):
        shown = torch.addcmul(scenes, weight, divergence(ahead), value=-1).clamp_min_(0)
        moved = torch.addcmul(ahead, step, differences(shown))
        new = moved.div_(torch.hypot(moved[0], moved[1]).clamp_min_(1))
        following = (1 + math.sqrt(1 + 4 * momentum**2)) / 2
        ahead = torch.lerp(new, dual, (1 - momentum) / following)
        dual, momentum = new, following
    return (scenes - weight * divergence(dual)).clamp_min(0), dual


def differences(scenes: Tensor) -> Tensor:
    """Forward differences (2, count, rows, columns) along y and x, 0 at the far edges."""
    found = scenes.new_zeros(2, *scenes.shape)
    torch.sub(scenes[:, 1:], scenes[:, :-1], out=found[0, :, :-1])
    torch.sub(scenes[:, :, 1:], scenes[:, :, :-1], out=found[1, :, :, :-1])
    return found


def divergence(dual: Tensor) -> Tensor:
    """Return the transpose of :func:`differences`."""
    found = torch.zeros_like(dual[0])
    found[:, 1:] += dual[0, :, :-1]
    found[:, :-1] -= dual[0, :, :-1]
    found[:, :, 1:] += dual[1, :, :, :-1]
    found[:, :, :-1] -= dual[1, :, :, :-1]
    return found


def duality_gap(
    normal: Normal, scenes: Tensor, slope: Tensor, weight: Tensor, dual: Tensor
) -> Tensor:
    """At most so much the objective is above its minimum, (count,): an upper bound.

    Any t with ``A^T t <= weight D^T p`` and ``|p| <= 1`` bounds the minimum from below by
    ``(|y|^2 - |y - t|^2) / 2``. The residual is such a t once enough light, the same
    on every embedding pixel, is taken from it: no entry of A is negative.
    """
    product = normal(scenes)
    pull = weight * divergence(dual)
    share = normal.of_white
    # What no light reaches has no share, and must not divide.
    lit = share > ROUNDING * share.max()
    excess = torch.where(lit, (slope - product - pull) / share.clamp_min(torch.finfo().tiny), 0)
    shift = excess.amax((1, 2)).clamp_min(0)
    numbers = math.prod(normal.camera.embedding)
    variation = (weight[:, 0, 0] * differences(scenes).square().sum(0).sqrt().sum((1, 2))).double()
    inner = (scenes.double() * (product - slope).double()).sum((1, 2))
    light = (scenes * share).double().sum((1, 2))
    return (inner + variation + shift * light + shift.square() * numbers / 2).clamp_min(0)


def tune(
    normal: Normal,
    embeddings: Tensor,
    truth: Tensor,
    *,
    variations: Sequence[float] = VARIATIONS,
    stops: Sequence[int] = STOPS,
    progress: Progress | None = None,
) -> ConvexAttack:
    """Choose the settings that recover these pictures best; they are for no other use.

    Args:
        normal: normal equations of the camera that the attacker assumes.
        embeddings: (count, rows, columns).
        truth: pictures before the camera, (count, rows, columns), in [0, 1].
        variations: weights to try.
        stops: iterations to try, rising.
        progress: function that is told the number of weights done, and of all.
    """
    require(bool(variations and stops), "there is nothing to try: use variations and stops")
    tried: list[ConvexAttack] = []
    for number, variation in enumerate(variations):
        found = descend(normal, embeddings, variation, stops)
        for iterations, each in zip(stops, found, strict=True):
            scale = float((each.scenes * truth).sum() / each.scenes.square().sum().clamp_min(1e-12))
            error = ((scale * each.scenes).clamp(0, 1) - truth).square().mean((1, 2))
            quality = float(-10 * error.clamp_min(1e-12).log10().mean())
            tried.append(ConvexAttack(variation, iterations, scale, quality))
        if progress is not None:
            progress(number + 1, len(variations))
    return max(tried, key=lambda each: each.psnr)
