"""Random sequences of an artist's actions on a room with results, and what must hold after each of ours."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

from fipt_blender.blend import marks
from fipt_blender.blend.pictures.image_files import read_pixels
from fipt_blender.blend.room.mesh_digest import is_edited
from fipt_blender.core.run.runfolder import RunFolder
from samples import artist
from samples.spots import spot_camera

ops = bpy.ops.fipt
Kept = dict[str, tuple]
WHAT = ("faces", "modifiers", "layers", "place", "hidden")  # of an object


def meshes() -> list[bpy.types.Object]:
    """The room's objects of the present scene, without lamps."""
    scene = bpy.context.scene
    found = [item for item in scene.objects if item.type == "MESH" and not marks.is_our_light(item)]
    return [item for item in found if len(item.data.polygons) > 1]


def lamps() -> list[bpy.types.Object]:
    return [item for item in bpy.context.scene.objects if marks.is_fixture(item)]


def kept() -> Kept:
    """What the artist has made: of each object its faces, modifiers, layers and place.

    Lamps that the artist has not touched follow the objects that they were split off.
    """
    bpy.context.view_layer.update()
    found: Kept = {}
    for item in [*meshes(), *lamps()]:
        matrix = np.array(item.matrix_world).round(5)
        lamp = marks.is_fixture(item)
        followed = lamp and np.allclose(matrix, Matrix.Translation(item[marks.PLACED]), atol=1e-4)
        found[item.name] = (
            None if lamp and not is_edited(item.data) else artist.faces(item),
            [(each.name, each.show_viewport) for each in item.modifiers],
            sorted(layer.name for layer in item.data.uv_layers),
            None if followed else matrix.tolist(),
            item.hide_render,
        )
    return found


def lamp_settings() -> dict[str, tuple]:
    """Of each lamp of the present scene."""
    return {item.name: tuple(item.get(key) for key in (marks.ON, marks.STOPS, marks.TINT)) for item in lamps()}


def parts() -> dict[str, set[str]]:
    return {item.name: set(artist.shown(item)) for item in meshes()}


def picture(folder: Path) -> np.ndarray:
    """(64,64,3) of the room from above, in Cycles."""
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 1, False
    scene.render.image_settings.file_format, scene.render.dither_intensity = "PNG", 0.0
    scene.render.filepath = str(folder / "picture.png")
    with spot_camera(scene, Vector((4.0, 3.0, 9.0)), Vector((4.0, 3.0, 0.0)), 64, 12.0):
        bpy.ops.render.render(write_still=True, scene=scene.name)
    return read_pixels(scene.render.filepath)


class Sequence:
    """One sequence of actions, in the scene of `applied_rooms`.

    Args:
        seed: of the choice.
        folder: for files.
    """

    def __init__(self, seed: int, folder: Path) -> None:
        self.random, self.folder = random.Random(seed), folder
        self.done: list[str] = []
        self.files = 0
        self.save_as()
        bpy.ops.ed.undo_push(message="start")

    def object(self) -> str:
        return self.random.choice(sorted(item.name for item in meshes()))

    def kind(self, *kinds: str) -> str:
        return self.random.choice(kinds)

    def save_as(self) -> None:
        self.files += 1
        folder = self.folder / f"place {self.files}"
        folder.mkdir()
        bpy.ops.wm.save_as_mainfile(filepath=str(folder / "room.blend"))

    def join(self) -> None:
        names = sorted(item.name for item in meshes())
        if len(names) > 1:
            artist.join(*self.random.sample(names, 2))

    def transform(self) -> None:
        item = bpy.data.objects[self.random.choice([self.object(), *[lamp.name for lamp in lamps()]])]
        item.location.x += self.random.choice([0.5, -1.0])
        item.scale.y *= self.random.choice([1.0, 1.5])

    def rename(self) -> None:
        for block in self.random.choice([bpy.data.objects, bpy.data.collections, bpy.data.materials]):
            block.name = f"mine {self.random.random():.3f}"

    def copy_scene(self) -> None:
        if len(bpy.data.scenes) < 2:
            bpy.ops.scene.new(type="FULL_COPY")

    def uv_layer(self) -> None:
        bpy.data.objects[self.object()].data.uv_layers.new(name="mine")

    def hide(self) -> None:
        item = bpy.data.objects[self.object()]
        item.hide_render = not item.hide_render

    def undo(self) -> None:
        if bpy.ops.ed.undo.poll():
            bpy.ops.ed.undo()

    def apply_again(self) -> None:
        bpy.context.scene.fipt.materials.texel_density = self.random.choice([16.0, 24.0])
        before, shown = kept(), parts()
        assert ops.apply_results("EXEC_DEFAULT", True) == {"FINISHED"}
        assert_same(kept(), before)
        for name, materials in parts().items():
            assert materials >= shown[name] - {""}, f"{name}: {shown[name]} -> {materials}"

    def set_lamp(self) -> None:
        rows = list(bpy.context.scene.fipt.lights.lights)
        if rows:
            row = self.random.choice(rows)
            row.stops, row.on = self.random.choice([-1.5, 0.0, 1.0]), self.random.random() < 0.5
            row.tint = self.kind("ESTIMATED", "COLOR", "TEMPERATURE")

    def light_groups(self) -> None:
        if ops.make_light_groups.poll():
            ops.make_light_groups()

    def estimate_again(self) -> None:
        """Lamps have other names and radiances, and keep what the artist has set."""
        run = RunFolder(bpy.context.scene.fipt.run_folder)
        table = json.loads(run.emitters_json.read_text())
        for entry in table["fixtures"]:
            entry["radiance"] = [1.01 * value for value in entry["radiance"]]
            entry["name"] = f"Fixture.{self.random.randrange(100):03}"
        run.emitters_json.write_text(json.dumps(table))
        run.fields_npz.write_text(json.dumps(table))
        before, lit = kept(), lamp_settings()
        assert ops.apply_results("EXEC_DEFAULT", True) == {"FINISHED"}
        assert_same({name: kept()[name] for name in before}, before)
        assert {name: lamp_settings()[name] for name in lit} == lit

    def revert_and_apply(self) -> None:
        """Modelled meshes stay in the file."""
        modelled = [item.data for item in meshes() if marks.has_results(item)]
        faces = [artist.faces_of(mesh) for mesh in modelled if is_edited(mesh)]
        if ops.revert.poll():
            ops.revert("EXEC_DEFAULT", True)
        present = [artist.faces_of(mesh) for mesh in bpy.data.meshes]
        assert all(each in present for each in faces)
        assert ops.apply_results("EXEC_DEFAULT", True) == {"FINISHED"}

    def reopen(self) -> None:
        """What was saved is there again, and looks the same."""
        before, shown = kept(), picture(self.folder)
        bpy.ops.wm.save_mainfile()
        # Another application, which is not saved.
        bpy.context.scene.fipt.materials.texel_density = 32.0
        ops.apply_results()
        bpy.ops.wm.open_mainfile(filepath=bpy.data.filepath)
        assert_same(kept(), before)
        assert np.abs(picture(self.folder) - shown).max() == 0.0

    def actions(self) -> dict[str, Callable[[], None]]:
        return {
            "delete faces": lambda: artist.delete_faces(self.object()),
            "extrude": lambda: artist.extrude(self.object()),
            "separate": lambda: artist.separate(self.object()),
            "join": self.join,
            "add a modifier": lambda: artist.add_modifier(self.object(), self.kind("BEVEL", "SOLIDIFY", "SUBSURF")),
            "apply a modifier": lambda: artist.apply_modifier(self.object(), self.kind("SOLIDIFY", "SUBSURF")),
            "transform": self.transform,
            "rename": self.rename,
            "copy the scene": self.copy_scene,
            "add a UV layer": self.uv_layer,
            "hide": self.hide,
            "save as": self.save_as,
            "undo": self.undo,
            "set a lamp": self.set_lamp,
            "light groups": self.light_groups,
            "estimate again": self.estimate_again,
            "apply again": self.apply_again,
            "revert and apply": self.revert_and_apply,
            "save and reopen": self.reopen,
        }

    def run(self, count: int = 8) -> None:
        """Do `count` actions, then apply, save and reopen."""
        actions = self.actions()
        for name in self.random.choices(sorted(actions), k=count):
            self.do(name)
        for name in ("apply again", "save and reopen"):
            self.do(name)

    def do(self, name: str) -> None:
        self.done.append(name)
        others = {scene.name: elsewhere(scene) for scene in bpy.data.scenes if scene != bpy.context.scene}
        self.actions()[name]()
        bpy.ops.ed.undo_push(message=name)
        if name not in ("undo", "rename"):
            for scene, before in others.items():
                assert elsewhere(bpy.data.scenes[scene]) == before, f"the scene {scene} has changed"


def elsewhere(scene: bpy.types.Scene) -> dict:
    """What another scene shows: the faces of its objects."""
    return {item.name: artist.faces(item) for item in scene.objects if item.type == "MESH"}


def assert_same(now: Kept, before: Kept) -> None:
    assert now.keys() == before.keys()
    for name, values in before.items():
        for what, value, present in zip(WHAT, values, now[name], strict=True):
            assert present == value, f"{name}: {what}"
