"""Backdrops, pictures of the room and over photographs, and the report."""

from __future__ import annotations

import json
import webbrowser
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Vector

import fipt_blender
from fipt_blender.blend import png16
from fipt_blender.blend.lights import light_state
from fipt_blender.blend.marks import STOPS
from fipt_blender.blend.pictures import image_files
from fipt_blender.blend.pictures.renders import plate_size
from fipt_blender.blend.render_settings import can_denoise
from fipt_blender.blend.results.scene_state import median_shown
from fipt_blender.core.capture.images import write_codes, write_exr
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.runfolder import write_json
from fipt_blender.jobs.room_steps import RoomSteps
from samples.engine_here import engine_here
from samples.operator_calls import refused
from samples.rendered_rooms import SIZE, VIEW, exr_layers, make_scene, photograph

ROOM = {"Floor", "Wall"}


pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def run(tmp_path):
    return make_scene(tmp_path)


def ball(x=0.0, y=0.6, kind="GRAY_BALL"):
    bpy.context.scene.cursor.location = (x, y, 0.0)
    assert bpy.ops.fipt.add_ball(kind=kind, size=0.28) == {"FINISHED"}


def into_photograph(run, samples) -> dict[str, np.ndarray]:
    """The layers of a picture of the view over its photograph, (H, W, 1, 3 or 4)."""
    scene = bpy.context.scene
    scene.cycles.samples, scene.cycles.use_denoising = samples, False
    bpy.ops.fipt.set_backdrop(mode="PHOTOGRAPH")
    before = state(scene)
    assert bpy.ops.fipt.final_picture() == {"FINISHED"}
    assert state(scene) == before and len(bpy.data.scenes) == 1
    return exr_layers(Path(scene.fipt.insert.picture).with_suffix(".exr"))


def rendered(scene, path: Path) -> dict[str, np.ndarray]:
    """The layers of Blender's last render."""
    for name, value in image_files.LAYERED_IMAGE.items():
        setattr(scene.render.image_settings, name, value)
    bpy.data.images["Render Result"].save_render(str(path), scene=scene)
    return exr_layers(path)


def state(scene):
    """What renders must not change."""
    items = [(o.name, o.hide_render, o.is_holdout, o.is_shadow_catcher) for o in scene.objects]
    render = scene.render
    return items, render.film_transparent, render.engine, render.resolution_x, scene.camera.name


def without_radiance(run, suffix: str = ".exr") -> None:
    """Let the photographs be ones that are not HDR."""
    data = json.loads(run.capture_json.read_text())
    for view in data["views"]:
        view |= {"encoded": True, "exposure": None, "image": str(Path(view["image"]).with_suffix(suffix))}
    write_json(run.capture_json, data)


def convert_lamp() -> tuple[bpy.types.Object, bpy.types.Object]:
    """Let a Blender light stand for the room's fixture; returns both."""
    scene = bpy.context.scene
    light_state.list_lights(scene)
    assert bpy.ops.fipt.fixture_to_area_light(fixture="Fixture.001") == {"FINISHED"}
    lamp = scene.objects["Fixture.001"]
    (light,) = lamp.children
    return lamp, light


def test_without_an_object_the_picture_is_the_photograph(run):
    """To the rounding of halves; also where a Blender light stands for a fixture, and whatever the lamps are."""
    photo = photograph(run, 16)
    layers = into_photograph(run, 4)
    np.testing.assert_allclose(layers["Composite.Combined"][..., :3], photo, rtol=1e-3, atol=1e-6)
    assert (layers["ViewLayer.Shadow Catcher"] == 1.0).all() and not layers["ViewLayer.Combined"].any()
    path = run.renders / "composite" / "val_000_photograph.png"
    assert bpy.context.scene.fipt.insert.picture == str(path) and path.exists()
    (entry,) = read_document(run.renders_json, dict)["renders"]
    assert entry == {"kind": "composite", "view": VIEW, "image": path.relative_to(run.root).as_posix()}
    lamp, light = convert_lamp()
    light_state.change(bpy.context.scene, lamp, {STOPS: -2.0})
    before = lamp.visible_diffuse, light.hide_render
    np.testing.assert_allclose(into_photograph(run, 4)["Composite.Combined"][..., :3], photo, rtol=1e-3, atol=1e-6)
    assert (lamp.visible_diffuse, light.hide_render) == before


def test_an_object_throws_its_shadow_on_the_photograph_and_the_compositor_scene_renders_the_same(run, tmp_path):
    photo = photograph(run)
    ball()
    scene = bpy.context.scene
    bpy.ops.fipt.set_backdrop(mode="ROOM")
    assert not bpy.ops.fipt.plate_nodes.poll()
    layers = into_photograph(run, 64)
    added, shadow = layers["ViewLayer.Combined"], layers["ViewLayer.Shadow Catcher"]
    result = layers["Composite.Combined"][..., :3]
    assert 0.0 < added[..., 3].mean() < 0.5 and shadow.min() < 0.9
    # In a picture as small as this, the shadow is hardly larger than the noise, and is shown in part.
    made, bare = (added[..., :3] + (1.0 - added[..., 3:]) * photo * light for light in (shadow, 1.0))
    assert (result >= np.minimum(made, bare) - 1e-3).all() and (result <= np.maximum(made, bare) + 1e-3).all()
    # The ball stands in the middle column; its shadow is around its foot.
    far = np.ones(SIZE[::-1], bool)
    far[:, 9:23] = False
    assert (shadow[far] != 1.0).any(axis=-1).mean() > 0.05  # noise, of which nothing is left
    np.testing.assert_allclose(result[far], photo[far], rtol=2e-3, atol=1e-6)
    assert np.abs(result - photo)[6:14, 12:20].max() > 0.05
    assert np.isfinite(result).all() and result.min() >= 0.0
    # The depth is the object's, and that of the wall behind it.
    depth, item, covered = layers["ViewLayer.Depth"][..., 0], bpy.data.objects["FIPT Gray Ball"], added[..., 3] > 0.999
    bpy.context.view_layer.update()
    to_camera = scene.camera.matrix_world.inverted() @ item.matrix_world
    middle = -(to_camera @ (sum((Vector(corner) for corner in item.bound_box), Vector()) / 8)).z
    assert (depth[covered] < middle + item.dimensions.x / 2).all() and depth[0, 0] > middle + item.dimensions.x / 2

    assert bpy.ops.fipt.plate_nodes() == {"FINISHED"}
    (composed,) = (each for each in bpy.data.scenes if each != scene)
    assert not getattr(scene, "compositing_node_group", scene.use_nodes)
    bpy.ops.render.render(scene=composed.name)
    again = rendered(composed, tmp_path / "out.exr")["Composite.Combined"][..., :3]
    np.testing.assert_allclose(again, result, rtol=5e-3, atol=1e-3)


@pytest.mark.skipif(not can_denoise(), reason="this Blender was built without its denoiser")
def test_the_denoiser_leaves_what_no_object_changes(run):
    photo = photograph(run, 16)
    scene = bpy.context.scene
    bpy.ops.fipt.set_backdrop(mode="PHOTOGRAPH")
    scene.cycles.samples, scene.cycles.use_denoising = 4, True
    assert bpy.ops.fipt.final_picture() == {"FINISHED"}
    layers = exr_layers(Path(scene.fipt.insert.picture).with_suffix(".exr"))
    np.testing.assert_allclose(layers["Composite.Combined"][..., :3], photo, rtol=5e-3, atol=1e-4)


def test_light_groups_are_layers_of_the_picture(run):
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    light_state.list_lights(scene)
    assert bpy.ops.fipt.make_light_groups() == {"FINISHED"}
    scene.cycles.samples, scene.cycles.use_denoising = 1, False
    assert bpy.ops.fipt.final_picture() == {"FINISHED"}
    layers = exr_layers(Path(scene.fipt.insert.picture).with_suffix(".exr"))
    np.testing.assert_allclose(
        layers["ViewLayer.Combined_Fixture_001"], layers["ViewLayer.Combined"][..., :3], rtol=1e-2, atol=1e-4
    )


@pytest.mark.parametrize("suffix", [".exr", ".png"])
def test_a_plate_that_is_not_hdr_is_brought_to_the_unit_of_the_room(run, suffix):
    """Twice as bright by its exposure: without an object it stays the same picture. One that the import has
    rewritten as EXR holds linear values, a PNG codes."""
    photo = photograph(run, 64)
    path = run.root / f"photos/val_000{suffix}"
    bright = np.clip(2.0 * photo, 0.0, 1.0)
    if suffix == ".exr":
        write_exr(path, bright)
    else:
        write_codes(path, png16.encode_srgb(bright))
    without_radiance(run, suffix)
    exposure = {"median_shown": 0.2, "views": {VIEW: {"shown_ev": 1.0}}}
    write_json(run.statistics_json, {"radiance_scale": 0.2, "photometry": exposure})
    layers = into_photograph(run, 4)
    dark = (photo.max(axis=-1) < 0.4) & (photo.min(axis=-1) > 0.01)  # where codes of 8 bits are fine enough
    assert dark.mean() > 0.3
    error = 5e-3 if suffix == ".exr" else 3e-2
    np.testing.assert_allclose(layers["Composite.Combined"][..., :3][dark], photo[dark], rtol=error, atol=1e-4)


def test_f12_and_the_final_picture_are_the_same(run, tmp_path):
    """With the artist's settings, in her size, beside her file; a second one replaces nothing."""
    scene = bpy.context.scene
    ball(kind="MIRROR_BALL")
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.max_bounces, scene.cycles.pixel_filter_type = 3, 2, "GAUSSIAN"
    scene.render.resolution_x, scene.render.resolution_y = 48, 30
    scene.render.resolution_percentage = 50
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    scene = bpy.context.scene
    assert bpy.ops.fipt.final_picture() == {"FINISHED"}
    picture = exr_layers(tmp_path / "shot_pictures" / "val_000.exr")["ViewLayer.Combined"]
    assert scene.fipt.insert.picture == str(tmp_path / "shot_pictures" / "val_000.png")
    assert image_files.read_pixels(Path(scene.fipt.insert.picture)).shape == (15, 24, 3)
    before = [getattr(scene.render.image_settings, name) for name in image_files.LAYERED_IMAGE]
    bpy.ops.render.render()
    np.testing.assert_array_equal(rendered(scene, tmp_path / "f12.exr")["ViewLayer.Combined"], picture)
    for name, value in zip(image_files.LAYERED_IMAGE, before, strict=True):
        setattr(scene.render.image_settings, name, value)
    assert bpy.ops.fipt.final_picture() == {"FINISHED"}
    assert scene.fipt.insert.picture.endswith("val_000_2.png")
    assert [getattr(scene.render.image_settings, name) for name in image_files.LAYERED_IMAGE] == before


def test_a_camera_of_the_artist_is_rendered_but_has_no_photograph(run):
    scene = bpy.context.scene
    scene.camera = bpy.data.objects.new("Hero / wide", bpy.data.cameras.new("Hero"))
    scene.collection.objects.link(scene.camera)
    scene.render.engine, scene.cycles.samples = "CYCLES", 1
    assert bpy.ops.fipt.final_picture() == {"FINISHED"}
    assert (run.renders / "insert" / "Hero _ wide.png").is_file()
    bpy.ops.fipt.set_backdrop(mode="PHOTOGRAPH")
    assert "no camera of the capture" in refused(bpy.ops.fipt.final_picture)


def test_sizes_are_the_scenes_resolution_in_the_photographs_proportions(run):
    scene, settings = bpy.context.scene, bpy.context.scene.fipt.check
    assert settings.size == "PHOTOGRAPH"
    settings.size = "HD"
    assert (scene.render.resolution_x, scene.render.resolution_y) == (1920, 1200)
    settings.size = "UHD"
    assert settings.size == "UHD" and scene.render.resolution_y == 2400
    scene.render.resolution_x = 1000
    assert settings.size == "OUTPUT"
    scene.render.resolution_percentage = 50
    assert plate_size(scene, scene.camera) == (1200, 750)  # in the photograph's proportions, however small that is
    settings.size = "PHOTOGRAPH"
    assert (scene.render.resolution_x, scene.render.resolution_y) == SIZE


def test_the_backdrop_changes_and_is_restored(run):
    scene = bpy.context.scene
    before = state(scene)
    camera = bpy.data.objects[VIEW].data
    assert bpy.ops.fipt.set_backdrop(mode="PHOTOGRAPH") == {"FINISHED"}
    caught = {item.name for item in scene.objects if item.is_shadow_catcher}
    assert caught == ROOM | {"Fixture.001"} and scene.render.film_transparent
    assert camera.background_images[0].display_depth == "BACK" and camera.background_images[0].alpha == 1.0
    bpy.ops.fipt.set_backdrop(mode="PHOTOGRAPH")  # twice
    bpy.ops.fipt.look_through(view="train/000")  # also behind the room in another view
    assert bpy.data.objects["train/000"].data.background_images[0].display_depth == "BACK"
    bpy.ops.fipt.look_through(view=VIEW)
    assert bpy.ops.fipt.set_backdrop(mode="ROOM") == {"FINISHED"}
    assert state(scene) == before and scene.fipt.insert.backdrop == "ROOM"
    assert camera.background_images[0].display_depth == "FRONT" and camera.background_images[0].alpha == 0.5
    # Cycles adds the light of lamps that are no shadow catchers to the photograph.
    bpy.ops.fipt.set_backdrop(mode="PHOTOGRAPH")
    _, light = convert_lamp()
    for mode, caught in (("PHOTOGRAPH", True), ("ROOM", False), ("PHOTOGRAPH", True)):
        bpy.ops.fipt.set_backdrop(mode=mode)
        assert light.is_shadow_catcher is caught


def test_missing_views_photographs_rooms_and_cameras_are_explained(run):
    assert "no camera for the view 'val/999'" in refused(bpy.ops.fipt.final_picture, view="val/999")
    (run.root / "photos/val_000.exr").unlink()
    with pytest.raises(RuntimeError, match=r"val_000\.exr of the view 'val/000' can't be read"):
        into_photograph(run, 1)
    camera, bpy.context.scene.camera = bpy.context.scene.camera, None
    assert "no camera" in refused(bpy.ops.fipt.final_picture)
    bpy.context.scene.camera = camera
    for name in ROOM:
        bpy.data.objects.remove(bpy.data.objects[name])
    assert "as the room" in refused(bpy.ops.fipt.final_picture)


def test_a_photograph_that_is_not_hdr_has_no_radiance_of_its_own(run):
    """Its values are not in the unit of the estimate: the median of all photographs sets the exposure."""
    write_json(run.statistics_json, {"radiance_scale": 0.06, "photometry": {"median_shown": 0.24}})
    without_radiance(run)
    radiance, warnings = RoomSteps(None, run).photographed_radiance(VIEW)
    assert median_shown(run) / np.median(radiance) == pytest.approx(4.0) and not warnings


def test_the_report_is_written_and_opened_on_demand(run, monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda url, *_, **__: opened.append(url) or True)
    photograph(run, 4)
    into_photograph(run, 1)
    with engine_here():
        assert bpy.ops.fipt.write_report() == {"FINISHED"}
    page = run.report / "index.html"
    assert "An inserted object in the photograph" in page.read_text(encoding="utf-8") and not opened
    assert bpy.ops.fipt.open_report() == {"FINISHED"}
    assert opened == [page.as_uri()]
    page.unlink()
    assert "no longer exists" in refused(bpy.ops.fipt.open_report)


@pytest.mark.parametrize("name", ["evil.desktop", "report/evil.html", "report/index.html"])
def test_only_the_report_of_a_run_is_opened_whatever_the_file_names(tmp_path, monkeypatch, name):
    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda url, *_, **__: opened.append(url) or True)
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.touch()
    if name != "report/index.html":  # the last one is in no run folder
        (tmp_path / "run.json").touch()
    bpy.context.scene.fipt.check.report = str(path)
    assert "not the report of a run" in refused(bpy.ops.fipt.open_report)
    assert not opened


def test_no_file_is_opened_with_its_scripts():
    package = Path(fipt_blender.__file__).parent
    lines = [line for path in package.rglob("*.py") for line in path.read_text("utf-8").splitlines()]
    opening = [line for line in lines if "open_mainfile(" in line]
    assert opening and all("use_scripts=False" in line for line in opening)
