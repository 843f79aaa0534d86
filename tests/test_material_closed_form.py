"""The closed-form estimate on cells: colours, what white surfaces reflect, and groups in place of parts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.light.baking import ShadingStore, open_shadings
from fipt_blender.core.light.observations import Observations, observe
from fipt_blender.core.material import training_input as training_input_module
from fipt_blender.core.material.closed_form import CellEstimate, TrainingData, fit_cells, followed_by_paths, white_rows
from fipt_blender.core.material.groups import group_units, join_cells, neighbours
from fipt_blender.core.material.hints import place_hints
from fipt_blender.core.material.mixture import GroupMaterials
from fipt_blender.core.material.projection import color_lines
from fipt_blender.core.material.training_input import training_input
from fipt_blender.core.parts.labels import NO_PART, Parts
from fipt_blender.core.parts.smooth_parts import Votes
from samples.panel_pixels import IS_PANEL, PARTS, ROOM, SETTINGS, make_pixels

LEVELS = np.array([0.1, 0.5, 1.0], np.float32)
WALLS = 6  # parts of the box; the panel is the seventh
COLORS = np.random.default_rng(1).uniform(0.1, 0.9, (WALLS + 1, 3))
METAL = 2  # the part that is a metal


@pytest.fixture
def seen(tmp_path: Path) -> Observations:
    return observe(ROOM, make_pixels(tmp_path / "pixels", 6), PARTS, SETTINGS, tmp_path)


@pytest.fixture
def data(seen: Observations) -> TrainingData:
    """Pixels whose radiance is Eq. 5 of parts of one colour, one of them metallic; the panel is a lamp."""
    pixels, rng = seen.pixels, np.random.default_rng(0)
    part = np.asarray(seen.part)
    metallic = (np.arange(WALLS + 1) == METAL).astype(np.float32)
    roughness = np.linspace(0.1, 1.0, WALLS + 1).astype(np.float32)
    roughness = LEVELS[np.abs(LEVELS - roughness[:, None]).argmin(axis=1)]
    diffuse = rng.uniform(0.5, 1.5, (len(pixels), 3))
    specular = rng.uniform(0.1, 0.5, (len(pixels), 3, 2, 3))
    s0, s1 = np.moveaxis(specular[np.arange(len(part)), np.searchsorted(LEVELS, roughness)[part]], 1, 0)
    color, metal = COLORS[part], metallic[part][:, None]
    kd, ks = color * (1.0 - metal), 0.04 * (1.0 - metal) + color * metal
    radiance = kd * diffuse + ks * s0 + s1
    radiance[IS_PANEL[pixels.triangle]] = 50.0
    pixels.own[:], pixels.weight[:] = radiance, np.where(pixels.pure, 1.0, 0.25)
    materials = GroupMaterials(np.column_stack([roughness, metallic]), np.zeros((len(roughness), 2)))
    return TrainingData(seen, ShadingStore(diffuse, specular, LEVELS), part, materials)


def reflecting(seen: Observations) -> np.ndarray:
    """Pixels of the walls."""
    rows = np.flatnonzero(np.asarray(seen.pixels.triangle) >= 0)
    return rows[~IS_PANEL[seen.pixels.triangle[rows]]]


def test_cells_have_the_colours_of_their_parts(seen, data) -> None:
    cells = fit_cells(data)
    group = cells.group
    walls = group < WALLS
    np.testing.assert_allclose(cells.color[walls], COLORS[group[walls]], atol=2e-3)
    assert (cells.color[~walls] == 1.0).all()
    np.testing.assert_array_equal(ROOM.triangle_object[cells.triangle], group)
    rows = reflecting(seen)
    found = cells.of_pixels(data, rows)
    assert (found >= 0).all() and (cells.entry[found] == seen.entry[rows]).all()


def test_pixels_without_a_group_are_diffuse(seen, data) -> None:
    specular = data.shadings.specular[:, -1]
    seen.pixels.own[:] = 0.5 * data.shadings.diffuse + 0.04 * specular[:, 0] + specular[:, 1]
    none, group = np.zeros((0, 2)), np.full(len(seen.pixels), -1)
    cells = fit_cells(replace(data, group=group, materials=GroupMaterials(none, none)))
    np.testing.assert_array_equal(cells.entry, np.unique(seen.entry[np.asarray(seen.donor) >= 0]))
    np.testing.assert_allclose(cells.values, [[0.5, 0.5, 0.5, 1.0, 0.0]] * len(cells.keys), atol=2e-3)


def test_a_white_surface_reflects_the_most(seen, data) -> None:
    """With the gloss of the group, dielectric or metal, and never less than a diffuse one."""
    rows = reflecting(seen)
    white, diffuse = white_rows(data, rows), np.asarray(data.shadings.diffuse[rows], np.float32)
    assert (white >= np.maximum(seen.pixels.own[rows], diffuse) * 0.99).all()
    slope, offset = color_lines(data.shadings, rows, data.materials.of_pixels[data.group[rows]])
    np.testing.assert_allclose(white, np.maximum(slope, diffuse) + offset, rtol=1e-5)


def test_values_of_an_entry_are_means_over_its_pixels() -> None:
    """Entry 3 has a pixel of no group and three of group 1, entry 5 one of group 0."""
    cells = CellEstimate(
        keys=np.array([9, 11, 16]),
        color=np.array([[0.2] * 3, [0.6] * 3, [0.9] * 3], np.float32),
        pixels=np.array([1.0, 3.0, 1.0]),
        triangle=np.array([7, 8, 9]),
        materials=np.array([[0.4, 1.0], [0.8, 0.0], [1.0, 0.0]]),
    )
    entries, values, triangle = cells.by_entry()
    assert entries.tolist() == [3, 5] and triangle.tolist() == [8, 9]
    np.testing.assert_allclose(values, [[0.5, 0.5, 0.5, 0.85, 0.0], [0.9, 0.9, 0.9, 0.4, 1.0]], rtol=1e-6)


def test_paths_follow_groups_that_may_be_smooth() -> None:
    none = np.zeros(0)
    roughness = np.array([0.86, 0.86, 0.4, 1.0])  # the last is of pixels without a group
    materials = np.column_stack([roughness, np.zeros(4)])
    cells = CellEstimate(none, np.zeros((0, 3)), none, none, materials)
    errors = np.array([0.3, 0.2, 0.3])
    followed = followed_by_paths(cells, errors, limit=0.6).materials[:, 0]
    assert 0.5 < followed[0] < np.float16(0.6)  # tables may be of half precision
    np.testing.assert_array_equal(followed[1:], roughness[1:])


def test_neighbours_are_cells_of_one_surface_whose_cubes_touch() -> None:
    surface = np.array([0, 0, 0, 0, 1])
    cube = np.array([[4, 4, 4], [5, 3, 4], [7, 4, 4], [4, 4, 4], [4, 4, 5]])
    pairs = np.sort(neighbours(surface, cube), axis=1)
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    assert set(map(tuple, pairs.tolist())) == {(0, 1), (0, 3), (1, 3)}
    assert neighbours(surface[:0], cube[:0]).shape == (0, 2)


@pytest.mark.parametrize("other", [(0.3, 0.3, 0.3), (0.6, 0.28, 0.6)])
def test_regions_end_where_the_base_colour_changes(rng, other) -> None:
    """A strip of cells with errors of few pixels, brighter towards one end, as the light may be wrong."""
    color = np.where(np.arange(100)[:, None] < 60, 0.6, other) * np.linspace(1.0, 1.1, 100)[:, None]
    noisy, pixels = color * np.exp(rng.normal(0.0, 0.1, (100, 1))), rng.uniform(3.0, 9.0, 100)
    strip = np.stack([np.arange(99), np.arange(1, 100)], axis=1)
    region = join_cells(noisy, pixels, strip)
    assert np.ptp(region[:60]) == np.ptp(region[60:]) == 0 and region[0] != region[99]
    dark = join_cells(rng.uniform(0.0, 0.01, (100, 3)), pixels, strip)  # whatever the chroma of noise
    assert np.ptp(dark) == 0
    assert join_cells(color, pixels, strip[:0]).tolist() == list(range(100))


def test_a_unit_is_what_a_surface_has_of_one_gloss() -> None:
    # Surface 0: two groups of one gloss, and another; 1: a triangle of two; 2: an unseen triangle of class 1.
    surface = np.array([0, 0, 0, 0, 1, 2])
    parts = Parts(np.array([0, 0, 0, 0, 0, 1], np.int32), "semantic")
    triangle, group = np.array([0, 1, 2, 4, 4]), np.array([0, 1, 2, 0, 2])
    votes = Votes(triangle, group, np.array([50.0, 40.0, 30.0, 50.0, 50.0]))
    materials = np.array([[0.4, 0.0], [0.4, 0.0], [0.4, 1.0]])
    units = group_units(parts, surface, votes, materials)
    assert units.triangle.tolist() == [2, 2, 3, 2, 0, 1]
    assert units.single.tolist() == [False, False, True, True]
    assert units.is_single(np.array([3, 0, NO_PART])).tolist() == [True, False, False]
    few = group_units(parts, surface, Votes(triangle, group, votes.weight / 10.0 + group), materials)
    assert few.triangle.tolist() == [2, 2, 3, 2, 4, 1]  # too few to tell


def test_pixels_outside_the_sample_have_their_own_colour(tmp_path, monkeypatch: pytest.MonkeyPatch):
    """Each surface of the box has one colour, so groups are surfaces, however small the sample is."""
    monkeypatch.setattr(training_input_module, "PROJECTION_PIXELS", 300)
    pixels = make_pixels(tmp_path / "pixels", 6)
    nothing = Parts(np.full(len(ROOM.triangles), NO_PART, np.int32), "none")
    seen = observe(ROOM, pixels, nothing, SETTINGS, tmp_path / "observed")
    shadings = open_shadings(tmp_path / "shadings", len(pixels), LEVELS, create=True)
    shadings.diffuse[:] = 2.0
    hints = place_hints([], ROOM.vertices, ROOM.triangles, nothing, seen.surface)
    data = training_input(seen, shadings, SETTINGS, hints)
    known = np.asarray(data.group) >= 0
    surface = ROOM.triangle_object[pixels.triangle[known]]
    assert known.sum() > 0.9 * len(seen.pool)
    assert (np.bincount(np.unique(np.stack([surface, data.group[known]]), axis=1)[0]) <= 1).all()
