# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands behind inserted objects, composites into photographs, and views checked against them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import webbrowser

import bpy
import numpy as np
import pytest
from insert_samples import SIZE, VIEW, make_scene, photograph

from fipt_blender.blend import backdrop, composite, light_state, pictures, render_job, renders, view_check
from fipt_blender.core.job.messages import parse_message
from fipt_blender.core.job.runfolder import read_json, write_json
from fipt_blender.core.report.comparison import ERROR_STOPS, psnr
from fipt_blender.properties.check import ERROR_SCALE
from fipt_blender.properties.lights import STOPS

ROOM = {"Floor", "Wall"}


pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def run(tmp_path):
    return make_scene(tmp_path)


def layers(shape=(6, 8), alpha=0.0):
    rng = np.random.default_rng(1)
    photo, empty = rng.random((2, *shape, 3)).astype(np.float32) + 0.1
    return composite.Layers(photo, empty.copy(), empty, np.full((*shape, 4), alpha, np.float32))


def ball(x=0.0, y=0.6, kind="GREY_BALL"):
    assert bpy.ops.fipt.insert_object(kind=kind, location=(x, y, 0.0), scale=1.5) == {"FINISHED"}


def test_without_any_change_the_composite_is_the_photograph():
    image = layers()
    np.testing.assert_array_equal(composite.compose(image), image.photograph)


def test_with_a_perfect_estimate_it_is_the_render():
    image = layers()
    smooth = np.linspace(0.5, 1.5, 8)[None, :, None] * image.empty  # shading over a texture
    perfect = composite.Layers(image.empty, smooth.astype(np.float32), image.empty, image.added)
    np.testing.assert_allclose(composite.compose(perfect), smooth, rtol=0.02)


def test_shadows_multiply_light_adds_and_the_object_covers():
    grey = np.full((5, 5, 3), 0.4, np.float32)
    nothing = np.zeros((5, 5, 4), np.float32)
    shadow = composite.compose(composite.Layers(0.5 * grey, 0.25 * grey, grey, nothing))
    np.testing.assert_allclose(shadow, 0.125 * grey, rtol=1e-5)  # never below zero
    light = composite.compose(composite.Layers(0.5 * grey, 1.5 * grey, grey, nothing))
    np.testing.assert_allclose(light, grey, rtol=1e-5)
    object_ = np.concatenate([3.0 * grey, np.ones((5, 5, 1), np.float32)], axis=-1)
    cover = composite.compose(composite.Layers(grey, 3.0 * grey, grey, object_))
    np.testing.assert_allclose(cover, 3.0 * grey, rtol=1e-5)


def test_half_covered_pixels_mix_object_and_photograph():
    photo, empty = np.full((3, 3, 3), 0.2, np.float32), np.full((3, 3, 3), 0.6, np.float32)
    half = np.full((3, 3, 4), 0.5, np.float32)  # colour 1, half covering
    full = 0.5 + 0.5 * empty
    np.testing.assert_allclose(composite.compose(composite.Layers(photo, full, empty, half)), 0.6, atol=1e-5)


def test_single_noisy_pixels_and_what_nobody_sees_leave_the_photograph():
    image = layers((9, 9))
    full = image.empty.copy()
    full[4, 4] += 50.0
    full[1, 1] *= 1.002
    noisy = composite.Layers(image.photograph, full, image.empty, image.added)
    np.testing.assert_array_equal(composite.compose(noisy), image.photograph)


def test_without_an_object_the_rendered_composite_is_the_photograph(run):
    photo = photograph(run, 16)
    assert bpy.ops.fipt.render_composite(backdrop="PHOTOGRAPH", samples=4) == {"FINISHED"}
    path = run.renders / "composite" / "val_000.exr"
    np.testing.assert_array_equal(renders.read_pixels(path), photo)
    assert bpy.context.scene.fipt.insert.picture == str(path) and path.with_suffix(".png").exists()
    (entry,) = read_json(run.renders_json)["renders"]
    assert entry == {"kind": "composite", "view": VIEW, "image": "renders/composite/val_000.exr"}


def test_an_object_changes_what_is_near_it_and_leaves_the_rest(run):
    photo = photograph(run)
    ball()
    scene = bpy.context.scene
    before = state(scene)
    assert bpy.ops.fipt.render_composite(backdrop="PHOTOGRAPH", samples=64) == {"FINISHED"}
    assert state(scene) == before
    result = renders.read_pixels(run.renders / "composite" / "val_000.exr")
    # The ball stands in the middle column; its shadow falls around its foot.
    far = np.ones(SIZE[::-1], bool)
    far[:, 9:23] = False
    assert psnr(result[far], photo[far]) > 40.0
    assert np.abs(result - photo)[6:14, 12:20].max() > 0.05
    assert np.isfinite(result).all() and result.min() >= 0.0


def state(scene):
    """What renders must leave as it was."""
    items = [(o.name, o.hide_render, o.is_holdout, o.is_shadow_catcher) for o in scene.objects]
    render = scene.render
    return items, render.film_transparent, render.engine, render.resolution_x, scene.camera.name


def test_lights_of_the_photograph_come_back_only_for_its_part(run):
    scene = bpy.context.scene
    lamp = scene.objects["Fixture.001"]
    nodes = lamp.data.materials[0].node_tree.nodes
    light_state.change(scene, lamp, {STOPS: 1.0})
    assert nodes["FIPT Front"].inputs["Strength"].default_value == pytest.approx(16.0)
    from fipt_blender.blend.photographed import lights_as_photographed

    with lights_as_photographed(scene):
        node = nodes["FIPT Front"].inputs
        assert node["Strength"].default_value * node["Color"].default_value[0] == pytest.approx(8.0)
    assert nodes["FIPT Front"].inputs["Strength"].default_value == pytest.approx(16.0)
    light_state.refresh(scene)
    assert nodes["FIPT Front"].inputs["Strength"].default_value == pytest.approx(16.0)


def test_what_counts_as_added(run):
    scene = bpy.context.scene
    ball()
    light = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "AREA"))
    scene.collection.objects.link(light)
    assert {item.name for item in composite.added_objects(scene, ROOM)} == {"FIPT grey_ball", "Lamp"}
    assert {item.name for item in composite.estimated_objects(scene, ROOM)} == ROOM | {"Fixture.001"}


def test_the_room_backdrop_renders_the_whole_view(run):
    ball(kind="MIRROR_BALL")
    assert bpy.ops.fipt.render_composite(view=VIEW, samples=4) == {"FINISHED"}
    (entry,) = read_json(run.renders_json)["renders"]
    assert entry["kind"] == "insert" and (run.renders / "insert" / "val_000.png").exists()


def test_the_backdrop_changes_and_comes_back(run):
    scene = bpy.context.scene
    before = state(scene)
    camera = bpy.data.objects[VIEW].data
    assert bpy.ops.fipt.set_backdrop(mode="PHOTOGRAPH") == {"FINISHED"}
    caught = {item.name for item in scene.objects if item.is_shadow_catcher}
    assert caught == ROOM | {"Fixture.001"} and scene.render.film_transparent
    assert camera.background_images[0].display_depth == "BACK" and camera.background_images[0].alpha == 1.0
    bpy.ops.fipt.set_backdrop(mode="PHOTOGRAPH")  # twice
    bpy.ops.fipt.look_through(view="train/000")  # another view keeps it behind
    assert bpy.data.objects["train/000"].data.background_images[0].display_depth == "BACK"
    bpy.ops.fipt.look_through(view=VIEW)
    assert bpy.ops.fipt.set_backdrop(mode="ROOM") == {"FINISHED"}
    assert state(scene) == before and scene.fipt.insert.backdrop == "ROOM"
    assert camera.background_images[0].display_depth == "FRONT" and camera.background_images[0].alpha == 0.5


def test_renders_do_not_mind_the_backdrop(run):
    photo = photograph(run, 16)
    bpy.ops.fipt.set_backdrop(mode="PHOTOGRAPH")
    before = state(bpy.context.scene)
    assert bpy.ops.fipt.render_views(which="CURRENT", samples=64) == {"FINISHED"}
    assert state(bpy.context.scene) == before
    render = renders.read_pixels(run.renders / "rerender" / "val_000.exr")
    assert render.mean() == pytest.approx(photo.mean(), rel=0.1)


def test_views_are_checked_without_what_was_inserted(run):
    photo = photograph(run)
    ball(y=0.0)
    scene = bpy.context.scene
    light_state.change(scene, scene.objects["Fixture.001"], {STOPS: -3.0})
    assert bpy.ops.fipt.render_views(samples=64) == {"FINISHED"}  # the panel's choice: held back
    (line,) = scene.fipt.check.views
    render = renders.read_pixels(run.renders / "rerender" / "val_000.exr")
    assert line.name == VIEW and line.held_back
    assert line.psnr == pytest.approx(psnr(render, photo), abs=1e-3) and line.psnr > 25.0
    assert scene.fipt.check.mean_psnr == pytest.approx(line.psnr)
    assert read_json(run.renders_json)["renders"][0]["kind"] == "rerender"
    error = bpy.data.images.load(line.error)
    assert tuple(error.size) == SIZE


def test_ticked_views_are_added_to_the_list(run):
    photograph(run, 4)
    scene = bpy.context.scene
    scene.fipt.check.which = "TICKED"
    assert bpy.ops.fipt.render_views(samples=2) == {"FINISHED"}
    assert [view.name for view in scene.fipt.check.views] == [VIEW, "train/000"]  # held-back ones first
    assert bpy.ops.fipt.render_views(view="train/000", samples=2) == {"FINISHED"}
    assert len(scene.fipt.check.views) == 2


def test_pictures_lie_over_the_view_and_go_again(run):
    photograph(run, 4)
    bpy.ops.fipt.render_views(samples=2)
    scene = bpy.context.scene
    background = bpy.data.objects[VIEW].data.background_images[0]
    photo = background.image
    for picture, end in (("RENDER", "rerender/val_000.exr"), ("ERROR", "error/val_000.png")):
        assert bpy.ops.fipt.show_check(view=VIEW, picture=picture) == {"FINISHED"}
        assert background.image.filepath.endswith(end) and background.alpha == 1.0
    assert bpy.ops.fipt.show_check(picture="PHOTOGRAPH") == {"FINISHED"}
    assert background.image == photo and background.alpha == 1.0
    bpy.ops.fipt.show_check(picture="RENDER")
    bpy.ops.fipt.look_through(view=VIEW)  # the section Capture shows the photograph again
    assert background.image == photo and background.alpha == 0.5
    assert scene.camera.name == VIEW
    with pytest.raises(RuntimeError, match="has not been rendered"):
        bpy.ops.fipt.show_check(view="train/000")
    os.remove(scene.fipt.check.views[0].error)
    with pytest.raises(RuntimeError, match="missing"):
        bpy.ops.fipt.show_check(picture="ERROR")


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("render_views", {"view": "val/999"}, "no view 'val/999'"),
        ("render_composite", {"view": "val/999"}, "no view 'val/999'"),
        ("render_views", {"which": "TICKED"}, "No view is ticked"),
        ("render_views", {"which": "HELD_BACK"}, "No ticked view is held back"),
    ],
)
def test_views_that_are_not_there_are_explained(run, name, options, words):
    for view in bpy.context.scene.fipt.capture.views:
        view.enabled = False
    with pytest.raises(RuntimeError, match=words):
        getattr(bpy.ops.fipt, name)("EXEC_DEFAULT", **options)


def test_missing_photographs_rooms_and_cameras_are_explained(run):
    (run.root / "photos/val_000.exr").unlink()
    with pytest.raises(RuntimeError, match="can't be read"):
        bpy.ops.fipt.render_views(samples=1)
    bpy.context.scene.camera = None
    with pytest.raises(RuntimeError, match="no camera of the capture"):
        bpy.ops.fipt.render_composite()
    for name in ROOM:
        bpy.data.objects.remove(bpy.data.objects[name])
    with pytest.raises(RuntimeError, match="no room"):
        bpy.ops.fipt.render_views(view=VIEW)


def test_polls(run):
    scene = bpy.context.scene
    assert bpy.ops.fipt.render_views.poll() and bpy.ops.fipt.render_composite.poll()
    assert not bpy.ops.fipt.show_check.poll() and not bpy.ops.fipt.open_report.poll()
    assert not bpy.ops.fipt.open_picture.poll()
    scene.fipt.run_folder = ""
    assert not bpy.ops.fipt.render_views.poll() and not bpy.ops.fipt.write_report.poll()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert not bpy.ops.fipt.set_backdrop.poll()


def test_the_report_is_written_and_opened_on_demand(run, monkeypatch):
    monkeypatch.setenv("FIPT_ENGINE_PYTHON", sys.executable)
    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda url, *_, **__: opened.append(url) or True)
    photograph(run, 4)
    bpy.ops.fipt.render_composite(backdrop="PHOTOGRAPH", samples=1)
    assert bpy.ops.fipt.write_report() == {"FINISHED"}
    page = run.report / "index.html"
    assert "An inserted object in the photograph" in page.read_text(encoding="utf-8") and not opened
    assert bpy.ops.fipt.open_report() == {"FINISHED"}
    assert opened == [page.as_uri()]
    page.unlink()
    with pytest.raises(RuntimeError, match="does not exist any more"):
        bpy.ops.fipt.open_report()


def test_a_second_blender_does_the_same(run, tmp_path):
    """The child's part, by the module: its messages, its files, and that it takes its folder away."""
    photograph(run, 4)
    scene = bpy.context.scene
    folder = run.renders / ".job"
    order = render_job.make_order(scene, run, render_job.CHECK, [VIEW], 2)
    write_json(folder / "order.json", vars(order))
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"), copy=True)
    code = render_job.child_command(folder / "scene.blend", folder / "order.json")[-1]
    start = f"import bpy; bpy.ops.wm.open_mainfile(filepath={str(folder / 'scene.blend')!r})\n"
    result = subprocess.run([sys.executable, "-c", start + code], capture_output=True, text=True, timeout=120)
    assert result.returncode == 0, result.stderr
    messages = [message for line in result.stdout.splitlines() if (message := parse_message(line))]
    assert [messages[0]["type"], messages[-1]["type"]] == ["stage", "done"]
    assert any(message["type"] == "progress" and message["fraction"] > 0.0 for message in messages)
    assert not folder.exists() and view_check.read_checks(run)["views"][0]["view"] == VIEW


def test_a_second_blender_explains_what_is_wrong(run):
    folder = run.renders / ".job"
    order = render_job.make_order(bpy.context.scene, run, render_job.CHECK, [VIEW], 2)
    write_json(folder / "order.json", {**vars(order), "scene": "gone"})
    code = render_job.child_command(folder / "scene.blend", folder / "order.json")[-1]
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    last = json.loads(result.stdout.splitlines()[-1])
    assert result.returncode == 1 and (last["type"], last["code"]) == ("error", "scene-gone")


def test_pixels_survive_writing(tmp_path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    values = np.random.default_rng(0).random((5, 7, 3)).astype(np.float32) * 4.0
    pictures.save_exr(tmp_path / "a.exr", values)
    np.testing.assert_array_equal(renders.read_pixels(tmp_path / "a.exr"), values)
    display = np.random.default_rng(0).integers(0, 256, (5, 7, 3)) / 255.0
    pictures.save_png(tmp_path / "a.png", display)
    np.testing.assert_allclose(renders.read_pixels(tmp_path / "a.png"), display, atol=1e-6)


def test_the_panels_scale_has_the_colours_of_the_pictures():
    np.testing.assert_allclose(np.array(ERROR_SCALE) * 255.0, ERROR_STOPS, atol=1e-4)
    assert backdrop.KEPT_PHOTOGRAPH.startswith("fipt_")
