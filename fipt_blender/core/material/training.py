# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage 2: fitting the networks to the photographs with fixed shadings (paper Sec. 4.5).

Every random choice depends only on (seed, round, step), so an interrupted training continues from its last
checkpoint and ends with the same weights.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..run.checkpoints import load_tensors, save_tensors
from ..run.errors import FiptError
from ..run.settings import Settings
from . import losses
from .networks import Networks, emission_mask
from .projection import InitialEstimate

# Learning rates at the end of a training, as a share of the initial ones; the decay is exponential.
_FINAL_RATE = 0.1
PRETRAINING_STEPS = 200
_PRETRAINING_RATE = 1e-2
_EMISSION_PRETRAINING_RATE = 3e-3
# Raw emission mask to which pixels that clearly emit are fitted in pretraining.
_EMITTING_RAW_MASK = 1.0
# One in so many pixels of a pretraining batch is an emitting one.
_EMITTING_STRIDE = 4
# One in so many pixels trains the emission network, which costs as much per pixel as everything else
# together.
_EMISSION_STRIDE = 4
_PARTNERS = 1024


@dataclass
class TrainingData:
    """Per-pixel arrays from which batches are drawn; they may be memory-mapped.

    Attributes:
        pool: (P,) int64 indices of the pixels to train on.
        donor: (N,) int64 index of the pixel whose radiance and shadings each pixel takes: itself, or a pure
            one beside a mixed one.
        position: (N, 3) float32 world metres.
        radiance: (N, 3) float32 in units of the capture's median.
        label: (N,) int part or semantic class of each pixel, negative for none.
        group: (N,) int part of each pixel, or the group in its place (:mod:`.groups`), negative for none.
        diffuse: (N, 3) L_d.
        specular: (N, K, 2, 3) L_s0 and L_s1.
        levels: (K,) roughness levels.
        semantic: whether labels are semantic classes.
        group_roughness, group_metallic: (groups,) closed-form estimates, sigma' and m' of l_p.
        normalise: maps world positions to the unit cube.
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
    """B pixels of the training data as tensors on the training device.

    Attributes:
        position: (B, 3) in the unit cube.
        radiance, diffuse: (B, 3). specular: (B, K, 2, 3). levels: (K,).
        label: (B,) int64, negative for none. grouped: (B,) bool, whether it has a group.
        group_roughness, group_metallic: (B,) sigma' and m' of its group; 1 and 0 without.
        semantic: whether labels are semantic classes.
    """

    position: torch.Tensor
    radiance: torch.Tensor
    label: torch.Tensor
    grouped: torch.Tensor
    diffuse: torch.Tensor
    specular: torch.Tensor
    levels: torch.Tensor
    group_roughness: torch.Tensor
    group_metallic: torch.Tensor
    semantic: bool


def gather_batch(data: TrainingData, rows: np.ndarray, device: torch.device) -> Batch:
    """Read the pixels `rows` (B,), in ascending order: sorted access keeps memory-mapped files fast."""
    rows = np.sort(rows)
    donors = data.donor[rows]

    def tensor(array: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.asarray(array[donors], np.float32)).to(device)

    label, group = (np.asarray(array[rows], np.int64) for array in (data.label, data.group))
    # One more entry at -1, for pixels without a group.
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
        levels=torch.from_numpy(data.levels).to(device),
        semantic=data.semantic,
    )


def total_loss(
    networks: Networks, batch: Batch, settings: Settings, partners: torch.Tensor, offset: int = 0
) -> torch.Tensor:
    """l + l_e + l_d + l_p of one batch (paper Eq. 15 to 20).

    The emission network gets gradients from every fourth pixel only. This scales the expected gradient of all
    its terms by a quarter, and Adam's steps do not depend on the scale.

    Args:
        partners: (P,) int64 rows of the batch that serve as x' of Eq. 20.
        offset: of these pixels, modulo four.
    """
    prediction = networks.brdf(batch.position)
    trained = torch.zeros(len(batch.position), dtype=torch.bool, device=batch.position.device)
    trained[offset % _EMISSION_STRIDE :: _EMISSION_STRIDE] = True
    trained_raw = networks.emission(batch.position[trained])
    with torch.no_grad():
        fixed_raw = networks.emission(batch.position[~trained])
    raw = fixed_raw.new_empty((len(trained), *fixed_raw.shape[1:]))
    raw[~trained], raw[trained] = fixed_raw, trained_raw
    share = len(trained_raw) / len(trained)
    rendered = losses.factorised_rendering(prediction, batch.diffuse, batch.specular, batch.levels)
    if settings.emission == "joint":
        loss = losses.joint_rendering_loss(rendered, torch.relu(raw), batch.radiance)
        loss = loss + settings.lambda_joint * share * losses.emission_loss(trained_raw)
    else:
        loss = losses.rendering_loss(rendered, emission_mask(raw), batch.radiance)
        loss = loss + settings.lambda_emission * share * losses.emission_loss(trained_raw)
    loss = loss + settings.lambda_diffuse * losses.diffuse_loss(prediction)
    loss = loss + settings.lambda_part * losses.part_loss(
        prediction, batch.group_roughness, batch.group_metallic, batch.grouped
    )
    if batch.semantic:
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
    networks: Networks,
    data: TrainingData,
    estimate: InitialEstimate,
    settings: Settings,
    round_index: int,
    progress: Callable[[float], None],
) -> None:
    """Fit the networks to the closed-form estimate before a round (the emission network before the first).

    A quarter of each batch consists of pixels that emit, so that a bulb of a few pixels is not lost. Emission
    that is fitted jointly starts at zero.

    Args:
        round_index: from 0.
        progress: called with the share of steps done.
    """
    brdf, device = networks.brdf, networks.device
    emission = networks.emission if round_index == 0 else None
    rates = [(list(brdf.parameters()), _PRETRAINING_RATE)]
    if emission is not None:
        rates.append((list(emission.parameters()), _EMISSION_PRETRAINING_RATE))
    optimiser = _Adam(rates, PRETRAINING_STEPS)
    emitting = np.flatnonzero(estimate.emitting)
    size = min(settings.batch_size, len(estimate.rows))
    emission_size = max(size // _EMISSION_STRIDE, 1)
    values = np.concatenate(
        [estimate.base_color, estimate.roughness[:, None], estimate.metallic[:, None]], axis=1
    )
    # Inside the range of the sigmoid, so that the rendering loss can still move values away from 0 and 1.
    values = values.clip(0.02, 0.98)
    raw_mask = _EMITTING_RAW_MASK if settings.emission == "mask" else 0.0
    mask = estimate.emitting.astype(np.float32) * raw_mask

    def positions(index: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(data.normalise(np.asarray(data.position[estimate.rows[index]]))).to(device)

    for step in range(PRETRAINING_STEPS):
        rng = np.random.default_rng([settings.seed, 1000 + round_index, step])
        chosen = rng.integers(0, len(estimate.rows), size)
        if len(emitting):
            quarter = size // _EMITTING_STRIDE
            chosen[:quarter] = emitting[rng.integers(0, len(emitting), quarter)]
        prediction = brdf(positions(chosen))
        outputs = torch.cat(
            [prediction.base_color, prediction.roughness[:, None], prediction.metallic[:, None]], dim=1
        )
        loss = (outputs - torch.from_numpy(values[chosen]).to(device)).square().sum(dim=1).mean()
        if emission is not None:
            emission_chosen = chosen[rng.integers(0, size, emission_size)]
            target = torch.from_numpy(mask[emission_chosen]).to(device)
            raw = emission(positions(emission_chosen))
            loss = loss + (raw - (target if raw.ndim == 1 else target[:, None])).square().mean()
        optimiser.step(step, loss)
        progress((step + 1) / PRETRAINING_STEPS)


class _Adam:
    """Adam whose learning rates decay exponentially to `_FINAL_RATE` of their initial values.

    Args:
        rates: parameters and their initial learning rate.
        steps: number of steps of the training.
    """

    def __init__(self, rates: Sequence[tuple[list[torch.nn.Parameter], float]], steps: int) -> None:
        self._rates, self._steps = [rate for _, rate in rates], steps
        groups = [{"params": parameters, "lr": rate} for parameters, rate in rates]
        self.optimiser = torch.optim.Adam(groups, betas=(0.9, 0.99), fused=True)

    def step(self, step: int, loss: torch.Tensor) -> None:
        """Take step number `step` (from 0) down the gradient of `loss`."""
        for group, rate in zip(self.optimiser.param_groups, self._rates, strict=True):
            group["lr"] = rate * _FINAL_RATE ** (step / self._steps)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        self.optimiser.step()


@dataclass(frozen=True)
class Resume:
    """How a training is kept and continued.

    Attributes:
        checkpoint: file that is written now and then.
        state: result of `read_checkpoint` if the training continues; None if it starts.
    """

    checkpoint: Path
    state: dict[str, Any] | None = None


def read_checkpoint(path: Path, networks: Networks, steps: int) -> dict[str, Any]:
    """The state of an unfinished training.

    Args:
        path: of the checkpoint that `train` wrote.
        networks: which are to continue; they are not changed.
        steps: of the training.

    Raises:
        FiptError: ``file-damaged``.
    """
    state = load_tensors(path, networks.device)
    problem = ""
    for name, network in (("brdf", networks.brdf), ("emission", networks.emission)):
        shapes = {key: value.shape for key, value in network.state_dict().items()}
        weights = state.get(name)
        if not isinstance(weights, dict) or shapes != {
            key: getattr(value, "shape", None) for key, value in weights.items()
        }:
            problem = f"its {name} network is another one"
    step = state.get("step")
    if not isinstance(step, int) or not 0 < step < steps:
        problem = f"its step is {step} of {steps}"
    table, *dense = _trained(networks)
    try:
        _Adam([([table], 0.0), (dense, 0.0)], steps).optimiser.load_state_dict(state["optimiser"])
        for index, parameter in enumerate((table, *dense)):
            moments = state["optimiser"]["state"].get(index, {})
            if any(moments[key].shape != parameter.shape for key in moments if key != "step"):
                problem = "its optimiser belongs to other networks"
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        problem = f"its optimiser can't be read: {error!r}"
    if problem:
        raise FiptError("file-damaged", f"{path} can't be read ({problem}).", "Start the estimation again.")
    return state


def _trained(networks: Networks) -> list[torch.nn.Parameter]:
    """The parameters of both networks in the optimiser's order."""
    return [networks.brdf.grid.table, *networks.brdf.mlp.parameters(), *networks.emission.parameters()]


def train(
    networks: Networks,
    data: TrainingData,
    settings: Settings,
    steps: int,
    round_index: int,
    resume: Resume | None,
    progress: Callable[[float], None],
) -> None:
    """Optimise both networks in place with Adam.

    Args:
        steps: optimiser steps of this round.
        round_index: from 0.
        resume: the checkpoint file, and where the training continues; None writes no file.
        progress: called with the share of steps done.
    """
    brdf, emission, device = networks.brdf, networks.emission, networks.device
    table, *dense = _trained(networks)
    optimiser = _Adam([([table], settings.hash_learning_rate), (dense, settings.learning_rate)], steps)
    start = 0
    if resume is not None and resume.state is not None:
        state = resume.state
        brdf.load_state_dict(state["brdf"])
        emission.load_state_dict(state["emission"])
        optimiser.optimiser.load_state_dict(state["optimiser"])
        start = int(state["step"])
    size = min(settings.batch_size, len(data.pool))
    for step in range(start, steps):
        rng = np.random.default_rng([settings.seed, round_index, step])
        batch = gather_batch(data, data.pool[rng.integers(0, len(data.pool), size)], device)
        partners = torch.from_numpy(rng.integers(0, size, min(_PARTNERS, size))).to(device)
        loss = total_loss(networks, batch, settings, partners, step)
        optimiser.step(step, loss)
        progress((step + 1) / steps)
        if resume is not None and (step + 1) % settings.checkpoint_steps == 0 and step + 1 < steps:
            state = {
                "brdf": brdf.state_dict(),
                "emission": emission.state_dict(),
                "optimiser": optimiser.optimiser.state_dict(),
                "step": step + 1,
            }
            save_tensors(resume.checkpoint, state)
