"""What photographs tell of surfaces that a scan lacks: panes in holes, lost things, torn parts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.views import View
from fipt_blender.core.checks.agreement import compared_pixels
from fipt_blender.core.completion.lost_surfaces import lost_surfaces, prism
from fipt_blender.core.pixels.camera_rays import trace_pixels
from fipt_blender.core.run.run_files import CLOSING, PANES, read_room
from fipt_blender.core.run.runfolder import write_json
from fipt_blender.core.run.stage_settings import CompletionSettings
from fipt_blender.core.surface.adjacency import Surface
from fipt_blender.core.surface.room import Room, load_room
from samples.camera_poses import look_at
from samples.lost_things import HIGH, LOW, photographed, with_box
from samples.made_rooms import complete_run
from samples.part_views import THING_PART, looking_views, with_own_ids, write_run
from samples.scans import grid_triangles, joined, scanned_box
from samples.small_rooms import BOX, make_room, mesh_room

SIZE = 48  # pixels, of the view of the opening
STEP, NOISE = 0.06, 0.003  # metres: edges of a torn thing, and what scans are off by
EDGE = 0.05  # metres between vertices of the scan
SCAN = scanned_box(cells=45, noise=NOISE)[0]


# ----------------------------------------------------------------------------------------------------- panes


def opened(behind: bool = False) -> Room:
    """A scanned room with an opening in the wall y = 2, and perhaps a board behind it."""
    room, side = scanned_box(cells=30, noise=NOISE)
    middle = room.vertices[room.triangles].mean(axis=1)
    opening = (side == 2) & (np.abs(middle[:, 0]) < 1.0) & (np.abs(middle[:, 2] - 1.5) < 0.7)
    vertices, triangles = room.vertices, room.triangles[~opening]
    if behind:
        board = np.array([[-3, 3, -1], [3, 3, -1], [3, 3, 4], [-3, 3, 4]], np.float32)
        triangles = np.concatenate([triangles, np.array([[0, 1, 2], [0, 2, 3]]) + len(vertices)])
        vertices = np.concatenate([vertices, board])
    return mesh_room(vertices, triangles, np.zeros(len(triangles)))


def view(folder: Path, through: float = 0.1) -> View:
    """Seen from the middle of the room, all radiance 1 but that of the opening."""
    image = np.ones((SIZE, SIZE, 3), np.float32)
    image[14:34, 14:34] = through
    write_exr(folder / "view.exr", image)
    pose = look_at([0.0, 0.0, 1.5], [0.0, 1.0, 1.5])
    middle, focal = 0.5 * SIZE, 0.5 * SIZE
    return View("view", "train", folder / "view.exr", SIZE, SIZE, focal, focal, middle, middle, pose)


def test_a_dark_opening_gets_a_pane(tmp_path: Path) -> None:
    run = write_run(tmp_path, opened(), "none")
    before = load_room(run)
    room = complete_run(run, [view(tmp_path)], CompletionSettings())
    added = slice(len(before.triangles), None)
    assert room.objects == (*before.objects, PANES) and len(room.triangles) > len(before.triangles)
    assert (room.triangle_object[added] == 1).all() and (room.triangle_material[added] == -1).all()
    assert np.array_equal(room.vertices[: len(before.vertices)], before.vertices)
    assert np.array_equal(room.triangles[: len(before.triangles)], before.triangles)
    pane = room.vertices[room.triangles[added]]
    assert 2.0 < pane[..., 1].mean() < 2.1 and np.ptp(pane[..., 1]) < 0.05
    assert 2.0 * 1.4 < room.areas[added].sum() < 2.0 * 2.0 * 1.4
    assert room.plane is not None and (room.plane[added] > before.plane.max()).all()
    assert room.corner_normals[added][..., 1].max() < -0.99
    # Switched off, they go.
    room = complete_run(run, [view(tmp_path)], CompletionSettings(panes=False))
    assert PANES not in room.objects and room.scan is not None


@pytest.mark.parametrize(("behind", "through"), [(False, 8.0), (True, 0.1)])
def test_what_shows_the_outside_or_a_surface_stays_open(tmp_path: Path, behind: bool, through: float) -> None:
    run = write_run(tmp_path, opened(behind), "none")
    assert PANES not in complete_run(run, [view(tmp_path, through)], CompletionSettings()).objects


def test_a_modelled_room_is_never_closed(tmp_path: Path) -> None:
    room = make_room(BOX[:2] + BOX[3:], objects=np.zeros(5, int))
    run = write_run(tmp_path, room, "none")
    assert len(complete_run(run, [view(tmp_path)], CompletionSettings()).triangles) == 10
    assert not run.scan_npz.exists()


def test_nothing_is_added_to_a_completed_room_until_it_is_no_longer_one(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    room = opened()
    kept = np.ones(len(room.triangles), bool)
    kept[rng.choice(np.flatnonzero(room.normals[:, 2] < -0.9), 20, replace=False)] = False
    run = write_run(tmp_path, mesh_room(room.vertices, room.triangles[kept], np.zeros(kept.sum())), "none")
    names = {"objects": ["scan"], "materials": ["scan"], "parts": "none"}
    for completed in (True, False, True):
        write_json(run.room_json, {**names, "completed": completed})
        if completed:  # what was added before the room was completed is not there any more
            assert len(read_room(run).triangles) == kept.sum()
        room = complete_run(run, [view(tmp_path)], CompletionSettings(), most_edges=20)
        assert room.plane is not None and room.objects == ("scan", *(() if completed else (CLOSING, PANES)))


# ----------------------------------------------------------------------------------------------- lost things


def found(scan: Room, views: list[View]) -> list[Surface]:
    return lost_surfaces(scan, compared_pixels(scan, views, EDGE))[0]


@pytest.fixture(scope="module")
def with_thing(tmp_path_factory: pytest.TempPathFactory) -> list[View]:
    """Photographs of the room with a box that its scan lacks."""
    return photographed(tmp_path_factory.mktemp("thing"), with_box(SCAN), np.random.default_rng(0))


@pytest.mark.parametrize("parts", ["none", "masks"])
def test_a_lost_box_is_put_back(tmp_path: Path, with_thing: list[View], rng: np.random.Generator, parts: str) -> None:
    run = write_run(tmp_path, SCAN, parts)
    assert complete_run(run, photographed(tmp_path, SCAN, rng), CompletionSettings()).objects == ("scan",)
    room = complete_run(run, with_thing, CompletionSettings())
    added = room.vertices[room.triangles[room.triangle_object == 1].reshape(-1)]
    assert room.objects == ("scan", PANES)
    # To a cell or two, which are as wide as a pixel.
    assert np.abs(added.min(axis=0) - LOW).max() < 0.1 and np.abs(added.max(axis=0) - HIGH).max() < 0.1


def test_nothing_is_found_on_a_floor_that_differs_between_views(tmp_path: Path, rng: np.random.Generator) -> None:
    assert found(SCAN, photographed(tmp_path, SCAN, rng, glossy=0.5)) == []


def test_a_thing_that_the_scanner_looked_into_is_not_closed(with_thing: list[View]) -> None:
    inner, _ = scanned_box(cells=12)
    size = 0.5 * (HIGH - LOW) / np.ptp(inner.vertices, axis=0)
    vertices = 0.5 * (LOW + HIGH) + size * (inner.vertices - inner.vertices.mean(axis=0))
    assert found(joined(SCAN, vertices, inner.triangles, 0), with_thing) == []


def test_masked_pixels_tell_nothing(tmp_path: Path, with_thing: list[View]) -> None:
    masked = []
    for each in with_thing:
        mask = tmp_path / f"mask_{each.name}.exr"
        write_exr(mask, (each.part_ids() == 1).astype(np.float32))
        masked.append(replace(each, mask=mask))
    assert found(SCAN, masked) == []


def test_a_prism_is_closed_and_faces_outwards() -> None:
    footprint = np.zeros((12, 9), bool)
    footprint[1:11, 2:8] = True
    footprint[1:4, 6:8] = False
    vertices, triangles, normals = prism(footprint, np.array([1.0, 2.0, 3.0]), 0.1, 4)
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert {tuple(edge) for edge in edges.tolist()} == {tuple(edge) for edge in edges[:, ::-1].tolist()}
    assert len(np.unique(edges, axis=0)) == len(edges)
    corners = vertices[triangles].astype(np.float64)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume = (corners[:, 0] * cross).sum() / 6.0
    # Smoothing rounds the corners of the outline.
    assert 0.85 * footprint.sum() * 0.4 * 0.01 < volume <= footprint.sum() * 0.4 * 0.01
    assert ((normals.mean(axis=1) * cross).sum(axis=1) > 0.0).all()
    assert vertices[:, 2].min() == pytest.approx(3.0) and vertices[:, 2].max() == pytest.approx(3.4)


# ------------------------------------------------------------------------------------------------ torn parts

Thing = Callable[[], tuple[np.ndarray, np.ndarray]]


def shade() -> tuple[np.ndarray, np.ndarray]:
    """A cone without ends, fronts outwards, around (0.1, 0) from 0.2 to 0.8 m."""
    rows, columns = 10, 50
    angle, height = 2.0 * np.pi * np.arange(columns + 1) / columns, np.arange(rows + 1) * STEP
    radius = (0.5 - 0.3 * height)[:, None]
    places = [0.1 + radius * np.cos(angle), radius * np.sin(angle), 0.2 + height[:, None] + 0.0 * angle]
    return np.stack(places, axis=-1).reshape(-1, 3), grid_triangles(rows, columns)[:, ::-1]


def board() -> tuple[np.ndarray, np.ndarray]:
    """An upright board, fronts towards -y, one metre wide and high."""
    count = 18
    x, z = np.meshgrid(np.linspace(-0.5, 0.5, count + 1), np.linspace(0.1, 1.1, count + 1))
    return np.stack([x, 0.0 * x, z], axis=-1).reshape(-1, 3), grid_triangles(count, count)[:, ::-1]


def in_hole(places: np.ndarray) -> np.ndarray:
    """(N,) bool, which places (N, 3) are in the hole on the front of each thing."""
    near = np.abs(places[:, [0, 2]] - [0.1, 0.5]) < 0.2
    return near.all(axis=1) & (places[:, 1] < 0.1)


@pytest.mark.parametrize("thing, evidence", [(shade, "masks"), (board, "own ids"), (shade, "photographs")])
def test_a_hole_in_a_part_is_filled(tmp_path: Path, rng: np.random.Generator, thing: Thing, evidence: str) -> None:
    vertices, triangles = thing()
    hole = in_hole(vertices[triangles].mean(axis=1))
    assert 0.05 < hole.mean() < 0.3
    noisy = vertices + rng.normal(0.0, NOISE, vertices.shape)
    parts = "none" if evidence == "photographs" else "masks"
    run = write_run(tmp_path, joined(SCAN, noisy, triangles[~hole], 0), parts)
    true = joined(SCAN, vertices, triangles, 1)
    views = photographed(tmp_path, true, rng) if parts == "none" else looking_views(tmp_path, true)
    told: list[float] = []
    given = with_own_ids(views, rng) if evidence == "own ids" else views
    room = complete_run(run, given, CompletionSettings(), progress=told.append)
    assert told and told == sorted(told) and told[0] >= 0.0 and 0.0 < told[-1] <= 1.0
    added = room.triangle_object == 1
    assert room.objects == ("scan", PANES) and added.any()
    # Seen from its front, the hole shows the part again, where it is; nothing else is hidden.
    filled, wanted = 0, 0
    for each in views:
        now, exact = trace_pixels(room, each), trace_pixels(true, each)
        new = added[np.array(now.triangle)]
        gap = np.isin(np.array(exact.triangle), len(SCAN.triangles) + np.flatnonzero(hole)) & np.array(exact.front)
        close = np.abs(np.array(now.distance) - np.array(exact.distance)) < STEP
        filled, wanted = filled + (gap & new & close).sum(), wanted + gap.sum()
        assert (new & ~close).mean() < 0.01
    assert wanted > 200 and filled > 0.8 * wanted


@pytest.mark.parametrize("thing, parts", [(board, "masks"), (shade, "none")])
def test_whole_parts_and_true_holes_stay(tmp_path: Path, rng: np.random.Generator, thing: Thing, parts: str) -> None:
    vertices, triangles = thing()
    hole = in_hole(vertices[triangles].mean(axis=1))
    noisy = vertices + rng.normal(0.0, NOISE, vertices.shape)
    for name, left in (("whole", triangles), ("open", triangles[~hole])):
        folder = tmp_path / name
        folder.mkdir()
        run = write_run(folder, joined(SCAN, noisy, left, 0), parts)
        true = joined(SCAN, vertices, left, 1)
        views = photographed(folder, true, rng) if parts == "none" else looking_views(folder, true)
        assert any((each.part_ids() == THING_PART).any() for each in views)
        assert complete_run(run, views, CompletionSettings()).objects == ("scan",)
