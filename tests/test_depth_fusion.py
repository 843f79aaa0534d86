"""Fusion of range images: the surface lies where it was measured, is welded, and open where nothing was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fipt_blender.core.depth.cleaning import simplified, without_specks
from fipt_blender.core.depth.extraction import FusedMesh, extract
from fipt_blender.core.depth.gaps import gap_image
from fipt_blender.core.depth.range_image import RangeImage
from fipt_blender.core.depth.volume import BlockVolume, pack, unpack
from samples.camera_poses import look_at

VOXEL = 0.04
UP = (0.3, 0.2, 0.9)  # no camera of these tests looks in this direction
RADIUS = 0.5


def sphere_image(origin: np.ndarray, color: np.ndarray | None = None) -> RangeImage:
    """What a camera at `origin` measures of a sphere around the world's origin."""
    pose, size, focal = look_at(origin, np.zeros(3), UP), 96, 96.0
    y, x = np.mgrid[:size, :size] + 0.5
    local = np.stack([(x - 48.0) / focal, (y - 48.0) / focal, np.ones_like(x)], axis=2)
    direction = local @ pose[:3, :3].T
    square, middle = (direction**2).sum(axis=2), direction @ origin
    root = middle**2 - square * (origin @ origin - RADIUS**2)
    depth = np.where(root > 0.0, (-middle - np.sqrt(np.maximum(root, 0.0))) / square, 0.0)
    colors = None if color is None else np.broadcast_to(color, (size, size, 3)).astype(np.float32)
    return RangeImage(depth.astype(np.float32), focal, focal, 48.0, 48.0, pose, colors)


def around() -> np.ndarray:
    """(14, 3) camera positions on all sides of the sphere."""
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T / np.sqrt(3.0)
    return 1.5 * np.concatenate([corners, np.eye(3), -np.eye(3)])


def fused(images: list[RangeImage], voxel: float = VOXEL) -> FusedMesh:
    volume = BlockVolume(voxel, with_color=images[0].color is not None)
    for image in images:
        volume.integrate(image)
    return extract(volume)


@pytest.fixture(scope="module")
def ball() -> FusedMesh:
    """The sphere, seen from all sides, in one colour."""
    return fused([sphere_image(origin, np.array([0.2, 0.4, 0.6])) for origin in around()])


def directed_edges(mesh: FusedMesh) -> np.ndarray:
    """(3 T, 2) edges in the direction in which triangles walk along them."""
    return np.stack([mesh.triangles, np.roll(mesh.triangles, -1, axis=1)], axis=-1).reshape(-1, 2)


def is_closed(mesh: FusedMesh) -> bool:
    """Whether every edge is walked once in each direction for each pair of triangles there."""
    edges = directed_edges(mesh)
    there, back = (np.unique(edges, axis=0, return_counts=True), np.unique(edges[:, ::-1], axis=0, return_counts=True))
    return np.array_equal(there[0], back[0]) and np.array_equal(there[1], back[1])


def test_a_sphere_seen_from_all_sides_is_one_closed_surface_at_its_place(ball: FusedMesh) -> None:
    mesh = ball
    radius = np.linalg.norm(mesh.vertices, axis=1)
    # Distances along the rays of slanting views are too long where the surface is curved.
    assert abs(radius.mean() - RADIUS) < 0.2 * VOXEL and np.abs(radius - RADIUS).max() < 0.5 * VOXEL
    assert is_closed(mesh)
    edges = np.unique(np.sort(directed_edges(mesh), axis=1), axis=0)
    assert len(mesh.vertices) - len(edges) + len(mesh.triangles) == 2  # Euler
    corners = mesh.vertices[mesh.triangles].astype(np.float64)
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6.0
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * RADIUS**3, rel=0.03)  # positive: normals point outward


def test_every_pattern_of_signs_gives_a_surface_without_gaps() -> None:
    volume = BlockVolume(1.0)
    volume.allocate(pack(np.array(np.meshgrid(*[np.arange(-2, 3)] * 3)).reshape(3, -1).T))
    volume.weight[:] = 1.0
    inner = (np.abs(unpack(volume.keys)) < 2).all(axis=1)
    noise = np.random.default_rng(1).normal(size=volume.distance.shape)
    volume.distance[:] = np.where(inner[:, None], noise, 1.0)
    mesh = extract(volume)
    assert len(mesh.triangles) > 10_000 and is_closed(mesh)


def test_what_no_camera_sees_stays_open() -> None:
    mesh = fused([sphere_image(np.array([0.0, 0.0, 1.5]))])
    assert mesh.vertices[:, 2].min() > -2.0 * VOXEL and not is_closed(mesh)


def test_a_wrong_measurement_in_the_air_is_removed_by_cameras_that_look_through_it() -> None:
    origins = around()
    clean = [sphere_image(origin) for origin in origins]
    wrong = clean[0].depth.copy()
    wrong[20:24, 40:44] = 0.6
    flying = RangeImage(wrong, 96.0, 96.0, 48.0, 48.0, clean[0].camera_to_world)
    alone = np.linalg.norm(fused([flying]).vertices, axis=1)
    assert alone.max() > RADIUS + 4.0 * VOXEL
    together = np.linalg.norm(fused([flying, *clean[:1], *clean]).vertices, axis=1)
    assert together.max() < RADIUS + 2.0 * VOXEL


def test_colors_are_means_of_the_views() -> None:
    views = [sphere_image(np.array([0.0, 0.0, 1.5]), np.array([value, 0.5, 0.0])) for value in (0.2, 0.4)]
    mesh = fused(views)
    assert mesh.colors is not None
    assert np.abs(mesh.colors - [0.3, 0.5, 0.0]).max() < 1e-5


def wall_image(place: float, hole: bool = True, depth: float = 1.0) -> RangeImage:
    """What a camera beside others measures of a slanting wall, with a hole in its middle."""
    _, x = (np.mgrid[:48, :48] + 0.5 - 24.0) / 48.0
    pose = np.eye(4)
    pose[0, 3] = place
    values = (depth + 0.3 * place) / (1.0 - 0.3 * x)
    values[16:32, 16:32] = 0.0 if hole else values[16:32, 16:32]
    return RangeImage(values.astype(np.float32), 48.0, 48.0, 24.0, 24.0, pose)


def test_a_plane_is_continued_through_a_gap_exactly() -> None:
    gap, whole = gap_image(wall_image(0.0)), wall_image(0.0, hole=False)
    inside = np.zeros((48, 48), bool)
    inside[16:32, 16:32] = True
    np.testing.assert_allclose(gap.depth[inside], whole.depth[inside], rtol=1e-5)
    assert not gap.depth[~inside].any()


def test_no_curtain_hangs_from_an_edge_and_nothing_continues_beyond_the_image() -> None:
    image = wall_image(0.0)
    image.depth[:, 24:] *= np.float32(0.5)  # something stands before the wall
    image.depth[16:32] = 0.0
    gap = gap_image(image).depth
    assert gap[20, 5] > 0.85 and 0.0 < gap[20, 40] < 0.7  # along columns
    image = wall_image(0.0, hole=False)
    image.depth[:, 30:] *= np.float32(0.5)
    image.depth[:, 20:30] = 0.0
    image.depth[:, :4] = 0.0
    assert not gap_image(image).depth.any()


def test_gaps_are_taken_over_where_nothing_is_known() -> None:
    volume, gaps = BlockVolume(VOXEL), BlockVolume(VOXEL)
    gaps.integrate(gap_image(wall_image(0.0)))
    volume.allocate(gaps.keys)
    volume.integrate(wall_image(0.0))
    before, measured = extract(volume, 1e-3), volume.weight > 0.0
    distance = volume.distance[measured].copy()
    volume.adopt(gaps)
    np.testing.assert_array_equal(volume.distance[: len(measured)][measured], distance)
    mesh = extract(volume, 1e-3)
    assert len(mesh.triangles) > 1.05 * len(before.triangles)
    assert np.abs(mesh.vertices[:, 2] - 0.3 * mesh.vertices[:, 0] - 1.0).max() < 0.01
    seen_through = BlockVolume(VOXEL)
    seen_through.allocate(gaps.keys)
    seen_through.integrate(wall_image(0.0, hole=False, depth=2.0))
    seen_through.adopt(gaps)
    assert np.abs(extract(seen_through, 1e-3).vertices[:, 2]).min() > 1.5


def test_weights_of_measurements() -> None:
    near, far = wall_image(0.0, hole=False), wall_image(0.0, hole=False, depth=1.03)
    volume = BlockVolume(VOXEL)
    volume.integrate(near)
    volume.integrate(replace(far, weight=np.full((48, 48), 0.01, np.float32)))
    lone = extract(volume, 1e-3).vertices
    plain = lone[:, 2] - 0.3 * lone[:, 0]
    assert np.abs(plain - 1.0).max() < 0.01


def test_nothing_measured_gives_no_surface() -> None:
    mesh = fused([RangeImage(np.zeros((8, 8), np.float32), 8.0, 8.0, 4.0, 4.0, np.eye(4))])
    assert mesh.vertices.shape == (0, 3) and mesh.triangles.shape == (0, 3)


def test_specks_are_dropped_and_large_pieces_stay(ball: FusedMesh) -> None:
    speck = FusedMesh(0.02 * ball.vertices + 2.0, ball.triangles)
    both = FusedMesh(
        np.concatenate([ball.vertices, speck.vertices]),
        np.concatenate([ball.triangles, speck.triangles + len(ball.vertices)]),
    )
    kept = without_specks(both, 0.01)
    assert np.array_equal(kept.vertices, ball.vertices) and len(kept.triangles) == len(ball.triangles)
    assert without_specks(both, 100.0).triangles.shape == (0, 3)


def test_a_mesh_is_simplified_to_its_budget_and_keeps_shape_and_colors(ball: FusedMesh) -> None:
    small = simplified(ball, 600)
    assert 300 < len(small.triangles) <= 600 < len(ball.triangles) and is_closed(small)
    radius = np.linalg.norm(ball.vertices, axis=1).mean()
    corners = small.vertices[small.triangles]
    np.testing.assert_allclose(np.linalg.norm(corners.mean(axis=1), axis=1), radius, rtol=0.03)
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("ni,ni->n", facing, corners.mean(axis=1)) > 0.0).all()  # nothing is inside out
    assert small.colors is not None and np.allclose(small.colors, ball.colors.mean(axis=0), atol=0.02)
    assert simplified(ball, len(ball.triangles)) is ball
    # Far from the origin, too.
    far = np.array([1000.0, -2000.0, 500.0], np.float32)
    small = simplified(FusedMesh(ball.vertices + far, ball.triangles), 600)
    np.testing.assert_allclose(np.linalg.norm(small.vertices - far, axis=1), radius, rtol=0.05)
