"""The closing of a scan's small holes in the run folder, and what uses it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fipt_blender.core.light.emitters import group_fixtures
from fipt_blender.core.parts.labels import NO_PART, label_parts, usable_sources
from fipt_blender.core.run.run_files import CLOSING
from fipt_blender.core.run.runfolder import write_json
from fipt_blender.core.surface.adjacency import make_mesh
from fipt_blender.core.surface.closing import open_loops
from fipt_blender.core.surface.room import Room, load_room
from samples.made_rooms import clean_run
from samples.part_views import write_run
from samples.scans import scanned_box
from samples.small_rooms import mesh_room

PINHOLES = 40


@pytest.fixture
def scan(rng: np.random.Generator) -> Room:
    """A scanned room whose ceiling lacks single triangles, and whose wall y = 2 lacks a window."""
    room, side = scanned_box(cells=30, noise=0.003)
    middle = room.vertices[room.triangles].mean(axis=1)
    high, low = room.vertices.max(axis=0), room.vertices.min(axis=0)
    ceiling = np.flatnonzero(
        (middle[:, 2] > high[2] - 0.02) & ((middle < high - 0.2) & (middle > low + 0.2))[:, :2].all(axis=1)
    )
    window = (side == 2) & (np.abs(middle[:, 0]) < 1.0) & (np.abs(middle[:, 2] - 1.5) < 0.9)
    kept = ~window
    kept[rng.choice(ceiling, PINHOLES, replace=False)] = False
    triangles = room.triangles[kept]
    return mesh_room(room.vertices, triangles, np.zeros(len(triangles)), parts="none")


def test_a_scan_is_closed_before_it_is_cleaned(tmp_path: Path, scan: Room) -> None:
    run = write_run(tmp_path, scan, "none")
    plain = run.scan_npz.read_bytes()
    holes = clean_run(run, most_edges=120)
    assert holes is not None and 20 < holes.closed <= PINHOLES and holes.left == 1
    assert holes.open_area == pytest.approx(2.0 * 1.8, rel=0.1)
    assert holes.text.startswith(f"The scan has {holes.closed} small holes, which were closed (")
    room = load_room(run)
    assert room.objects[-1] == CLOSING and room.closing.sum() == len(room.triangles) - len(scan.triangles)
    assert np.array_equal(room.triangles[: len(scan.triangles)], scan.triangles)
    # Cleaned with what is around it: of one plane, and all that is open is the window.
    assert room.plane is not None and (room.plane[room.closing] >= 0).mean() > 0.9
    mesh, _ = make_mesh(room.vertices, room.triangles)
    assert len(list(open_loops(mesh))) == 1
    # The setting turns it off.
    assert clean_run(run) is None and run.scan_npz.read_bytes() == plain
    assert len(load_room(run).triangles) == len(scan.triangles)


def test_a_room_that_holds_an_earlier_closing_gets_no_second_one(tmp_path: Path, scan: Room) -> None:
    """As when the scene is estimated again after its results were applied."""
    run = write_run(tmp_path, scan, "none")
    write_json(run.room_json, {"objects": ["scan"], "object_ids": [CLOSING], "materials": ["scan"]})
    holes = clean_run(run, most_edges=120)
    assert holes is not None and holes.closed == 0 and holes.left > 20
    assert load_room(run).objects == ("scan",)


def test_what_closes_a_hole_has_the_part_around_it_and_is_no_lamp(tmp_path: Path, scan: Room) -> None:
    run = write_run(tmp_path, scan, "objects")
    clean_run(run, most_edges=120)
    room = load_room(run)
    parts = label_parts(room, "objects", [], [])
    assert (parts.triangle_part == 0).all()
    assert NO_PART not in parts.triangle_part and "objects" not in usable_sources(room, [])
    # Bright pixels on what closes a hole are those of what is behind it; on the ceiling they are of a lamp.
    ceiling = room.vertices[room.triangles].mean(axis=1)[:, 2] > room.vertices[:, 2].max() - 0.05
    for lamp, count in ((room.closing, 0), (ceiling & ~room.closing, 1)):
        seen = np.repeat(np.flatnonzero(lamp), 4)
        own, ones = np.full((len(seen), 3), 9.0), np.ones(len(seen))
        pixels = SimpleNamespace(triangle=seen, front=ones > 0, own=own, weight=ones)
        assert len(group_fixtures(room, lamp, pixels)) == count
