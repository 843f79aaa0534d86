# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Training recovers the materials of synthetic pixels, and is reproducible over threads and interruptions."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from fipt_blender.core.light.baking import ShadingStore
from fipt_blender.core.material.closed_form import TrainingData
from fipt_blender.core.material.emission_mask import EmissionNetwork, emission_mask
from fipt_blender.core.material.mixture import GroupMaterials
from fipt_blender.core.material.networks import BrdfNetwork
from fipt_blender.core.material.seen import Box
from fipt_blender.core.material.training import (
    Networks,
    Resume,
    Surfaces,
    gather_batch,
    read_checkpoint,
    save_tensors,
    total_loss,
    train,
)
from fipt_blender.core.run.settings import Settings
from samples.refusals import error_of

CPU = torch.device("cpu")
SETTINGS = Settings(
    hash_levels=4, hash_log2_size=10, batch_size=512, checkpoint_steps=5, learning_rate=5e-3,
)  # fmt: skip
LEVELS = np.array([0.02, 0.5, 1.0], np.float32)


def make_data(kind: str = "part") -> TrainingData:
    """Matt pixels in two halves, one red and one blue, and a lamp in a corner."""
    rng = np.random.default_rng(4)
    count = 4000
    position = rng.random((count, 3)).astype(np.float32)
    part = (position[:, 0] > 0.5).astype(np.int32)
    color = np.where(part[:, None] == 0, [0.7, 0.2, 0.1], [0.1, 0.3, 0.6])
    diffuse = rng.uniform(0.5, 1.5, (count, 1)) * np.ones(3)
    radiance = color * diffuse
    lamp = np.linalg.norm(position - 1.0, axis=1) < 0.4
    radiance[lamp] = 30.0
    observations = SimpleNamespace(
        pool=np.arange(count),
        donor=np.arange(count),
        part=part,
        parts=SimpleNamespace(kind=kind),
        pixels=SimpleNamespace(
            position=position * 4.0 - 2.0, own=radiance.astype(np.float32), triangle=np.where(lamp, 2, part)
        ),
    )
    return TrainingData(
        observations,
        ShadingStore(diffuse.astype(np.float16), np.full((count, 3, 2, 3), 1e-3, np.float16)),
        LEVELS,
        np.full(count, -1) if kind == "none" else part.copy(),
        GroupMaterials(np.array([[1.0, 0.0]] * 2, np.float32), np.zeros((2, 2), np.float32)),
    )


def make_surfaces() -> Surfaces:
    """Triangle 0 is the red half, 1 the blue one and 2 the lamp; the halves are units."""
    emitting = np.array([False, False, True])
    return Surfaces(Box(np.full(3, -2.0), 4.0), np.array([0, 1, -1]), emitting)


def do_train(networks: Networks, steps: int, resume: Resume | None = None, progress=lambda _: None, **changes) -> None:
    data = make_data()
    train(networks, data, make_surfaces(), replace(SETTINGS, training_steps=steps, **changes), resume, progress)


def make_networks() -> Networks:
    generator = torch.Generator().manual_seed(1)
    brdf = BrdfNetwork(SETTINGS, 4, np.full((3, 5), 0.5), generator, CPU)
    return Networks(brdf, EmissionNetwork(generator, CPU, width=32, depth=2))


def weights(networks: Networks) -> list[bytes]:
    return [value.numpy().tobytes() for state in networks.state().values() for value in state.values()]


def test_the_same_seed_gives_the_same_weights_on_all_threads() -> None:
    results = []
    for seed in (0, 0, 1):
        networks = make_networks()
        do_train(networks, 6, seed=seed)
        results.append(weights(networks))
    assert results[0] == results[1]
    assert results[2] != results[0]


def test_an_interrupted_training_ends_with_the_same_weights(one_thread, tmp_path: Path) -> None:
    uninterrupted = make_networks()
    do_train(uninterrupted, 12)

    def interrupt(share: float) -> None:
        if share > 0.9:
            raise KeyboardInterrupt

    checkpoint = tmp_path / "unfinished.pt"
    with pytest.raises(KeyboardInterrupt):
        do_train(make_networks(), 12, Resume(checkpoint), interrupt)
    assert checkpoint.exists()
    resumed = make_networks()
    shares: list[float] = []
    do_train(resumed, 12, Resume(checkpoint, read_checkpoint(checkpoint, resumed, 12)), shares.append)
    assert shares[0] == pytest.approx(11 / 12)  # from the checkpoint after step 10
    assert weights(uninterrupted) == weights(resumed)


@pytest.mark.parametrize(
    "change",
    [
        {"brdf": None},
        {"brdf": {}},
        {"emission": {}},
        {"step": 12},
        {"step": "5"},
        {"optimiser": {}},
        {"optimiser": {"state": {0: {"exp_avg": torch.zeros(3)}}, "param_groups": []}},
    ],
)
def test_a_checkpoint_that_does_not_fit_is_refused(change, tmp_path: Path) -> None:
    checkpoint = tmp_path / "unfinished.pt"
    do_train(make_networks(), 6, Resume(checkpoint))
    assert read_checkpoint(checkpoint, make_networks(), 6)["step"] == 5
    save_tensors(checkpoint, {**torch.load(checkpoint, weights_only=True), **change})
    assert error_of(read_checkpoint, checkpoint, make_networks(), 6).code == "file-damaged"


def test_colours_are_found_beside_a_lamp_that_does_not_count(one_thread) -> None:
    networks, data, surfaces = make_networks(), make_data(), make_surfaces()
    seen, pixels = data.observations, data.observations.pixels
    train(networks, data, surfaces, replace(SETTINGS, training_steps=400), None, lambda _: None)
    inputs = torch.from_numpy(surfaces.box.normalise(pixels.position))
    with torch.no_grad():
        prediction = networks.brdf(inputs, torch.from_numpy(surfaces.unit[pixels.triangle]))
    kd = (prediction.base_color * (1 - prediction.metallic[:, None])).numpy()
    expected = np.where(seen.part[:, None] == 0, [0.7, 0.2, 0.1], [0.1, 0.3, 0.6])
    on_lamp = pixels.triangle == 2
    error = np.abs(kd - expected).mean(axis=1)
    assert error[~on_lamp].mean() < 0.04
    at_border = np.abs(surfaces.box.normalise(pixels.position)[:, 0] - 0.5) < 0.05
    assert error[~on_lamp & at_border].mean() < 0.06


def test_the_mask_finds_a_lamp_that_nothing_has_found_before(one_thread) -> None:
    """Reflection can't explain the lamp's pixels, so the mask takes them; l_e keeps it small elsewhere."""
    networks, data = make_networks(), make_data()
    surfaces = replace(make_surfaces(), emitting=np.zeros(3, bool))
    train(networks, data, surfaces, replace(SETTINGS, training_steps=400), None, lambda _: None)
    pixels = data.observations.pixels
    with torch.no_grad():
        raw = networks.emission(torch.from_numpy(surfaces.box.normalise(pixels.position)))
    alpha, on_lamp = emission_mask(raw).numpy(), pixels.triangle == 2
    assert np.quantile(alpha[on_lamp], 0.05) > 0.05
    assert np.quantile(alpha[~on_lamp], 0.9) < 0.01


@pytest.mark.parametrize("kind", ["part", "semantic", "none"])
def test_every_term_is_in_the_total(kind: str) -> None:
    """Raising the weight of a term raises the total, unless the data have no such term."""
    data = make_data(kind)
    batch = gather_batch(data, make_surfaces(), np.arange(0, 400), CPU)
    partners, networks = torch.arange(0, 400, 2), make_networks()
    with torch.no_grad():  # it starts with hardly any detail
        networks.brdf.mlp[-1].weight.mul_(1000.0)
    terms = ("lambda_emission", "lambda_diffuse", "lambda_part", "lambda_semantic")

    def total(**changes: float) -> float:
        settings = Settings(**{**dict.fromkeys(terms, 0.0), **changes})
        with torch.no_grad():
            return float(total_loss(networks, batch, settings, partners))

    base = total()
    raised = {name: total(**{name: 1.0}) > base + 1e-6 for name in terms}
    expected = {
        "lambda_emission": True,
        "lambda_diffuse": True,
        "lambda_part": kind != "none",
        "lambda_semantic": kind == "semantic",
    }
    assert raised == expected
