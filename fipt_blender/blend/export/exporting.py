"""Export of the estimated room as glTF or USD: plain materials and lights stand in while Blender writes it.

The file is left as it was. What the formats can't hold is said in warnings.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import bpy

from ...bridge.process import Message
from ...core.run.errors import FiptError, warning
from ...core.run.runfolder import explained_write_errors
from ..collecting import check_pictures
from ..lights.color import LUMENS_PER_WATT
from ..lights.convert import lights_as_converted
from ..lights.fixture_nodes import is_emission_material
from ..marks import (
    FIXTURE_LIGHT,
    MATERIAL,
    VISIBILITY,
    WORLD,
    fixture_lights,
    has_estimates,
    has_results,
    is_our_light,
    room_with_results,
)
from ..results.adjust import NO_ADJUSTMENT, Adjustment
from ..results.materials import is_uniform
from ..room.atlas import file_names
from ..room.originals import shows_original
from ..room.uv_layer import UV_LAYER
from ..save import check_space, write_error
from .color import colors_in_rec709
from .environment import is_dark, plain_world
from .lights import area_spot, has_default_nodes, lamp_light, turned, without_nodes
from .materials import (
    TEXTURE_SIZE,
    PlainTextures,
    artists_name,
    has_maps,
    plain_lamp,
    plain_material,
    plain_textures,
    texture_key,
)
from .stage import Stage, rendered_objects

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


def export_room(
    scene: bpy.types.Scene, path: Path, texture_size: int = TEXTURE_SIZE, lamp_lights: bool = True
) -> Exported:
    """Write the estimated room with its lights to a file.

    Args:
        scene: with applied results, which are shown; in Object Mode.
        path: the suffix chooses the format, one of SUFFIXES.
        texture_size: the most texels of a texture's side.
        lamp_lights: in glTF, give lamps a light besides the surface that glows. Game engines
            and browsers light by lights alone; path tracers would light the room twice.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise FiptError("export-format", suffix=path.suffix, suffixes=", ".join(SUFFIXES))
    room = room_with_results(scene)
    if not room or any(map(shows_original, room)):
        raise FiptError("export-nothing.export-room")
    ours = [slot.material for item in room for slot in item.material_slots if slot.material is not None]
    if not all(has_maps(material) for material in ours if MATERIAL in material):
        raise FiptError("export-attributes")
    check_pictures()
    exported = Exported(path)
    suffix, shown = path.suffix.lower(), rendered_objects(scene)
    if not set(room) & set(shown):
        raise FiptError("export-nothing.export-room-2")
    with (
        _written_whole(path) as written,
        tempfile.TemporaryDirectory(prefix="fipt_export_") as folder,
        Stage() as stage,
    ):
        pictures = f"{folder}/" + ("" if suffix in _ONE_FILE else f"{path.name.replace('.', '_')}_")
        _show_surfaces(stage, shown, exported.warnings)
        with_lights = suffix in GLTF and lamp_lights
        unit = LUMENS_PER_WATT if suffix in GLTF else 1.0  # glTF has nits and candelas
        parts = _plain_room(stage, pictures, texture_size)
        _plain_lamps(stage, scene, shown, parts, unit, with_lights, exported.warnings)
        _plain_lights(stage, scene, shown, suffix in GLTF, exported.warnings)
        _plain_world(stage, scene, pictures, suffix in GLTF, exported.warnings)
        stage.hide_others()
        exported.objects = len(stage.scene.objects)
        colors_in_rec709(stage, suffix in USD)
        _write(written, path)
    return exported


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """A folder is made for what is written in the block; a new one goes if that fails."""
    is_new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BaseException:
        if is_new:
            shutil.rmtree(folder, ignore_errors=True)
        raise


@contextmanager
def _written_whole(path: Path) -> Iterator[Path]:
    """Where a file and those that it refers to are written; they get to their places together at the end."""
    with explained_write_errors(path), _made(path.parent):
        with tempfile.TemporaryDirectory(prefix=".fipt_export_", dir=path.parent) as folder:
            yield Path(folder, path.name)
            check_space(path)  # on a full disk Blender writes a part and reports nothing
            for file in [each for each in Path(folder).rglob("*") if each.is_file()]:
                target = path.parent / file.relative_to(folder)
                target.parent.mkdir(parents=True, exist_ok=True)
                file.replace(target)


def _show_surfaces(stage: Stage, shown: list[bpy.types.Object], warnings: list[Message]) -> None:
    """Put all that has a surface on the stage; the room's meshes with the UVs of its textures alone."""
    others: list[str] = []
    meshes: dict[bpy.types.Mesh, bpy.types.Mesh] = {}
    for item in shown:
        if has_results(item) and not len(item.data.polygons):  # all of it is a lamp
            continue
        if item.type in _SURFACES or (item.type == "EMPTY" and item.instance_collection is not None):
            stage.show(item)
        elif item.type in ("CURVES", "POINTCLOUD", "VOLUME", "GREASEPENCIL") or item.is_instancer:
            others.append(item.name)
        if has_estimates(item) and UV_LAYER in item.data.uv_layers:
            if item.data not in meshes:
                meshes[item.data] = stage.add(item.data.copy(), stage.name(item))
            stage.set(item, "data", meshes[item.data])
            for name in [layer.name for layer in item.data.uv_layers if layer.name != UV_LAYER]:
                item.data.uv_layers.remove(item.data.uv_layers[name])  # readers take the first of several
    stage.keep_names(
        *(each for each in _materials(stage) if not has_maps(each) and not is_emission_material(each))
    )
    if others:
        warnings.append(warning("export-others", others=", ".join(others)))


def _materials(stage: Stage) -> list[bpy.types.Material]:
    """The materials on the stage, each once."""
    slots = (slot for item in stage.scene.objects for slot in item.material_slots)
    return list(dict.fromkeys(slot.material for slot in slots if slot.material is not None))


def _plain_room(stage: Stage, pictures: str, texture_size: int) -> set[str]:
    """Let plain materials stand for the estimated ones on the stage; returns their names.

    Args:
        pictures: path that the files of textures begin with.
        texture_size: the most texels of their sides.
    """
    names: set[str] = set()
    files: list[str] = []
    made: dict[tuple[bpy.types.Image, Adjustment], PlainTextures] = {}
    for material in filter(has_maps, _materials(stage)):
        name = artists_name(material, stage.name(material))
        names.add(name)
        key = None if is_uniform(material) else texture_key(material)
        if key is not None and key not in made:
            files.append(name if key[1] != NO_ADJUSTMENT else material[MATERIAL])
            made[key] = plain_textures(material, pictures + file_names(files)[-1], texture_size)
            for image in (made[key].base_color, made[key].orm):
                stage.add(image, Path(image.filepath).stem)
        stage.replace(material, plain_material(material, None if key is None else made[key]), name)
    return names


def _plain_lamps(
    stage: Stage,
    scene: bpy.types.Scene,
    shown: list[bpy.types.Object],
    parts: set[str],
    unit: float,
    with_lights: bool,
    warnings: list[Message],
) -> None:
    """Give lamps plain materials, and a light each where these are wanted.

    Args:
        parts: names of the room's materials.
        unit: by which radiance is multiplied.
    """
    dark = []
    for item in (each for each in shown if each.type == "MESH" and is_our_light(each)):
        lit = item.visible_diffuse or _stands_for(scene, item, shown)
        light = lamp_light(item) if lit and with_lights else None
        if not lit:
            dark.append(item.name)
        for slot in item.material_slots:
            if slot.material is not None and is_emission_material(slot.material):
                material, name = slot.material, stage.name(slot.material)
                name = f"{name} Light" if name in parts else name
                stage.replace(material, plain_lamp(material, unit if lit else 0.0), name)
        if light is not None:
            stage.add_light(f"{item.name} Light", *light)
    if dark:
        warnings.append(warning("export-lamps-dark", dark=", ".join(dark)))


def _stands_for(scene: bpy.types.Scene, item: bpy.types.Object, shown: list[bpy.types.Object]) -> bool:
    """Whether a converted fixture's surface can be exported in place of its Blender lights."""
    return (
        VISIBILITY in item
        and item in shown
        and lights_as_converted(scene, item)
        and set(fixture_lights(item)) <= set(shown)
    )


def _plain_lights(
    stage: Stage, scene: bpy.types.Scene, shown: list[bpy.types.Object], gltf: bool, warnings: list[Message]
) -> None:
    """The Blender lights; those for which a fixture's surface is exported are left out."""
    spots = []
    for item in (each for each in shown if each.type == "LIGHT"):
        if FIXTURE_LIGHT in item and item.parent is not None and _stands_for(scene, item.parent, shown):
            continue
        if gltf and item.data.type == "AREA":
            spots.append(stage.name(item))
            stage.add_light(spots[-1], area_spot(item), turned(item.matrix_world))
        else:
            stage.show(item)
            if has_default_nodes(item.data):
                light = stage.add(item.data.copy(), stage.name(item.data))
                stage.set(item, "data", without_nodes(light))
    if spots:
        warnings.append(warning("export-light-size", spots=", ".join(spots)))


def _plain_world(
    stage: Stage, scene: bpy.types.Scene, pictures: str, gltf: bool, warnings: list[Message]
) -> None:
    """The environment that lights renders; `pictures` is the path that its picture's begins with."""
    if is_dark(scene.world):
        return
    if gltf:
        warnings.append(warning("export-environment"))
        return
    if WORLD not in scene.world:
        stage.scene.world = scene.world
        return
    path = Path(f"{pictures}environment.exr")
    if plain := plain_world(scene.world, path):
        stage.scene.world = stage.add(plain[0], stage.name(scene.world))
        stage.add(plain[1], path.stem)


def _write(path: Path, target: Path) -> None:
    """Call Blender's exporter on the window's scene; `target` is where the file gets to."""
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
        raise FiptError.of("export-failed", text, remedy) from None
    options = _gltf_options(path) if is_gltf else _USD_OPTIONS
    arguments = {name: value for name, value in options.items() if name in known}
    try:
        operator(filepath=str(path), **arguments)
    except RuntimeError as error:
        lines = [line for line in str(error).strip().splitlines() if not line.startswith("Location:")]
        reason = RuntimeError(lines[-1] if lines else "")  # of a traceback, the error
        raise write_error(target, reason, "export-failed") from None
    if not path.is_file():
        raise FiptError("export-failed", path=path)


_USD_OPTIONS = {
    "export_animation": False,
    "export_materials": True,
    "generate_preview_surface": True,
    "export_textures_mode": "NEW",
    "overwrite_textures": True,
    "relative_paths": True,
    "export_custom_properties": False,  # they name files of this machine
    "merge_parent_xform": True,  # readers take the name of the data for the object's otherwise
    "export_cameras": False,
    "evaluation_mode": "RENDER",
    "convert_world_material": True,
    "export_hair": False,
    "allow_unicode": True,
}


def _gltf_options(path: Path) -> dict[str, object]:
    return {
        "export_format": "GLB" if path.suffix.lower() == ".glb" else "GLTF_SEPARATE",
        "use_active_scene": True,
        "use_renderable": True,
        "export_lights": True,
        "export_import_convert_lighting_mode": "SPEC",  # candelas and lux
        "export_apply": True,
        "export_cameras": False,
        "export_animations": False,
        "export_extras": False,
        "export_attributes": False,
        "export_vertex_color": "NONE",
        "export_image_format": "AUTO",
        "export_yup": True,
    }
