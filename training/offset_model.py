"""PyTorch model of the network in `vision.lateral.learned`, and the likelihoods computed from its output.

2-D convolutions reduce the radius of the log-polar picture to one row; residual circular 1-D convolutions over the
angle follow. The output is the scores of the floor's and the ceiling's corner at each angle, a class for each angle
as an auxiliary task, and three log-odds of "cannot tell". `offset_likelihood` computes the offset's likelihood from
it, which the training maximises.
"""

from __future__ import annotations

from math import pi

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from vision.lateral.learned import N_BINS, N_ODDS, N_QUARTER, PAIR_OFFSET
from vision.lateral.polar import ANGLES, N_ANGLES

CHANNELS = (12, 24, 40, 64)
DILATIONS = (1, 2, 4, 8, 16)
N_CLASSES = 3


class _CircularLayer(nn.Module):
    """Convolution with circular padding in angle, batch normalisation, ReLU; export fuses the first two."""

    def __init__(
        self,
        inputs: int,
        outputs: int,
        kernel: tuple[int, int],
        *,
        stride: tuple[int, int] = (1, 1),
        dilation: int = 1,
        radius_padding: int = 0,
    ) -> None:
        super().__init__()
        self.convolution = nn.Conv2d(inputs, outputs, kernel, stride, dilation=(1, dilation), bias=False)
        self.norm = nn.BatchNorm2d(outputs)
        self.before, self.after = (kernel[1] - 1) // 2 * dilation, kernel[1] // 2 * dilation
        self.radius_padding = radius_padding

    def forward(self, x: Tensor) -> Tensor:
        """Evaluate the layer."""
        if self.after:
            x = torch.cat([x[..., -self.before :], x, x[..., : self.after]], dim=-1)
        if self.radius_padding:
            x = functional.pad(x, (0, 0, self.radius_padding, self.radius_padding))
        return functional.relu(self.norm(self.convolution(x)))


class OffsetNetwork(nn.Module):
    """Network from polar pictures (n, 2, N_RADII, N_ANGLES) to scores (n, 5, N_ANGLES) and log-odds (n, 3)."""

    def __init__(self) -> None:
        super().__init__()
        a, b, c, d = CHANNELS
        self.radial = nn.Sequential(
            _CircularLayer(2, a, (3, 5), stride=(2, 1), radius_padding=1),
            _CircularLayer(a, b, (3, 4), stride=(2, 2), radius_padding=1),
            _CircularLayer(b, c, (3, 3), stride=(2, 1), radius_padding=1),
            _CircularLayer(c, d, (3, 1)),
        )
        self.place = nn.Parameter(torch.zeros(d, 6))
        self.around = nn.ModuleList([_CircularLayer(d, d, (1, 5), dilation=k) for k in DILATIONS])
        self.scores = nn.Conv2d(d, 2 * (2 + N_CLASSES), 1)  # two angles for each position
        self.odds = nn.Linear(2 * d, N_ODDS)
        self.reset_odds()
        angle = ANGLES.reshape(-1, 2).mean(axis=1)
        even, odd = (
            [np.cos(k * angle) for k in (0, 2, 4)],
            [np.sin(k * angle) for k in (1, 3, 5)],
        )  # by mirroring
        self.register_buffer("position", torch.tensor(np.stack(even + odd), dtype=torch.float32))

    def layers(self) -> list[_CircularLayer]:
        """Return the convolutions in order."""
        return [layer for layer in (*self.radial, *self.around) if isinstance(layer, _CircularLayer)]

    def reset_odds(self) -> None:
        """Reset the log-odds of "cannot tell" to a constant small probability."""
        nn.init.zeros_(self.odds.weight)
        nn.init.constant_(self.odds.bias, -2.0)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Evaluate the network."""
        x = self.radial(x) + (self.place @ self.position)[None, :, None]
        for layer in self.around:
            x = x + layer(x)
        pooled = torch.cat([x.mean(dim=(2, 3)), x.amax(dim=(2, 3))], dim=-1)
        scores = self.scores(x).reshape(len(x), 2 + N_CLASSES, 2, N_ANGLES // 2)
        return scores.transpose(2, 3).flatten(2), self.odds(pooled)


def _pair_matrix() -> Tensor:
    """Return the matrix (N_QUARTER^2, N_BINS) from pairs of corners to offset bins, linear between neighbours."""
    place = (PAIR_OFFSET.ravel() + 1.0) / 2.0 * N_BINS - 0.5
    low = np.clip(np.floor(place).astype(int), 0, N_BINS - 2)
    share = np.clip(place - low, 0.0, 1.0)
    matrix = np.zeros((len(place), N_BINS), np.float32)
    matrix[np.arange(len(place)), low] = 1.0 - share
    matrix[np.arange(len(place)), low + 1] += share
    return torch.tensor(matrix)


PAIRS = _pair_matrix()


def corner_probability(scores: Tensor) -> list[Tensor]:
    """Return log-probabilities (n, N_QUARTER) over the angle from level: floor right, left, ceiling right, left."""
    q = N_QUARTER
    floor, ceiling = scores[:, 0], scores[:, 1]
    parts = [
        floor[:, :q],
        floor[:, q : 2 * q].flip(-1),
        ceiling[:, 3 * q :].flip(-1),
        ceiling[:, 2 * q : 3 * q],
    ]
    return [functional.log_softmax(part, dim=-1) for part in parts]


def pair_density(left: Tensor, right: Tensor) -> Tensor:
    """Return the density (n, N_BINS) of the offset by two corners, relative to the uniform density."""
    outer = left.exp()[:, :, None] * right.exp()[:, None, :]
    return outer.flatten(1) @ PAIRS * N_BINS


def offset_likelihood(scores: Tensor, odds: Tensor) -> tuple[Tensor, Tensor]:
    """Return the offset's likelihood over uniform (n, N_BINS), and the frame's "cannot tell" probability (n,)."""
    fr, fl, cr, cl = corner_probability(scores)
    cannot_tell = torch.sigmoid(odds)
    floor = cannot_tell[:, :1] + (1.0 - cannot_tell[:, :1]) * pair_density(fl, fr)
    ceiling = cannot_tell[:, 1:2] + (1.0 - cannot_tell[:, 1:2]) * pair_density(cl, cr)
    return floor * ceiling, cannot_tell[:, 2]


def offset_density(scores: Tensor, odds: Tensor) -> Tensor:
    """Return the offset's density (n, N_BINS), relative to the uniform density."""
    likelihood, cannot_tell = offset_likelihood(scores, odds)
    mixed = cannot_tell[:, None] + (1.0 - cannot_tell[:, None]) * likelihood
    return mixed / mixed.mean(dim=-1, keepdim=True)


def at_offset(density: Tensor, offset: Tensor) -> Tensor:
    """Return the density (n,) at offsets, linear between the bins."""
    place = ((offset + 1.0) / 2.0 * N_BINS - 0.5).clamp(0.0, N_BINS - 1.001)
    low = place.floor().long()
    share = place - low
    return (
        density.gather(1, low[:, None])[:, 0] * (1 - share)
        + density.gather(1, low[:, None] + 1)[:, 0] * share
    )


def corner_loss(scores: Tensor, corners: Tensor) -> Tensor:
    """Return the cross-entropy of the visible corners, each target linear between the two nearest angles."""
    from_level = corners.clone()
    from_level[:, 1], from_level[:, 2] = pi - corners[:, 1], corners[:, 2] - pi
    from_level[:, 3] = 2 * pi - corners[:, 3]
    from_level = from_level[:, [0, 1, 3, 2]]
    total = torch.zeros(())
    for k, log_p in enumerate(corner_probability(scores)):
        angle = from_level[:, k]
        seen = ~torch.isnan(angle)
        place = (torch.nan_to_num(angle) / (pi / 2) * N_QUARTER - 0.5).clamp(0.0, N_QUARTER - 1.001)
        low = place.floor().long()
        share = place - low
        taken = (
            log_p.gather(1, low[:, None])[:, 0] * (1 - share)
            + log_p.gather(1, low[:, None] + 1)[:, 0] * share
        )
        total = total - (taken * seen).mean()
    return total
