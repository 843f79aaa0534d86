# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Things that a scan lost, found from photographs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.views import View
from fipt_blender.core.checks.agreement import compared_pixels
from fipt_blender.core.completion import panes
from fipt_blender.core.completion.lost_surfaces import lost_surfaces
from fipt_blender.core.completion.panes import close_holes
from fipt_blender.core.completion.prism import prism
from fipt_blender.core.parts.masked_views import masked_views
from fipt_blender.core.run.run_files import PANES
from fipt_blender.core.surface.adjacency import Surface
from fipt_blender.core.surface.room import Room, load_room
from samples.lost_things import HIGH, LOW, photographed, with_box
from samples.part_views import write_run
from samples.scans import scanned_box
from samples.small_rooms import mesh_room

EDGE = 0.05  # metres between vertices of the scan


def found(scan: Room, views: list[View]) -> list[Surface]:
    return lost_surfaces(scan, compared_pixels(scan, views, EDGE))[0]


@pytest.mark.parametrize("parts", ["none", "masks"])
def test_a_lost_box_is_put_back(tmp_path: Path, rng: np.random.Generator, parts: str) -> None:
    scan, _ = scanned_box(cells=60, noise=0.003)
    run = write_run(tmp_path, scan, parts)
    views = photographed(tmp_path, with_box(scan), rng)
    close_holes(run, views)
    room = load_room(run)
    added = room.vertices[room.triangles[room.triangle_object == 1].reshape(-1)]
    assert room.objects == ("scan", PANES)
    # To a cell or two, which are as wide as a pixel.
    assert np.abs(added.min(axis=0) - LOW).max() < 0.1 and np.abs(added.max(axis=0) - HIGH).max() < 0.1
    # Once more: the room has it.
    written = run.panes_npz.read_bytes()
    close_holes(run, views)
    assert run.panes_npz.read_bytes() == written


def test_a_scan_that_lacks_nothing_is_searched_once(
    tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    scan, _ = scanned_box(cells=60, noise=0.003)
    run = write_run(tmp_path, scan, "masks")
    views = photographed(tmp_path, scan, rng)
    close_holes(run, views)
    searched = []
    monkeypatch.setattr(panes, "masked_views", lambda *given: searched.append(given) or masked_views(*given))
    close_holes(run, views)
    assert not searched and load_room(run).objects == ("scan",)
    close_holes(run, photographed(tmp_path, with_box(scan), rng))  # other masks
    assert searched and load_room(run).objects == ("scan", PANES)


@pytest.mark.parametrize("glossy", [0.0, 0.5])
def test_nothing_is_found_where_nothing_is_lost(tmp_path: Path, rng: np.random.Generator, glossy: float) -> None:
    scan, _ = scanned_box(cells=60, noise=0.003)
    assert found(scan, photographed(tmp_path, scan, rng, glossy)) == []


def test_a_thing_that_the_scanner_looked_into_is_not_closed(tmp_path: Path, rng: np.random.Generator) -> None:
    scan, _ = scanned_box(cells=60, noise=0.003)
    views = photographed(tmp_path, with_box(scan), rng)
    assert found(scan, views)
    inner, _ = scanned_box(cells=12)
    size = 0.5 * (HIGH - LOW) / np.ptp(inner.vertices, axis=0)
    vertices = 0.5 * (LOW + HIGH) + size * (inner.vertices - inner.vertices.mean(axis=0))
    both = mesh_room(
        np.concatenate([scan.vertices, vertices]),
        np.concatenate([scan.triangles, inner.triangles + len(scan.vertices)]),
        np.zeros(len(scan.triangles) + len(inner.triangles)),
    )
    assert found(both, views) == []


def test_masked_pixels_tell_nothing(tmp_path: Path, rng: np.random.Generator) -> None:
    scan, _ = scanned_box(cells=60, noise=0.003)
    views = photographed(tmp_path, with_box(scan), rng)
    masked = []
    for view in views:
        mask = tmp_path / f"mask_{view.name}.exr"
        write_exr(mask, (view.part_ids() == 1).astype(np.float32))
        masked.append(replace(view, mask=mask))
    assert found(scan, views)
    assert found(scan, masked) == []


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
