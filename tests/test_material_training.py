# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Training recovers the materials of synthetic pixels, and is reproducible over threads and interruptions."""

from pathlib import Path

import numpy as np
import pytest
import torch

from fipt_blender.core.material.networks import BrdfNetwork, EmissionNetwork, Networks, emission_mask
from fipt_blender.core.material.training import (
    Resume,
    TrainingData,
    gather_batch,
    read_checkpoint,
    total_loss,
    train,
)
from fipt_blender.core.run.checkpoints import save_tensors
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.settings import Settings

CPU = torch.device("cpu")
SETTINGS = Settings(
    hash_levels=4, hash_log2_size=10, batch_size=512, emission_width=32, emission_depth=4, checkpoint_steps=5,
    learning_rate=5e-3,
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
    return TrainingData(
        pool=np.arange(count),
        donor=np.arange(count),
        position=position * 4.0 - 2.0,
        radiance=radiance.astype(np.float32),
        label=part,
        group=np.full(count, -1) if kind == "none" else part,
        diffuse=diffuse.astype(np.float16),
        specular=np.full((count, 3, 2, 3), 1e-3, np.float16),
        levels=LEVELS,
        semantic=kind == "semantic",
        group_roughness=np.array([1.0, 1.0], np.float32),
        group_metallic=np.array([0.0, 0.0], np.float32),
        normalise=lambda world: ((world + 2.0) / 4.0).astype(np.float32),
    )


@pytest.fixture
def one_thread():
    """Networks this small lose more time waiting for a second thread than they gain."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def make_networks() -> Networks:
    generator = torch.Generator().manual_seed(1)
    return Networks(BrdfNetwork(SETTINGS, 4, generator, CPU), EmissionNetwork(SETTINGS, generator, CPU))


def weights(networks: Networks) -> list[bytes]:
    modules = (networks.brdf, networks.emission)
    return [value.numpy().tobytes() for module in modules for value in module.state_dict().values()]


def test_the_same_seed_gives_the_same_weights_on_all_threads() -> None:
    results = []
    for round_index in (0, 0, 1):
        networks = make_networks()
        train(networks, make_data(), SETTINGS, 6, round_index, None, lambda _: None)
        results.append(weights(networks))
    assert results[0] == results[1]
    assert results[2] != results[0]  # another round draws other batches


def test_an_interrupted_training_ends_with_the_same_weights(one_thread, tmp_path: Path) -> None:
    uninterrupted = make_networks()
    train(uninterrupted, make_data(), SETTINGS, 12, 0, None, lambda _: None)

    def interrupt(share: float) -> None:
        if share > 0.9:
            raise KeyboardInterrupt

    checkpoint = tmp_path / "training-0.pt"
    with pytest.raises(KeyboardInterrupt):
        train(make_networks(), make_data(), SETTINGS, 12, 0, Resume(checkpoint), interrupt)
    assert checkpoint.exists()
    resumed = make_networks()
    shares: list[float] = []
    resume = Resume(checkpoint, read_checkpoint(checkpoint, resumed, 12))
    train(resumed, make_data(), SETTINGS, 12, 0, resume, shares.append)
    assert shares[0] == pytest.approx(11 / 12)  # from the checkpoint after step 10
    assert weights(uninterrupted) == weights(resumed)


@pytest.mark.parametrize(
    "change",
    [
        {"brdf": None},
        {"emission": {}},
        {"step": 12},
        {"step": "5"},
        {"optimiser": {}},
        {"optimiser": {"state": {0: {"exp_avg": torch.zeros(3)}}, "param_groups": []}},
    ],
)
def test_a_checkpoint_that_does_not_fit_is_refused(change, tmp_path: Path) -> None:
    checkpoint = tmp_path / "training-0.pt"
    train(make_networks(), make_data(), SETTINGS, 6, 0, Resume(checkpoint), lambda _: None)
    assert read_checkpoint(checkpoint, make_networks(), 6)["step"] == 5
    save_tensors(checkpoint, {**torch.load(checkpoint, weights_only=True), **change})
    with pytest.raises(FiptError) as caught:
        read_checkpoint(checkpoint, make_networks(), 6)
    assert caught.value.code == "file-damaged"


def test_colours_and_the_lamp_are_found(one_thread) -> None:
    networks = make_networks()
    data = make_data()
    train(networks, data, SETTINGS, 400, 0, None, lambda _: None)
    inputs = torch.from_numpy(data.normalise(data.position))
    with torch.no_grad():
        prediction = networks.brdf(inputs)
        alpha = emission_mask(networks.emission(inputs)).numpy()
    kd = (prediction.base_color * (1 - prediction.metallic[:, None])).numpy()
    expected = np.where(data.label[:, None] == 0, [0.7, 0.2, 0.1], [0.1, 0.3, 0.6])
    distance = np.linalg.norm(data.normalise(data.position) - 1.0, axis=1)
    clear = (np.abs(data.normalise(data.position)[:, 0] - 0.5) > 0.05) & (distance > 0.5)
    assert np.abs(kd - expected)[clear].mean() < 0.06
    assert alpha[distance < 0.3].min() > 0.1 and alpha[clear].mean() < 0.01


@pytest.mark.parametrize("kind", ["part", "semantic", "none"])
def test_every_term_is_in_the_total(kind: str) -> None:
    """Raising the weight of a term raises the total, unless the data have no such term."""
    data = make_data(kind)
    batch = gather_batch(data, np.arange(0, 400), CPU)
    partners, networks = torch.arange(0, 400, 2), make_networks()

    def total(**changes: float) -> float:
        zero = {name: 0.0 for name in ("lambda_emission", "lambda_diffuse", "lambda_part", "lambda_semantic")}
        settings = Settings(**{**zero, **changes})
        with torch.no_grad():
            return float(total_loss(networks, batch, settings, partners))

    base = total()
    raised = {
        name: total(**{name: 1.0}) > base + 1e-6
        for name in ("lambda_emission", "lambda_diffuse", "lambda_part", "lambda_semantic")
    }
    assert raised == {
        "lambda_emission": True,
        "lambda_diffuse": True,
        "lambda_part": kind != "none",
        "lambda_semantic": kind == "semantic",
    }


def test_batches_keep_their_rows_together(rng: np.random.Generator) -> None:
    data = make_data()
    data.label[5] = data.group[5] = -1
    rows = rng.permutation(200)
    batch = gather_batch(data, rows, CPU)
    order = np.sort(rows)
    assert (batch.label.numpy() == data.label[order]).all()
    assert not batch.grouped[5] and batch.grouped[6]
    np.testing.assert_array_equal(batch.radiance.numpy(), data.radiance[order])
    np.testing.assert_array_equal(batch.position.numpy(), data.normalise(data.position[order]))
    assert batch.diffuse.dtype == torch.float32 and batch.group_roughness[5] == 1.0
