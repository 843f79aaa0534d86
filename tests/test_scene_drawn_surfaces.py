"""Surfaces that the artist has drawn beside a scan, and rooms that the artist has completed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from fipt_blender.core.checks.agreement import survey_pixels
from fipt_blender.core.parts.labels import label_parts
from fipt_blender.core.parts.outlines import outlined_vertices
from fipt_blender.core.run.run_files import PANES
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.stage_settings import CompletionSettings
from fipt_blender.core.surface.room import Room, load_room
from samples.lost_things import HIGH, photographed, with_box
from samples.made_rooms import clean_run, complete_run
from samples.part_views import looking_views
from samples.scans import joined, scanned_box
from samples.small_rooms import write_room

SCAN = scanned_box(cells=45, noise=0.003)[0]
BOTH = with_box(SCAN)


def written(root: Path, room: Room, exact: np.ndarray | None, **names) -> RunFolder:
    """A run with a room, of which some triangles (T,) are exact."""
    root.mkdir(exist_ok=True)
    run = RunFolder(root)
    write_room(root, room, **({} if exact is None else {"triangle_exact": exact}))
    objects = [f"object {index}" for index in range(int(room.triangle_object.max()) + 1)]
    write_json(run.room_json, {"objects": objects, "materials": objects, "parts": "none", **names})
    clean_run(run, most_edges=120)
    return run


def drawn(room: Room) -> np.ndarray:
    return room.triangle_object == 1


def test_a_drawn_box_stays_as_it_is_and_the_scan_keeps_its_bits(tmp_path: Path) -> None:
    alone = load_room(written(tmp_path / "alone", SCAN, None))
    room = load_room(written(tmp_path / "both", BOTH, drawn(BOTH)))
    box = room.exact
    assert box is not None and box.sum() == 12 and alone.exact is None
    assert room.noise == alone.noise > 0.0
    for name in ("triangles", "corner_normals", "plane"):
        assert np.array_equal(getattr(room, name)[~box], getattr(alone, name)), name
    assert np.array_equal(room.vertices[: len(SCAN.vertices)], alone.vertices)
    assert np.array_equal(room.vertices[len(SCAN.vertices) :], BOTH.vertices[len(SCAN.vertices) :])
    assert np.array_equal(room.corner_normals[box], BOTH.corner_normals[box]) and (room.plane[box] < 0).all()
    # As a part of the scan it would have been moved and rounded.
    rounded = load_room(written(tmp_path / "rounded", BOTH, None))
    assert not np.array_equal(rounded.corner_normals[box], BOTH.corner_normals[box])

    down = mi.Ray3f(mi.Point3f([0.1, 1.5], [0.1, 1.5], [2.0, 2.0]), mi.Vector3f(0.0, 0.0, -1.0))
    hit = room.intersect(down)
    dr.eval(hit)
    assert np.array(hit.position.z) == pytest.approx([HIGH[2], 0.0], abs=0.01)
    assert np.array(hit.normal.z)[0] == 1.0 and box[np.array(hit.triangle)].tolist() == [True, False]

    pieces = label_parts(room, "loose", [], []).triangle_part
    assert len(np.unique(pieces[box])) == 1 and not np.isin(pieces[~box], pieces[box]).any()


@pytest.mark.parametrize("cleaned", [True, False])
def test_large_drawn_surfaces_do_not_make_a_scan_a_modelled_room(tmp_path: Path, cleaned: bool) -> None:
    vertices = np.tile(np.array([[-1.9, -1.9], [1.9, -1.9], [1.9, 1.9], [-1.9, 1.9]]), (5, 1))
    vertices = np.column_stack([vertices, np.repeat(np.linspace(0.5, 2.5, 5), 4)])
    triangles = np.arange(20).reshape(-1, 4)[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    panels = joined(SCAN, vertices, triangles, 1)
    run = written(tmp_path / "a", panels, drawn(panels))
    if not cleaned:
        clean_run(run, clean=False)
    room = load_room(run)
    assert (room.noise > 0.0) == cleaned and room.scan is not None
    assert replace(room, exact=None, noise=0.0).scan is None  # what the panels would make of it


def test_outlines_leave_a_drawn_box_alone(tmp_path: Path) -> None:
    views = looking_views(tmp_path, BOTH)  # masks of the box as it is; what is drawn is too large
    larger = BOTH.vertices.copy()
    larger[len(SCAN.vertices) :] = 1.02 * (larger[len(SCAN.vertices) :] - [0, 0, 0.3]) + [0, 0, 0.3]
    given = replace(BOTH, vertices=larger, parts="masks")
    room = load_room(written(tmp_path / "a", given, drawn(given), parts="masks"))
    parts = replace(label_parts(room, "objects", [], []), ids=np.array([1, 7]))
    moved = outlined_vertices(room, views, parts)
    free = outlined_vertices(replace(room, exact=None), views, parts)
    box = slice(len(SCAN.vertices), None)
    assert np.array_equal(moved[box], room.vertices[box])
    assert np.abs(free[box] - room.vertices[box]).max() > 1e-4


def test_what_is_drawn_has_no_holes_and_two_views_are_too_few_to_compare(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    views = photographed(tmp_path, BOTH, rng)
    assert survey_pixels(SCAN, views[:2]) is None
    run = written(tmp_path / "a", BOTH, drawn(BOTH))
    assert PANES not in complete_run(run, views, CompletionSettings(), most_edges=120).objects
