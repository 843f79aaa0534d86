"""The cleaned copy of a scan on analytic meshes: walls, creases, round and thin things; exact meshes stay."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.run.run_files import Geometry
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.surface.adjacency import NONE, face_vectors, make_mesh
from fipt_blender.core.surface.clean import clean_mesh
from fipt_blender.core.surface.patches import Planes
from fipt_blender.core.surface.planes import parallel_normals
from fipt_blender.core.surface.room import load_room
from samples.made_rooms import clean_run
from samples.refusals import error_of
from samples.scans import grid_triangles, scanned_box
from samples.small_rooms import BOX, make_room, write_room

STEP = 0.02  # metres between vertices
NOISE = 0.001

Mesh = tuple[np.ndarray, np.ndarray]


def grid(cells: int, across: list[float], up: list[float], corner: list[float]) -> Mesh:
    """A parallelogram of 2 * cells^2 triangles; its normal is across x up."""
    u, v = (axis.ravel() for axis in np.meshgrid(*2 * [np.linspace(0.0, 1.0, cells + 1)], indexing="ij"))
    points = np.array(corner) + u[:, None] * np.array(across) + v[:, None] * np.array(up)
    return points, grid_triangles(cells, cells)


def joined(pieces: list[Mesh]) -> Mesh:
    """One welded mesh of several."""
    points = np.concatenate([piece[0] for piece in pieces])
    starts = np.cumsum([0] + [len(piece[0]) for piece in pieces[:-1]])
    triangles = np.concatenate([piece[1] + start for piece, start in zip(pieces, starts, strict=True)])
    mesh, _ = make_mesh(points, triangles)
    return mesh.vertices, mesh.triangles


def noisy(mesh: Mesh, seed: int = 0) -> Mesh:
    points, triangles = mesh
    return points + np.random.default_rng(seed).normal(0.0, NOISE, points.shape), triangles


def sphere(radius: float) -> Mesh:
    """A cube of grids blown up; edges are about STEP long."""
    cells = round(1.5 * radius / STEP)
    sides = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            corner, across, up = np.full(3, -1.0), np.zeros(3), np.zeros(3)
            corner[axis] = sign
            across[(axis + 1) % 3], up[(axis + 2) % 3] = (2.0, 2.0)
            pair = (across, up) if sign > 0.0 else (up, across)
            sides.append(grid(cells, *(list(edge) for edge in pair), list(corner)))
    points, triangles = joined(sides)
    bent = np.tan(points * np.pi / 4.0)
    return radius * bent / np.linalg.norm(bent, axis=1, keepdims=True), triangles


def cleaned(mesh: Mesh) -> Geometry:
    result = clean_mesh(np.asarray(mesh[0], np.float32), mesh[1])
    assert result is not None
    return result


def errors(vertices: np.ndarray, triangles: np.ndarray, true: np.ndarray) -> np.ndarray:
    """(T,) angle in degrees between triangles and the true normals."""
    normals, _ = face_vectors(vertices.astype(np.float64), triangles)
    return np.degrees(np.arccos(np.clip((normals * true).sum(axis=1), -1.0, 1.0)))


def test_walls_become_planes_and_right_angles_stay() -> None:
    # Floor and wall meet in the x axis.
    exact = joined([grid(40, [0.8, 0, 0], [0, 0.8, 0], [0, 0, 0]), grid(40, [0, 0, 0.8], [0.8, 0, 0], [0, 0, 0])])
    true, _ = face_vectors(*exact)
    mesh = noisy(exact)
    assert np.median(errors(*mesh, true)) > 3.0
    clean = cleaned(mesh)
    wrong = errors(clean.vertices, mesh[1], true)
    assert np.median(wrong) < 0.1 and np.quantile(wrong, 0.99) < 2.0
    assert set(np.unique(clean.plane[clean.plane != NONE])) == {0, 1}
    assert 0.5 * NOISE < clean.noise < 1.5 * NOISE
    # The vertices of the crease lie on both planes.
    crease = np.flatnonzero(np.abs(exact[0][:, 1:]).max(axis=1) < 1e-9)
    assert np.abs(clean.vertices[crease, 1:]).max() < 0.5 * NOISE
    # No shading normal is bent over the crease.
    across = (clean.corner_normals * true[:, None]).sum(axis=2)
    assert np.degrees(np.arccos(np.clip(across.min(), -1.0, 1.0))) < 3.0


def test_a_sphere_stays_round() -> None:
    points, triangles = sphere(0.3)
    mesh = noisy((points, triangles))
    clean = cleaned(mesh)
    middle = points[triangles].mean(axis=1)
    true = middle / np.linalg.norm(middle, axis=1, keepdims=True)
    assert np.median(errors(clean.vertices, triangles, true)) < 0.5 * np.median(errors(*mesh, true))
    radius = np.linalg.norm(clean.vertices, axis=1)
    assert abs(radius.mean() - 0.3) < NOISE and radius.std() < 1.5 * NOISE


def test_both_sides_of_a_thin_plate_stay_apart() -> None:
    top = grid(30, [0.6, 0, 0], [0, 0.6, 0], [0, 0, 0.02])
    bottom = grid(30, [0, 0.6, 0], [0.6, 0, 0], [0, 0, 0.0])
    mesh = noisy(joined([top, bottom]))
    clean = cleaned(mesh)
    upper = mesh[0][mesh[1]].mean(axis=1)[:, 2] > 0.01
    assert len(np.unique(clean.plane[upper])) == 1 and len(np.unique(clean.plane[~upper])) == 1
    height = clean.vertices[:, 2]
    apart = height[np.unique(mesh[1][upper])].mean() - height[np.unique(mesh[1][~upper])].mean()
    assert abs(apart - 0.02) < 0.2 * NOISE
    true = np.where(upper[:, None], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0])
    assert errors(clean.vertices, mesh[1], true).max() < 1.0


def test_steps_higher_than_the_noise_stay() -> None:
    # Two levels, 1 cm apart, joined by a riser.
    low = grid(30, [0.6, 0, 0], [0, 0.6, 0], [0, 0, 0])
    high = grid(30, [0.6, 0, 0], [0, 0.6, 0], [0, 0.6, 0.01])
    mesh = noisy(joined([low, high]))
    clean = cleaned(mesh)
    second = mesh[0][mesh[1]].mean(axis=1)[:, 1] > 0.6
    assert set(np.unique(clean.plane[second])).isdisjoint(np.unique(clean.plane[~second]))
    levels = [np.median(clean.vertices[np.unique(mesh[1][half]), 2]) for half in (~second, second)]
    assert levels == pytest.approx([0.0, 0.01], abs=0.3 * NOISE)


def test_modelled_meshes_are_no_scans() -> None:
    room = make_room(BOX)
    assert clean_mesh(room.vertices, room.triangles) is None
    box = joined([grid(40, *edges) for edges in (([2, 0, 0], [0, 2, 0], [0, 0, 0]), ([0, 0, 2], [2, 0, 0], [0, 0, 0]))])
    assert clean_mesh(box[0].astype(np.float32), box[1]) is None
    flat = joined([grid(40, [2.0, 0, 0], [0, 2.0, 0], [0, 0, 0]), sphere(0.3)])
    assert clean_mesh(flat[0].astype(np.float32), flat[1]) is None


def test_a_run_works_on_the_cleaned_scan(tmp_path: Path) -> None:
    scan, side = scanned_box(cells=20, noise=0.01)
    run = RunFolder(tmp_path)
    write_room(run.root, scan)
    assert np.array_equal(load_room(run).vertices, scan.vertices)
    clean_run(run)
    room = load_room(run)
    assert np.array_equal(room.triangles, scan.triangles)
    assert 0.005 < room.noise < 0.02 and room.offset == 2.0 * room.noise
    floor = np.unique(room.triangles[side == 0])
    assert room.vertices[floor, 2].std() < 0.2 * scan.vertices[floor, 2].std()
    assert room.scan is not None
    # What was made of another mesh is not used, and what can't be read is an error.
    write_json(run.room_json, {"objects": ["scan"], "materials": ["scan"], "parts": "masks", "completed": True})
    assert np.array_equal(load_room(run).vertices, scan.vertices)
    run.scan_npz.write_bytes(run.scan_npz.read_bytes()[:1000])
    assert error_of(load_room, run).code == "file-damaged"
    clean_run(run, clean=False)
    assert not run.scan_npz.exists() and np.array_equal(load_room(run).vertices, scan.vertices)


def test_a_modelled_room_keeps_every_bit(tmp_path: Path) -> None:
    exact = make_room(BOX)
    run = RunFolder(tmp_path)
    write_room(run.root, exact)
    clean_run(run)
    room = load_room(run)
    assert not run.scan_npz.exists() and room.noise == 0.0 and room.plane is None
    assert np.array_equal(room.vertices, exact.vertices)
    assert np.array_equal(room.corner_normals, exact.corner_normals)
    low, high = room.bounds
    assert room.offset == float(5e-5 * np.linalg.norm(high - low))


def test_narrow_planes_are_shaded_parallel_to_large_ones() -> None:
    tilts = np.radians([0.0, 6.0, 6.0, 30.0, 174.0])
    planes = Planes(
        normal=np.stack([np.sin(tilts), np.zeros(5), np.cos(tilts)], axis=1),
        centre=np.zeros((5, 3)),
        deviation=np.zeros(5),
        # A tilt by 6 degrees is resolved over 50 cm, but not over 10 cm; 30 degrees always are.
        width=np.array([2.0, 0.1, 0.5, 0.1, 0.1]),
    )
    found = parallel_normals(planes, np.array([4.0, 0.1, 0.3, 0.1, 0.1]), STEP)
    assert np.allclose(found[[0, 2, 3]], planes.normal[[0, 2, 3]])
    assert np.allclose(found[[1, 4]], [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
