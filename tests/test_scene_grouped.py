"""Sums and medians of groups as numpy has them group by group; connected components."""

import statistics

import numpy as np
import pytest

from fipt_blender.core.parts.components import graph_components, mesh_components
from fipt_blender.core.pixels.grouped import (
    first_by_key,
    grouped_means,
    grouped_median,
    grouped_sums,
    grouped_weighted_median,
    numbered,
    summed_by_key,
)


@pytest.mark.parametrize("dtype, large", [(np.float32, 0), (np.float64, 0), (np.float32, 150)])
def test_medians_are_those_of_each_group_alone(rng: np.random.Generator, dtype, large: int) -> None:
    values, group = rng.random((300, 3)).round(1).astype(dtype), rng.integers(0, 40, 300)
    group[:large] = 7
    medians = grouped_median(values, group, 42)
    assert medians.dtype == dtype and not medians[40:].any()
    for index in np.unique(group):
        members = values[group == index]
        assert (medians[index] == np.median(members, axis=0)).all()
    assert grouped_median(np.zeros((0, 3)), np.zeros(0, int), 2).shape == (2, 3)


def test_sums_are_those_of_each_group_alone(rng: np.random.Generator) -> None:
    values, group = rng.random((300, 3)), rng.integers(0, 40, 300)
    sums = grouped_sums(values, group, 42)
    assert sums.shape == (42, 3) and not sums[40:].any()
    expected = [values[group == index].sum(axis=0) for index in range(42)]
    np.testing.assert_allclose(sums, expected)
    assert (grouped_sums(values[:, 0], group, 42) == sums[:, 0]).all()
    means = grouped_means(values, group, 42)
    assert np.isnan(means[40:]).all() and np.isnan(grouped_means(values[:, 0], group, 42)[40:]).all()
    np.testing.assert_allclose(means[:40], [values[group == index].mean(axis=0) for index in range(40)])


def test_keys_in_pieces_give_what_all_of_them_give_at_once(rng: np.random.Generator) -> None:
    """Whatever the pieces' sizes; some are empty."""
    keys, values = rng.integers(0, 50, 400), rng.integers(0, 9, 400).astype(float)
    bounds = np.sort(rng.integers(0, 400, 20))
    pieces = list(zip(np.split(keys, bounds), np.split(values, bounds), strict=True))
    expected, first, place = np.unique(keys, return_index=True, return_inverse=True)
    for found, wanted in (
        (summed_by_key(pieces), np.bincount(place, values)),
        (first_by_key(pieces), values[first]),
        (first_by_key((key, np.tile(value, (3, 1)).T) for key, value in pieces), values[first][:, None]),
    ):
        assert (found[0] == expected).all() and (found[1] == wanted).all()
    assert [len(array) for array in summed_by_key([])] == [0, 0]


def test_weights_count_as_repeated_values(rng: np.random.Generator) -> None:
    values, weight, group = rng.random(100), rng.integers(0, 4, 100), rng.integers(0, 9, 100)
    medians = grouped_weighted_median(values, weight, group, 10)
    for index in np.unique(group[weight > 0]):
        repeated = np.repeat(values[group == index], weight[group == index])
        assert medians[index] == statistics.median_low(repeated.tolist())
    assert not grouped_weighted_median(np.zeros(0), np.zeros(0), np.zeros(0, int), 2).any()


@pytest.mark.parametrize("scale", (1, 1 << 40))
def test_numbers_follow_the_order_of_the_combinations(rng: np.random.Generator, scale: int) -> None:
    columns = [rng.integers(-1, 2, 200) * scale for _ in range(4)]
    combinations, expected = np.unique(np.stack(columns), axis=1, return_inverse=True)
    assert combinations.shape[1] < 200
    assert (numbered(columns) == expected.reshape(-1)).all()
    assert not len(numbered([np.zeros(0, np.int32)] * 2))


def test_components_are_numbered_by_their_lowest_nodes():
    pairs = np.array([[6, 5], [4, 1], [1, 4], [2, 2], [3, 6]])
    none = np.zeros((0, 2), int)
    assert graph_components(pairs, 8).tolist() == [0, 1, 2, 3, 1, 3, 3, 4]
    assert graph_components(none, 3).tolist() == [0, 1, 2] and graph_components(none, 0).tolist() == []
    assert graph_components(np.tile([[0, 1]], (512, 1)), 2).tolist() == [0, 0]  # an edge given often still counts
    corners = np.array([[7, 8, 9], [1, 2, 3], [3, 4, 5], [11, 9, 12]])  # of triangles
    assert mesh_components(corners).tolist() == [1, 0, 0, 1]
    assert mesh_components(np.zeros((0, 3), int)).tolist() == []
