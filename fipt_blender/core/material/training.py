"""Stage 2: fitting the networks to the photographs with fixed shadings (paper Sec. 4.5).

Every random choice depends only on (seed, step), so an interrupted training continues from its last
checkpoint and ends with the same weights.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..run.errors import FiptError
from ..run.runfolder import atomic_path
from ..run.stage_settings import TrainingSettings
from . import losses
from .closed_form import CellEstimate, TrainingData
from .networks import BrdfNetwork, EmissionNetwork, emission_mask
from .seen import Box

# Learning rates at the end of a training, as a share of the initial ones; the decay is exponential.
_FINAL_RATE = 0.1
PRETRAINING_STEPS = 200
_PRETRAINING_RATE = 1e-2
# One in so many pixels trains the emission network, which costs as much per pixel as all else together.
_EMISSION_STRIDE = 4
_PARTNERS = 1024


@dataclass
class Networks:
    """MLP_brdf and MLP_emit."""

    brdf: BrdfNetwork
    emission: EmissionNetwork

    def state(self) -> dict[str, Any]:
        """Weights of both."""
        return {"brdf": self.brdf.state_dict(), "emission": self.emission.state_dict()}

    def load(self, state: dict[str, Any]) -> None:
        """Take weights of :meth:`state`."""
        self.brdf.load_state_dict(state["brdf"])
        self.emission.load_state_dict(state["emission"])

    def trained(self) -> list[torch.nn.Parameter]:
        """All parameters in the optimiser's order, the hash grid's table first."""
        return [self.brdf.grid.table, *self.brdf.mlp.parameters(), *self.emission.parameters()]


@dataclass(frozen=True)
class Surfaces:
    """What is known of the T triangles before a training.

    Attributes:
        box: to which positions are normalised.
        unit: (T,) int unit of each, negative for none.
        emitting: (T,) bool, those whose pixels show emission, not only reflection.
    """

    box: Box
    unit: np.ndarray
    emitting: np.ndarray


@dataclass
class Batch:
    """B pixels of the training data as tensors on the training device.

    Attributes:
        position: (B, 3) in the unit cube. unit: (B,) int64, negative for none.
        radiance: (B, 3). reflects: (B,) bool, whether it is reflection alone.
        diffuse: (B, 3). specular: (B, K, 2, 3). levels: (K,).
        label: (B,) int64, negative for none. grouped: (B,) bool, whether it has a group.
        group_material: (B, 2) sigma' and m' of its group; 1 and 0 without.
        semantic: whether labels are semantic classes.
    """

    position: torch.Tensor
    unit: torch.Tensor
    radiance: torch.Tensor
    reflects: torch.Tensor
    label: torch.Tensor
    grouped: torch.Tensor
    diffuse: torch.Tensor
    specular: torch.Tensor
    levels: torch.Tensor
    group_material: torch.Tensor
    semantic: bool


def gather_batch(data: TrainingData, surfaces: Surfaces, rows: np.ndarray, device: torch.device) -> Batch:
    """Read the pixels `rows` (B,), in ascending order: sorted access keeps memory-mapped files fast."""
    rows = np.sort(rows)
    observations = data.observations
    donors = observations.donor[rows]

    def tensor(array: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.asarray(array[donors], np.float32)).to(device)

    triangle = observations.pixels.triangle[rows]
    label, group = (np.asarray(array[rows], np.int64) for array in (observations.part, data.group))
    material = data.materials.of_pixels[group].astype(np.float32)
    position, unit = _places(data, surfaces, rows, device)
    return Batch(
        position=position,
        unit=unit,
        radiance=tensor(observations.pixels.own),
        reflects=torch.from_numpy(~surfaces.emitting[triangle]).to(device),
        label=torch.from_numpy(label).to(device),
        grouped=torch.from_numpy(group >= 0).to(device),
        diffuse=tensor(data.shadings.diffuse),
        specular=tensor(data.shadings.specular),
        levels=torch.tensor(data.shadings.levels).to(device),
        group_material=torch.from_numpy(material).to(device),
        semantic=observations.parts.kind == "semantic",
    )


def _places(
    data: TrainingData, surfaces: Surfaces, rows: np.ndarray, device: torch.device
) -> tuple[torch.Tensor, torch.Tensor]:
    """(R, 3) positions of pixels in the unit cube, and (R,) int64 units."""
    pixels = data.observations.pixels
    position = surfaces.box.normalise(np.asarray(pixels.position[rows]))
    unit = surfaces.unit[pixels.triangle[rows]].astype(np.int64)
    return torch.from_numpy(position).to(device), torch.from_numpy(unit).to(device)


def total_loss(
    networks: Networks, batch: Batch, settings: TrainingSettings, partners: torch.Tensor
) -> torch.Tensor:
    """l + l_e + l_d + l_p of one batch (paper Eq. 15 to 20).

    The emission mask is trained by every fourth pixel. The others take the mask of the emitters that the
    closed form has found: 0 or 1.

    Args:
        partners: (P,) int64 rows of the batch that serve as x' of Eq. 20.
    """
    prediction = networks.brdf(batch.position, batch.unit)
    rendered = losses.factorised_rendering(prediction, batch.diffuse, batch.specular, batch.levels)
    alpha = 1.0 - batch.reflects.to(rendered.dtype)
    raw = networks.emission(batch.position[::_EMISSION_STRIDE])
    alpha[::_EMISSION_STRIDE] = emission_mask(raw)
    emission_loss = losses.emission_loss(raw) * (len(raw) / len(alpha))
    loss = losses.rendering_loss(rendered, alpha, batch.radiance) + settings.lambda_emission * emission_loss
    loss = loss + settings.lambda_diffuse * losses.diffuse_loss(prediction)
    loss = loss + settings.lambda_part * losses.part_loss(prediction, batch.group_material, batch.grouped)
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
    brdf: BrdfNetwork,
    data: TrainingData,
    surfaces: Surfaces,
    cells: CellEstimate,
    settings: TrainingSettings,
    progress: Callable[[float], None],
) -> None:
    """Fit the BRDF network to the closed-form estimate, before the photographs are used.

    Args:
        progress: called with the share of steps done.
    """
    device = brdf.grid.table.device
    optimiser = _Adam([(list(brdf.parameters()), _PRETRAINING_RATE)], PRETRAINING_STEPS)
    pool, donor = data.observations.pool, data.observations.donor
    size = min(settings.batch_size, len(pool))
    # Inside the range of the sigmoid, so that the rendering loss can still move values away from 0 and 1.
    values = cells.values.clip(0.02, 0.98)
    for step in range(PRETRAINING_STEPS):
        rng = np.random.default_rng([settings.seed, 1000, step])
        rows = np.sort(donor[pool[rng.integers(0, len(pool), size)]])
        target = torch.from_numpy(values[cells.of_pixels(data, rows)]).to(device)
        prediction = brdf(*_places(data, surfaces, rows, device))
        optimiser.step(step, (prediction.values - target).square().sum(dim=1).mean())
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
        state: what the file holds if the training continues; None if it starts.
    """

    checkpoint: Path
    state: dict[str, Any] | None = None


def train(
    networks: Networks,
    data: TrainingData,
    surfaces: Surfaces,
    settings: TrainingSettings,
    resume: Resume | None,
    progress: Callable[[float], None],
    first: int = 0,
) -> None:
    """Optimise the networks in place with Adam.

    Args:
        first: number of the first step; learning rates and batches are those of a training from 0.
        resume: the checkpoint file, and where the training continues; None writes no file.
        progress: called with the share of steps done.
    """
    table, *dense = networks.trained()
    steps = settings.training_steps
    optimiser = _Adam([([table], settings.hash_learning_rate), (dense, settings.learning_rate)], steps)
    start = first
    if resume is not None and resume.state is not None:
        networks.load(resume.state)
        optimiser.optimiser.load_state_dict(resume.state["optimiser"])
        start = int(resume.state["step"])
    pool = data.observations.pool
    size = min(settings.batch_size, len(pool))
    for step in range(start, steps):
        rng = np.random.default_rng([settings.seed, 0, step])
        rows = pool[rng.integers(0, len(pool), size)]
        batch = gather_batch(data, surfaces, rows, table.device)
        partners = torch.from_numpy(rng.integers(0, size, min(_PARTNERS, size))).to(table.device)
        optimiser.step(step, total_loss(networks, batch, settings, partners))
        progress((step + 1 - first) / (steps - first))
        if resume is not None and (step + 1) % settings.checkpoint_steps == 0 and step + 1 < steps:
            state = {
                **networks.state(),
                "optimiser": optimiser.optimiser.state_dict(),
                "step": step + 1,
            }
            save_tensors(resume.checkpoint, state)


def load_tensors(path: Path, device: torch.device) -> dict[str, Any]:
    """Read what the function `save_tensors` wrote; code in the file is never run.

    Raises:
        FiptError: ``file-damaged``.
    """
    try:
        state = torch.load(path, map_location=device, weights_only=True)
        if not isinstance(state, dict):
            raise TypeError("it holds no tensors by name")
    except Exception as error:
        raise FiptError("file-damaged.load-tensors", path=path, error=error) from None
    return state


def save_tensors(path: Path, state: dict[str, Any]) -> None:
    """Write tensors to a file, completely or not at all.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    # Through memory: torch's own writer hides the system's error.
    buffer = io.BytesIO()
    torch.save(state, buffer)
    with atomic_path(path) as temporary:
        temporary.write_bytes(buffer.getbuffer())
