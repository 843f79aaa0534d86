# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Hints in estimations of a tiny box: honoured by every stage, again in seconds, and nothing else changes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.estimate import doubts
from fipt_blender.core.material.fields import RoomFields
from fipt_blender.core.run.hints import Hint, write_hints
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.versions import can_continue, list_versions, present_version
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

pytestmark = pytest.mark.usefixtures("one_thread")

FLOOR, BACK, LEFT = (0.3, 0.2, 0.0), (0.0, 2.0, 1.5), (-2.0, 0.0, 1.5)
AGAIN = ["hinted-estimate", "hinted-training"]
LIGHT = ["hinted-lamps", "hinted-reflection", "hinted-refinement"]


@pytest.fixture(scope="module")
def capture() -> SmallCapture:
    return some_views(panel_capture())


@pytest.fixture(scope="module")
def finished(capture: SmallCapture, tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    run = write_run(tmp_path_factory.mktemp("finished") / "run", capture, **UNTRAINED)
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
    """However wide the range that an answer leaves. The results before stay as a version."""
    run = copy_of(finished, tmp_path)
    monkeypatch.setattr(doubts, "LEAST_DOUBT", 1e-6)  # ask about each wall
    run_here(run, train=False)
    before = present_version(run)
    asked = json.loads(run.doubts_json.read_text())["doubts"]
    gloss = next(doubt for doubt in asked if doubt["question"] == "gloss")
    again(run, Hint((tuple(gloss["point"]),), gloss["name"], roughness=(0.0, 0.9)))
    left = json.loads(run.doubts_json.read_text())["doubts"]
    assert (gloss["name"], "gloss") not in {(doubt["name"], doubt["question"]) for doubt in left}
    newest, oldest = list_versions(run)
    assert oldest.id == before and newest.hints == (gloss["name"],) and can_continue(run)


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
    whole = write_run(tmp_path / "whole", capture, **UNTRAINED)
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
    run = write_run(tmp_path / "run", capture, **UNTRAINED)
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
