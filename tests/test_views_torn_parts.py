# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts that a scan tore: what completes them, by what is left of them and their masks."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.completion.panes import close_holes
from fipt_blender.core.pixels.camera_rays import trace_pixels
from fipt_blender.core.run.run_files import PANES
from fipt_blender.core.surface.room import Room, load_room
from samples.lost_things import photographed
from samples.part_views import THING_PART, looking_views, with_own_ids, write_run
from samples.scans import scanned_box
from samples.small_rooms import mesh_room

STEP, NOISE = 0.06, 0.003


def grid(rows: int, columns: int) -> np.ndarray:
    """(2 R S, 3) triangles of a grid of cells, fronts towards the right when walking up the rows."""
    corner = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    quads = np.stack([corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]], axis=-1)
    return quads.reshape(-1, 4)[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)


def shade() -> tuple[np.ndarray, np.ndarray]:
    """A cone without ends, fronts outwards, around (0.1, 0) from 0.2 to 0.8 m."""
    rows, columns = 10, 50
    angle, height = 2.0 * np.pi * np.arange(columns + 1) / columns, np.arange(rows + 1) * STEP
    radius = (0.5 - 0.3 * height)[:, None]
    places = [0.1 + radius * np.cos(angle), radius * np.sin(angle), 0.2 + height[:, None] + 0.0 * angle]
    return np.stack(places, axis=-1).reshape(-1, 3), grid(rows, columns)


def board() -> tuple[np.ndarray, np.ndarray]:
    """An upright board, fronts towards -y, one metre wide and high."""
    count = 18
    x, z = np.meshgrid(np.linspace(-0.5, 0.5, count + 1), np.linspace(0.1, 1.1, count + 1))
    return np.stack([x, 0.0 * x, z], axis=-1).reshape(-1, 3), grid(count, count)


def joined(scan: Room, vertices: np.ndarray, triangles: np.ndarray, thing: int) -> Room:
    """The scanned box with a thing in it, of the object with a number."""
    return mesh_room(
        np.concatenate([scan.vertices, vertices]),
        np.concatenate([scan.triangles, triangles + len(scan.vertices)]),
        np.repeat([0, thing], [len(scan.triangles), len(triangles)]),
        parts="masks",
    )


def in_hole(places: np.ndarray) -> np.ndarray:
    """(N,) bool, which places (N, 3) are in the hole on the front of each thing."""
    near = np.abs(places[:, [0, 2]] - [0.1, 0.5]) < 0.2
    return near.all(axis=1) & (places[:, 1] < 0.1)


@pytest.mark.parametrize(
    "thing, evidence",
    [(shade, "masks"), (board, "masks"), (shade, "own ids"), (board, "own ids"), (shade, "photographs")],
)
def test_a_hole_in_a_part_is_filled(
    tmp_path: Path, rng: np.random.Generator, thing: Callable[[], tuple[np.ndarray, np.ndarray]], evidence: str
) -> None:
    scan, _ = scanned_box(cells=60, noise=NOISE)
    vertices, triangles = thing()
    hole = in_hole(vertices[triangles].mean(axis=1))
    assert 0.05 < hole.mean() < 0.3
    noisy = vertices + rng.normal(0.0, NOISE, vertices.shape)
    parts = "none" if evidence == "photographs" else "masks"
    run = write_run(tmp_path, joined(scan, noisy, triangles[~hole], 0), parts)
    true = joined(scan, vertices, triangles, 1)
    views = photographed(tmp_path, true, rng) if parts == "none" else looking_views(tmp_path, true)
    close_holes(run, with_own_ids(views, rng) if evidence == "own ids" else views)
    room = load_room(run)
    added = room.triangle_object == 1
    assert room.objects == ("scan", PANES) and added.any()
    # Seen from its front, the hole shows the part again, where it is; nothing else is hidden.
    filled, wanted = 0, 0
    for view in views:
        now, exact = trace_pixels(room, view), trace_pixels(true, view)
        new = added[np.array(now.triangle)]
        gap = np.isin(np.array(exact.triangle), len(scan.triangles) + np.flatnonzero(hole)) & np.array(exact.front)
        close = np.abs(np.array(now.distance) - np.array(exact.distance)) < STEP
        filled, wanted = filled + (gap & new & close).sum(), wanted + gap.sum()
        assert (new & ~close).mean() < 0.01
    assert wanted > 500 and filled > 0.8 * wanted


@pytest.mark.parametrize("thing, parts", [(shade, "masks"), (board, "masks"), (shade, "none")])
def test_whole_parts_and_true_holes_stay(
    tmp_path: Path, rng: np.random.Generator, thing: Callable[[], tuple[np.ndarray, np.ndarray]], parts: str
) -> None:
    scan, _ = scanned_box(cells=60, noise=NOISE)
    vertices, triangles = thing()
    hole = in_hole(vertices[triangles].mean(axis=1))
    noisy = vertices + rng.normal(0.0, NOISE, vertices.shape)
    for name, left in (("whole", triangles), ("open", triangles[~hole])):
        folder = tmp_path / name
        folder.mkdir()
        run = write_run(folder, joined(scan, noisy, left, 0), parts)
        true = joined(scan, vertices, left, 1)
        views = photographed(folder, true, rng) if parts == "none" else looking_views(folder, true)
        assert any((view.part_ids() == THING_PART).any() for view in views)
        close_holes(run, views)
        assert load_room(run).objects == ("scan",)
