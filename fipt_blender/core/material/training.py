# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage 2: fitting base colour to the photographs with fixed shadings (paper Sec. 4.5).

Roughness, metallic and emission are those of the closed form, so that the rendering is linear in base colour.
Every random choice depends only on (seed, step), so an interrupted training continues from its last
checkpoint and ends with the same weights.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..run.checkpoints import load_tensors, save_tensors
from ..run.errors import FiptError
from ..run.settings import Settings
from .networks import ColorNetwork
from .pixel_samples import GroupedPixels
from .seen import Box

# Learning rate at the end of a training, as a share of the initial one; the decay is exponential.
_FINAL_RATE = 0.1


@dataclass(frozen=True)
class Surfaces:
    """What is known of the surfaces that pixels see.

    Attributes:
        box: to which positions are normalised.
        unit: (T,) int unit of each triangle, negative for none.
        emitting: (T,) bool, triangles whose pixels show emission, not only reflection: they do not count.
        emission: (T, 3) float32 radiance that is subtracted from the pixels of a triangle; (0, 3) for none.
    """

    box: Box
    unit: np.ndarray
    emitting: np.ndarray
    emission: np.ndarray


@dataclass(frozen=True)
class Batch:
    """B pixels as tensors on the training device.

    Attributes:
        position: (B, 3) in the unit cube. unit: (B,) int64, negative for none.
        radiance: (B, 3) without known emission.
        slope, offset: (B, 3) of the rendering slope a + offset.
        counts: (B,) 1, or 0 for pixels that show emission.
    """

    position: torch.Tensor
    unit: torch.Tensor
    radiance: torch.Tensor
    slope: torch.Tensor
    offset: torch.Tensor
    counts: torch.Tensor


def gather_batch(data: GroupedPixels, surfaces: Surfaces, rows: np.ndarray, device: torch.device) -> Batch:
    """Read the pixels `rows` (B,), in ascending order: sorted access keeps memory-mapped files fast."""
    rows, pixels = np.sort(rows), data.observations.pixels
    donors, triangle = data.observations.donor[rows], np.asarray(pixels.triangle[rows])
    radiance = np.asarray(pixels.own[donors], np.float32)
    if len(surfaces.emission):
        radiance = radiance - surfaces.emission[triangle]
    slope, offset = data.lines(donors, data.material_of(rows))
    position = surfaces.box.normalise(np.asarray(pixels.position[rows]))
    unit, counts = surfaces.unit[triangle].astype(np.int64), ~surfaces.emitting[triangle]
    arrays = position, unit, radiance, slope, offset, counts.astype(np.float32)
    return Batch(*(torch.from_numpy(array).to(device) for array in arrays))


def tone_map(radiance: torch.Tensor) -> torch.Tensor:
    """The tone mapping of Munkberg et al. 2022: the sRGB transfer function of log(1 + x)."""
    x = torch.log1p(radiance.clamp_min(0.0))
    return torch.where(x <= 0.0031308, 12.92 * x, 1.055 * x.clamp_min(1e-7) ** (1.0 / 2.4) - 0.055)


def rendering_loss(color: torch.Tensor, batch: Batch) -> torch.Tensor:
    """Tone-mapped L2 of base colours (B, 3), mean over the pixels (paper Eq. 15)."""
    error = tone_map(batch.slope * color + batch.offset) - tone_map(batch.radiance)
    return (error.square().sum(dim=1) * batch.counts).mean()


@dataclass(frozen=True)
class Resume:
    """How a training is kept and continued.

    Attributes:
        checkpoint: file that is written now and then.
        state: result of `read_checkpoint` if the training continues; None if it starts.
    """

    checkpoint: Path
    state: dict[str, Any] | None = None


def read_checkpoint(path: Path, network: ColorNetwork, settings: Settings) -> dict[str, Any]:
    """The state of an unfinished training.

    Args:
        path: of the checkpoint that `train` wrote.
        network: which is to continue; it is not changed.

    Raises:
        FiptError: ``file-damaged``.
    """
    state = load_tensors(path, network.grid.table.device)
    problem = ""
    weights = state.get("network")
    if not isinstance(weights, dict) or {key: value.shape for key, value in network.state_dict().items()} != {
        key: getattr(value, "shape", None) for key, value in weights.items()
    }:
        problem = "it is of another network"
    step = state.get("step")
    if not isinstance(step, int) or not 0 < step < settings.training_steps:
        problem = f"its step is {step} of {settings.training_steps}"
    try:
        _adam(network).load_state_dict(state["optimiser"])
        for index, parameter in enumerate(network.parameters()):
            moments = state["optimiser"]["state"].get(index, {})
            if any(moments[key].shape != parameter.shape for key in moments if key != "step"):
                problem = "its optimiser belongs to another network"
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        problem = f"its optimiser can't be read: {error!r}"
    if problem:
        raise FiptError("file-damaged", f"{path} can't be read ({problem}).", "Start the estimation again.")
    return state


def _adam(network: ColorNetwork) -> torch.optim.Adam:
    return torch.optim.Adam(network.parameters(), betas=(0.9, 0.99), fused=True)


def train(
    network: ColorNetwork,
    data: GroupedPixels,
    surfaces: Surfaces,
    settings: Settings,
    resume: Resume | None,
    progress: Callable[[float], None],
    first: int = 0,
) -> None:
    """Optimise the network in place with Adam.

    Args:
        first: number of the first step; learning rates and batches are those of a training from 0.
        resume: the checkpoint file, and where the training continues; None writes no file.
        progress: called with the share of steps done.
    """
    optimiser, steps, start = _adam(network), settings.training_steps, first
    if resume is not None and resume.state is not None:
        network.load_state_dict(resume.state["network"])
        optimiser.load_state_dict(resume.state["optimiser"])
        start = int(resume.state["step"])
    pool = data.observations.pool
    size = min(settings.batch_size, len(pool))
    for step in range(start, steps):
        rng = np.random.default_rng([settings.seed, 0, step])
        rows = pool[rng.integers(0, len(pool), size)]
        batch = gather_batch(data, surfaces, rows, network.grid.table.device)
        optimiser.param_groups[0]["lr"] = settings.learning_rate * _FINAL_RATE ** (step / steps)
        optimiser.zero_grad(set_to_none=True)
        rendering_loss(network(batch.position, batch.unit), batch).backward()
        optimiser.step()
        progress((step + 1 - first) / (steps - first))
        if resume is not None and (step + 1) % settings.checkpoint_steps == 0 and step + 1 < steps:
            state = {
                "network": network.state_dict(),
                "optimiser": optimiser.state_dict(),
                "step": step + 1,
            }
            save_tensors(resume.checkpoint, state)
