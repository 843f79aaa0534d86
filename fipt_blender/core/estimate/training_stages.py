"""Stage 2: the BRDF network and the emission mask (paper Sec. 4.5, Eq. 12, 14 to 20)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from ..device.variant import torch_device
from ..material.closed_form import CellEstimate, TrainingData
from ..material.groups import Units
from ..material.networks import (
    BrdfNetwork,
    EmissionNetwork,
    Fields,
    brdf_network,
    network_generator,
    tensors,
    typical_values,
    useful_hash_levels,
)
from ..material.seen import room_box
from ..material.training import (
    PRETRAINING_STEPS,
    Networks,
    Resume,
    Surfaces,
    load_tensors,
    pretrain,
    train,
)
from ..run.chain import Tools
from ..run.errors import FiptError
from ..run.stage_settings import NetworkSettings, TrainingSettings
from ..surface.room import Room

# The last steps of the training that are repeated with hints, as a share of all: high learning rates would
# unlearn what the hints say nothing of.
HINTED_SHARE = 1.0 / 3.0


@dataclass(frozen=True)
class TrainedNetworks:
    """Weights of both networks, by their names in torch, and the units that the networks know by number."""

    brdf: dict[str, np.ndarray]
    emission: dict[str, np.ndarray]
    trained_units: Units


def train_networks(
    room: Room,
    data: TrainingData,
    cells: CellEstimate,
    units: Units,
    emitting: np.ndarray,
    brdf: Mapping[str, np.ndarray] | None = None,
    emission: Mapping[str, np.ndarray] | None = None,
    *,
    settings: TrainingSettings,
    tools: Tools,
) -> TrainedNetworks:
    """Fit the networks to the closed-form estimate, then to the photographs.

    Networks that were trained before, without the present hints, are continued: they add detail to the
    typical values of the units, those of the new closed form. The training's last steps are repeated.

    Args:
        emitting: (T,) bool, the lamps.
        brdf, emission: weights of networks that were trained before; None at first.
    """
    box, observations = room_box(room.bounds), data.observations
    levels = useful_hash_levels(settings, box.extent, observations.footprint)
    typical = typical_values(cells.values, units.triangle[cells.triangle], len(units.single))
    device = torch.device(torch_device())
    networks = Networks(
        BrdfNetwork(settings, levels, typical, network_generator(settings), device),
        EmissionNetwork(network_generator(settings), device),
    )
    surfaces, steps = Surfaces(box, units.triangle, emitting), settings.training_steps
    if brdf is None or emission is None:
        _train_anew(networks, data, surfaces, cells, settings, tools)
    else:
        present = networks.brdf.state_dict()["typical"]
        networks.load({"brdf": {**tensors(brdf), "typical": present}, "emission": tensors(emission)})
        steps = max(round(HINTED_SHARE * steps), 1)
        first = settings.training_steps - steps
        train(networks, data, surfaces, settings, None, tools.reporter.progress, first)
    tools.facts.update(steps=steps, hash_levels=len(networks.brdf.grid.resolutions))
    weights = {
        name: {key: tensor.cpu().numpy() for key, tensor in state.items()}
        for name, state in networks.state().items()
    }
    return TrainedNetworks(weights["brdf"], weights["emission"], units)


def _train_anew(
    networks: Networks,
    data: TrainingData,
    surfaces: Surfaces,
    cells: CellEstimate,
    settings: TrainingSettings,
    tools: Tools,
) -> None:
    """Train networks that are new, or those of an interrupted training."""
    checkpoint = tools.folder / "unfinished.pt"
    state = None
    if checkpoint.exists():
        try:
            state = load_tensors(checkpoint, networks.brdf.grid.table.device)
        except FiptError as error:
            tools.reporter.warning("checkpoint-damaged.train-anew", text=error.text)
            checkpoint.unlink()
    fitted = PRETRAINING_STEPS / (PRETRAINING_STEPS + settings.training_steps)
    if state is None:
        pretrain(networks.brdf, data, surfaces, cells, settings, tools.progress_within(0.0, fitted))
    resume, progress = Resume(checkpoint, state), tools.progress_within(fitted, 1.0)
    train(networks, data, surfaces, settings, resume, progress)


def open_fields(
    room: Room, units: Units, brdf: dict[str, np.ndarray], *, settings: NetworkSettings
) -> Fields:
    """The materials as functions of places: the network of its weights."""
    return Fields(brdf_network(settings, brdf, len(units.single)), room_box(room.bounds))
