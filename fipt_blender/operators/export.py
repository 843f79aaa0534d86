"""Export of the estimated room as glTF or USD."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..core.run.declared import Option
from ..core.run.errors import FiptError
from .action import REGISTER, Glob, Messages, action, file_dialog, note
from .polls import has_results, in_object_mode, needs

KEPT: dict[str, Any] = {"options": set()}  # what was chosen last is offered again

SIZES = tuple(
    (str(size), f"{size}", f"Textures have {size} x {size} texels at most")
    for size in (512, 1024, 2048, 4096, 8192)
)
FORMATS = (
    (".glb", "glTF Binary", "One file with textures"),
    (".gltf", "glTF", "A .gltf file with its textures beside it"),
    (".usdc", "USD", "A .usdc file with its textures beside it"),
    (".usdz", "USDZ", "One file with textures"),
)


def _ask(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
    if not self.filepath:
        blend = bpy.data.filepath
        self.filepath = str(Path(blend).with_suffix("")) if blend else iface_("room")
    return file_dialog(self, context, event)


@action(
    "Export Room",
    needs=(
        has_results,
        in_object_mode,
        needs(
            lambda context: context.scene.fipt.materials.shown == "ESTIMATED",
            "Choose Estimated as Show first",
        ),
    ),
    options=REGISTER,
    invoke=_ask,
)
def export_room(
    scene: bpy.types.Scene,
    filepath: Annotated[str, Option("The file to write", "File", shown=KEPT | {"subtype": "FILE_PATH"})] = "",
    filter_glob: Glob = "*.glb;*.gltf;*.usd;*.usda;*.usdc;*.usdz",
    file_format: Annotated[
        str, Option("Format of a file whose name has none", "Format", choices=FORMATS, shown=KEPT)
    ] = ".glb",
    texture_size: Annotated[
        str,
        Option("The most texels of a texture's side; larger ones are scaled down", choices=SIZES, shown=KEPT),
    ] = "4096",
    lamp_lights: Annotated[
        bool,
        Option(
            "In glTF, give each lamp a light besides its glowing surface: game engines and browsers light by"
            " lights alone. Switch it off for path tracers, where both would light the room",
            "Lights of Lamps",
            shown=KEPT,
        ),
    ] = True,
) -> Messages:
    """Export the estimated room and its lights as glTF or USD, in a form that other programs understand:
    plain materials with your adjustments in their textures, and surfaces that emit light.
    """
    from ..blend.export import exporting

    if not filepath:
        raise FiptError("export-file.export-room")
    path = Path(bpy.path.abspath(filepath))
    if path.suffix.lower() not in exporting.SUFFIXES:
        path = path.with_name(path.name + file_format)
    exported = exporting.export_room(scene, path, int(texture_size), lamp_lights)
    text = iface_("{} objects written to {}").format(exported.objects, path.name)
    return [*exported.warnings, note(text)]
