"""Try the Example: one click to a room with estimated materials, with the real engine at quick settings."""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy
import pytest

from fipt_blender import machine
from fipt_blender.api import estimating
from fipt_blender.bridge.places import PACKAGE_FOLDER
from fipt_blender.core.run.settings import make_settings
from fipt_blender.operators.estimate import copy_example
from samples.engine_here import engine_here, hardly_training
from samples.small_captures import QUICK, UNTRAINED

pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def data(tmp_path, monkeypatch) -> Path:
    folder = tmp_path / "data"
    monkeypatch.setattr(machine.DEFAULTS, "data_folder", str(folder))
    monkeypatch.setattr(machine.DEFAULTS, "device", "llvm")
    return folder


def test_the_example_is_copied_and_repaired(tmp_path):
    first = copy_example(tmp_path)
    (first / "scene.obj").write_text("damaged")
    shutil.rmtree(first / "val")
    again = copy_example(tmp_path)
    assert again == first
    names = {path.relative_to(PACKAGE_FOLDER / "example") for path in (PACKAGE_FOLDER / "example").rglob("*")}
    assert names == {path.relative_to(first) for path in first.rglob("*")}
    assert (first / "scene.obj").stat().st_size > 1e6


def test_one_click_estimates_the_room_in_a_scene_of_its_own(data, monkeypatch):
    changes = {**QUICK, **UNTRAINED, "light_pixels": 0.03, "view_share": 0.3, "texture_size": 256}
    changes["texel_density"] = 10.0
    monkeypatch.setattr(estimating, "scene_settings", lambda *_: make_settings("draft", changes))
    own = bpy.context.scene
    own.collection.objects.link(bpy.data.objects.new("Cube", bpy.data.meshes.new("Cube")))
    with engine_here(), hardly_training():
        assert bpy.ops.fipt.try_example() == {"FINISHED"}
    scene = bpy.data.scenes["Example Room"]
    assert [each.name for each in own.objects] == ["Cube"] and not own.fipt.run_folder
    assert len(scene.fipt.capture.views) == 22 and scene.fipt.capture.held_back_count == 2
    assert scene.fipt.materials.object_count == 42 and len(scene.fipt.lights.lights) >= 1
    with bpy.context.temp_override(scene=scene):
        assert not bpy.ops.fipt.try_example.poll()
