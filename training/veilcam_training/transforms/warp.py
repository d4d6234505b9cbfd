"""Drawing images through maps of the plane: scaled, turned, tilted."""

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, grid_sample, pad


def homographies(sources: Tensor, target: Tensor) -> Tensor:
    """Return maps (batch, 3, 3) that take points ``sources`` (batch, 4, 2) to ``target``."""
    x, y = sources.double().unbind(-1)
    u, v = target.double().expand(len(sources), 4, 2).unbind(-1)
    one, zero = torch.ones_like(x), torch.zeros_like(x)
    first = torch.stack([x, y, one, zero, zero, zero, -u * x, -u * y], dim=-1)
    second = torch.stack([zero, zero, zero, x, y, one, -v * x, -v * y], dim=-1)
    solved = torch.linalg.solve(torch.cat([first, second], 1), torch.cat([u, v], 1))
    return torch.cat([solved, solved.new_ones(len(x), 1)], 1).reshape(-1, 3, 3)


def warp(images: Tensor, matrices: Tensor, shape: tuple[int, int], *, reduce: int = 1) -> Tensor:
    """Draw each image through a map of its own, bilinearly, on black.

    Args:
        images: (batch, rows, columns) or (batch, channels, rows, columns).
        matrices: (batch, 3, 3); each takes a place (x, y, 1) of the result to a place in its image,
            both in pixels from the centre.
        shape: rows and columns of the result.
        reduce: side of the squares of image pixels that are averaged first.

    Returns:
        (batch, [channels,] rows, columns).
    """
    planes = images if images.ndim == 4 else images[:, None]
    if reduce > 1:
        extra = [-side % reduce for side in planes.shape[-2:]]
        top, left = extra[0] // 2, extra[1] // 2
        planes = pad(planes, (left, extra[1] - left, top, extra[0] - top))
        # Uneven padding moves the centre by half a pixel.
        centre = torch.tensor([left - extra[1] / 2, top - extra[0] / 2])
        planes = avg_pool2d(planes, reduce)
    else:
        centre = torch.zeros(2)
    half = torch.tensor(planes.shape[:-3:-1]) * (reduce / 2)
    y, x = (torch.arange(count) - (count - 1) / 2 for count in shape)
    # Into the units of grid_sample. Rows and columns enter by a sum, so no place is multiplied out.
    to_grid = torch.eye(3)
    to_grid[:2] = torch.cat([torch.diag(1 / half), (centre / half)[:, None]], dim=1)
    mapped = (to_grid @ matrices.float()).to(images)[..., None, None]
    x, y = x.to(images), y.to(images)[:, None]
    places = mapped[:, :2, 0] * x + (mapped[:, :2, 1] * y + mapped[:, :2, 2])
    if bool((matrices[:, 2, :2] != 0).any()):
        depth = mapped[:, 2:, 0] * x + (mapped[:, 2:, 1] * y + mapped[:, 2:, 2])
        # Beyond the horizon of a perspective space folds over: nothing is there.
        places = torch.where(depth > 1e-6, places / depth, 2e3)
    places = places.permute(0, 2, 3, 1)
    drawn = grid_sample(planes, places, mode="bilinear", align_corners=False)
    return drawn if images.ndim == 4 else drawn[:, 0]
