# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Export of the estimated room as glTF or USD: copies with plain materials in a scene of their own.

The file is left as it was. What the formats can't hold is said in warnings.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import bpy
import numpy as np

from ...bridge.process import Message
from ...core.run.errors import FiptError
from ...core.run.runfolder import explained_write_errors
from ..lights.color import LUMENS_PER_WATT
from ..lights.convert import lights_as_converted
from ..lights.fixture_nodes import is_emission_material
from ..marks import (
    FIXTURE_LIGHT,
    MATERIAL,
    PART,
    VISIBILITY,
    fixture_lights,
    has_results,
    is_our_light,
    room_with_results,
)
from ..results.materials import is_uniform
from ..room.originals import shows_original
from ..room.uv_layer import UV_LAYER
from .color import colors_in_rec709
from .copies import Copies, rendered_objects
from .environment import plain_world, read_environment
from .lamps import GAP, add_backs, lamp_light, plain_lamp, wide_spot
from .lights import (
    Lost,
    area_surface,
    emits,
    emitted_power,
    is_plain_area,
    note_losses,
    plain_light,
    turned,
    warning,
)
from .materials import artists_name, glowing_material, has_maps, plain_material
from .part_textures import TEXTURE_SIZE, make_part_textures

GLTF, USD = (".glb", ".gltf"), (".usdc", ".usda", ".usd", ".usdz")
SUFFIXES = GLTF + USD
_ONE_FILE = (".glb", ".usdz")  # pictures of others lie beside them, where each needs its own name
_SURFACES = ("MESH", "CURVE", "SURFACE", "META", "FONT")


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


@dataclass(frozen=True)
class ExportOptions:
    """What can be chosen.

    Attributes:
        texture_size: the most texels of a side of a part's textures.
        lamp_lights: in glTF, give lamps and area lights a light besides the surface that glows. Game engines
            and browsers light by lights alone; path tracers would light the room twice.
    """

    texture_size: int = TEXTURE_SIZE
    lamp_lights: bool = True


def export_room(scene: bpy.types.Scene, path: Path, options: ExportOptions = ExportOptions()) -> Exported:
    """Write the estimated room with its lights to a file.

    Args:
        scene: with applied results, which are shown; in Object Mode.
        path: the suffix chooses the format, one of SUFFIXES.
        options: what can be chosen.

    Raises:
        FiptError: ``export-format``, ``export-nothing``, ``export-attributes``, ``export-uv``,
            ``export-failed``, ``disk-full`` or ``run-unwritable``.
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
        with tempfile.TemporaryFile(dir=path.parent):  # Blender's exporters end in a traceback
            pass
    exported = Exported(path)
    gltf, shown = path.suffix.lower() in GLTF, rendered_objects(scene)
    if not set(room) & set(shown):
        raise FiptError("export-nothing", "Renders show nothing of the room.", "Enable it in renders.")
    with tempfile.TemporaryDirectory(prefix="fipt_export_") as folder, Copies() as copies:
        with_lights = gltf and options.lamp_lights
        unit = LUMENS_PER_WATT if gltf else 1.0  # glTF has nits and candelas
        room_copies, lamps = _copied_surfaces(copies, shown, exported.warnings)
        prefix = "" if path.suffix.lower() in _ONE_FILE else f"{path.name.replace('.', '_')}_"
        taken = _add_room(copies, room_copies, Path(folder), prefix, options.texture_size)
        _add_lamps(copies, scene, shown, lamps, taken, unit, with_lights, exported.warnings)
        _add_lights(copies, scene, shown, gltf, with_lights, exported.warnings)
        _add_world(copies, scene, Path(folder) / f"{prefix}environment.exr", gltf, exported.warnings)
        exported.objects = len(copies.scene.objects)
        with _shown_in_window(copies.scene), colors_in_rec709(copies.scene, path.suffix.lower() in USD):
            _write(path)
    return exported


_Copied = list[tuple[bpy.types.Object, bpy.types.Mesh]]  # objects and copies of their meshes


def _copied_surfaces(
    copies: Copies, shown: list[bpy.types.Object], warnings: list[Message]
) -> tuple[_Copied, _Copied]:
    """The room's objects and the lamps; inserted objects, and the artist's own materials, as they are."""
    room, lamps, inserted, others = [], [], [], []
    for item in shown:
        is_lamp = item.type == "MESH" and is_our_light(item)
        if has_results(item) and len(item.data.polygons):  # without polygons all of it is a lamp
            room.append((item, copies.mesh(item)))
        elif is_lamp:
            lamps.append((item, copies.mesh(item)))
        elif not has_results(item) and item.type in _SURFACES:
            inserted.append((item, copies.mesh(item)))
        elif item.type == "EMPTY" and item.instance_collection is not None:
            copies.add(item, None, item.matrix_world).instance_collection = item.instance_collection
        elif item.type in ("CURVES", "POINTCLOUD", "VOLUME", "GREASEPENCIL") or item.is_instancer:
            others.append(item.name)
    for item, mesh in inserted:
        copies.add(item, mesh, item.matrix_world)
    if others:
        text = f"{', '.join(others)}: objects of these kinds are not in the file."
        warnings.append(
            warning("export-others", text, "Convert them to meshes, or make their instances real.")
        )
    for material in {each for _, mesh in room + lamps + inserted for each in mesh.materials if each}:
        if not has_maps(material) and not is_emission_material(material):
            copies.keep_name(material)
    return room, lamps


def _add_room(copies: Copies, room: _Copied, folder: Path, prefix: str, texture_size: int) -> set[str]:
    """The room with plain materials, of pictures named by `prefix`; returns the names of the materials."""
    for item, mesh in room:
        if UV_LAYER not in mesh.uv_layers:
            raise FiptError(
                "export-uv",
                f"A modifier of '{item.name}' removes the UV map '{UV_LAYER}', and with it the textures.",
                "Disable the modifier in renders.",
            )
    names = {
        material: artists_name(material, copies.name(material))
        for _, mesh in room
        for material in mesh.materials
        if material is not None and has_maps(material)
    }
    meshes = [mesh for _, mesh in room]
    with_maps = {each: name for each, name in names.items() if not is_uniform(each)}
    textures = make_part_textures(meshes, with_maps, folder, texture_size, prefix)
    for image in (image for each in set(textures.values()) for image in (each.base_color, each.orm)):
        copies.keep(image, Path(image.filepath_raw).stem)
    made: dict[tuple[str, str], bpy.types.Material] = {}
    for item, mesh in room:
        for name in [layer.name for layer in mesh.uv_layers if layer.name != UV_LAYER]:
            mesh.uv_layers.remove(mesh.uv_layers[name])  # of several, USD's and other readers take the first
        for index, material in enumerate(mesh.materials):
            if material not in names or (material in with_maps and material not in textures):
                continue
            key = (material[PART], names[material])
            if key not in made:
                made[key] = copies.keep(plain_material(material, textures.get(material)), key[1])
            mesh.materials[index] = made[key]
        copies.add(item, mesh, item.matrix_world)
    return set(names.values())


def _add_lamps(
    copies: Copies,
    scene: bpy.types.Scene,
    shown: list[bpy.types.Object],
    lamps: _Copied,
    taken: set[str],
    unit: float,
    with_lights: bool,
    warnings: list[Message],
) -> None:
    """The lamps as surfaces, and a light for each where these are wanted.

    Args:
        taken: names of the room's materials.
        unit: by which radiance is multiplied.
    """
    dark = []
    for item, mesh in lamps:
        lit = item.visible_diffuse or _stands_for(scene, item, shown)
        if not lit:
            dark.append(copies.name(item))
        copy = copies.add(item, mesh, item.matrix_world)
        light = lamp_light(copy) if lit and with_lights else None
        for material, source, suffix in plain_lamp(copy, lit, unit):
            name = copies.name(source)
            copies.keep(material, f"{name} Light{suffix}" if name in taken else name + suffix)
        if light is not None:
            copies.add_light(f"{copies.name(item)} Light", *light)
    if dark:
        text = f"{', '.join(dark)}: other lights light the room in place of these lamps, which are black."
        warnings.append(warning("export-lamps-dark", text, "Use Convert Back to export their own light."))


def _stands_for(scene: bpy.types.Scene, item: bpy.types.Object, shown: list[bpy.types.Object]) -> bool:
    """Whether a converted fixture's surface can be exported in place of its Blender lights."""
    return (
        VISIBILITY in item
        and item in shown
        and lights_as_converted(scene, item)
        and set(fixture_lights(item)) <= set(shown)
    )


def _add_lights(
    copies: Copies,
    scene: bpy.types.Scene,
    shown: list[bpy.types.Object],
    gltf: bool,
    with_lights: bool,
    warnings: list[Message],
) -> None:
    """The Blender lights; those for which a fixture's surface is exported are left out."""
    lost = Lost()
    for item in (each for each in shown if each.type == "LIGHT" and emits(each)):
        if FIXTURE_LIGHT in item and item.parent is not None and _stands_for(scene, item.parent, shown):
            continue
        note_losses(copies.name(item), item, gltf, lost)
        if item.data.type == "AREA" and (gltf or not is_plain_area(item)):
            mesh, radiance = area_surface(item)
            copies.keep(mesh, copies.name(item))
            front = copies.name(item)
            glow = tuple(value * (LUMENS_PER_WATT if gltf else 1.0) for value in radiance)
            for name, emitted in ((front, glow), (f"{front} Back", (0.0, 0.0, 0.0))):
                mesh.materials.append(copies.keep(glowing_material(name, emitted, True), name))
            add_backs(mesh, {0: 1}, GAP)
            copies.add(item, mesh, turned(item.matrix_world))
            if with_lights:
                spot = wide_spot(np.maximum(emitted_power(item), 0.0))
                copies.add_light(f"{front} Light", spot, turned(item.matrix_world))
        else:
            light = copies.keep(plain_light(item, gltf), copies.name(item))
            copies.add(item, light, turned(item.matrix_world))
    warnings += lost.warnings()


def _add_world(
    copies: Copies, scene: bpy.types.Scene, path: Path, gltf: bool, warnings: list[Message]
) -> None:
    """The environment that lights renders; `path` is that of its picture."""
    environment = read_environment(scene.world)
    if environment is None:
        return
    if gltf:
        text = "glTF has no environment: the light from outside the room is not in the file."
        warnings.append(warning("export-environment", text, "Export USD to keep it."))
    elif not environment.whole:
        text = "The world's nodes do more than show and turn a picture: it is not in the file."
        warnings.append(warning("export-world", text, "Use one environment picture and one Mapping node."))
    else:
        world, image = plain_world(environment, path)
        copies.scene.world = copies.keep(world, copies.name(scene.world))
        copies.keep(image, path.stem)


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
        reason = str(error).strip().splitlines()[-1]  # of a traceback, the error
        text = f"Blender's exporter has failed ({reason})."
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
    "export_custom_properties": True,  # the artist's names; copies have no others
    "convert_world_material": True,
    "export_hair": False,
    "allow_unicode": True,
}


def _gltf_options(path: Path) -> dict[str, object]:
    return {
        "export_format": "GLB" if path.suffix.lower() == ".glb" else "GLTF_SEPARATE",
        "use_active_scene": True,
        "export_lights": True,
        "export_import_convert_lighting_mode": "SPEC",  # candelas and lux
        "export_cameras": False,
        "export_animations": False,
        "export_extras": False,
        "export_attributes": False,
        "export_vertex_color": "NONE",
        "export_image_format": "AUTO",
        "export_yup": True,
    }
