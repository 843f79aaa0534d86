"""The panel Hints by its operators: hints by click, area and answer; what the run folder gets of them."""

from __future__ import annotations

import json
from pathlib import Path

import bpy
import numpy as np
import pytest

from fipt_blender.blend.hints.exchange import scene_hints, write_for_run, write_hints_rerun
from fipt_blender.core.run.hints import light_changes, read_hints
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.panels.hints import hint_text
from samples.applied_rooms import make_applied_scene
from samples.operator_calls import refused

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def settings() -> bpy.types.PropertyGroup:
    """Of a scene with a cube of two meters at x = 5 and a floor below it."""
    bpy.ops.mesh.primitive_cube_add(size=2.0, location=(5.0, 0.0, 1.0))
    bpy.context.object.name = "Box"
    bpy.ops.mesh.primitive_plane_add(size=20.0)
    bpy.context.object.name = "Floor"
    return bpy.context.scene.fipt.hints


def add(x: float = 5.0, **options) -> set[str]:
    return bpy.ops.fipt.add_hint(origin=(x, 0.0, 9.0), direction=(0.0, 0.0, -1.0), **options)


def test_a_click_makes_a_hint_that_moves_with_its_object(settings) -> None:
    assert add() == {"FINISHED"}
    hint = settings.hint()
    assert hint.object.name == hint.name == "Box" and hint_text(hint) == "Unknown"
    hint.object.location.x += 1.0
    hint.material, hint.roughness_known, hint.roughness = "METAL", "VALUE", 0.25
    bpy.context.view_layer.update()
    (found,) = scene_hints(bpy.context.scene)
    assert found.points[0] == pytest.approx((6.0, 0.0, 2.0)) and found.material == "metal"
    assert found.roughness == pytest.approx((0.25, 0.25)) and found.emits is None and not found.area
    assert hint_text(hint) == "Metal, 0.25"


def test_hints_on_removed_objects_are_left_out(settings) -> None:
    add()
    add(0.0)
    settings.hints[1].same_object = bpy.data.objects["Box"]
    bpy.data.objects.remove(bpy.data.objects["Box"])
    (found,) = scene_hints(bpy.context.scene)
    assert found.name == "Floor" and found.same_as is None


def test_the_same_material_as_a_clicked_part(settings) -> None:
    add()
    ray = {"origin": (0.0, 0.0, 9.0), "direction": (0.0, 0.0, -1.0)}
    assert bpy.ops.fipt.pick_same_material(**ray) == {"FINISHED"}
    (found,) = scene_hints(bpy.context.scene)
    assert found.same_as == pytest.approx((0.0, 0.0, 0.0)) and hint_text(settings.hint()) == "as Floor"


def test_selected_faces_become_an_area(settings) -> None:
    box = bpy.data.objects["Box"]
    bpy.context.view_layer.objects.active = box
    assert not bpy.ops.fipt.add_area_hint.poll()
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="DESELECT")
    assert "No face is selected" in refused(bpy.ops.fipt.add_area_hint)
    assert not len(settings.hints)
    bpy.ops.mesh.select_mode(type="FACE")
    bpy.ops.mesh.select_all(action="SELECT")
    assert bpy.ops.fipt.add_area_hint() == {"FINISHED"}
    bpy.ops.object.mode_set(mode="OBJECT")
    (found,) = scene_hints(bpy.context.scene)
    points = np.array(found.points)
    assert found.area and points.shape == (12, 3)
    np.testing.assert_allclose(points.mean(axis=0), [5.0, 0.0, 1.0], atol=1e-5)


def test_a_clicked_face_set_becomes_an_area(settings) -> None:
    with pytest.raises(RuntimeError, match="no face sets"):
        add(what="FACE_SET")
    assert not len(settings.hints)
    mesh = bpy.data.objects["Box"].data
    top = [polygon.normal.z > 0.5 for polygon in mesh.polygons]
    attribute = mesh.attributes.new(".sculpt_face_set", "INT", "FACE")
    attribute.data.foreach_set("value", [2 if is_top else 1 for is_top in top])
    assert add(what="FACE_SET") == {"FINISHED"}
    (found,) = scene_hints(bpy.context.scene)
    assert len(found.points) == 2 and {round(point[2], 5) for point in found.points} == {2.0}


def test_hints_are_removed_one_by_one_or_all(settings) -> None:
    assert not bpy.ops.fipt.remove_hint.poll()
    for x in (5.0, 0.0, 5.0):
        add(x)
    assert bpy.ops.fipt.remove_hint(index=0) == {"FINISHED"}
    assert [hint.name for hint in settings.hints] == ["Floor", "Box"]
    assert "no row 7. The list has 2" in refused(bpy.ops.fipt.remove_hint, index=7)
    assert bpy.ops.fipt.remove_hint(every=True) == {"FINISHED"} and not len(settings.hints)


def test_a_hint_on_a_lamp_outlasts_the_next_results(tmp_path: Path, monkeypatch) -> None:
    scene = make_applied_scene(tmp_path / "run", monkeypatch)
    row, hints = scene.fipt.lights.lights[0], scene.fipt.hints.hints
    lamp = row.object
    triangles = [[2.5 - 1 / 6, 2 / 3, 0.0], [2.5 + 1 / 6, 1 / 3, 0.0]]
    down = {"origin": (2.5, 0.5, 9.0), "direction": (0.0, 0.0, -1.0)}
    assert bpy.ops.fipt.add_hint(**down) == {"FINISHED"}  # a click on it
    assert bpy.ops.fipt.hint_on_lamp(emission="EMITS") == {"FINISHED"}
    assert bpy.ops.fipt.hint_on_lamp(light=lamp.name, emission="NOT") == {"FINISHED"}  # instead
    assert [(hint.object.name, hint.name, hint_text(hint)) for hint in hints] == [
        ("panel", lamp.name, "Unknown"),
        ("panel", lamp.name, "Does Not Emit"),
    ]
    assert bpy.ops.fipt.apply_results() == {"FINISHED"}
    assert row.object and [hint.object.name for hint in hints] == ["panel", "panel"]
    clicked, said = scene_hints(scene)
    assert clicked.points[0] == pytest.approx((2.5, 0.5, 0.0), abs=1e-5) and said.area and said.emits is False
    np.testing.assert_allclose(sorted(said.points), triangles, atol=1e-5)


def doubts_of(run: RunFolder, *questions: str) -> None:
    entry = {"name": "Box", "text": "?", "view": "train/000", "point": [5.0, 0.0, 2.0], "pixels": 5}
    numbers = dict.fromkeys(("share", "roughness", "metallic", "roughness_error", "metallic_error"), 0.2)
    rest = {"box": [0, 0, 1, 1], "picture": "01.png"}
    doubts = [{**entry, **numbers, **rest, "question": question} for question in questions]
    run.doubts_json.parent.mkdir(parents=True, exist_ok=True)
    run.doubts_json.write_text(json.dumps({"format": "fipt-doubts", "version": 1, "doubts": doubts}))


@pytest.mark.parametrize(
    "answer, text",
    [
        ("METAL", "Metal"),
        ("DIELECTRIC", "Dielectric"),
        ("GLOSSY", "0-0.5"),
        ("MATT", "0.5-1"),
        ("EMITS", "Emits Light"),
        ("NOT", "Does Not Emit"),
        ("LEAVE", "Leave Alone"),
    ],
)
def test_an_answer_makes_a_hint(settings, run_folder: RunFolder, answer: str, text: str) -> None:
    doubts_of(run_folder, "metal", "gloss")
    bpy.context.scene.fipt.run_folder = str(run_folder.root)
    assert bpy.ops.fipt.read_doubts() == {"FINISHED"}
    assert [doubt.question for doubt in settings.doubts] == ["METAL", "GLOSS"]
    assert bpy.ops.fipt.answer_doubt(index=1, answer=answer) == {"FINISHED"}
    assert hint_text(settings.hint()) == text and settings.hint().object.name == "Box"
    assert [doubt.answered for doubt in settings.doubts] == [False, True]


def test_damaged_questions_are_refused_and_the_list_stays(settings, run_folder: RunFolder) -> None:
    doubts_of(run_folder, "metal")
    bpy.context.scene.fipt.run_folder = str(run_folder.root)
    bpy.ops.fipt.read_doubts()
    run_folder.doubts_json.write_text('{"format": "fipt-doubts", "version": 1, "doubts": [{"picture": "../x"}]}')
    assert "can't be read" in refused(bpy.ops.fipt.read_doubts)
    assert len(settings.doubts) == 1


def test_files_of_a_run_and_of_a_run_again(settings, run_folder: RunFolder) -> None:
    """A re-estimate leaves the run's own hints as they are; an estimate replaces both."""
    run_folder.root.mkdir(exist_ok=True)
    scene = bpy.context.scene
    add()
    write_for_run(scene, run_folder)
    settings.hints[0].material = "METAL"
    write_hints_rerun(scene, run_folder)
    assert read_hints(run_folder.hints_json)[0].material == "unknown"
    assert read_hints(run_folder.hints_again_json)[0].material == "metal"
    assert not light_changes(run_folder.hints_again_json)
    settings.light = True
    write_hints_rerun(scene, run_folder)
    assert light_changes(run_folder.hints_again_json) and not light_changes(run_folder.hints_json)
    settings.hints.clear()
    write_hints_rerun(scene, run_folder)
    assert run_folder.hints_again_json.exists() and read_hints(run_folder.hints_again_json) == []
    write_for_run(scene, run_folder)
    assert not run_folder.hints_json.exists() and not run_folder.hints_again_json.exists()
    write_hints_rerun(scene, run_folder)
    assert not run_folder.hints_again_json.exists()
