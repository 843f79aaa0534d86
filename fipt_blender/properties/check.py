# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""State of the section Render: size of pictures, which views are compared, how well they match."""

from __future__ import annotations

import bpy

from ..blend.marks import RESOLUTION

# A copy of `core.report.comparison.ERROR_STOPS`, since that module imports numpy.
ERROR_SCALE = tuple(
    tuple(value / 255.0 for value in stop)
    for stop in ((0, 0, 4), (66, 10, 104), (147, 38, 103), (221, 81, 58), (252, 165, 10), (252, 255, 164))
)
VIEWS = (
    (
        "HELD_BACK",
        "Held Back",
        "Views that the estimation has not used, for a fair comparison",
        "HIDE_OFF",
        0,
    ),
    ("TICKED", "Ticked", "Views that are ticked in the section Capture", "CHECKBOX_HLT", 1),
    ("CURRENT", "Current", "View whose camera is the scene's active camera", "CAMERA_DATA", 2),
)
PICTURES = (
    ("PHOTOGRAPH", "Photo", "The photograph", "IMAGE_DATA", 0),
    ("RENDER", "Render", "The same view of the estimated room, rendered in Cycles", "RENDER_STILL", 1),
    (
        "ERROR",
        "Error",
        "The difference: black is none, pale yellow is a quarter of white or more",
        "SHADING_SOLID",
        2,
    ),
)
SIZES = (
    ("PHOTOGRAPH", "Photograph", "The size of the photograph of the scene's camera", "IMAGE_DATA", 0),
    ("HD", "1080p", "1920 pixels on the longer side: 1920 x 1080 in the usual proportions", "NONE", 1),
    ("UHD", "4K", "3840 pixels on the longer side: 3840 x 2160 in the usual proportions", "NONE", 2),
    ("OUTPUT", "As in Output", "The size in the Output properties, as you have set it", "OUTPUT", 3),
)
_LONGER_SIDES = {1: 1920, 2: 3840}  # pixels
COMPARISONS = (
    ("OFF", "Off", "Show no comparison", "X", 0),
    ("VIEWPORT", "Viewport", "Wipe the photograph over the viewport", "VIEW3D", 1),
    ("RENDER", "Render", "Wipe the photograph over the view's render", "RENDER_STILL", 2),
)


def _move_divider(self: FIPT_CheckSettings, context: bpy.types.Context) -> None:
    from ..blend.capture import compare

    compare.move(self.id_data)


def _show(self: FIPT_CheckSettings, context: bpy.types.Context) -> None:
    if 0 <= self.active < len(self.views):
        from ..blend.pictures.check_pictures import show_active

        show_active(self.id_data, context)


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


class FIPT_CheckedView(bpy.types.PropertyGroup):
    """One rendered view. `name` is the view's name in capture.json."""

    held_back: bpy.props.BoolProperty(description="Whether the estimation has not used its photograph")
    psnr: bpy.props.FloatProperty(description="PSNR in dB of tone-mapped values: clipped, γ = 1/2.2")
    psnr_linear: bpy.props.FloatProperty(description="PSNR in dB of linear values, clipped")
    render: bpy.props.StringProperty(description="Image file of the render")
    error: bpy.props.StringProperty(description="Image file of the error in false colors")


def _error_color(index: int) -> object:
    """A property that shows one colour of the scale, in display values (not colour managed)."""

    def get(self: FIPT_CheckSettings) -> tuple[float, ...]:
        return ERROR_SCALE[index]

    return bpy.props.FloatVectorProperty(
        name="Error",
        description="Color of this error, as a share of display white",
        subtype="COLOR_GAMMA",
        size=3,
        get=get,
    )


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
    which: bpy.props.EnumProperty(
        name="Views", description="Views to render", items=VIEWS, default="HELD_BACK"
    )
    samples: bpy.props.IntProperty(
        name="Samples",
        description="Cycles samples per pixel of views that are compared: more reduce noise and take longer",
        default=64,
        min=1,
        soft_max=4096,
    )
    views: bpy.props.CollectionProperty(type=FIPT_CheckedView)
    active: bpy.props.IntProperty(
        name="View",
        description="Click to look through the camera of a view at the selected picture",
        options=set(),
        update=_show,
    )
    picture: bpy.props.EnumProperty(
        name="Picture",
        description="Image shown over the view, and in an Image Editor if one is open",
        items=PICTURES,
        default="RENDER",
        options=set(),
        update=_show,
    )
    mean_psnr: bpy.props.FloatProperty(description="Mean PSNR of the views in dB, display values")
    mean_psnr_linear: bpy.props.FloatProperty(description="Mean PSNR of the views in dB, linear values")
    # The legend of the error image, drawn as a row of colours.
    color_0: _error_color(0)
    color_1: _error_color(1)
    color_2: _error_color(2)
    color_3: _error_color(3)
    color_4: _error_color(4)
    color_5: _error_color(5)
    compare: bpy.props.EnumProperty(
        name="Compare",
        description="What is compared; set by Compare with Photograph and by Compare Versions",
        items=(*COMPARISONS, ("VERSIONS", "Versions", "Wipe one version over another", "RENDERLAYERS", 3)),
        options=set(),
    )
    divider: bpy.props.FloatProperty(
        name="Divider",
        description="Where the photograph ends and the render begins; drag it in the picture",
        subtype="FACTOR",
        min=0.0,
        max=1.0,
        default=0.5,
        options=set(),
        update=_move_divider,
    )
    report: bpy.props.StringProperty(description="HTML page of the last report")
