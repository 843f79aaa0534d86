"""Hints: files, surfaces, the mixture; and estimations of a tiny box that honour them and keep the rest."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.estimate import doubts
from fipt_blender.core.estimate.doubts import group_doubts, question
from fipt_blender.core.material.fields import RoomFields
from fipt_blender.core.material.hints import KnownMaterials, SurfaceHints, known_colors, nearest_triangles, place_hints
from fipt_blender.core.material.mixture import GroupMaterials, infer_materials
from fipt_blender.core.parts.labels import Parts
from fipt_blender.core.run.hints import Hint, hints_digest, read_hints, references, write_hints
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.versions import results_id
from samples.material_pixels import LEVELS, SETTINGS, synthetic
from samples.refusals import error_of
from samples.small_captures import (
    PANEL_TRIANGLES,
    UNTRAINED,
    SmallCapture,
    fixtures_of,
    panel_capture,
    run_here,
    some_views,
    stages_of,
    warnings_of,
    write_run,
)
from samples.small_rooms import BOX, make_room

FLOOR, BACK, LEFT = (0.3, 0.2, 0.0), (0.0, 2.0, 1.5), (-2.0, 0.0, 1.5)
AGAIN = ["hinted-estimate", "hinted-training"]
FEW = {**UNTRAINED, "batch_size": 128, "diffuse_spp": 8, "refine_diffuse_spp": 8, "voxel_resolution": 32}
LIGHT = ["hinted-lamps", "hinted-reflection", "hinted-refinement"]


@pytest.fixture(scope="module")
def capture() -> SmallCapture:
    return some_views(panel_capture())


@pytest.fixture(scope="module")
def finished(capture: SmallCapture, tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    run = write_run(tmp_path_factory.mktemp("finished") / "run", capture, **FEW)
    run_here(run, train=False)
    return run


def copy_of(run: RunFolder, folder: Path) -> RunFolder:
    return RunFolder(shutil.copytree(run.root, folder / "run"))


def wall_values(run: RunFolder, room) -> np.ndarray:
    """(14, 2) roughness and metallic at the center of each triangle."""
    points = room.vertices[room.triangles].mean(axis=1)
    _, roughness, metallic = RoomFields.load(run).query(points, np.arange(len(points)))
    return np.stack([roughness, metallic], axis=1)


def again(run: RunFolder, *hints: Hint, light: bool = False) -> list[dict]:
    write_hints(run.hints_again_json, hints, light)
    return run_here(run, train=False)


def test_hints_are_honoured_again_and_reuse_all_stages(
    finished: RunFolder, capture: SmallCapture, tmp_path: Path
) -> None:
    run = copy_of(finished, tmp_path)
    before = wall_values(run, capture.room)
    metal = Hint((FLOOR,), "Floor", material="metal", roughness=(0.35, 0.35))
    messages = again(run, metal, Hint((BACK,), "Back", same_as=LEFT))
    assert stages_of(messages) == AGAIN and warnings_of(messages) == []
    after = wall_values(run, capture.room)
    np.testing.assert_allclose(after[:2], [[0.35, 1.0]] * 2, atol=1e-6)
    np.testing.assert_array_equal(after[4], after[6])  # back and left are of one material
    # The front and right walls, of which nothing was said, are diffuse as before.
    np.testing.assert_allclose(after[8:12], before[8:12], atol=0.05)
    facts = json.loads(run.statistics_json.read_text())["hints"]
    assert facts[0]["name"] == "Floor" and facts[0]["roughness"] == 0.35 and facts[0]["metallic"] == 1.0
    # The same hints once more: nothing is left to do. Other hints: only the last stages.
    assert stages_of(run_here(run, train=False)) == []
    assert stages_of(again(run, Hint((FLOOR,), material="dielectric"))) == AGAIN
    assert wall_values(run, capture.room)[:2, 1].max() == 0.0
    # Without any, the run's own results come back.
    run.hints_again_json.unlink()
    assert stages_of(run_here(run, train=False)) == []
    np.testing.assert_array_equal(wall_values(run, capture.room), before)


def test_what_a_hint_says_is_not_asked_again(
    finished: RunFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However wide the range that an answer leaves."""
    run = copy_of(finished, tmp_path)
    monkeypatch.setattr(doubts, "MIN_DOUBT", 1e-6)  # ask about each wall
    run_here(run, train=False)
    before = results_id(run)
    asked = json.loads(run.doubts_json.read_text())["doubts"]
    gloss = next(doubt for doubt in asked if doubt["question"] == "gloss")
    again(run, Hint((tuple(gloss["point"]),), gloss["name"], roughness=(0.0, 0.9)))
    left = json.loads(run.doubts_json.read_text())["doubts"]
    assert (gloss["name"], "gloss") not in {(doubt["name"], doubt["question"]) for doubt in left}
    assert results_id(run) != before


def test_lamps_and_left_alone(finished: RunFolder, capture: SmallCapture, tmp_path: Path) -> None:
    run = copy_of(finished, tmp_path)
    panel = Hint(((0.0, 0.0, 2.9),), "Panel", emits=False)
    messages = again(run, panel, Hint((LEFT,), "Left", emits=True), Hint((FLOOR,), "Floor", leave_alone=True))
    assert warnings_of(messages).count("hints-lamps") == 1
    fixtures = fixtures_of(run)
    lamps = {triangle for fixture in fixtures for triangle in fixture["triangles"]}
    assert not lamps & {*PANEL_TRIANGLES, 0, 1} and {6, 7} <= lamps
    with np.load(run.left_alone_npz) as file:
        assert np.flatnonzero(file["left_alone"]).tolist() == [0, 1]
    again(run, panel)
    assert not run.left_alone_npz.exists()


def test_the_light_changes_with_the_lamps(finished: RunFolder, capture: SmallCapture, tmp_path: Path) -> None:
    """The light is that of an estimate with the hints from its beginning; what other hints need is kept."""
    run = copy_of(finished, tmp_path)
    before = (run.stage / "refinement-1" / "diffuse.npy").read_bytes()
    panel = Hint(((0.0, 0.0, 2.9),), "Panel", emits=False)
    messages = again(run, panel, light=True)
    assert stages_of(messages) == LIGHT + AGAIN and "hints-lamps" not in warnings_of(messages)
    assert fixtures_of(run) == []
    whole = write_run(tmp_path / "whole", capture, **FEW)
    write_hints(whole.hints_json, [panel])
    run_here(whole, train=False)
    folders = [run.stage / "refinement-1", run.stage / "hinted-refinement", whole.stage / "refinement-1"]
    old, new, wanted = (np.load(folder / "diffuse.npy").astype(float) for folder in folders)
    assert np.abs(new - wanted).mean() < 0.2 * np.abs(old - wanted).mean()
    assert (run.stage / "refinement-1" / "diffuse.npy").read_bytes() == before
    assert stages_of(run_here(run, train=False)) == []
    assert stages_of(again(run, panel)) == AGAIN
    assert not (run.stage / "hinted-refinement").exists()


def test_an_area_becomes_a_part_of_its_own(finished: RunFolder, capture: SmallCapture, tmp_path: Path) -> None:
    run = copy_of(finished, tmp_path)
    room = capture.room
    center = tuple(room.vertices[room.triangles[0]].mean(axis=0).tolist())
    area = Hint((center,), "Rug", area=True, material="metal", roughness=(0.2, 0.3))
    floor = [Hint(((-x, x, 0.0),), f"Floor {x}", roughness=(0.9, 1.0)) for x in (0.5, 0.6)]
    messages = again(run, area, *floor)
    (text,) = [message["text"] for message in messages if message.get("code") == "hints-unclear"]
    assert "'Floor 0.5' is on the same part as 'Floor 0.6'" in text
    values = wall_values(run, capture.room)
    assert values[0, 1] == 1.0 and 0.2 <= values[0, 0] <= 0.3
    assert values[1, 1] < 0.5 and 0.9 <= values[1, 0] <= 1.0
    with np.load(run.parts_npz) as parts:
        assert parts["triangle_part"][0] == parts["triangle_part"].max() != parts["triangle_part"][1]
    listed = json.loads(run.parts_json.read_text())["parts"]
    assert (listed[-1]["name"], listed[-1]["key"]) == ("Rug", "area:Rug")
    assert not any(part["key"].startswith("area:") for part in listed[:-1])


def test_a_run_with_hints_without_parts(capture: SmallCapture, tmp_path: Path) -> None:
    """The piece of the mesh at a hint becomes a part of its own; an empty file of later hints lifts them."""
    run = write_run(tmp_path / "run", capture, **FEW)
    names = json.loads(run.room_json.read_text())
    run.room_json.write_text(json.dumps({**names, "parts": "none"}))
    write_hints(run.hints_json, [Hint(((0.0, 0.0, 2.9),), "Panel", emits=False, material="metal")])
    run_here(run, train=False)
    assert fixtures_of(run) == []
    values = wall_values(run, capture.room)
    assert (values[PANEL_TRIANGLES, 1] == 1.0).all() and (values[:12, 1] < 1.0).all()
    # A name does not matter.
    write_hints(run.hints_json, [Hint(((0.0, 0.0, 2.9),), "Other", emits=False, material="metal")])
    assert stages_of(run_here(run, train=False)) == []
    messages = again(run)
    assert stages_of(messages) == AGAIN
    (fixture,) = fixtures_of(run)
    assert fixture["triangles"] == PANEL_TRIANGLES


ROOM = make_room(BOX, parts="objects", objects=np.arange(6))
WALL = np.repeat(np.arange(6), 2).astype(np.int32)
CEILING = (0.3, 0.2, 3.0)
METAL, GLOSSY = (float(LEVELS[3]), 1.0), (float(LEVELS[4]), 0.0)


def placed(*hints: Hint, parts: bool = True) -> SurfaceHints:
    found = Parts(WALL if parts else np.full(12, -1, np.int32), "part" if parts else "none")
    return place_hints(hints, ROOM.vertices, ROOM.triangles, found, WALL)


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
        Hint((FLOOR,), "Card", base_color=(0.18, 0.18, 0.18)),
    ]
    write_hints(path, hints)
    assert read_hints(path) == hints
    assert hints_digest([]) == "" and hints_digest(hints) != hints_digest(hints[:1])


def test_light_depends_on_known_base_colors_alone() -> None:
    card, plain = Hint((FLOOR,), "Card", base_color=(0.2, 0.2, 0.1)), Hint((CEILING,), "Panel", emits=True)
    assert references([plain]) == []
    assert references([plain, card]) == references([replace(card, name="Other", material="metal")])
    known = known_colors([card, plain], ROOM.vertices, ROOM.triangles, Parts(WALL, "part"), WALL)
    assert known[:2].tolist() == [[0.2, 0.2, 0.1]] * 2 and np.isnan(known[2:]).all()
    assert np.isnan(known_colors([], ROOM.vertices, ROOM.triangles, Parts(WALL, "part"), WALL)).all()


@pytest.mark.parametrize(
    "change",
    [
        *({"points": points} for points in ([], [[0.0, 1.0]], [[0.0, 1.0, None]])),
        *({"roughness": bounds} for bounds in ([0.5, 0.2], [-0.1, 0.2], [0.5])),
        *({"material": "glass"}, {"emits": "yes"}, {"same_as": [0.0]}, {"leave_alone": 1}, {"name": 7}),
        *({"base_color": value} for value in ([0.5, 0.5], [0.0, 0.5, 0.5], [0.5, 0.5, 1.5])),
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
