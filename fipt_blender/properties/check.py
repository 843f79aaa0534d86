"""State of the section Render: size and backdrop of pictures, the last one, the report."""

from __future__ import annotations

import bpy

from ..blend.marks import RESOLUTION

SIZES = (
    ("PHOTOGRAPH", "Photograph", "The size of the photograph of the scene's camera", "IMAGE_DATA", 0),
    ("HD", "1080p", "1920 pixels on the longer side: 1920 x 1080 in the usual proportions", "NONE", 1),
    ("UHD", "4K", "3840 pixels on the longer side: 3840 x 2160 in the usual proportions", "NONE", 2),
    ("OUTPUT", "As in Output", "The size in the Output properties, as you have set it", "OUTPUT", 3),
)
_LONGER_SIDES = {1: 1920, 2: 3840}  # pixels


def _photograph_size(scene: bpy.types.Scene) -> tuple[int, int] | None:
    """Columns and rows of the photograph of the scene's camera; None without one."""
    size = scene.camera.get(RESOLUTION) if scene.camera is not None else None
    return None if size is None else (int(size[0]), int(size[1]))


def _size(self: FIPT_CheckSettings) -> int:
    """Which of `SIZES` the scene's resolution is."""
    scene = self.id_data
    size = (scene.render.resolution_x, scene.render.resolution_y)
    if size == _photograph_size(scene):
        return 0
    return next((number for number, side in _LONGER_SIDES.items() if max(size) == side), 3)


def _set_size(self: FIPT_CheckSettings, number: int) -> None:
    """Set the scene's resolution, in the proportions of the photograph, else of the present frame."""
    from ..blend.render_settings import fitted

    scene, render = self.id_data, self.id_data.render
    size = _photograph_size(scene) or (render.resolution_x, render.resolution_y)
    if number in _LONGER_SIDES:
        size = fitted(size, _LONGER_SIDES[number])
    if number < len(SIZES) - 1:
        render.resolution_x, render.resolution_y = size


class FIPT_CheckSettings(bpy.types.PropertyGroup):
    """The section Render. How pictures are rendered is in Blender's own render settings."""

    size: bpy.props.EnumProperty(
        name="Size",
        description="Size of pictures, also of those that F12 renders",
        items=SIZES,
        get=_size,
        set=_set_size,
        options=set(),
    )
    report: bpy.props.StringProperty(description="HTML page of the last report")


BACKDROPS = (
    ("ROOM", "Rendered Room", "Render the whole picture, with changed lights and materials", "HOME", 0),
    (
        "PHOTOGRAPH",
        "Photograph",
        "Render the inserted objects with their shadows and reflections over the original photograph",
        "IMAGE_DATA",
        1,
    ),
)


class FIPT_InsertSettings(bpy.types.PropertyGroup):
    """Pictures of the section Render."""

    # Set only by the operator Set Backdrop, which also changes the scene.
    backdrop: bpy.props.EnumProperty(
        name="Backdrop", description="What is behind the inserted objects", items=BACKDROPS, default="ROOM"
    )
    picture: bpy.props.StringProperty(description="Image file of the last rendered picture")
