# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""State of the section Photographs: the folder, the groups of bracketed exposures, and the settings."""

from __future__ import annotations

from pathlib import Path

import bpy

GROUPINGS = (
    ("auto", "Automatic", "Find brackets by exposure, time and camera, as written in the files"),
    ("folders", "Folders", "Each folder with photographs is one bracket"),
    ("single", "Single", "Each photograph is a view of its own"),
)
RESPONSES = (
    ("auto", "Recover", "Recover the response of JPEG, PNG and TIFF from the brackets"),
    ("srgb", "sRGB", "The pixel values follow the sRGB curve"),
    ("linear", "Linear", "The pixel values are proportional to light"),
)
WHITE_BALANCES = (
    ("camera", "Camera", "The white balance that the camera has chosen for the first photograph, for all"),
    ("daylight", "Daylight", "The white balance of daylight"),
)
VIGNETTINGS = (
    ("auto", "Automatic", "From the lens database, otherwise from what overlapping views have in common"),
    ("none", "None", "Vignetting is not corrected"),
)
SCALES = (
    ("none", "Unknown", "The capture is scaled later, under Alignment in the section Capture"),
    ("points", "Two Points", "Two points that are marked in photographs, and their distance"),
    ("marker", "Printed Marker", "A printed ArUco marker that is seen in photographs"),
)
ENGINE_SETTINGS = (
    *("grouping", "working_width", "response", "layer", "white_balance", "align", "vignetting"),
    *("cameras", "scale", "scale_length", "scale_picks"),
)
STATES = (
    ("NONE", "", "", "NONE", 0),
    ("REGISTERED", "Registered", "Its camera has been found", "CHECKMARK", 1),
    ("LEFT_OUT", "Left Out", "Its camera has not been found", "ERROR", 2),
)


class FIPT_Photograph(bpy.types.PropertyGroup):
    """One file of a group. `name` is its path in prepare.json."""

    exposure: bpy.props.StringProperty(description="Shutter, aperture and ISO as the file states them")


class FIPT_PhotographGroup(bpy.types.PropertyGroup):
    """Exposures of one view. `name` is the name of the merged image."""

    used: bpy.props.BoolProperty(name="Use", description="Make a view from these photographs", default=True)
    photographs: bpy.props.CollectionProperty(type=FIPT_Photograph)
    clipped_share: bpy.props.FloatProperty(description="Share of pixels clipped in every photograph")
    state: bpy.props.EnumProperty(name="State", description="Whether its camera has been found", items=STATES)
    problem: bpy.props.StringProperty(description="Why its camera has not been found")


class FIPT_PhotographsSettings(bpy.types.PropertyGroup):
    """The section Photographs."""

    path: bpy.props.StringProperty(
        name="Folder",
        description="Folder of the photographs as the camera has written them: RAW, JPEG, TIFF, PNG, EXR",
        subtype="DIR_PATH",
    )
    output: bpy.props.StringProperty(
        name="Output",
        description="Folder for the capture. If empty, a folder beside the photographs is used",
        subtype="DIR_PATH",
    )
    chosen: bpy.props.StringProperty(
        description="Names of the files that were chosen, one per line; empty for all in the folder"
    )
    grouping: bpy.props.EnumProperty(
        name="Brackets", description="How photographs of one view are recognized", items=GROUPINGS
    )
    working_width: bpy.props.IntProperty(
        name="Size",
        description="Longer side of the merged images in pixels. 0 keeps the size of the photographs",
        default=2048,
        min=0,
        soft_max=8192,
    )
    response: bpy.props.EnumProperty(
        name="Response",
        description="Relation between light and the pixel values of JPEG, PNG and TIFF",
        items=RESPONSES,
    )
    layer: bpy.props.StringProperty(
        name="Layer",
        description="Layer or part of OpenEXR photographs that have several. If empty, the one without a"
        " name or with one like Combined, beauty, rgba, C or image is used",
    )
    white_balance: bpy.props.EnumProperty(
        name="White Balance", description="White balance of RAW photographs", items=WHITE_BALANCES
    )
    vignetting: bpy.props.EnumProperty(
        name="Vignetting", description="Correction of the lens's darker corners", items=VIGNETTINGS
    )
    align: bpy.props.BoolProperty(
        name="Align",
        description="Align photographs taken by hand, and take what moved from one of them",
        default=True,
    )
    cameras: bpy.props.StringProperty(
        name="Existing Solve",
        description="Folder of cameras that were solved elsewhere (COLMAP, transforms.json) for images of the"
        " same names. If empty, the cameras are solved here",
        subtype="DIR_PATH",
    )
    scale: bpy.props.EnumProperty(
        name="Scale", description="What the real size of the room is known from", items=SCALES
    )
    scale_length: bpy.props.FloatProperty(
        name="Length",
        description="Distance of the two points, or the length of the marker's edge, in meters",
        min=0.0,
        soft_max=10.0,
        precision=4,
    )
    scale_picks: bpy.props.StringProperty(
        name="Points",
        description="Two points, each with a view and its pixel, or several with commas, e.g."
        " IMG_4209 812 440, IMG_4214 790 431; IMG_4209 102 455",
    )
    groups: bpy.props.CollectionProperty(type=FIPT_PhotographGroup)
    active_group: bpy.props.IntProperty(name="Group", options=set())
    active_photograph: bpy.props.IntProperty(name="Photograph", options=set())
    listed: bpy.props.StringProperty(description="Digest of the groups in prepare.json when they were listed")
    registered_count: bpy.props.IntProperty(
        description="Number of views with a camera; negative before the cameras are solved", default=-1
    )

    def capture_folder(self) -> Path | None:
        """The folder of the capture: the chosen one, or one beside the photographs; None without either."""
        if self.output:
            return Path(bpy.path.abspath(self.output)).absolute()
        if not self.path:
            return None
        photographs = Path(bpy.path.abspath(self.path)).absolute()
        return photographs.parent / f"{photographs.name or 'photographs'}-capture"

    def engine_settings(self) -> dict[str, object]:
        """The settings of `prepare` by their names."""
        settings = {name: getattr(self, name) for name in ENGINE_SETTINGS}
        if self.cameras:
            settings["cameras"] = str(Path(bpy.path.abspath(self.cameras)).absolute())
        return settings

    @property
    def used_count(self) -> int:
        """Number of ticked groups."""
        return sum(group.used for group in self.groups)
