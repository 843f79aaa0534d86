# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""State of the section Check: which views are rendered again, and how well they agree with photographs."""

from __future__ import annotations

from typing import Any

import bpy

# As `core.report.comparison.ERROR_STOPS`, which needs numpy.
ERROR_SCALE = tuple(
    tuple(value / 255.0 for value in stop)
    for stop in ((0, 0, 4), (66, 10, 104), (147, 38, 103), (221, 81, 58), (252, 165, 10), (252, 255, 164))
)
VIEWS = (
    (
        "HELD_BACK",
        "Held Back",
        "The views that the estimate has not seen: the honest judgement",
        "HIDE_OFF",
        0,
    ),
    ("TICKED", "Ticked", "The views that are ticked in the section Capture", "CHECKBOX_HLT", 1),
    ("CURRENT", "Current", "The view through whose camera the scene looks", "CAMERA_DATA", 2),
)
PICTURES = (
    ("PHOTOGRAPH", "Photo", "What the camera saw", "IMAGE_DATA", 0),
    ("RENDER", "Render", "The same view of the estimated room, from Cycles", "RENDER_STILL", 1),
    (
        "ERROR",
        "Error",
        "Where they differ: black for nothing, pale yellow for a quarter of white",
        "SHADING_SOLID",
        2,
    ),
)


def _show(self: FIPT_CheckSettings, context: bpy.types.Context) -> None:
    if 0 <= self.active < len(self.views):
        from ..blend.check_pictures import show_active

        show_active(self.id_data, context)


class FIPT_CheckedView(bpy.types.PropertyGroup):
    """One view that was rendered again. `name` is the view's name in capture.json."""

    held_back: bpy.props.BoolProperty(description="Whether the estimate has not seen its photograph")
    psnr: bpy.props.FloatProperty(description="PSNR in dB of tone-mapped values: clipped, γ = 1/2.2")
    psnr_linear: bpy.props.FloatProperty(description="PSNR in dB of linear values, clipped")
    render: bpy.props.StringProperty(description="File of the render")
    error: bpy.props.StringProperty(description="File of the false-colour picture")


def _error_color(index: int) -> Any:
    """A property that shows one colour of the scale; display values, so no colour management."""

    def get(self: FIPT_CheckSettings) -> tuple[float, ...]:
        return ERROR_SCALE[index]

    return bpy.props.FloatVectorProperty(
        name="Error",
        description="Colour of this error, as a share of white on the display",
        subtype="COLOR_GAMMA",
        size=3,
        get=get,
    )


class FIPT_CheckSettings(bpy.types.PropertyGroup):
    """The section Check."""

    which: bpy.props.EnumProperty(
        name="Views", description="Which views to render again", items=VIEWS, default="HELD_BACK"
    )
    samples: bpy.props.IntProperty(
        name="Samples",
        description="Cycles' samples a pixel: more take longer and leave less noise",
        default=64,
        min=1,
        soft_max=4096,
    )
    views: bpy.props.CollectionProperty(type=FIPT_CheckedView)
    active: bpy.props.IntProperty(
        name="View",
        description="Click to look through the view's camera at the chosen picture",
        options=set(),
        update=_show,
    )
    picture: bpy.props.EnumProperty(
        name="Picture",
        description="What lies over the view, and is shown in an Image Editor if one is open",
        items=PICTURES,
        default="RENDER",
        options=set(),
        update=_show,
    )
    mean_psnr: bpy.props.FloatProperty(description="Mean over the views, in dB")
    mean_psnr_linear: bpy.props.FloatProperty(description="Mean over the views, in dB")
    # The scale of the error's colours; a row of them is drawn.
    color_0: _error_color(0)
    color_1: _error_color(1)
    color_2: _error_color(2)
    color_3: _error_color(3)
    color_4: _error_color(4)
    color_5: _error_color(5)
    report: bpy.props.StringProperty(description="The report's page that was written last")


CLASSES = (FIPT_CheckedView, FIPT_CheckSettings)
