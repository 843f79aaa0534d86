# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Hints: what a file may hold, which surfaces they are about, and what they change in the mixture."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.estimate.doubts import group_doubts, question
from fipt_blender.core.material.hints import KnownMaterials, SurfaceHints, nearest_triangles, place_hints
from fipt_blender.core.material.likelihood import make_candidates
from fipt_blender.core.material.mixture import GroupMaterials, infer_materials
from fipt_blender.core.parts.labels import Parts
from fipt_blender.core.run.hints import Hint, hints_digest, read_hints, write_hints
from samples.material_pixels import LEVELS, SETTINGS, synthetic
from samples.refusals import error_of
from samples.small_rooms import BOX, make_room

ROOM = make_room(BOX, parts="objects", objects=np.arange(6))
WALL = np.repeat(np.arange(6), 2).astype(np.int32)
FLOOR, CEILING = (0.3, 0.2, 0.0), (0.3, 0.2, 3.0)
METAL, GLOSSY = (float(LEVELS[3]), 1.0), (float(LEVELS[4]), 0.0)


def placed(*hints: Hint, parts: bool = True) -> SurfaceHints:
    found = Parts(WALL if parts else np.full(12, -1, np.int32), "part" if parts else "none")
    return place_hints(hints, ROOM.vertices, ROOM.triangles, found, None if parts else WALL)


def infer(known: KnownMaterials | None) -> GroupMaterials:
    """Of a metal, a glossy and a diffuse group with little noise."""
    samples, _ = synthetic(np.random.default_rng(3), [METAL, GLOSSY, (1.0, 0.0)], 0.02, 0.0)
    return infer_materials(samples, 3, samples.cell, SETTINGS, known=known)


def known_of(**group: tuple[float, float]) -> KnownMaterials:
    """Three groups; of the first the roughness or metallic is known."""
    known = KnownMaterials.none(3)
    for name, bounds in group.items():
        getattr(known, name)[0] = bounds
    return known


def test_without_hints_the_mixture_stays_as_it_is() -> None:
    for one, other in zip(vars(infer(None)).values(), vars(infer(KnownMaterials.none(3))).values(), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "bounds"),
    [
        *(("metallic", bounds) for bounds in ((0.0, 0.0), (1.0, 1.0))),
        *(("roughness", bounds) for bounds in ((0.4, 0.4), (0.5, 0.7), (0.61, 0.62), (0.0, 0.0), (1.0, 1.0))),
    ],
)
def test_what_is_known_of_a_group_holds_and_the_others_stay(name: str, bounds: tuple[float, float]) -> None:
    before, after = infer(None), infer(known_of(**{name: bounds}))
    of, (low, high) = ("roughness", "metallic").index(name), np.float32(bounds)
    assert low <= after.mean[0, of] <= high and after.error[0, of] <= (high - low) * 0.29
    np.testing.assert_allclose(after.mean[1:], before.mean[1:], atol=0.02)


def test_groups_of_one_material_share_it() -> None:
    """What the pixels of both say together, and the ranges of both."""
    known = KnownMaterials.none(3)
    known.same[:] = [0, 0, 2]
    found = infer(known)
    assert (found.mean[0] == found.mean[1]).all() and found.error[0, 0] == found.error[1, 0]
    assert found.mean[2, 0] == pytest.approx(1.0, abs=0.02)


def test_what_is_known_leaves_a_candidate_in_any_case() -> None:
    candidates = make_candidates(LEVELS)
    known = KnownMaterials(
        np.array([[0.301, 0.302], [0.0, 0.001], [1.0, 1.0]]), np.tile([1.0, 1.0], (3, 1)), np.arange(3)
    )
    allowed = known.allows(candidates.roughness, candidates.metallic)
    assert (allowed.sum(axis=0) >= 1).all() and not allowed[candidates.metallic == 0.0].any()
    chosen = candidates.roughness[allowed[:, 0]]
    assert chosen.min() < 0.301 and chosen.max() > 0.302 and len(chosen) == 2


def test_a_group_without_pixels_takes_what_is_known() -> None:
    known = KnownMaterials.none(4)
    known.roughness[3], known.metallic[3] = (0.2, 0.3), (1.0, 1.0)
    samples, _ = synthetic(np.random.default_rng(3), [METAL, GLOSSY, (1.0, 0.0)], 0.02, 0.0)
    found = infer_materials(samples, 4, samples.cell, SETTINGS, known=known)
    assert found.mean[3, 1] == 1.0 and 0.2 <= found.mean[3, 0] <= 0.3


def test_a_hint_is_about_the_part_at_its_point_or_its_piece_where_no_parts_are_known() -> None:
    hints = placed(Hint((FLOOR,), material="metal"), Hint((CEILING,), emits=True))
    assert hints.triangle.tolist() == [0, 0, 1, 1, *[-1] * 8] and not hints.own.any()
    assert hints.of_triangles(hints.emits).tolist() == [0, 0, 1, 1, *[0] * 8]
    assert hints.about_material.tolist() == [True, False] and hints.problems == ()
    hints = placed(Hint((FLOOR,)), parts=False)
    assert hints.triangle.tolist() == [0, 0, *[-1] * 10] and hints.own.all()
    assert hints.split(np.zeros(12, np.int32), 7).tolist() == [7, 7, *[0] * 10]


def test_an_area_takes_its_triangles_from_the_part() -> None:
    """Whichever hint comes first; with points that are a little off, too."""
    center = ROOM.vertices[ROOM.triangles[0]].mean(axis=0) + [0.01, 0.0, 0.01]
    area = Hint((tuple(center.tolist()),), "Rug", area=True)
    part = Hint(((-0.5, 0.5, 0.0),), "Floor", roughness=(0.5, 0.5))
    for order in ((area, part), (part, area)):
        hints = placed(*order)
        assert [hints.names[index] for index in hints.triangle[:2]] == ["Rug", "Floor"]
        parts = hints.split_parts(Parts(WALL, "part")).triangle_part
        assert parts[0] == 6 and (parts[1:] == WALL[1:]).all()


def test_the_same_material_as_a_part_without_a_hint() -> None:
    hints = placed(Hint((FLOOR,), "Floor", material="metal", same_as=CEILING))
    assert hints.triangle[:4].tolist() == [0, 0, 1, 1] and hints.same.tolist() == [0, 0]
    known = hints.known(np.array([0, 1]), 6)
    assert known.same.tolist() == [0, 0, 2, 3, 4, 5]
    assert known.metallic[:2].tolist() == [[1.0, 1.0]] * 2  # what is known of one holds for the other


@pytest.mark.parametrize(
    "hints, problem",
    [
        ([Hint((FLOOR,), "A"), Hint((FLOOR,), "B")], "'A' is on the same part as 'B'"),
        (
            [Hint((FLOOR,), "A", material="metal", same_as=CEILING), Hint((CEILING,), "B", material="dielectric")],
            "no common material",
        ),
        ([Hint(((0.6, -0.6, 0.0),), "A", area=True), Hint(((0.6, -0.6, 0.0),), "B")], "'B' lies in the area 'A'"),
    ],
)
def test_hints_that_contradict_each_other_are_named(hints: list[Hint], problem: str) -> None:
    assert any(problem in text for text in placed(*hints).problems)


def test_the_nearest_triangle_is_not_that_of_the_nearest_center() -> None:
    """A point on a large triangle, beside a small one."""
    small = np.array([[0.0, 0.0, 0.2], [0.1, 0.0, 0.2], [0.0, 0.1, 0.2]])
    large = np.array([[-10.0, -10.0, 0.0], [10.0, -10.0, 0.0], [0.0, 20.0, 0.0]])
    assert nearest_triangles(np.array([[0.02, 0.02, 0.05]]), np.stack([small, large])).tolist() == [1]


def test_files_of_hints_come_back(tmp_path: Path) -> None:
    path = tmp_path / "hints.json"
    assert read_hints(path) == []
    hints = [
        Hint((FLOOR, CEILING), "Area", True, "metal", (0.1, 0.2), False, CEILING, False),
        Hint((FLOOR,), "Plant", leave_alone=True),
    ]
    write_hints(path, hints)
    assert read_hints(path) == hints
    assert hints_digest([]) == "" and hints_digest(hints) != hints_digest(hints[:1])


@pytest.mark.parametrize(
    "change",
    [
        *({"points": points} for points in ([], [[0.0, 1.0]], [[0.0, 1.0, None]])),
        *({"roughness": bounds} for bounds in ([0.5, 0.2], [-0.1, 0.2], [0.5])),
        *({"material": "glass"}, {"emits": "yes"}, {"same_as": [0.0]}, {"leave_alone": 1}, {"name": 7}),
    ],
)
def test_bad_files_are_refused(tmp_path: Path, change: dict) -> None:
    path = tmp_path / "hints.json"
    entry = {"points": [[0.0, 0.0, 0.0]], **change}
    path.write_text(json.dumps({"format": "fipt-hints", "version": 1, "hints": [entry]}))
    assert error_of(read_hints, path).code in ("file-damaged", "hints-invalid")


def test_doubts_are_ordered_by_what_a_hint_is_worth() -> None:
    """Large and unclear parts first; clear, small and bright ones not at all."""
    errors = np.array([[0.3, 0.0], [0.3, 0.0], [0.02, 0.0], [0.3, 0.4], [0.0, 0.0]])
    pixels = np.array([1000, 5000, 90_000, 10_000, 10_000])
    emits, doubt = np.array([[0.0, 0.0, 0.0, 1.0, 0.5], [0.0, 0.0, 0.0, 0.0, 0.25]])
    doubts = group_doubts(errors, pixels, emits, doubt)
    assert np.argsort(-doubts.score)[:3].tolist() == [4, 1, 0] and doubts.score[2] == doubts.score[3] == 0.0
    answered = group_doubts(errors, pixels, emits, np.zeros(5))
    assert answered.score[4] == 0.0


def test_questions_are_about_what_is_unclear() -> None:
    assert question(0.5, np.array([0.1, 0.4]), 0.05, False) == ("metal", "Dark metal or plastic?")
    assert question(0.5, np.array([0.1, 0.4]), 0.6, False)[0] == "metal"
    assert question(0.01, np.array([0.3, 0.02]), 0.6, False)[0] == "gloss"
    assert question(0.0, np.array([0.0, 0.0]), 0.9, True)[0] == "lamp"
