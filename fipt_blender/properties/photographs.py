"""State of the section Photographs: the folder, the groups of bracketed exposures, and the settings."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..prepare.preparation import PrepareSettings
from .declared import properties_of, values_of

OPTIONS = properties_of(PrepareSettings)  # of `prepare`, as properties by their names
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
    __annotations__.update(OPTIONS)
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
        settings = values_of(self, PrepareSettings)
        if self.cameras:
            settings["cameras"] = str(Path(bpy.path.abspath(self.cameras)).absolute())
        return settings

    @property
    def used_count(self) -> int:
        """Number of ticked groups."""
        return sum(group.used for group in self.groups)
