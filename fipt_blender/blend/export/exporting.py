# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Export of the estimated room as glTF or USD: copies with plain materials in a scene of their own.

The file is left as it was. What the formats can't hold is said in warnings.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import bpy
from mathutils import Matrix

from ...bridge.process import Message
from ...core.run.errors import FiptError
from ...core.run.runfolder import explained_write_errors
from ..lights.area_lights import area_light_watts
from ..marks import FIXTURE_LIGHT, MATERIAL, is_our_light, result_world, room_with_results
from ..marks import WORLD as OUR_WORLD
from ..results.materials import is_uniform
from ..room.originals import shows_original
from ..room.tiles import split_tiles
from ..room.uv_layer import UV_LAYER
from .color import colors_in_rec709
from .lamps import GAP, add_backs, plain_lamp
from .materials import Atlas, AtlasKey, glowing_material, has_maps, make_atlases, plain_material

GLTF, USD = (".glb", ".gltf"), (".usdc", ".usda", ".usd", ".usdz")
SUFFIXES = GLTF + USD
_ASIDE = ".fipt_aside"  # behind the names of objects, while copies have them
_SCENE = "FIPT Export"


@dataclass
class Exported:
    """What an export has written.

    Attributes:
        path: of the file.
        objects: number of objects in it.
        warnings: what it does not hold.
    """

    path: Path
    objects: int = 0
    warnings: list[Message] = field(default_factory=list)


def export_room(scene: bpy.types.Scene, path: Path) -> Exported:
    """Write the estimated room with its lights to a file.

    Args:
        scene: with applied results, which are shown; in Object Mode.
        path: the suffix chooses the format, one of SUFFIXES.

    Raises:
        FiptError: ``export-format``, ``export-nothing``, ``export-attributes``, ``export-failed``,
            ``disk-full`` or ``run-unwritable``.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise FiptError(
            "export-format",
            f"'{path.suffix}' is not the suffix of a format that can be exported.",
            f"Use one of {', '.join(SUFFIXES)}.",
        )
    room = room_with_results(scene)
    if not room or any(map(shows_original, room)):
        raise FiptError("export-nothing", "No results are shown.", "Apply the results, and show Estimated.")
    ours = [slot.material for item in room for slot in item.material_slots if slot.material is not None]
    if not all(has_maps(material) for material in ours if MATERIAL in material):
        raise FiptError(
            "export-attributes",
            "The results are color attributes, which other programs do not read as materials.",
            "Choose Image Textures as Store In, and apply the results again.",
        )
    with explained_write_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    exported = Exported(path)
    with tempfile.TemporaryDirectory(prefix="fipt_export_") as folder, _Copies(scene) as copies:
        atlases = make_atlases(room, Path(folder), packed=path.suffix.lower() in GLTF)
        copies.keep_images(atlases.values())
        copies.add_room(room, atlases)
        copies.add_lights(path.suffix.lower() in GLTF)
        exported.objects = len(copies.scene.objects)
        with _shown_in_window(copies.scene), colors_in_rec709(copies.scene, path.suffix.lower() in USD):
            _write(path)
    if path.suffix.lower() in GLTF:
        world = result_world(scene)
        if world is not None and world[OUR_WORLD]:
            text = "glTF has no environment: the light from outside the room is not in the file."
            exported.warnings.append(_warning("export-environment", text, "Export USD to keep it."))
    return exported


def _warning(code: str, text: str, remedy: str) -> Message:
    return {"type": "warning", "code": code, "text": text, "remedy": remedy}


class _Copies:
    """A scene of copies that have the originals' names, until the block ends."""

    def __init__(self, source: bpy.types.Scene) -> None:
        self._source = source
        self._renamed: list[tuple[bpy.types.Object, str]] = []
        self._materials: dict[tuple[bpy.types.Material, int], bpy.types.Material] = {}
        self._images: list[bpy.types.Image] = []
        self._meshes: list[bpy.types.Mesh] = []
        self._lamps: list[bpy.types.Material] = []

    def __enter__(self) -> _Copies:
        self.scene = bpy.data.scenes.new(_SCENE)
        self.scene.world = result_world(self._source)
        return self

    def __exit__(self, *_: object) -> None:
        for item in list(self.scene.objects):
            bpy.data.objects.remove(item)
        for item, name in self._renamed:
            item.name = name
        bpy.data.scenes.remove(self.scene)
        bpy.data.batch_remove([*self._materials.values(), *self._lamps, *self._images, *self._meshes])

    def keep_images(self, atlases: Iterable[Atlas]) -> None:
        """Remove these images, too, at the end."""
        self._images = [image for atlas in atlases for image in atlas.images]

    def add_room(self, room: list[bpy.types.Object], atlases: dict[AtlasKey, Atlas]) -> None:
        """Copies of the room's objects with plain materials; the artist's own materials stay."""
        for item in room:
            if not len(item.data.polygons):  # all of it is a lamp
                continue
            copy = self._copy(item)
            layers = copy.data.uv_layers  # of several, USD's and other readers take the first
            for name in [layer.name for layer in layers if layer.name != UV_LAYER]:
                layers.remove(layers[name])
            # Other programs have no tiles: a part is a material for each atlas image on which it lies.
            for slot, image in zip(copy.material_slots, split_tiles(copy.data), strict=True):
                material = slot.material
                if not has_maps(material):
                    continue
                uniform = is_uniform(material)
                key = (material, -1 if uniform else image)
                if key not in self._materials:
                    atlas = None if uniform else atlases[material[MATERIAL], image]
                    self._materials[key] = plain_material(material, atlas)
                slot.material = self._materials[key]

    def add_lights(self, areas_as_meshes: bool) -> None:
        """Copies of visible lights and lamps; Blender lights that stand for fixtures are left out."""
        for item in list(self._source.objects):
            if FIXTURE_LIGHT in item or item.hide_render:
                continue
            if item.type == "LIGHT" and item.data.type == "AREA" and areas_as_meshes:
                self._add_area(item)
            elif item.type == "LIGHT":
                self._copy(item)
            elif is_our_light(item) and item.type == "MESH":
                self._add_lamp(item)

    def _copy(self, item: bpy.types.Object) -> bpy.types.Object:
        """A copy of the name, with a mesh of its own, without parent and custom properties."""
        name, matrix = item.name, item.matrix_world.copy()
        copy = item.copy()
        copy.parent = None
        copy.matrix_world = matrix
        copy.constraints.clear()
        copy.animation_data_clear()
        for key in list(copy.keys()):
            del copy[key]
        if item.type == "MESH":
            copy.data = item.data.copy()
            copy.data.name = name
            self._meshes.append(copy.data)
            for slot in copy.material_slots:
                slot.link = "DATA"
        item.name = name + _ASIDE
        self._renamed.append((item, name))
        copy.name = name
        self.scene.collection.objects.link(copy)
        return copy

    def _add_lamp(self, item: bpy.types.Object) -> None:
        copy = self._copy(item)
        copy.visible_camera = copy.visible_diffuse = copy.visible_glossy = True
        self._lamps += plain_lamp(copy)

    def _add_area(self, item: bpy.types.Object) -> None:
        """An area light as a surface that emits the same radiance; glTF has none."""
        light, name = item.data, item.name
        x, y = (
            0.5 * light.size,
            0.5 * (light.size_y if light.shape in ("RECTANGLE", "ELLIPSE") else light.size),
        )
        if light.shape in ("DISK", "ELLIPSE"):
            turns = [2.0 * math.pi * step / 32 for step in range(32)]
            points = [(x * math.cos(turn), -y * math.sin(turn), 0.0) for turn in turns]
            area = math.pi * x * y
        else:
            points = [(-x, -y, 0.0), (-x, y, 0.0), (x, y, 0.0), (x, -y, 0.0)]
            area = 4.0 * x * y
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata(points, [], [tuple(range(len(points)))])
        self._meshes.append(mesh)
        radiance = light.energy / max(area_light_watts(1.0, area), 1e-12)
        color = tuple(radiance * value for value in light.color)
        black = (0.0, 0.0, 0.0)
        for each, emitted in ((name, color), (f"{name} Back", black)):
            self._lamps.append(glowing_material(each, emitted, True))
            mesh.materials.append(self._lamps[-1])
        add_backs(mesh, {0: 1}, GAP / max(item.matrix_world.median_scale, 1e-6))
        item.name = name + _ASIDE
        self._renamed.append((item, name))
        made = bpy.data.objects.new(name, mesh)
        made.matrix_world = Matrix(item.matrix_world)
        self.scene.collection.objects.link(made)


@contextmanager
def _shown_in_window(scene: bpy.types.Scene) -> Iterator[None]:
    """Make a scene the window's: exporters export that one."""
    window = bpy.context.window
    before = window.scene
    window.scene = scene
    try:
        yield
    finally:
        window.scene = before


def _write(path: Path) -> None:
    """Call Blender's exporter on the window's scene."""
    is_gltf = path.suffix.lower() in GLTF
    operator = bpy.ops.export_scene.gltf if is_gltf else bpy.ops.wm.usd_export
    try:
        known = operator.get_rna_type().properties.keys()
    except KeyError:
        text, remedy = (
            ("The add-on of glTF is disabled.", "Enable 'glTF 2.0 format' in the preferences.")
            if is_gltf
            else ("This Blender was built without USD.", "Export glTF, or use a Blender of blender.org.")
        )
        raise FiptError("export-failed", text, remedy) from None
    options = _gltf_options(path) if is_gltf else _USD_OPTIONS
    arguments = {name: value for name, value in options.items() if name in known}
    path.unlink(missing_ok=True)
    try:
        operator(filepath=str(path), **arguments)
    except RuntimeError as error:
        text = f"Blender's exporter has failed ({str(error).strip()})."
        raise FiptError("export-failed", text, "Choose another folder or format.") from None
    if not path.is_file():
        raise FiptError("export-failed", f"{path} was not written.", "Choose another folder or format.")


_USD_OPTIONS = {
    "export_animation": False,
    "export_materials": True,
    "generate_preview_surface": True,
    "export_textures_mode": "NEW",
    "overwrite_textures": True,
    "relative_paths": True,
    "export_custom_properties": False,
    "convert_world_material": True,
    "export_hair": False,
}


def _gltf_options(path: Path) -> dict[str, object]:
    return {
        "export_format": "GLB" if path.suffix.lower() == ".glb" else "GLTF_SEPARATE",
        "use_active_scene": True,
        "export_lights": True,
        "export_cameras": False,
        "export_animations": False,
        "export_extras": False,
        "export_attributes": False,
        "export_vertex_color": "NONE",
        "export_image_format": "AUTO",
        "export_yup": True,
    }
