"""Train the network of `vision.lateral.learned` on simulated corridors, and write its weights.

``python -m training.offset_network render FOLDER`` renders the pictures. ``... train FOLDER`` (extra ``training``)
trains on them, calibrates on corridors that were not used in training, and writes
``vision/lateral/offset_network.onnx``, with its origin and its accuracy as JSON beside it. ``... refine FOLDER`` does
the same, starting from the packaged weights. Seeds are fixed.
"""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from math import cos, pi
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import onnx
import torch
import typer
from torch import Tensor, nn
from torch.nn import functional

from training.offset_model import OffsetNetwork, at_offset, corner_loss, offset_density
from training.offset_views import VIEWS_PER_CAMERA, TrainingView, render_views
from training.scores import OffsetScores
from training.variations import UNKNOWN, Sample, draw_sample, draw_sample_without_corridor
from vision.lateral import learned
from vision.lateral.learned import learned_mixture
from vision.lateral.polar import N_ANGLES, N_RADII

MIN_HALVED = 64  # elements: smaller tensors are not stored in half precision
BATCH = 48
LEARNING_RATE, LATER_RATE, REFINING_RATE = 4e-3, 3e-3, 1.5e-3
ODDS_RATE = 0.02  # learning rate of the log-odds over the other one; with a larger one the sigmoid saturates
WARM_UP_STEPS, CORNER_STEPS = 60, 300
FIRST_NORMALISED = 96  # views that restore the batch normalisation, which export has fused
WITHOUT_CORRIDOR = 0.05
CORNER_WEIGHT, CLASS_WEIGHT = 0.25, 0.3
CHUNK_VIEWS = 10 * VIEWS_PER_CAMERA
CHUNKS, STEPS, LATER_STEPS, SEED = 53, 11000, 26000, 11
HELD_OUT, HELD_OUT_SEED, VARIATIONS = 240, 900, 4
TEST_VIEWS, TEST_SEED = 48, 950
TEMPERATURES = (1.0, 1.1, 1.25, 1.4, 1.6, 1.8, 2.1)  # at least 1: not more confident than trained
SHIFTS = (1.0, 1.5, 2.0)  # at least 1: all calibration pictures show a corridor, others may not


@dataclass(frozen=True, slots=True)
class Batch:
    """Stacked samples: polar (n, 2, N_RADII, N_ANGLES), offset (n,), corners (n, 4), classes (n, N_ANGLES)."""

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
    """Return the file of a chunk of rendered views."""
    return folder / f"views_{seed}_{number}.pkl"


def train(
    folder: Path,
    chunks: int,
    steps: int,
    seed: int,
    rate: float = LEARNING_RATE,
    earlier: OffsetNetwork | None = None,
) -> OffsetNetwork:
    """Train a network on random variations of the views in a folder.

    Training continues with an ``earlier`` network, in place. Reset its log-odds if its corners were not accurate yet:
    only with accurate corners can the network learn when they are unreliable.
    """
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    network = earlier or OffsetNetwork()
    network.train()
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
                draw_sample_without_corridor(rng)
                if rng.random() < WITHOUT_CORRIDOR
                else draw_sample(views[order.pop()], rng)
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
        # Corners first: while they are random, "cannot tell" is correct, and would not be unlearned later.
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
    """Fit a temperature of the corner scores and a shift of "cannot tell" on held-out pictures; apply both in place.

    Returns
    -------
    temperature, shift
        Temperature of the scores, shift of the frame's log-odds.
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
    """The network with one output (n, 2 N_ANGLES + N_ODDS): corner scores and log-odds."""

    def __init__(self, network: OffsetNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, polar: Tensor) -> Tensor:
        """Evaluate the network."""
        scores, odds = self.network(polar)
        return torch.cat([scores[:, :2].flatten(1), odds], dim=1)


def export(network: OffsetNetwork, file: Path) -> None:
    """Write the network as ONNX for `cv2.dnn`, with a batch of one picture."""
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
    """Store the weights of an exported network in half precision, with casts to single precision."""
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


def packaged_network(views: list[TrainingView], cannot_tell_shift: float) -> OffsetNetwork:
    """Load the packaged weights for further training; ``cannot_tell_shift``, added by calibration, is subtracted.

    Export has fused the batch normalisations into the convolutions. They are restored with the mean and variance of
    the convolutions' outputs on samples of the views.
    """
    model = onnx.load(Path(learned.__file__).with_name(learned.WEIGHTS_FILE))
    tensors = {t.name.removesuffix("_half"): onnx.numpy_helper.to_array(t) for t in model.graph.initializer}
    network = OffsetNetwork()
    own = {
        name.removeprefix("network."): torch.from_numpy(values.astype(np.float32))
        for name, values in tensors.items()
        if name.startswith("network.")
    }
    network.load_state_dict(own, strict=False)
    convolutions = [
        n for n in model.graph.node if n.op_type == "Conv" and not n.input[1].startswith("network.")
    ]
    rng = np.random.default_rng(0)
    samples = Batch.of([draw_sample(view, rng) for view in views])

    def unfolded(layer: nn.Module, weight: str, bias: str) -> Callable[..., None]:
        folded = torch.from_numpy(tensors[bias].astype(np.float32))

        def before(_: nn.Module, inputs: tuple[Tensor]) -> None:
            x = inputs[0]
            variance, mean = torch.var_mean(x, dim=(0, 2, 3))
            norm.running_mean.copy_(mean)
            norm.running_var.copy_(variance)
            norm.weight.copy_(torch.sqrt(variance + norm.eps))
            norm.bias.copy_(mean + folded)

        norm = layer.norm
        layer.convolution.weight.copy_(torch.from_numpy(tensors[weight].astype(np.float32)))
        return norm.register_forward_pre_hook(before).remove

    network.eval()
    with torch.no_grad():
        network.odds.bias[2] -= cannot_tell_shift
        remove = [
            unfolded(layer, node.input[1], node.input[2])
            for layer, node in zip(network.layers(), convolutions, strict=True)
        ]
        network(samples.polar)
    for hook in remove:
        hook()
    return network.train()


def scores(views: list[TrainingView]) -> dict[str, float]:
    """Score the packaged weights on views, about the measured axes."""
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
    network.reset_odds()
    network = train(folder, chunks, later_steps, seed, LATER_RATE, network)
    command = (
        f"python -m training.offset_network train FOLDER --chunks {chunks} --steps {steps} "
        f"--later-steps {later_steps} --seed {seed}"
    )
    write(network, folder, {"made_by": command, "views": chunks * CHUNK_VIEWS})


@app.command()
def refine(folder: Path, chunks: int, steps: int, seed: int, rate: float = REFINING_RATE) -> None:
    """Go on training the weights in the package, calibrate and write them; render the pictures with another seed."""
    torch.set_num_threads(1)
    made = json.loads(described_weights().read_text(encoding="utf-8"))
    views = list(render_views(FIRST_NORMALISED, seed))
    network = packaged_network(views, made["cannot_tell_shift"])
    network = train(folder, chunks, steps, seed, rate, network)
    command = f"python -m training.offset_network refine FOLDER {chunks} {steps} {seed} --rate {rate:g}"
    before = [*made.get("before", ()), {k: made[k] for k in ("made_by", "commit", "views")}]
    write(network, folder, {"made_by": command, "views": chunks * CHUNK_VIEWS, "before": before})


def described_weights() -> Path:
    """Return the file with origin and accuracy of the packaged weights."""
    return Path(learned.__file__).with_name(learned.WEIGHTS_FILE).with_suffix(".json")


def write(network: OffsetNetwork, folder: Path, made: dict[str, Any]) -> None:
    """Calibrate a trained network, and write it into the package with its origin and accuracy."""
    torch.save(network.state_dict(), folder / "network.pt")
    held_out = list(render_views(HELD_OUT, HELD_OUT_SEED))
    rng = np.random.default_rng(HELD_OUT_SEED)
    draws = [
        draw_sample(view, rng, vary=k % 2 == 0)
        for view in held_out[: HELD_OUT // 2]
        for k in range(VARIATIONS)
    ]
    temperature, shift = calibrate(network, Batch.of(draws))
    file = Path(learned.__file__).with_name(learned.WEIGHTS_FILE)
    export(network, file)
    git = subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, text=True, check=True)
    made = {
        **made,
        "commit": git.stdout.strip(),
        "parameters": sum(parameter.numel() for parameter in network.parameters()),
        "temperature": temperature,
        "cannot_tell_shift": shift,
        # In a separate process: this one has cached the weights it loaded at its start.
        **json.loads(subprocess.check_output([sys.executable, "-m", "training.offset_network", "score"])),
    }
    described_weights().write_text(json.dumps(made, indent=2) + "\n", encoding="utf-8")
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
