"""Networks and losses against values by hand and differences; training finds materials, and is reproducible."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from fipt_blender.core.light.baking import ShadingStore
from fipt_blender.core.material import losses
from fipt_blender.core.material.closed_form import TrainingData
from fipt_blender.core.material.hashgrid import HashGrid
from fipt_blender.core.material.mixture import GroupMaterials
from fipt_blender.core.material.networks import (
    BrdfNetwork,
    EmissionNetwork,
    Prediction,
    emission_mask,
    positional_encoding,
    typical_values,
    useful_hash_levels,
)
from fipt_blender.core.material.seen import Box
from fipt_blender.core.material.training import (
    Networks,
    Resume,
    Surfaces,
    gather_batch,
    load_tensors,
    total_loss,
    train,
)
from fipt_blender.core.optics.factorised import level_roughness
from fipt_blender.core.run.settings import Settings

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
        ShadingStore(diffuse.astype(np.float16), np.full((count, 3, 2, 3), 1e-3, np.float16), LEVELS),
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


@pytest.fixture
def threads() -> Iterator[None]:
    """Several of them; other tests have one."""
    torch.set_num_threads(4)
    yield
    torch.set_num_threads(1)


def test_the_same_seed_gives_the_same_weights_on_all_threads(threads: None) -> None:
    results = []
    for seed in (0, 0, 1):
        networks = make_networks()
        do_train(networks, 6, seed=seed)
        results.append(weights(networks))
    assert results[0] == results[1]
    assert results[2] != results[0]


def test_an_interrupted_training_ends_with_the_same_weights(tmp_path: Path) -> None:
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
    do_train(resumed, 12, Resume(checkpoint, load_tensors(checkpoint, CPU)), shares.append)
    assert shares[0] == pytest.approx(11 / 12)  # from the checkpoint after step 10
    assert weights(uninterrupted) == weights(resumed)


def test_colours_are_found_beside_a_lamp_that_does_not_count() -> None:
    networks, data, surfaces = make_networks(), make_data(), make_surfaces()
    seen, pixels = data.observations, data.observations.pixels
    train(networks, data, surfaces, replace(SETTINGS, training_steps=300), None, lambda _: None)
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


def test_the_mask_finds_a_lamp_that_nothing_has_found_before() -> None:
    """Reflection can't explain the lamp's pixels, so the mask takes them; l_e keeps it small elsewhere."""
    networks, data = make_networks(), make_data()
    surfaces = replace(make_surfaces(), emitting=np.zeros(3, bool))
    train(networks, data, surfaces, replace(SETTINGS, training_steps=300), None, lambda _: None)
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
    expected = {**dict.fromkeys(terms, True), "lambda_part": kind != "none", "lambda_semantic": kind == "semantic"}
    assert raised == expected


def make_grid(levels: int = 5, seed: int = 0) -> HashGrid:
    """Five levels: the first three have an entry for each grid point, the others share 2^12."""
    grid = HashGrid(levels, 2, 12, 4, 1.8, torch.Generator().manual_seed(seed), CPU)
    with torch.no_grad():
        grid.table.mul_(1e4)
    return grid


def units_of(positions: torch.Tensor) -> torch.Tensor:
    """Three units in turn."""
    return torch.arange(len(positions)) % 3


def reference_weights(grid: HashGrid, positions: np.ndarray) -> np.ndarray:
    """(N, levels, table rows) trilinear weights in double precision, by Eq. 4 of Müller et al. with units."""
    unit = np.arange(len(positions), dtype=np.uint64) % 3 * 3674653429 % 2**32
    unit ^= unit >> 15
    result = np.zeros((len(positions), len(grid.resolutions), len(grid.table)))
    for level, resolution in enumerate(grid.resolutions):
        scaled = positions.astype(np.float64) * resolution
        cell = np.floor(scaled).astype(np.int64)
        fraction = scaled - cell
        for x, y, z in np.ndindex(2, 2, 2):
            corner = cell + [x, y, z]
            if (resolution + 1) ** 3 <= 2**12:
                entry = corner @ [1, resolution + 1, (resolution + 1) ** 2]
            else:
                hashed = corner.astype(np.uint64) * np.array([1, 2654435761, 805459861], np.uint64)
                entry = ((hashed[:, 0] ^ hashed[:, 1] ^ hashed[:, 2] ^ unit) % 2**12).astype(np.int64)
            weight = np.abs(1 - np.array([x, y, z]) - fraction).prod(axis=1)
            np.add.at(result, (np.arange(len(cell)), level, entry + grid.levels[level][2]), weight)
    return result


def test_hash_grid_is_its_definition_forward_and_backward(rng: np.random.Generator) -> None:
    grid = make_grid()
    assert grid.resolutions == [4, 7, 12, 23, 41] and grid.width == 10
    positions = rng.random((200, 3)).astype(np.float32)
    weights = reference_weights(grid, positions)
    points = torch.from_numpy(positions)
    features = grid(points, units_of(points))
    table = grid.table.detach().numpy().astype(np.float64)
    expected = np.einsum("nlt,tf->nlf", weights, table).reshape(200, -1)
    np.testing.assert_allclose(features.detach().numpy(), expected, atol=3e-5)
    upstream = rng.normal(size=features.shape)
    features.backward(torch.from_numpy(upstream.astype(np.float32)))
    gradient = np.einsum("nlt,nlf->tf", weights, upstream.reshape(200, 5, 2))
    np.testing.assert_allclose(grid.table.grad.numpy(), gradient, atol=2e-5 * np.abs(gradient).max())


def test_hash_grid_at_the_borders_and_with_no_gradient() -> None:
    grid = make_grid()
    corners = torch.tensor([[0.0, 0, 0], [1, 1, 1], [1, 0, 1], [-0.1, 2.0, 0.5]])
    features = grid(corners, torch.zeros(4, dtype=torch.int64))
    assert torch.isfinite(features).all()
    inside = grid(torch.tensor([[1.0 - 2e-6] * 3]), torch.zeros(1, dtype=torch.int64))
    assert torch.allclose(features[1], inside[0], atol=1e-3)
    (features * 0.0).sum().backward()
    assert (grid.table.grad == 0).all()


def test_hash_grid_gradients_are_the_same_bit_for_bit(threads: None, rng: np.random.Generator) -> None:
    """Many points lie in the same cells, so the order of summation would show."""
    positions = torch.from_numpy((rng.random((20_000, 3)) * 0.2).astype(np.float32))
    upstream = torch.from_numpy(rng.normal(size=(20_000, 10)).astype(np.float32))
    gradients = []
    for _ in range(3):
        grid = make_grid()
        grid(positions, units_of(positions)).backward(upstream)
        gradients.append(grid.table.grad.clone())
    assert torch.equal(gradients[0], gradients[1]) and torch.equal(gradients[0], gradients[2])
    shuffled = torch.from_numpy(np.random.default_rng(1).permutation(20_000))
    grid = make_grid()
    grid(positions[shuffled], units_of(positions)[shuffled]).backward(upstream[shuffled])
    assert torch.equal(grid.table.grad, gradients[0])


def test_the_network_starts_near_the_typical_values_of_each_unit() -> None:
    """These are medians, and those of all where nothing was seen."""
    typical = np.array([[0.1, 0.2, 0.3, 0.4, 0.0], [0.9, 0.8, 0.7, 1.0, 1.0], [0.5] * 5])
    brdf = BrdfNetwork(Settings(hash_levels=4), 4, typical, torch.Generator().manual_seed(0), CPU)
    positions = torch.rand((60, 3), generator=torch.Generator().manual_seed(1))
    found = brdf(positions, units_of(positions) - 1)  # units -1, 0 and 1; the last row is for none
    values = torch.cat([found.base_color, found.roughness[:, None], found.metallic[:, None]], dim=1)
    expected = torch.from_numpy(typical).float()[units_of(positions) - 1]
    assert (values - expected).abs().max() < 0.01
    medians = typical_values(np.array([[0.1], [0.3], [0.2], [0.9], [0.5]]), np.array([0, 0, 0, 2, -1]), 3)
    assert medians[:, 0].tolist() == pytest.approx([0.2, 0.3, 0.9, 0.3])


def test_units_that_touch_share_no_fine_detail() -> None:
    """The gradient at a point of one unit changes another unit's value there by the coarse levels alone."""
    grid = make_grid()
    point = torch.full((1, 3), 0.4)
    first, second = (torch.full((1,), unit) for unit in (0, 1))
    before = grid(point, first), grid(point, second)
    grid(point, first)[:, 6:].sum().backward()  # of the levels that share entries
    with torch.no_grad():
        grid.table.add_(grid.table.grad)
    after = grid(point, first), grid(point, second)
    assert (after[0] - before[0])[:, 6:].min() > 0.1
    assert torch.equal(after[1], before[1])


def test_positional_encoding() -> None:
    x = torch.tensor([[0.25, -0.5, 1.0]], dtype=torch.float64)
    code = positional_encoding(x, 2)[0].tolist()
    angles = [np.pi * v * f for v in (0.25, -0.5, 1.0) for f in (1, 2)]
    assert code == pytest.approx([0.25, -0.5, 1.0, *np.sin(angles), *np.cos(angles)], abs=1e-12)


def test_hash_levels_end_at_half_a_pixel() -> None:
    settings = Settings()
    assert useful_hash_levels(settings, 5.0, 1e-9) == settings.hash_levels
    levels = useful_hash_levels(settings, 5.0, 0.02)
    assert 5.0 / (16 * 1.3 ** (levels - 1)) >= 0.01 > 5.0 / (16 * 1.3**levels)
    assert useful_hash_levels(settings, 500.0, 2.0) == levels  # whatever the unit


def prediction(seed: int, count: int = 6) -> tuple[torch.Tensor, ...]:
    """Base colour, roughness and metallic where the losses are differentiable, in double precision."""
    values = torch.rand((count, 5), generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    values = 0.1 + 0.8 * values
    return tuple(v.clone().requires_grad_() for v in (values[:, :3], values[:, 3], values[:, 4]))


GRADES = torch.tensor([0.02, 0.3, 1.0], dtype=torch.float64)
UNIFORM = torch.rand((6, 3, 2, 3), generator=torch.Generator().manual_seed(9), dtype=torch.float64)
LIGHT = UNIFORM[:, 0, 0] + 0.3


def test_specular_shading_at_and_between_levels() -> None:
    for index, level in enumerate(GRADES):
        s0, s1 = losses.interpolate_specular(UNIFORM, level.repeat(6), GRADES)
        assert torch.allclose(s0, UNIFORM[:, index, 0]) and torch.allclose(s1, UNIFORM[:, index, 1])
    quarter = level_roughness(0.25, *GRADES[1:3])
    s0, _ = losses.interpolate_specular(UNIFORM, quarter.repeat(6), GRADES)
    assert torch.allclose(s0, 0.75 * UNIFORM[:, 1, 0] + 0.25 * UNIFORM[:, 2, 0])
    s0, _ = losses.interpolate_specular(UNIFORM, torch.full((6,), 0.001, dtype=torch.float64), GRADES)
    assert torch.allclose(s0, UNIFORM[:, 0, 0])


def test_factorised_rendering_by_hand_and_its_gradient() -> None:
    shadings = torch.tensor([[[[1.0], [0.5]], [[2.0], [0.1]], [[3.0], [0.2]]]], dtype=torch.float64)
    one = Prediction(*(torch.tensor(v, dtype=torch.float64) for v in ([[0.5, 0.5, 0.2]], [0.3], [0.25])))
    rendered = losses.factorised_rendering(
        one, torch.full((1, 3), 4.0, dtype=torch.float64), shadings.expand(1, 3, 2, 3), GRADES
    )
    expected = [1.5 + (0.03 + 0.125) * 2 + 0.1] * 2 + [0.6 + 0.08 * 2 + 0.1]
    assert rendered[0].tolist() == pytest.approx(expected)
    values = prediction(2)
    assert torch.autograd.gradcheck(
        lambda *v: losses.factorised_rendering(Prediction(*v), LIGHT, UNIFORM, GRADES), values
    )


def test_tone_mapping_and_rendering_loss() -> None:
    x = torch.tensor([0.0, 0.001, 1.0, 50.0, -1.0], dtype=torch.float64)
    logs = np.log1p([0.0, 0.001, 1.0, 50.0, 0.0])
    curve = np.where(logs <= 0.0031308, 12.92 * logs, 1.055 * logs ** (1 / 2.4) - 0.055)
    assert losses.tone_map(x).tolist() == pytest.approx(curve.tolist())
    photographed = torch.full((6, 3), 2.0, dtype=torch.float64)
    ones = torch.ones(6, dtype=torch.float64)
    squared = (losses.tone_map(LIGHT) - losses.tone_map(photographed)).square().sum(dim=1)
    # With alpha = 1 emission explains the photograph; with 0 only the rendering counts.
    assert float(losses.rendering_loss(LIGHT, ones, photographed)) == 0.0
    assert float(losses.rendering_loss(LIGHT, ones * 0, photographed)) == pytest.approx(float(squared.mean()))
    rendered = LIGHT.clone().requires_grad_()
    alpha = torch.linspace(0.0, 0.9, 6, dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(lambda r, a: losses.rendering_loss(r, a, photographed), (rendered, alpha))


def test_emission_and_diffuse_terms() -> None:
    assert float(losses.emission_loss(torch.tensor([1.0, -2.0, 0.0, 0.0]))) == pytest.approx(0.75)
    values = prediction(3)
    expected = ((1 - values[1]) + values[2]).mean()
    assert float(losses.diffuse_loss(Prediction(*values)).detach()) == pytest.approx(float(expected.detach()))
    assert torch.autograd.gradcheck(lambda *v: losses.diffuse_loss(Prediction(*v)), values)


def test_part_term_by_hand() -> None:
    """|0.5 - 0.4| + |0.2 - 0| for the first pixel, 0.3 + 1 for the second; the third has no part."""
    values = [torch.tensor(v, dtype=torch.float64) for v in ([[0.5] * 3] * 3, [0.5, 0.7, 0.9], [0.2, 0.0, 0.6])]
    target = torch.tensor([[0.4, 0.0], [1.0, 1.0], [1.0, 0.0]], dtype=torch.float64)
    known = torch.tensor([True, True, False])
    assert float(losses.part_loss(Prediction(*values), target, known)) == pytest.approx(1.6 / 3)
    free = prediction(4, 3)
    assert torch.autograd.gradcheck(lambda *v: losses.part_loss(Prediction(*v), target, known), free)


def test_semantic_term_is_its_equation(rng: np.random.Generator) -> None:
    """Eq. 20: sigma' is the mean over x' of the same class, weighted by distance in colour and position."""
    color, roughness, metallic = (v.detach().numpy() for v in prediction(5))
    positions = rng.random((6, 3)) * 0.2
    part = np.array([0, 0, 1, 1, -1, 2])
    partners = np.array([0, 1, 2, 3, 4])
    total = 0.0
    for i in range(6):
        weights, means = 0.0, np.zeros(2)
        for j in partners:
            if part[i] != part[j] or part[i] < 0:
                continue
            w = np.exp(-((color[i] - color[j]) ** 2).sum() / (2 * 0.3**2))
            w *= np.exp(-((positions[i] - positions[j]) ** 2).sum() / (2 * 0.1**2))
            weights += w
            means += w * np.array([roughness[j], metallic[j]])
        if weights > 0:  # the last pixel has no partner, the fifth no class
            total += np.abs(np.array([roughness[i], metallic[i]]) - means / weights).sum()
    arguments = [torch.from_numpy(a) for a in (positions, part, partners)]
    loss = losses.semantic_loss(Prediction(*prediction(5)), *arguments, 0.3, 0.1)
    assert float(loss) == pytest.approx(total / 6, rel=1e-9)


def test_semantic_term_has_the_gradient_of_fixed_means() -> None:
    """sigma' and m' are constant targets: x' gets no gradient."""
    values = prediction(6)
    positions = torch.zeros((6, 3), dtype=torch.float64)
    part, partners = torch.zeros(6, dtype=torch.int64), torch.arange(6)
    losses.semantic_loss(Prediction(*values), positions, part, partners, 10.0, 10.0).backward()
    for value in values[1:]:
        sign = torch.sign(value.detach() - value.detach().mean())
        assert torch.allclose(value.grad, sign / 6)
    assert values[0].grad is None or (values[0].grad == 0).all()
