# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Hash grid and network against values by hand or in double precision, and differences."""

import numpy as np
import pytest
import torch

from fipt_blender.core.material.hashgrid import HashGrid
from fipt_blender.core.material.networks import ColorNetwork, typical_colors, useful_hash_levels
from fipt_blender.core.run.settings import Settings

CPU = torch.device("cpu")


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
    result = np.zeros((len(positions), len(grid.resolutions), int(grid.offsets[-1])))
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
            np.add.at(result, (np.arange(len(cell)), level, entry + grid.offsets[level]), weight)
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


def test_hash_grid_gradient_is_the_finite_difference(rng: np.random.Generator) -> None:
    grid = make_grid()
    positions = torch.from_numpy(rng.random((500, 3)).astype(np.float32))

    def loss() -> torch.Tensor:
        return torch.sin(grid(positions, units_of(positions)).double()).sum()

    loss().backward()
    direction = torch.from_numpy(rng.normal(size=grid.table.shape).astype(np.float32))
    slope = float((grid.table.grad.double() * direction).sum())
    step = 1e-2
    values = []
    for sign in (1.0, -1.0):
        with torch.no_grad():
            grid.table.add_(sign * step * direction)
            values.append(float(loss()))
            grid.table.sub_(sign * step * direction)
    assert (values[0] - values[1]) / (2 * step) == pytest.approx(slope, rel=2e-3)


def test_hash_grid_at_the_borders_and_with_no_gradient() -> None:
    grid = make_grid()
    corners = torch.tensor([[0.0, 0, 0], [1, 1, 1], [1, 0, 1], [-0.1, 2.0, 0.5]])
    features = grid(corners, torch.zeros(4, dtype=torch.int64))
    assert torch.isfinite(features).all()
    inside = grid(torch.tensor([[1.0 - 2e-6] * 3]), torch.zeros(1, dtype=torch.int64))
    assert torch.allclose(features[1], inside[0], atol=1e-3)
    (features * 0.0).sum().backward()
    assert (grid.table.grad == 0).all()


def test_hash_grid_gradients_are_the_same_bit_for_bit(rng: np.random.Generator) -> None:
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


def test_networks_stay_in_range_and_start_alike() -> None:
    settings = Settings(hash_levels=4, hash_log2_size=10)
    positions = torch.rand((300, 3), generator=torch.Generator().manual_seed(2))
    first, again = (
        ColorNetwork(settings, 4, np.full((3, 3), 0.5), torch.Generator().manual_seed(5), CPU)(
            positions, units_of(positions) - 1
        )
        for _ in range(2)
    )
    assert torch.equal(first, again) and 0 <= first.min() and first.max() <= 1


def test_the_network_starts_near_the_typical_values_of_each_unit() -> None:
    typical = np.array([[0.1, 0.2, 0.3], [0.9, 0.8, 1.0], [0.5] * 3])
    network = ColorNetwork(Settings(hash_levels=4), 4, typical, torch.Generator().manual_seed(0), CPU)
    positions = torch.rand((60, 3), generator=torch.Generator().manual_seed(1))
    found = network(positions, units_of(positions) - 1)  # units -1, 0 and 1; the last row is for none
    expected = torch.from_numpy(typical).float()[units_of(positions) - 1]
    assert (found - expected).abs().max() < 0.01


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


def test_typical_colours_are_medians_by_weight_and_those_of_all_where_nothing_was_seen() -> None:
    color = np.repeat([[0.1], [0.3], [0.2], [0.9], [0.5]], 3, axis=1)
    found = typical_colors(color, np.array([1.0, 5.0, 1.0, 1.0, 1.0]), np.array([0, 0, 0, 2, -1]), 3)
    assert found[:, 0].tolist() == pytest.approx([0.3, 0.3, 0.9, 0.3])


def test_hash_levels_end_at_half_a_pixel() -> None:
    settings = Settings()
    assert useful_hash_levels(settings, 5.0, 1e-9) == settings.hash_levels
    levels = useful_hash_levels(settings, 5.0, 0.02)
    assert 5.0 / (16 * 1.3 ** (levels - 1)) >= 0.01 > 5.0 / (16 * 1.3**levels)
    assert useful_hash_levels(settings, 500.0, 2.0) == levels  # whatever the unit
