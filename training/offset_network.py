"""Train the network of `vision.lateral.learned` on simulated corridors, and write its weights.

``python -m training.offset_network render FOLDER`` renders the pictures, ``... train FOLDER`` (extra ``training``)
trains on them, calibrates on corridors that the training has not seen, and writes
``vision/lateral/offset_network.onnx`` and, as JSON beside it, how it was made and how good it is. Seeds are fixed.

The network classifies every angle about the axis. 2-D convolutions collapse the radius, circular 1-D convolutions
over the angle follow; out come scores of the floor's and the ceiling's corner at each angle, a class of each angle as
an auxiliary task, and three log-odds. The offset's likelihood follows in `offset_likelihood`, and is what the
training maximises.
"""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from math import cos, pi
from pathlib import Path
from typing import Annotated

import numpy as np
import onnx
import torch
import typer
from torch import Tensor, nn
from torch.nn import functional

from training.offset_views import VIEWS_PER_CAMERA, TrainingView, render_views
from training.scores import OffsetScores
from training.variations import UNKNOWN, Sample, varied, without_corridor
from vision.lateral import learned
from vision.lateral.learned import N_BINS, N_ODDS, N_QUARTER, PAIR_OFFSET, learned_mixture
from vision.lateral.polar import ANGLES, N_ANGLES, N_RADII

MIN_HALVED = 64  # numbers of a tensor that is kept at half precision
CHANNELS = (12, 24, 40, 64)
DILATIONS = (1, 2, 4, 8, 16)
BATCH = 48
LEARNING_RATE, LATER_RATE = 4e-3, 3e-3
ODDS_RATE = 0.02  # of that for the log-odds: faster, they run off to where the sigmoid has no gradient
WARM_UP_STEPS, CORNER_STEPS = 60, 300
WITHOUT_CORRIDOR = 0.05
CORNER_WEIGHT, CLASS_WEIGHT = 0.25, 0.3
N_CLASSES = 3
CHUNK_VIEWS = 10 * VIEWS_PER_CAMERA
CHUNKS, STEPS, LATER_STEPS, SEED = 53, 11000, 26000, 11
HELD_OUT, HELD_OUT_SEED, VARIATIONS = 240, 900, 4
TEST_VIEWS, TEST_SEED = 48, 950
TEMPERATURES = (1.0, 1.1, 1.25, 1.4, 1.6, 1.8, 2.1)  # never surer than trained
SHIFTS = (1.0, 1.5, 2.0)  # never less: all the pictures that it is fitted on show a corridor, others do not


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


@dataclass(frozen=True, slots=True)
class Batch:
    """Samples stacked: polar (n, 2, N_RADII, N_ANGLES), offset (n,), corners (n, 4), classes (n, N_ANGLES)."""

    polar: Tensor
    offset: Tensor
    corners: Tensor
    classes: Tensor

    @classmethod
    def of(cls, samples: list[Sample]) -> Batch:
        """Stack samples."""
        return cls(
            torch.from_numpy(np.stack([s.polar for s in samples])),
            torch.tensor([s.offset_norm for s in samples], dtype=torch.float32),
            torch.from_numpy(np.stack([s.corners_rad for s in samples]).astype(np.float32)),
            torch.from_numpy(np.stack([s.classes for s in samples])),
        )


def chunk_file(folder: Path, seed: int, number: int) -> Path:
    """File of a chunk of rendered views."""
    return folder / f"views_{seed}_{number}.pkl"


def train(
    folder: Path,
    chunks: int,
    steps: int,
    seed: int,
    rate: float = LEARNING_RATE,
    earlier: OffsetNetwork | None = None,
) -> OffsetNetwork:
    """Train a network on endless variations of the views in a folder.

    It goes on from an ``earlier`` one, whose log-odds begin anew: only where the corners are right can it be learned
    when they are not to be relied on.
    """
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    network = OffsetNetwork()
    if earlier is not None:
        network.load_state_dict(earlier.state_dict())
        network.reset_odds()
    odds = list(network.odds.parameters())
    rest = [p for name, p in network.named_parameters() if not name.startswith("odds.")]
    groups = [{"params": rest, "share": 1.0}, {"params": odds, "share": ODDS_RATE}]
    optimiser = torch.optim.AdamW(groups, lr=rate, weight_decay=1e-3)
    views: list[TrainingView] = []
    for number in range(chunks):
        views += pickle.loads(chunk_file(folder, seed, number).read_bytes())
    started, order, losses = time.monotonic(), list[int](), list[tuple[float, ...]]()
    for step in range(steps):
        if len(order) < BATCH:
            order += rng.permutation(len(views)).tolist()
        batch = Batch.of(
            [
                without_corridor(rng) if rng.random() < WITHOUT_CORRIDOR else varied(views[order.pop()], rng)
                for _ in range(BATCH)
            ]
        )
        warm, cool = min(1.0, (step + 1) / WARM_UP_STEPS), 0.5 * (1.0 + cos(pi * step / steps))
        for group in optimiser.param_groups:
            group["lr"] = rate * group["share"] * warm * cool
        scores, odds = network(batch.polar)
        nll = -torch.log(at_offset(offset_density(scores, odds), batch.offset) + 1e-6).mean()
        corners = corner_loss(scores, batch.corners)
        classes = functional.cross_entropy(scores[:, 2:], batch.classes, ignore_index=UNKNOWN)
        optimiser.zero_grad()
        # The corners first: while they are at random, "cannot tell" is right, and it would never be unlearned.
        share = 1.0 if earlier is not None else min(1.0, max(0.0, step / CORNER_STEPS - 0.5))
        (share * nll + CORNER_WEIGHT * corners + CLASS_WEIGHT * classes).backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        losses.append((nll.item(), corners.item(), classes.item()))
        if (step + 1) % 200 == 0:
            mean = np.mean(losses[-200:], axis=0).round(3).tolist()
            print(f"step {step + 1} of {steps}, {time.monotonic() - started:.0f} s: {mean}", flush=True)
    return network.eval()


def calibrate(network: OffsetNetwork, held: Batch) -> tuple[float, float]:
    """Fit a temperature of the corners' scores and a shift of "cannot tell" on pictures not trained on; fold them in.

    Returns
    -------
    temperature, shift
        Of the scores, and of the frame's log-odds.
    """
    with torch.no_grad():
        scores, odds = network(held.polar)
        best = (torch.inf, 1.0, 0.0)
        for temperature in TEMPERATURES:
            for shift in SHIFTS:
                moved = odds + torch.tensor([0.0, 0.0, shift])
                density = offset_density(scores / temperature, moved)
                nll = -torch.log(at_offset(density, held.offset) + 1e-6).mean().item()
                best = min(best, (nll, temperature, shift))
        _, temperature, shift = best
        for parameter in (network.scores.weight, network.scores.bias):
            parameter[:4] /= temperature  # floor and ceiling, two angles each
        network.odds.bias[2] += shift
    return temperature, shift


class _Exported(nn.Module):
    """The network with one output (n, 5 N_ANGLES + N_ODDS); what does not depend on the picture is a constant."""

    def __init__(self, network: OffsetNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, polar: Tensor) -> Tensor:
        scores, odds = self.network(polar)
        return torch.cat([scores[:, :2].flatten(1), odds], dim=1)


def export(network: OffsetNetwork, file: Path) -> None:
    """Write the network for `cv2.dnn`, for one picture."""
    example = torch.zeros(1, 2, N_RADII, N_ANGLES)
    torch.onnx.export(
        _Exported(network).eval(),
        (example,),
        str(file),
        input_names=["polar"],
        output_names=["scores"],
        opset_version=13,
        dynamo=False,
    )
    _halve(file)


def _halve(file: Path) -> None:
    """Keep the weights of an exported network as half-precision numbers, which are cast when it is loaded."""
    model = onnx.load(file)
    graph = model.graph
    weights, casts = [], []
    for tensor in graph.initializer:
        values = onnx.numpy_helper.to_array(tensor)
        if values.dtype == np.float32 and values.size >= MIN_HALVED:
            name = f"{tensor.name}_half"
            casts.append(onnx.helper.make_node("Cast", [name], [tensor.name], to=onnx.TensorProto.FLOAT))
            tensor = onnx.numpy_helper.from_array(values.astype(np.float16), name)
        weights.append(tensor)
    nodes = [*casts, *graph.node]
    del graph.initializer[:], graph.node[:]
    graph.initializer.extend(weights)
    graph.node.extend(nodes)
    onnx.checker.check_model(model)
    onnx.save(model, file)


def scores(views: list[TrainingView]) -> dict[str, float]:
    """Score the weights in the package on views about the axes that vision finds."""
    known = [view for view in views if view.R_measured is not None]
    mixtures = [learned_mixture(view.image, view.camera, view.R_measured) for view in known]
    found = OffsetScores.of(mixtures, [view.box.offset_norm for view in known])
    return {name: round(value, 4) for name, value in asdict(found).items()}


app = typer.Typer(help=__doc__, add_completion=False)


@app.command()
def render(
    folder: Path,
    chunks: Annotated[int, typer.Option(help=f"Of {CHUNK_VIEWS} pictures each.")] = CHUNKS,
    first: Annotated[
        int, typer.Option(help="Begin with this one: several processes may share the work.")
    ] = 0,
    seed: int = SEED,
) -> None:
    """Render the pictures to train on; those that are there stay."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(first, chunks):
        file = chunk_file(folder, seed, number)
        if file.exists():
            continue
        views = list(render_views(CHUNK_VIEWS, seed, number * CHUNK_VIEWS // VIEWS_PER_CAMERA))
        unfinished = file.with_suffix(".part")
        unfinished.write_bytes(pickle.dumps(views))
        unfinished.rename(file)
        print(file, flush=True)


@app.command("train")
def train_and_write(
    folder: Path,
    chunks: int = CHUNKS,
    steps: int = STEPS,
    later_steps: Annotated[
        int, typer.Option(help="With what cannot be told begun anew, at a lower rate.")
    ] = LATER_STEPS,
    seed: int = SEED,
) -> None:
    """Train, calibrate and write the weights."""
    torch.set_num_threads(1)
    network = train(folder, chunks, steps, seed)
    network = train(folder, chunks, later_steps, seed, LATER_RATE, network)
    torch.save(network.state_dict(), folder / "network.pt")
    held_out = list(render_views(HELD_OUT, HELD_OUT_SEED))
    rng = np.random.default_rng(HELD_OUT_SEED)
    draws = [
        varied(view, rng, vary=k % 2 == 0) for view in held_out[: HELD_OUT // 2] for k in range(VARIATIONS)
    ]
    temperature, shift = calibrate(network, Batch.of(draws))
    file = Path(learned.__file__).with_name(learned.WEIGHTS_FILE)
    export(network, file)
    git = subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, text=True, check=True)
    command = (
        f"python -m training.offset_network train FOLDER --chunks {chunks} --steps {steps} "
        f"--later-steps {later_steps} --seed {seed}"
    )
    made = {
        "made_by": command,
        "commit": git.stdout.strip(),
        "parameters": sum(parameter.numel() for parameter in network.parameters()),
        "views": chunks * CHUNK_VIEWS,
        "temperature": temperature,
        "cannot_tell_shift": shift,
        # In a process of its own: this one holds the weights that it found when it began.
        **json.loads(subprocess.check_output([sys.executable, "-m", "training.offset_network", "score"])),
    }
    file.with_suffix(".json").write_text(json.dumps(made, indent=2) + "\n", encoding="utf-8")
    print(json.dumps(made, indent=2))


@app.command()
def score() -> None:
    """Print how good the weights in the package are on corridors that no training has seen."""
    corridors = list(render_views(HELD_OUT, HELD_OUT_SEED))[HELD_OUT // 2 :]
    views = list(render_views(TEST_VIEWS, TEST_SEED))
    figures = {
        "simulated_corridors": scores(corridors),
        "test_views": {"views": TEST_VIEWS, "seed": TEST_SEED, **scores(views)},
    }
    print(json.dumps(figures, indent=2))


if __name__ == "__main__":
    app()
