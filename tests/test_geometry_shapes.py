"""Surfaces of revolution and sheets that are fitted to the triangles of a scan."""

from __future__ import annotations

import numpy as np
import pytest

from fipt_blender.core.completion.shapes import fit_revolutions, fit_sheets, revolved

STEP = 0.02
AXIS = np.array([1.0, -2.0])


def cone(rng: np.random.Generator, count: int = 3000, share: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) on a share of a cone that is 0.3 m high and 0.2 to 0.14 m wide, and normals."""
    height, angle = rng.uniform(0.0, 0.3, count), rng.uniform(0.0, 2.0 * np.pi * share, count)
    away = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.column_stack([AXIS + (0.2 - 0.2 * height)[:, None] * away, 1.0 + height])
    normals = np.column_stack([away, np.full(count, 0.2)]) / np.sqrt(1.04)
    return points + rng.normal(0.0, 0.002, points.shape), normals


def turned(normals: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Normals with an error of about six degrees."""
    noisy = normals + rng.normal(0.0, 0.1, normals.shape)
    return np.asarray(noisy / np.linalg.norm(noisy, axis=1, keepdims=True))


@pytest.mark.parametrize("side", [1, -1])
def test_a_cone_is_found_from_half_of_it(rng: np.random.Generator, side: int) -> None:
    points, normals = cone(rng, share=0.5)
    found = fit_revolutions(points, turned(side * normals, rng), np.ones(len(points)), STEP)
    assert len(found) == 1
    places, facing = found[0].cells()
    assert np.abs(places.mean(axis=(0, 1))[:2] - AXIS).max() < 0.003
    radius = np.linalg.norm(places[..., :2] - AXIS, axis=2)
    assert np.abs(radius - (0.2 - 0.2 * (places[..., 2] - 1.0))).max() < 0.004
    around = (places[..., :2] - AXIS) / radius[..., None]
    assert (side * (facing[..., :2] * around).sum(axis=2) > 0.95).all()


def test_boxes_walls_and_thin_rods_are_no_surfaces_of_revolution(rng: np.random.Generator) -> None:
    count = 4000
    face, height, along = rng.integers(0, 4, count), rng.uniform(0, 0.4, count), rng.uniform(-0.2, 0.2, count)
    out = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0.0]])[face]
    sideways = np.stack([-out[:, 1], out[:, 0], out[:, 2]], axis=1)
    box = 0.2 * out + along[:, None] * sideways + height[:, None] * [0, 0, 1.0]
    assert not fit_revolutions(box, turned(out, rng), np.ones(count), STEP)
    wall = face == 0
    assert not fit_revolutions(box[wall], turned(out[wall], rng), np.ones(wall.sum()), STEP)
    points, normals = cone(rng)
    rod = np.column_stack([AXIS + 0.2 * (points[:, :2] - AXIS), points[:, 2]])
    assert not fit_revolutions(rod, turned(normals, rng), np.ones(len(rod)), STEP)


@pytest.mark.parametrize("side", [1, -1])
def test_the_mesh_of_a_revolution_has_its_area_and_faces_its_side(side: int) -> None:
    cylinder = revolved(AXIS, 1.0, STEP, np.full(11, 0.2), side)
    vertices, triangles, normals = cylinder.surface(np.ones(cylinder.shape, bool))
    corners = vertices[triangles].astype(np.float64)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert 0.5 * np.linalg.norm(cross, axis=1).sum() == pytest.approx(2.0 * np.pi * 0.2 * 0.2, rel=0.01)
    away = corners.mean(axis=1)[:, :2] - AXIS
    assert (side * (cross[:, :2] * away).sum(axis=1) > 0.0).all()
    assert ((normals.mean(axis=1) * cross).sum(axis=1) > 0.0).all()
    # It is closed around: only its two ends are open.
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    uses = np.unique(edges, axis=0, return_counts=True)[1]
    assert (uses == 1).sum() == 2 * cylinder.shape[1] and uses.max() == 2


def test_sheets_of_two_sides_are_apart_and_keep_their_waves(rng: np.random.Generator) -> None:
    count = 6000
    across, up = rng.uniform(0.0, 1.0, count), rng.uniform(0.0, 1.0, count)
    wave = 0.02 * np.sin(2.0 * np.pi * across / 0.4)
    slope = 0.02 * 2.0 * np.pi / 0.4 * np.cos(2.0 * np.pi * across / 0.4)
    front = np.column_stack([across, wave, up])
    facing = np.column_stack([slope, -np.ones(count), np.zeros(count)]) / np.sqrt(1.0 + slope**2)[:, None]
    few = rng.random(count) < 0.3
    side = np.column_stack([np.full(count, -0.2), across, up])[few]
    left = np.tile([-1.0, 0.0, 0.0], (len(side), 1))
    hole = (np.abs(across - 0.5) < 0.1) & (np.abs(up - 0.5) < 0.1)
    points, normals = np.concatenate([front[~hole], side]), np.concatenate([facing[~hole], left])
    found = fit_sheets(points, turned(normals, rng), np.ones(len(points)), STEP, 100, rng)
    assert len(found) >= 2
    front, left = (each.normals.mean(axis=(0, 1)) for each in found[:2])
    assert front @ [0.0, -1.0, 0.0] > 0.9 and left @ [-1.0, 0.0, 0.0] > 0.9
    places, normals = found[0].cells()
    x, y, z = np.moveaxis(places, 2, 0)
    within = (x > 0.02) & (x < 0.98) & (z > 0.02) & (z < 0.98)
    gap = within & (np.abs(x - 0.5) < 0.1) & (np.abs(z - 0.5) < 0.1)
    off = np.abs(y - 0.02 * np.sin(2.0 * np.pi * x / 0.4))
    assert off[within & ~gap].max() < 0.012 and off[gap].max() < 0.025
    vertices, triangles, _ = found[0].surface(within)
    corners = vertices[triangles].astype(np.float64)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (cross @ front > 0.0).all() and len(triangles) == 2 * within.sum()
