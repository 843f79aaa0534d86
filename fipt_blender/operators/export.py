# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Export of the estimated room as glTF or USD."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..core.run.errors import FiptError
from .polls import all_of, has_results, in_object_mode, needs
from .reporting import report_messages, reports_errors

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


class FIPT_OT_export_room(bpy.types.Operator):
    bl_idname = "fipt.export_room"
    bl_label = "Export Room"
    bl_description = (
        "Export the estimated room and its lights as glTF or USD, in a form that other programs understand:"
        " plain materials with your adjustments in their textures, and surfaces that emit light"
    )
    bl_options = {"REGISTER"}

    filepath: bpy.props.StringProperty(name="File", description="The file to write", subtype="FILE_PATH")
    filter_glob: bpy.props.StringProperty(
        default="*.glb;*.gltf;*.usd;*.usda;*.usdc;*.usdz", options={"HIDDEN"}
    )
    file_format: bpy.props.EnumProperty(
        name="Format", description="Format of a file whose name has none", items=FORMATS, default=".glb"
    )
    texture_size: bpy.props.EnumProperty(
        name="Texture Size",
        description="The most texels of a texture's side; larger ones are scaled down",
        items=SIZES,
        default="4096",
    )
    lamp_lights: bpy.props.BoolProperty(
        name="Lights of Lamps",
        description=(
            "In glTF, give each lamp a light besides its glowing surface: game engines and browsers light by"
            " lights alone. Switch it off for path tracers, where both would light the room"
        ),
        default=True,
    )

    poll = all_of(
        has_results,
        in_object_mode,
        needs(
            lambda context: context.scene.fipt.materials.shown == "ESTIMATED",
            "Choose Estimated as Show first",
        ),
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if not self.filepath:
            blend = bpy.data.filepath
            self.filepath = str(Path(blend).with_suffix("")) if blend else iface_("room")
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        from ..blend.export.exporting import SUFFIXES, ExportOptions, export_room

        if not self.filepath:
            raise FiptError("export-file", "No file is chosen.", "Choose the file to write.")
        path = Path(bpy.path.abspath(self.filepath))
        if path.suffix.lower() not in SUFFIXES:
            path = path.with_name(path.name + self.file_format)
        exported = export_room(context.scene, path, ExportOptions(int(self.texture_size), self.lamp_lights))
        report_messages(self, exported.warnings)
        self.report({"INFO"}, iface_("{} objects written to {}").format(exported.objects, path.name))
        return {"FINISHED"}
