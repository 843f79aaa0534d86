"""Scans: telling them from modelled rooms, parts by a random walk, and segments."""

from dataclasses import replace

import numpy as np
import pytest

from fipt_blender.core.parts.labels import choose_source, room_pieces
from fipt_blender.core.parts.segments import absorb_small
from fipt_blender.core.parts.smooth_parts import Votes, smooth_labels, without_specks
from fipt_blender.core.run.run_files import PANES
from fipt_blender.core.surface.adjacency import Mesh
from fipt_blender.core.surface.scan import PLACE_NOISE
from samples.scans import scanned_box
from samples.small_rooms import BOX, make_room

STRIP = np.array([[i, i + 1, i + 2] for i in range(40)])


def strip_mesh():
    vertices = np.array([[0.5 * i, i % 2, 0.0] for i in range(42)])
    return Mesh(vertices, STRIP)


def test_triangles_that_share_an_edge_are_neighbours_but_for_an_edge_of_three() -> None:
    mesh = strip_mesh()
    pairs = {tuple(sorted(pair)) for pair in mesh.dual_edges.tolist()}
    assert pairs == {(i, i + 1) for i in range(39)}
    assert np.allclose(mesh.dual_lengths, np.hypot(0.5, 1.0))
    assert (mesh.dual_matrix(mesh.dual_lengths) - mesh.dual_matrix(mesh.dual_lengths).T).nnz == 0
    fin = Mesh(np.eye(6)[:, :3], np.array([[0, 1, 2], [0, 1, 3], [1, 0, 4], [2, 1, 5]]))
    assert {tuple(sorted(pair)) for pair in fin.dual_edges.tolist()} == {(0, 3)}


def test_scans_are_rough_and_modelled_rooms_are_not() -> None:
    """And their places are doubtful by edges and by noise, but neither a fine nor a smooth scan is far off."""
    room = scanned_box(noise=0.002)[0]
    scan = room.scan
    assert scan is not None and room.place == scan.place > 0.0
    assert replace(scan, noise=1.0).place == scan.edge
    assert replace(scan, noise=1e-5).place == pytest.approx(PLACE_NOISE * 1e-5)
    assert scanned_box(noise=0.0)[0].scan is None  # finely divided, but flat
    assert scanned_box(cells=10)[0].scan is None  # too few triangles to be a scan
    assert make_room(BOX).scan is None and make_room(BOX).place == 0.0


def test_parts_of_a_scan_follow_the_walk_of_the_votes() -> None:
    """Half of the triangles are seen, by one pixel each, which is off by a fifth of a metre."""
    room, side = scanned_box(cells=60, noise=0.003)
    assert room.scan is not None
    rng = np.random.default_rng(1)
    seen = np.flatnonzero(rng.random(len(side)) < 0.5)

    def part_at(points: np.ndarray) -> np.ndarray:
        """The floor has a rug; every other side is one part."""
        return np.where((side[seen] == 0) & (np.abs(points[:, :2]) < 1.0).all(axis=1), 9, side[seen] + 1)

    shown = part_at(room.scan.centers[seen] + rng.normal(0.0, 0.2, (len(seen), 3)))
    centers = room.scan.centers
    true = np.where((side == 0) & (np.abs(centers[:, :2]) < 1.0).all(axis=1), 9, side + 1)
    found = smooth_labels(Votes(seen, shown, np.ones(len(seen))), room.scan.mesh, room.scan.cross)
    wrong_before = np.count_nonzero(shown != true[seen])
    assert wrong_before > 0.01 * len(seen)
    assert np.count_nonzero(found[seen] != true[seen]) < 0.6 * wrong_before
    away = np.abs(np.abs(centers[:, :2]) - 1.0).min(axis=1) > 0.3
    assert (found[away] == true[away]).all()  # corners of the room included


def test_specks_join_the_part_around_them_and_small_parts_stay() -> None:
    label = np.zeros(40, np.int64)
    label[10] = 1  # a speck of the part that the end of the strip has
    label[30:] = 1
    label[20:22] = 2  # a part of its own
    kept = without_specks(label, strip_mesh(), np.where(label == 1, 2.0, 1.0))
    kept_more = without_specks(np.where(np.arange(40) == 11, 1, label), strip_mesh(), np.ones(40))
    assert kept[10] == 0 and np.array_equal(np.delete(kept, 10), np.delete(label, 10))
    assert kept_more[10] == kept_more[11] == 1  # two of twelve are more than a tenth


def test_segments_of_a_scan_are_its_planes_and_smooth_pieces() -> None:
    room, side = scanned_box(noise=0.003)
    plane = np.where(side < 2, side, -1).astype(np.int32)  # of floor and ceiling alone
    segment = room_pieces(replace(room, plane=plane))
    assert len(np.unique(segment)) == 6
    for index in range(6):
        count = np.bincount(segment[side == index])
        assert count.max() >= 0.95 * count.sum()
    assert all(len(np.unique(segment[side == index])) == 1 for index in (0, 1))
    flat, _ = scanned_box(noise=0.0)
    assert len(np.unique(room_pieces(flat))) == 1  # connected pieces, as for any modelled room


def test_objects_and_materials_of_a_scan_are_parts_only_if_asked_for() -> None:
    """A pane that was added is a second object, and the pages of a scan's texture are materials."""
    for noise, chosen in ((0.003, "none"), (0.0, "materials")):
        room, side = scanned_box(noise=noise)
        paged = (side % 2).astype(np.int32)
        room = replace(room, triangle_object=paged, triangle_material=paged, objects=("scan", PANES), parts="auto")
        assert choose_source(room, []) == chosen
        assert choose_source(replace(room, parts="objects"), []) == "objects"


def test_small_components_join_the_neighbour_with_the_longest_border() -> None:
    component = np.zeros(40, np.int64)
    component[5:7], component[7:] = 1, 2
    joined = absorb_small(component, strip_mesh(), np.ones(40), 4.0)
    assert len(np.unique(joined)) == 2 and len(np.unique(joined[5:7])) == 1
    alone = absorb_small(np.zeros(40, np.int64), strip_mesh(), np.ones(40), 100.0)
    assert not alone.any()  # without a neighbour it stays
