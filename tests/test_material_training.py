# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Training: finds what made the pixels, the same twice on several threads, the same after an interruption."""

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
import torch

mi.set_variant("llvm_ad_rgb")

from fipt_blender.core.job.settings import Settings  # noqa: E402
from fipt_blender.core.material.networks import BrdfNetwork, EmissionNetwork, emission_mask  # noqa: E402
from fipt_blender.core.material.training import TrainingData, gather_batch, total_loss, train  # noqa: E402

CPU = torch.device("cpu")
SETTINGS = Settings(
    hash_levels=4, hash_log2_size=10, batch_size=512, emission_width=32, emission_depth=4, checkpoint_steps=5,
    learning_rate=5e-3,
)  # fmt: skip
LEVELS = np.array([0.02, 0.5, 1.0], np.float32)


def make_data(kind: str = "part") -> TrainingData:
    """Matt pixels in two halves, red and blue, and a lamp in a corner."""
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
    """Networks this small lose more by waiting for a second thread than they gain."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def networks() -> tuple[BrdfNetwork, EmissionNetwork]:
    generator = torch.Generator().manual_seed(1)
    return BrdfNetwork(SETTINGS, 4, generator, CPU), EmissionNetwork(SETTINGS, generator, CPU)


def weights(*modules: torch.nn.Module) -> list[bytes]:
    return [value.numpy().tobytes() for module in modules for value in module.state_dict().values()]


def test_the_same_seed_gives_the_same_weights_on_all_threads() -> None:
    found = []
    for _ in range(2):
        pair = networks()
        train(*pair, make_data(), SETTINGS, 6, 0, CPU, None, lambda _: None)
        found.append(weights(*pair))
    assert found[0] == found[1]
    pair = networks()
    train(*pair, make_data(), SETTINGS, 6, 1, CPU, None, lambda _: None)
    assert weights(*pair) != found[0]  # another round draws other batches


def test_an_interrupted_training_ends_with_the_same_weights(one_thread, tmp_path: Path) -> None:
    whole = networks()
    train(*whole, make_data(), SETTINGS, 12, 0, CPU, None, lambda _: None)

    def interrupt(share: float) -> None:
        if share > 0.9:
            raise KeyboardInterrupt

    checkpoint = tmp_path / "training-0.pt"
    with pytest.raises(KeyboardInterrupt):
        train(*networks(), make_data(), SETTINGS, 12, 0, CPU, checkpoint, interrupt)
    assert checkpoint.exists()
    resumed = networks()
    shares: list[float] = []
    train(*resumed, make_data(), SETTINGS, 12, 0, CPU, checkpoint, shares.append)
    assert shares[0] == pytest.approx(11 / 12)  # from the checkpoint after step 10
    assert weights(*whole) == weights(*resumed)


def test_colours_and_the_lamp_are_found(one_thread) -> None:
    brdf, emission = networks()
    data = make_data()
    train(brdf, emission, data, SETTINGS, 400, 0, CPU, None, lambda _: None)
    inputs = torch.from_numpy(data.normalise(data.position))
    with torch.no_grad():
        prediction, alpha = brdf(inputs), emission_mask(emission(inputs)).numpy()
    kd = (prediction.base_color * (1 - prediction.metallic[:, None])).numpy()
    expected = np.where(data.label[:, None] == 0, [0.7, 0.2, 0.1], [0.1, 0.3, 0.6])
    distance = np.linalg.norm(data.normalise(data.position) - 1.0, axis=1)
    clear = (np.abs(data.normalise(data.position)[:, 0] - 0.5) > 0.05) & (distance > 0.5)
    assert np.abs(kd - expected)[clear].mean() < 0.06
    assert alpha[distance < 0.3].min() > 0.1 and alpha[clear].mean() < 0.01


@pytest.mark.parametrize("kind", ["part", "semantic", "none"])
def test_every_term_is_in_the_total(kind: str) -> None:
    """Raising one weight raises the total by that weight's term; the others do not answer."""
    data = make_data(kind)
    batch = gather_batch(data, np.arange(0, 400), CPU)
    levels, partners = torch.from_numpy(LEVELS), torch.arange(0, 400, 2)
    pair = networks()

    def total(**changes: float) -> float:
        zero = {name: 0.0 for name in ("lambda_emission", "lambda_diffuse", "lambda_part", "lambda_semantic")}
        settings = Settings(**{**zero, **changes})
        with torch.no_grad():
            return float(total_loss(*pair, batch, levels, kind == "semantic", settings, partners))

    base = total()
    answers = {
        name: total(**{name: 1.0}) > base + 1e-6
        for name in ("lambda_emission", "lambda_diffuse", "lambda_part", "lambda_semantic")
    }
    assert answers == {
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
