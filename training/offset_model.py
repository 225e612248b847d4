"""The network of `vision.lateral.learned` as it is trained, and the likelihoods that its scores stand for.

The network classifies every angle about the axis. 2-D convolutions collapse the radius, circular 1-D convolutions
over the angle follow; out come scores of the floor's and the ceiling's corner at each angle, a class of each angle as
an auxiliary task, and three log-odds. The offset's likelihood follows in `offset_likelihood`, and is what the
training maximises.
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
    """Convolution that goes on around the angle, batch normalisation, ReLU; export folds the first two into one."""

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
    """From polar pictures (n, 2, N_RADII, N_ANGLES) to scores (n, 5, N_ANGLES) and log-odds (n, 3)."""

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
        self.scores = nn.Conv2d(d, 2 * (2 + N_CLASSES), 1)  # two angles for each place
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
        """Begin anew with what cannot be told: a little of everything."""
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
    """(N_QUARTER^2, N_BINS): into which bins of the offset a pair of corners falls, shared between neighbours."""
    place = (PAIR_OFFSET.ravel() + 1.0) / 2.0 * N_BINS - 0.5
    low = np.clip(np.floor(place).astype(int), 0, N_BINS - 2)
    share = np.clip(place - low, 0.0, 1.0)
    matrix = np.zeros((len(place), N_BINS), np.float32)
    matrix[np.arange(len(place)), low] = 1.0 - share
    matrix[np.arange(len(place)), low + 1] += share
    return torch.tensor(matrix)


PAIRS = _pair_matrix()


def corner_probability(scores: Tensor) -> list[Tensor]:
    """Log-probabilities (n, N_QUARTER) of floor right and left, ceiling right and left, outwards from the wall."""
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
    """Probability over chance (n, N_BINS) of the offset by two corners."""
    outer = left.exp()[:, :, None] * right.exp()[:, None, :]
    return outer.flatten(1) @ PAIRS * N_BINS


def offset_likelihood(scores: Tensor, odds: Tensor) -> tuple[Tensor, Tensor]:
    """Likelihood over chance (n, N_BINS) of the offset, and the probability (n,) that the frame cannot tell."""
    fr, fl, cr, cl = corner_probability(scores)
    blind = torch.sigmoid(odds)
    floor = blind[:, :1] + (1.0 - blind[:, :1]) * pair_density(fl, fr)
    ceiling = blind[:, 1:2] + (1.0 - blind[:, 1:2]) * pair_density(cl, cr)
    return floor * ceiling, blind[:, 2]


def offset_density(scores: Tensor, odds: Tensor) -> Tensor:
    """Posterior over chance (n, N_BINS)."""
    likelihood, blind = offset_likelihood(scores, odds)
    mixed = blind[:, None] + (1.0 - blind[:, None]) * likelihood
    return mixed / mixed.mean(dim=-1, keepdim=True)


def at_offset(density: Tensor, offset: Tensor) -> Tensor:
    """Density (n,) at offsets, linear between the bins."""
    place = ((offset + 1.0) / 2.0 * N_BINS - 0.5).clamp(0.0, N_BINS - 1.001)
    low = place.floor().long()
    share = place - low
    return (
        density.gather(1, low[:, None])[:, 0] * (1 - share)
        + density.gather(1, low[:, None] + 1)[:, 0] * share
    )


def corner_loss(scores: Tensor, corners: Tensor) -> Tensor:
    """Cross-entropy of the corners that can be seen, each shared between the two nearest angles."""
    rights = corners.clone()
    rights[:, 1], rights[:, 2], rights[:, 3] = pi - corners[:, 1], corners[:, 2] - pi, 2 * pi - corners[:, 3]
    rights = rights[:, [0, 1, 3, 2]]
    total = torch.zeros(())
    for k, log_p in enumerate(corner_probability(scores)):
        angle = rights[:, k]
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
