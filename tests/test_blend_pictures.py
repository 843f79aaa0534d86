# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders for comparisons depend on the room, not on the artist's render settings or the names of folders."""

from __future__ import annotations

import os
import random
from contextlib import suppress
from pathlib import Path

import bpy
import numpy as np
import pytest

from fipt_blender.blend.pictures import cycles, image_files, orders, renders
from fipt_blender.blend.pictures.cycles import RenderOptions
from fipt_blender.blend.save import save_blend
from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.jobs.options import MainJobOptions
from fipt_blender.jobs.room_steps import RoomSteps
from samples.at_once import export_room
from samples.rendered_rooms import VIEW, make_scene, photograph

pytestmark = pytest.mark.usefixtures("registered")

OPTIONS = RenderOptions(2, seed=3, denoise=False)
# What a room is made of, or which machine renders; names and paths of other files.
NO_SETTING = {"name", "device", "feature_set", "shading_system", "dicing_rate", "max_subdivisions"}


def render(folder: Path) -> np.ndarray:
    path = folder / "render.exr"
    renders.render_view(bpy.context.scene, VIEW, path, OPTIONS)
    return image_files.read_pixels(path)


def lit_room(folder: Path) -> bpy.types.Scene:
    """A room with a bright, shiny floor, a sky, and a second view layer that is not rendered."""
    make_scene(folder)
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("Sky")
    floor = bpy.data.objects["Floor"].data.materials[0]
    floor.metallic = 1.0
    scene.view_layers.new("Other").use = False
    return scene


def other_values(owner: bpy.types.bpy_struct) -> dict[str, list]:
    """Other values than the present one for each setting of an owner."""
    found: dict[str, list] = {}
    for each in owner.bl_rna.properties:
        name = each.identifier
        if each.is_readonly or name in NO_SETTING or getattr(each, "is_array", False):
            continue
        value = getattr(owner, name)
        if each.type == "BOOLEAN":
            found[name] = [not value]
        elif each.type in ("INT", "FLOAT"):
            low, high = max(each.hard_min, -100.0), min(each.hard_max, 100.0)
            values = (min(max(other, low), high) for other in (value * 2 + 1, value / 2, low, high))
            found[name] = [int(other) if each.type == "INT" else other for other in values]
        elif each.type == "ENUM":
            found[name] = [item.identifier for item in each.enum_items if item.identifier not in ("GPU", value)]
    return found


def changed_to(owner: bpy.types.bpy_struct, name: str, value: object) -> bool:
    """Set a value; whether it differs from the one before."""
    before = getattr(owner, name)
    with suppress(TypeError):  # a format or device that this Blender lacks
        setattr(owner, name, value)
    return getattr(owner, name) != before


def owners(scene: bpy.types.Scene) -> dict[str, list[bpy.types.bpy_struct]]:
    layer = scene.view_layers[0]
    return {
        "cycles": [scene.cycles],
        "render": [scene.render],
        "image": [scene.render.image_settings, scene.view_settings, scene.display_settings],
        "layer": [layer, layer.cycles],
    }


@pytest.mark.parametrize("variant", range(4))
@pytest.mark.parametrize("group", ["cycles", "render", "image", "layer"])
def test_no_setting_of_the_artist_changes_the_picture(tmp_path, group, variant):
    """All settings of a group have another value at once."""
    scene = lit_room(tmp_path)
    expected = render(tmp_path)
    assert expected.mean() > 0.01
    changes = []
    for owner in owners(scene)[group]:
        for name, values in other_values(owner).items():
            if values and changed_to(owner, name, values[variant % len(values)]):
                changes.append((owner, name, getattr(owner, name)))
    assert len(changes) > (3 if group == "image" else 10)
    same = np.allclose(render(tmp_path), expected, rtol=1e-4, atol=1e-6)
    assert [getattr(owner, name) for owner, name, *_ in changes] == [value for *_, value in changes]
    assert same, changes


def test_other_view_layers_and_overrides_are_not_rendered(tmp_path):
    scene = lit_room(tmp_path)
    expected = render(tmp_path)
    black = bpy.data.materials.new("Black")
    for layer in scene.view_layers:
        layer.use = True
        layer.material_override = black
        for child in layer.layer_collection.children:
            child.holdout = child.indirect_only = True
    np.testing.assert_array_equal(render(tmp_path), expected)
    assert all(layer.use and layer.material_override == black for layer in scene.view_layers)


def folder_names() -> list[str]:
    """Names with what Blender's paths, its templates, formats of numbers and shells give a meaning."""
    draw = random.Random(7)
    signs = ["{", "}", "{client}", "{{", "#", "####", "%04d", "$HOME", "~", "é", "é", "部屋", " ", ".", "&", ";", "'"]
    made = ["".join(draw.choices([*signs, "room", "1"], k=5)).strip("/") for _ in range(4)]
    return ["{client} room", "{blend_name}", "a}b", "shot.####", "100 %", *made]


@pytest.mark.skipif(os.name != "posix", reason="two slashes are a server's name there")
def test_two_slashes_are_not_the_folder_of_the_blend_file(tmp_path):
    for name in ("run", "a b/{run}", "x//run"):
        run = RunFolder(f"/{tmp_path}/{name}")
        run.renders.mkdir(parents=True)
        write_exr(run.renders / "a.exr", np.ones((2, 3, 3), np.float32))
        assert image_files.read_pixels(run.renders / "a.exr").shape == (2, 3, 3)
        assert (tmp_path / name / "renders" / "a.exr").exists()


@pytest.mark.parametrize("name", folder_names())
def test_the_name_of_a_folder_stops_no_step(tmp_path, name, monkeypatch):
    monkeypatch.setattr(cycles, "can_denoise", lambda: False)
    folder = tmp_path / name
    run = make_scene(folder)
    photo = photograph(run, 4)
    scene = bpy.context.scene
    export_room([bpy.data.objects["Floor"], bpy.data.objects["Wall"]], run)
    list(RoomSteps(MainJobOptions(capture=folder, output=run.root, render_spp=4), run).rerender())
    (entry,) = read_document(run.renders_json, dict)["renders"]
    render = image_files.read_pixels(run.resolve(entry["image"]))
    assert render.mean() == pytest.approx(photo.mean(), rel=0.2)
    save_blend(run.root / "room.blend")
    scene.cycles.samples = 2
    order = orders.order_picture(scene, run, scene.camera, True)
    orders.carry_out(order)
    assert image_files.read_pixels(orders.last_picture(run)).shape == photo.shape
    bpy.ops.wm.open_mainfile(filepath=str(run.root / "room.blend"))
    assert sorted(path.name for path in folder.iterdir()) == ["run"]
    assert not [path for path in tmp_path.iterdir() if path != folder]
