# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Training recovers the colours of synthetic pixels, and is reproducible over threads and interruptions."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from fipt_blender.core.light.baking import ShadingStore
from fipt_blender.core.material.networks import ColorNetwork
from fipt_blender.core.material.pixel_samples import GroupedPixels, GroupMaterials
from fipt_blender.core.material.seen import Box
from fipt_blender.core.material.training import (
    Resume,
    Surfaces,
    gather_batch,
    read_checkpoint,
    rendering_loss,
    tone_map,
    train,
)
from fipt_blender.core.run.checkpoints import save_tensors
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.settings import Settings

CPU = torch.device("cpu")
SETTINGS = Settings(
    hash_levels=4, hash_log2_size=10, batch_size=512, checkpoint_steps=5, learning_rate=5e-3,
)  # fmt: skip
LEVELS = np.array([0.02, 0.5, 1.0], np.float32)
RED, BLUE = [0.7, 0.2, 0.1], [0.1, 0.3, 0.6]


def make_data() -> GroupedPixels:
    """Matt red pixels and metallic blue ones, a half of the cube each, and a lamp in a corner.

    Triangle 0 is the red half, 1 the blue one and 2 the lamp.
    """
    rng = np.random.default_rng(4)
    count = 4000
    position = rng.random((count, 3)).astype(np.float32)
    part = (position[:, 0] > 0.5).astype(np.int32)
    color = np.where(part[:, None] == 0, RED, BLUE)
    diffuse, lobe = rng.uniform(0.5, 1.5, (2, count, 1)) * np.ones(3)
    specular = np.repeat(np.stack([lobe, 0.1 * lobe], axis=1)[:, None], 3, axis=1)
    radiance = np.where(part[:, None] == 0, color * diffuse + 0.04 * lobe, color * lobe) + 0.1 * lobe
    lamp = np.linalg.norm(position - 1.0, axis=1) < 0.4
    radiance[lamp] = 30.0
    pixels = SimpleNamespace(
        own=radiance.astype(np.float32), position=position * 4.0 - 2.0, triangle=np.where(lamp, 2, part)
    )
    rows = np.arange(count)
    observations = SimpleNamespace(pixels=pixels, donor=rows, pool=rows)
    materials = GroupMaterials(np.array([[1.0, 0.0], [0.5, 1.0]], np.float32), np.zeros((2, 2), np.float32))
    shadings = ShadingStore(diffuse.astype(np.float16), specular.astype(np.float16))
    return GroupedPixels(observations, shadings, LEVELS, part, materials, np.zeros(2, bool))


def make_surfaces() -> Surfaces:
    """The halves are units; the lamp emits."""
    unit, emitting = np.array([0, 1, -1]), np.array([False, False, True])
    return Surfaces(Box(np.full(3, -2.0), 4.0), unit, emitting, np.zeros((0, 3), np.float32))


def do_train(
    network: ColorNetwork, steps: int, resume: Resume | None = None, progress=lambda _: None, **changes
) -> None:
    settings = replace(SETTINGS, training_steps=steps, **changes)
    train(network, make_data(), make_surfaces(), settings, resume, progress)


@pytest.fixture
def one_thread():
    """Networks this small lose more time waiting for a second thread than they gain."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def make_network() -> ColorNetwork:
    return ColorNetwork(SETTINGS, 4, np.full((3, 3), 0.5), torch.Generator().manual_seed(1), CPU)


def weights(network: ColorNetwork) -> list[bytes]:
    return [value.numpy().tobytes() for value in network.state_dict().values()]


def test_the_same_seed_gives_the_same_weights_on_all_threads() -> None:
    results = []
    for seed in (0, 0, 1):
        network = make_network()
        do_train(network, 6, seed=seed)
        results.append(weights(network))
    assert results[0] == results[1]
    assert results[2] != results[0]


def test_an_interrupted_training_ends_with_the_same_weights(one_thread, tmp_path: Path) -> None:
    uninterrupted = make_network()
    do_train(uninterrupted, 12)

    def interrupt(share: float) -> None:
        if share > 0.9:
            raise KeyboardInterrupt

    checkpoint = tmp_path / "unfinished.pt"
    with pytest.raises(KeyboardInterrupt):
        do_train(make_network(), 12, Resume(checkpoint), interrupt)
    assert checkpoint.exists()
    resumed = make_network()
    shares: list[float] = []
    do_train(
        resumed,
        12,
        Resume(checkpoint, read_checkpoint(checkpoint, resumed, replace(SETTINGS, training_steps=12))),
        shares.append,
    )
    assert shares[0] == pytest.approx(11 / 12)  # from the checkpoint after step 10
    assert weights(uninterrupted) == weights(resumed)


@pytest.mark.parametrize(
    "change",
    [
        {"network": None},
        {"network": {}},
        {"step": 12},
        {"step": "5"},
        {"optimiser": {}},
        {"optimiser": {"state": {0: {"exp_avg": torch.zeros(3)}}, "param_groups": []}},
    ],
)
def test_a_checkpoint_that_does_not_fit_is_refused(change, tmp_path: Path) -> None:
    checkpoint = tmp_path / "unfinished.pt"
    do_train(make_network(), 6, Resume(checkpoint))
    assert read_checkpoint(checkpoint, make_network(), replace(SETTINGS, training_steps=6))["step"] == 5
    save_tensors(checkpoint, {**torch.load(checkpoint, weights_only=True), **change})
    with pytest.raises(FiptError) as caught:
        read_checkpoint(checkpoint, make_network(), replace(SETTINGS, training_steps=6))
    assert caught.value.code == "file-damaged"


@pytest.mark.parametrize("glow", [False, True])
def test_colours_are_found_beside_a_lamp_that_does_not_count(glow: bool, one_thread) -> None:
    """Also of a metal. Emission of the red half that is known is subtracted."""
    network, data, surfaces = make_network(), make_data(), make_surfaces()
    pixels = data.observations.pixels
    if glow:
        emission = np.array([[0.4, 0.3, 0.2], [0.0] * 3, [0.0] * 3], np.float32)
        pixels.own += emission[pixels.triangle]
        surfaces = replace(surfaces, emission=emission)
    train(network, data, surfaces, replace(SETTINGS, training_steps=400), None, lambda _: None)
    inputs = surfaces.box.normalise(pixels.position)
    with torch.no_grad():
        unit = torch.from_numpy(surfaces.unit[pixels.triangle])
        found = network(torch.from_numpy(inputs), unit).numpy()
    error = np.abs(found - np.where(data.group[:, None] == 0, RED, BLUE)).mean(axis=1)
    on_lamp = pixels.triangle == 2
    assert error[~on_lamp].mean() < 0.04
    assert error[~on_lamp & (np.abs(inputs[:, 0] - 0.5) < 0.05)].mean() < 0.06


def test_tone_mapping_and_rendering_loss() -> None:
    x = torch.tensor([0.0, 0.001, 1.0, 50.0, -1.0], dtype=torch.float64)
    logs = np.log1p([0.0, 0.001, 1.0, 50.0, 0.0])
    curve = np.where(logs <= 0.0031308, 12.92 * logs, 1.055 * logs ** (1 / 2.4) - 0.055)
    assert tone_map(x).tolist() == pytest.approx(curve.tolist())
    batch = gather_batch(make_data(), make_surfaces(), np.arange(200), CPU)
    color = torch.full((200, 3), 0.5)
    error = tone_map(0.5 * batch.slope + batch.offset) - tone_map(batch.radiance)
    squared = error.square().sum(dim=1)[batch.counts > 0]
    assert float(rendering_loss(color, batch)) == pytest.approx(float(squared.sum()) / 200)


def test_batches_keep_their_rows_together(rng: np.random.Generator) -> None:
    data, surfaces = make_data(), make_surfaces()
    pixels = data.observations.pixels
    data.group[5] = -1
    rows = rng.permutation(200)
    batch = gather_batch(data, surfaces, rows, CPU)
    order = np.sort(rows)
    np.testing.assert_array_equal(batch.radiance.numpy(), pixels.own[order])
    np.testing.assert_array_equal(batch.position.numpy(), surfaces.box.normalise(pixels.position[order]))
    assert (batch.counts.numpy() == (pixels.triangle[order] != 2)).all()
    assert batch.unit.numpy().tolist() == surfaces.unit[pixels.triangle[order]].tolist()
    assert batch.slope.dtype == torch.float32
    # Eq. 5 by hand, of a pixel without a group (diffuse) and of a metal.
    np.testing.assert_array_equal(batch.slope[5], data.shadings.diffuse[5].astype(np.float32))
    metal = np.flatnonzero(data.group[:200] == 1)[0]
    np.testing.assert_allclose(batch.slope[metal], data.shadings.specular[metal, 1, 0], rtol=1e-5)
    np.testing.assert_allclose(batch.offset[metal], data.shadings.specular[metal, 1, 1], rtol=1e-5)
