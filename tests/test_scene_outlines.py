"""Outlines of parts on a scan: vertices move to the borders of masks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.views import View
from fipt_blender.core.parts.labels import Parts
from fipt_blender.core.parts.outlines import outlined_vertices, without_folds
from fipt_blender.core.pixels.camera_rays import trace_pixels
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.surface.adjacency import Mesh, face_vectors
from fipt_blender.core.surface.clean import clean_mesh
from fipt_blender.core.surface.room import Room, load_room
from samples import small_captures
from samples.camera_poses import look_at
from samples.made_rooms import clean_run, complete_run
from samples.scans import grid_triangles, joined, scanned_box
from samples.small_captures import PANEL, panel_capture, pinhole, run_here
from samples.small_rooms import BOX, make_room, write_room

WIDTH, HEIGHT, FOCAL = 96, 64, 60.0
WALLS, RUG, BOARD = 1, 2, 3
RUG_SIZE, BOARD_SIZE = (0.76, 0.57), 0.5
EYES = ([-1.2, -1.5, 1.9], [1.3, -1.6, 1.7], [0.2, -1.8, 2.2], [-0.6, -0.9, 2.4])


def masked_views(folder: Path, exact: Room, target: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> list[View]:
    """Views whose masks show the exact room: a rug on the floor, and the object with index 6 as a board."""
    views = []
    for number, eye in enumerate(EYES):
        lens = (WIDTH, HEIGHT, FOCAL, FOCAL, 0.5 * WIDTH, 0.5 * HEIGHT)
        mask = folder / f"{number}_mask.exr"
        view = View(str(number), "train", folder / f"{number}.exr", *lens, look_at(eye, target), parts=mask)
        surface = trace_pixels(exact, view)
        x, y, z = np.array(surface.position)
        ids = np.full(WIDTH * HEIGHT, WALLS)
        ids[(np.abs(z) < 1e-3) & (np.abs(x) < RUG_SIZE[0]) & (np.abs(y) < RUG_SIZE[1])] = RUG
        ids[exact.triangle_object[np.array(surface.triangle)] == 6] = BOARD
        write_exr(mask, ids.reshape(HEIGHT, WIDTH).astype(np.float32))
        views.append(view)
    return views


def labels_of(room: Room, side: np.ndarray) -> np.ndarray:
    """(T,) int32 part of each triangle by its center: 0 walls, 1 rug."""
    x, y, _ = room.vertices[room.triangles].mean(axis=1).T
    return ((side == 0) & (np.abs(x) < RUG_SIZE[0]) & (np.abs(y) < RUG_SIZE[1])).astype(np.int32)


def cleaned(room: Room) -> Room:
    clean = clean_mesh(room.vertices, room.triangles)
    assert clean is not None
    return replace(
        room, vertices=clean.vertices, corner_normals=clean.corner_normals, plane=clean.plane, noise=clean.noise
    )


def rug_border(room: Room, label: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices between rug and floor, and their distance from the rug's true border."""
    vertex = np.intersect1d(room.triangles[label == 1], room.triangles[label == 0])
    off = np.abs(room.vertices[vertex, :2]) - RUG_SIZE
    outside = np.linalg.norm(np.maximum(off, 0.0), axis=1)
    return vertex, np.where(off.max(axis=1) > 0.0, outside, off.max(axis=1))


def test_borders_of_parts_become_those_of_the_masks(tmp_path: Path) -> None:
    scan, side = scanned_box(cells=60, noise=0.002)
    room = cleaned(scan)
    views = masked_views(tmp_path, make_room(BOX))
    label = labels_of(room, side)
    parts = Parts(label, "part", np.array([WALLS, RUG]))
    moved = replace(room, vertices=outlined_vertices(room, views, parts))
    vertex, before = rug_border(room, label)
    _, after = rug_border(moved, label)
    assert np.sqrt((before**2).mean()) > 0.015
    assert np.sqrt((after**2).mean()) < 0.5 * np.sqrt((before**2).mean())
    # They stay on the floor, and what is away from the border stays where it was.
    assert np.abs(moved.vertices[vertex, 2] - room.vertices[vertex, 2]).max() < 0.003
    far = np.linalg.norm(room.vertices - [0.0, 0.0, 0.0], axis=1) > 2.0
    assert np.abs(moved.vertices[far] - room.vertices[far]).max() < 0.005


def test_a_board_that_the_scanner_made_smaller_grows(tmp_path: Path) -> None:
    """Its rim is a silhouette: what the masks have their border with is more than a metre behind."""
    scan, side = scanned_box(cells=40, noise=0.002)
    cells, size = 14, BOARD_SIZE - 0.04
    u, v = (axis.ravel() for axis in np.meshgrid(*2 * [np.linspace(-size, size, cells + 1)], indexing="ij"))
    points = np.stack([u, np.full_like(u, 0.5), v + 1.2], axis=1)
    room = joined(scan, points, grid_triangles(cells, cells), 0)
    true = [[x, 0.5, z + 1.2] for x, z in np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * BOARD_SIZE]
    views = masked_views(tmp_path, make_room([*BOX, true]), (0.0, 0.5, 1.2))
    label = labels_of(room, np.append(side, np.ones(2 * cells**2)))
    label[len(side) :] = 2
    parts = Parts(label, "part", np.array([WALLS, RUG, BOARD]))
    moved = outlined_vertices(room, views, parts)[len(scan.vertices) :]
    middle = np.abs(v) < 0.7 * size  # of the left and right rims
    for rim, sign in ((u < -size + 1e-6, -1.0), (u > size - 1e-6, 1.0)):
        assert sign * moved[rim & middle, 0].mean() == pytest.approx(BOARD_SIZE, abs=0.015)
    assert np.abs(moved[:, 1] - 0.5).max() < 0.1


def test_moves_never_fold_triangles() -> None:
    x, y = (axis.ravel() for axis in np.meshgrid(*2 * [np.arange(12.0)]))
    mesh = Mesh(np.stack([x, y, 0.0 * x], axis=1), grid_triangles(11, 11)[:, ::-1])
    moves = np.random.default_rng(0).normal(0.0, 0.6, (144, 3)) * (1.0, 1.0, 0.0)
    up = face_vectors(mesh.vertices + moves, mesh.triangles)[0][:, 2]
    assert (up < 0.0).any()
    smaller = without_folds(mesh, moves)
    assert (face_vectors(mesh.vertices + smaller, mesh.triangles)[0][:, 2] > 0.0).all()
    assert (np.linalg.norm(smaller, axis=1) <= np.linalg.norm(moves, axis=1) + 1e-12).all()
    assert np.array_equal(without_folds(mesh, 0.1 * moves), 0.1 * moves)


def write_run(root: Path, room: Room) -> RunFolder:
    write_room(root, room)
    run = RunFolder(root)
    clean_run(run)
    return run


def test_a_room_gets_the_outlines_of_its_views(tmp_path: Path) -> None:
    scan, _ = scanned_box(cells=30, noise=0.003)
    run = write_run(tmp_path, scan)
    views = masked_views(tmp_path, make_room(BOX))
    clean = load_room(run).vertices
    moved = complete_run(run, views, outlines=True).vertices
    assert not np.array_equal(moved, clean) and np.abs(moved - clean).max() < 0.25
    assert not np.array_equal(complete_run(run, views[:2], outlines=True).vertices, moved)
    none = [replace(view, parts=None) for view in views]
    assert np.array_equal(complete_run(run, none, outlines=True).vertices, clean)


def masked_capture(root: Path) -> RunFolder:
    """A scanned box with a panel, photographed in the exact one; the masks' ids mean nothing in other views."""
    exact = panel_capture()
    scan, _ = scanned_box(cells=30, noise=0.003)
    room = joined(scan, np.array(PANEL, np.float32), np.array([[0, 1, 2], [0, 2, 3]]), 0)
    run = small_captures.write_run(
        root, replace(exact, room=room), rounds=0, **small_captures.UNTRAINED, **small_captures.FEW
    )
    head = read_document(run.capture_json, dict)
    for number, (view, pose) in enumerate(zip(head["views"], exact.poses, strict=True)):
        surface = trace_pixels(exact.room, pinhole(pose))
        ids = exact.room.triangle_object[np.array(surface.triangle)] + 1 + 100 * number
        view["parts"] = view["image"].replace(".exr", "_parts.exr")
        write_exr(run.root / view["parts"], ids.reshape(view["height"], view["width"]).astype(np.float32))
    write_json(run.capture_json, head)
    return run


def test_a_resumed_estimation_keeps_outlines_and_stages(tmp_path: Path) -> None:
    run = masked_capture(tmp_path)
    first = [message["name"] for message in run_here(run, train=False) if message["type"] == "stage"]
    assert first[:6] == ["cleaning", "relation", "completion", "linking", "outlines", "pixels"]
    assert run.fields_npz.exists() and [*run.scan.rglob("linked/**/*.exr")]
    written = run.scan_npz.read_bytes()
    again = [message["name"] for message in run_here(run, train=False) if message["type"] == "stage"]
    assert again == [] and run.scan_npz.read_bytes() == written


def test_a_modelled_room_has_no_outlines(tmp_path: Path) -> None:
    run = write_run(tmp_path, make_room(BOX))
    complete_run(run, masked_views(tmp_path, make_room(BOX)), outlines=True)
    assert not run.scan_npz.exists()
