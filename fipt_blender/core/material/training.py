# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage 2: fitting the networks to the photographs with fixed shadings (paper Sec. 4.5).

Every random choice depends on (seed, round, step) alone, so a training that was killed goes on from its last
checkpoint and ends with the same weights.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from ..job.checkpoints import save_tensors
from ..job.settings import Settings
from . import losses
from .networks import BrdfNetwork, EmissionNetwork, emission_mask
from .projection import Guess

# Share of steps in which the learning rate has fallen to a tenth.
_DECAY = 0.1
PRETRAINING_STEPS = 200
_PRETRAINING_RATE = 1e-2
_EMISSION_PRETRAINING_RATE = 3e-3
# Raw emission mask to which clear emitters are fitted at first.
_SEED_MASK = 1.0
# Of so many pixels one teaches the emission network, which costs as much a pixel as all else together.
_EMISSION_STRIDE = 4
_PARTNERS = 1024


@dataclass
class TrainingData:
    """Per-pixel arrays that training draws from; memory-mapped arrays will do.

    Attributes:
        pool: (P,) int64 pixels to train on.
        donor: (N,) int64 pixel whose radiance and shadings are taken for each of them: itself, or a pure one
            beside a mixed one.
        position: (N, 3) float32 normalised to the unit cube by `normalise`.
        radiance: (N, 3) in units of the capture's median.
        label: (N,) int part or semantic class of each pixel, negative without.
        group: (N,) int part of each pixel, or what stands for it (core/material/groups.py), negative without.
        diffuse: (N, 3) L_d.
        specular: (N, K, 2, 3) L_s0 and L_s1.
        levels: (K,) roughness levels.
        semantic: whether labels are semantic classes.
        group_roughness, group_metallic: (groups,) closed-form estimates, sigma' and m' of l_p.
        normalise: world positions to the unit cube.
    """

    pool: np.ndarray
    donor: np.ndarray
    position: np.ndarray
    radiance: np.ndarray
    label: np.ndarray
    group: np.ndarray
    diffuse: np.ndarray
    specular: np.ndarray
    levels: np.ndarray
    semantic: bool
    group_roughness: np.ndarray
    group_metallic: np.ndarray
    normalise: Callable[[np.ndarray], np.ndarray]


@dataclass
class Batch:
    """Rows of the training data as tensors on the training device."""

    position: torch.Tensor
    radiance: torch.Tensor
    label: torch.Tensor
    grouped: torch.Tensor
    diffuse: torch.Tensor
    specular: torch.Tensor
    group_roughness: torch.Tensor
    group_metallic: torch.Tensor


def gather_batch(data: TrainingData, rows: np.ndarray, device: torch.device) -> Batch:
    """Read rows; sorted access keeps memory-mapped files fast."""
    rows = np.sort(rows)
    shown = data.donor[rows]

    def tensor(array: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.asarray(array[shown], np.float32)).to(device)

    label, group = (np.asarray(array[rows], np.int64) for array in (data.label, data.group))
    # One more for pixels without a group, at -1.
    roughness, metallic = np.append(data.group_roughness, 1.0), np.append(data.group_metallic, 0.0)
    return Batch(
        group_roughness=torch.as_tensor(roughness[group], dtype=torch.float32, device=device),
        group_metallic=torch.as_tensor(metallic[group], dtype=torch.float32, device=device),
        position=torch.from_numpy(data.normalise(np.asarray(data.position[rows]))).to(device),
        radiance=tensor(data.radiance),
        label=torch.from_numpy(label).to(device),
        grouped=torch.from_numpy(group >= 0).to(device),
        diffuse=tensor(data.diffuse),
        specular=tensor(data.specular),
    )


def total_loss(
    brdf: BrdfNetwork,
    emission: EmissionNetwork,
    batch: Batch,
    levels: torch.Tensor,
    semantic: bool,
    settings: Settings,
    partners: torch.Tensor,
    turn: int = 0,
) -> torch.Tensor:
    """l + l_e + l_d + l_p of one batch (paper Eq. 12 to 17).

    The emission network has gradients at every fourth pixel only; the expected gradient is a quarter of the
    whole batch's for all its terms alike, and Adam does not care for scale.

    Args:
        partners: rows of the batch that serve as x' of Eq. 17.
        turn: which of four pixels it is.
    """
    prediction = brdf(batch.position)
    taught = torch.zeros(len(batch.position), dtype=torch.bool, device=batch.position.device)
    taught[turn % _EMISSION_STRIDE :: _EMISSION_STRIDE] = True
    lesson = emission(batch.position[taught])
    with torch.no_grad():
        rest = emission(batch.position[~taught])
    raw = rest.new_empty((len(taught), *rest.shape[1:]))
    raw[~taught], raw[taught] = rest, lesson
    share = len(lesson) / len(taught)
    rendered = losses.factorised_rendering(prediction, batch.diffuse, batch.specular, levels)
    if settings.emission == "joint":
        loss = losses.joint_rendering_loss(rendered, torch.relu(raw), batch.radiance)
        loss = loss + settings.lambda_joint * share * losses.emission_loss(lesson)
    else:
        loss = losses.rendering_loss(rendered, emission_mask(raw), batch.radiance)
        loss = loss + settings.lambda_emission * share * losses.emission_loss(lesson)
    loss = loss + settings.lambda_diffuse * losses.diffuse_loss(prediction)
    loss = loss + settings.lambda_part * losses.part_loss(
        prediction, batch.group_roughness, batch.group_metallic, batch.grouped
    )
    if semantic:
        loss = loss + settings.lambda_semantic * losses.semantic_loss(
            prediction,
            batch.position,
            batch.label,
            partners,
            settings.sigma_albedo,
            settings.sigma_position,
        )
    return loss


def pretrain(
    brdf: BrdfNetwork,
    emission: EmissionNetwork | None,
    data: TrainingData,
    guess: Guess,
    guess_rows: np.ndarray,
    settings: Settings,
    round_index: int,
    device: torch.device,
    progress: Callable[[float], None],
) -> None:
    """Fit the networks to a closed-form guess before a round.

    A quarter of each batch are pixels that must emit, so that a bulb of a few pixels is not lost. Emission
    that is fitted jointly starts at zero.

    Args:
        emission: None leaves it as it is.
        guess: values at the pixels `guess_rows`.
        progress: called with the share of steps done.
    """
    rates = [(list(brdf.parameters()), _PRETRAINING_RATE)]
    if emission is not None:
        rates.append((list(emission.parameters()), _EMISSION_PRETRAINING_RATE))
    optimiser = _Adam(rates, PRETRAINING_STEPS)
    bright = np.flatnonzero(guess.emitting)
    size = min(settings.batch_size, len(guess_rows))
    part = max(size // _EMISSION_STRIDE, 1)
    values = np.concatenate([guess.base_color, guess.roughness[:, None], guess.metallic[:, None]], axis=1)
    # Inside the sigmoid's range, so that the rendering loss can still move away from 0 and 1.
    values = values.clip(0.02, 0.98)
    mask = guess.emitting.astype(np.float32) * (_SEED_MASK if settings.emission == "mask" else 0.0)

    def positions(chosen: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(data.normalise(np.asarray(data.position[guess_rows[chosen]]))).to(device)

    for step in range(PRETRAINING_STEPS):
        rng = np.random.default_rng([settings.seed, 1000 + round_index, step])
        chosen = rng.integers(0, len(guess_rows), size)
        if len(bright):
            chosen[: size // 4] = bright[rng.integers(0, len(bright), size // 4)]
        found = brdf(positions(chosen))
        outputs = torch.cat([found.base_color, found.roughness[:, None], found.metallic[:, None]], dim=1)
        loss = (outputs - torch.from_numpy(values[chosen]).to(device)).square().sum(dim=1).mean()
        if emission is not None:
            some = chosen[rng.integers(0, size, part)]
            target = torch.from_numpy(mask[some]).to(device)
            raw = emission(positions(some))
            loss = loss + (raw - (target if raw.ndim == 1 else target[:, None])).square().mean()
        optimiser.step(step, loss)
        progress((step + 1) / PRETRAINING_STEPS)


class _Adam:
    """Adam whose rates fall to a tenth over the steps of a training.

    Args:
        rates: parameters and their first rate.
        steps: of the whole training.
    """

    def __init__(self, rates: Sequence[tuple[list[torch.nn.Parameter], float]], steps: int) -> None:
        self._rates, self._steps = [rate for _, rate in rates], steps
        groups = [{"params": parameters, "lr": rate} for parameters, rate in rates]
        self.optimiser = torch.optim.Adam(groups, betas=(0.9, 0.99), fused=True)

    def step(self, step: int, loss: torch.Tensor) -> None:
        """Step number `step` down the gradient of `loss`."""
        for group, rate in zip(self.optimiser.param_groups, self._rates, strict=True):
            group["lr"] = rate * _DECAY ** (step / self._steps)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        self.optimiser.step()


def train(
    brdf: BrdfNetwork,
    emission: EmissionNetwork,
    data: TrainingData,
    settings: Settings,
    steps: int,
    round_index: int,
    device: torch.device,
    checkpoint: Path | None,
    progress: Callable[[float], None],
) -> None:
    """Optimise both networks in place with Adam.

    Args:
        steps: optimiser steps of this round.
        checkpoint: file for checkpoints, continued from where it exists; None writes none.
        progress: called with the share of steps done.
    """
    networks = [*brdf.mlp.parameters(), *emission.parameters()]
    rates = [([brdf.grid.table], settings.hash_learning_rate), (networks, settings.learning_rate)]
    optimiser = _Adam(rates, steps)
    start = 0
    if checkpoint is not None and checkpoint.exists():
        state = torch.load(checkpoint, map_location=device, weights_only=True)
        brdf.load_state_dict(state["brdf"])
        emission.load_state_dict(state["emission"])
        optimiser.optimiser.load_state_dict(state["optimiser"])
        start = int(state["step"])
    levels = torch.from_numpy(data.levels).to(device)
    size = min(settings.batch_size, len(data.pool))
    for step in range(start, steps):
        rng = np.random.default_rng([settings.seed, round_index, step])
        batch = gather_batch(data, data.pool[rng.integers(0, len(data.pool), size)], device)
        partners = torch.from_numpy(rng.integers(0, size, min(_PARTNERS, size))).to(device)
        loss = total_loss(brdf, emission, batch, levels, data.semantic, settings, partners, step)
        optimiser.step(step, loss)
        progress((step + 1) / steps)
        if checkpoint is not None and (step + 1) % settings.checkpoint_steps == 0 and step + 1 < steps:
            state = {
                "brdf": brdf.state_dict(),
                "emission": emission.state_dict(),
                "optimiser": optimiser.optimiser.state_dict(),
                "step": step + 1,
            }
            save_tensors(checkpoint, state)
