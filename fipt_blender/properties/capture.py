"""State of the section Capture: the source of the photographs, the views, and the room's mesh."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import bpy

from ..blend.marks import FIXTURE_SOURCES, RESOLUTION, VIEW, view_cameras
from ..core.capture.options import UP, CaptureOptions
from ..core.run.shapes import UP_AXES
from .declared import enum_items, properties_of

IMPORT_OPTIONS = properties_of(CaptureOptions)  # as properties by their names

_counting = True  # False while several views change at once


def _views_changed(self: FIPT_CaptureView, context: bpy.types.Context) -> None:
    if _counting:
        self.id_data.fipt.capture.count_views()


def _path_changed(self: FIPT_CaptureSettings, context: bpy.types.Context) -> None:
    """Another capture does not have the mistake that was fixed in the last one."""
    if self.fixed and self.fixed != self.path:
        self.correct = self.fixed = ""


def _active_changed(self: FIPT_CaptureSettings, context: bpy.types.Context) -> None:
    """Look through the camera of the row that was clicked, unless a script fills the list."""
    if self.follow and 0 <= self.active_view < len(self.views):
        from ..blend.capture.look import look_through

        look_through(self.id_data, self.views[self.active_view], context)


_pictures: list[tuple[str, str, str, int, int]] = []  # Blender needs the texts as long as it shows them


def _view_pictures(
    self: FIPT_CaptureSettings, context: bpy.types.Context
) -> list[tuple[str, str, str, int, int]]:
    """The views with their photographs as thumbnails."""
    from pathlib import Path

    from ..blend.previews import view_pictures

    found = [
        (view.name, view.name.removeprefix(self.name_prefix) or view.name, "", icon, index)
        for index, view in enumerate(self.views)
        for icon in (view_pictures.add(Path(bpy.path.abspath(view.image))),)
    ]
    if found != _pictures:
        _pictures[:] = found
    return _pictures


def _get_picture(self: FIPT_CaptureSettings) -> int:
    return self.active_view


def _set_picture(self: FIPT_CaptureSettings, value: int) -> None:
    self.active_view = value  # its update function looks through the camera


def _photograph_changed(self: FIPT_CaptureSettings, context: bpy.types.Context) -> None:
    from ..blend.capture.look import refresh_photograph

    refresh_photograph(self.id_data)


def _get_alignment_scale(self: FIPT_CaptureSettings) -> float:
    return float(self.alignment.scale[0]) if self.alignment is not None else 1.0


def _set_alignment_scale(self: FIPT_CaptureSettings, value: float) -> None:
    if self.alignment is not None:
        self.alignment.scale = (value,) * 3


def _get_up(self: FIPT_CaptureSettings) -> int:
    from ..blend.capture.importing import up_axis

    return UP_AXES.index(up_axis(self))


def _set_up(self: FIPT_CaptureSettings, value: int) -> None:
    from ..blend.capture.importing import turn_up

    turn_up(self, UP_AXES[value])


class FIPT_CaptureView(bpy.types.PropertyGroup):
    """One photograph with its camera. `name` is the view's name in capture.json."""

    camera: bpy.props.StringProperty(name="Camera", description="The view's camera object")
    enabled: bpy.props.BoolProperty(
        name="Use", description="Use this photograph", default=True, update=_views_changed
    )
    split: bpy.props.EnumProperty(
        name="Use For",
        description="Purpose of this photograph",
        items=[
            ("train", "Estimation", "Estimate materials and lights from this photograph", "IMAGE_DATA", 0),
            (
                "held_back",
                "Held Back",
                "Only compare renders of the result with this photograph",
                "HIDE_OFF",
                1,
            ),
        ],
        default="train",
        update=_views_changed,
    )
    image: bpy.props.StringProperty(name="Photograph", description="Image file of the photograph")
    exposure: bpy.props.FloatProperty(
        description="Exposure of the photograph after that of the median one, stops; 0 where they are HDR"
    )
    checked: bpy.props.BoolProperty(description="Whether the view has been checked since it was imported")
    image_missing: bpy.props.BoolProperty(description="Whether the photograph's file is missing")
    room_share: bpy.props.FloatProperty(description="Share of the pixels that show the room")
    clipped_share: bpy.props.FloatProperty(description="Share of the pixels that look overexposed")
    misfit: bpy.props.FloatProperty(
        description="Pixels between the edges of the mesh and of the photograph; negative if unknown",
        default=-1.0,
    )
    warning: bpy.props.StringProperty(description="Problem with the view; empty if there is none")

    def camera_object(self) -> bpy.types.Object | None:
        """The view's camera in its scene, by name or, if it was renamed, by its mark; None if deleted."""
        camera = bpy.data.objects.get(self.camera)
        if camera is not None and camera.get(VIEW) == self.name and self.id_data in camera.users_scene:
            return camera
        return view_cameras(self.id_data).get(self.name)


class FIPT_CaptureSettings(bpy.types.PropertyGroup):
    """The section Capture."""

    path: bpy.props.StringProperty(
        name="Capture",
        description="Folder of the photographs and their cameras (COLMAP, transforms.json, FIPT), or the"
        " camera file itself",
        subtype="FILE_PATH",
        update=_path_changed,
    )
    fixed: bpy.props.StringProperty(description="The capture that Fix has corrected", options={"HIDDEN"})
    __annotations__.update(IMPORT_OPTIONS)
    room: bpy.props.PointerProperty(
        name="Room",
        description="Collection whose meshes are the room. If empty, the collection Parts is used",
        type=bpy.types.Collection,
    )
    alignment: bpy.props.PointerProperty(
        name="Alignment",
        description="Empty that is the parent of the cameras and the imported mesh. Move, rotate or scale it"
        " to align the capture with the scene",
        type=bpy.types.Object,
    )
    alignment_scale: bpy.props.FloatProperty(
        name="Scale",
        description="Uniform scale of the alignment",
        min=1e-6,
        soft_min=0.01,
        soft_max=100.0,
        precision=4,
        get=_get_alignment_scale,
        set=_set_alignment_scale,
    )
    up: bpy.props.EnumProperty(
        name="Up",
        description="The capture's axis that points up in the scene. Another one turns FIPT Alignment with"
        " the cameras and the imported mesh",
        items=enum_items(UP[1:]),
        get=_get_up,
        set=_set_up,
    )
    imported_up: bpy.props.StringProperty(description="The axis of the capture that the import turned up")
    up_source: bpy.props.StringProperty(description="What told the import which axis is up")
    up_angle: bpy.props.FloatProperty(description="Degrees between that axis and up")
    shown_exposure: bpy.props.FloatProperty(
        description="The photograph's exposure that is in the scene's, stops"
    )
    imported_path: bpy.props.StringProperty(description="Source of the imported views")
    previous_run: bpy.props.StringProperty(description="Run folder before the import, restored if that fails")
    views: bpy.props.CollectionProperty(type=FIPT_CaptureView)
    active_view: bpy.props.IntProperty(
        name="View",
        description="Click to look through the camera of a view, with its photograph",
        options=set(),
        update=_active_changed,
    )
    picture: bpy.props.EnumProperty(
        name="Photograph",
        description="Click to see all photographs, and one of them to look through its camera",
        items=_view_pictures,
        options={"SKIP_SAVE"},
        get=_get_picture,
        set=_set_picture,
    )
    follow: bpy.props.BoolProperty(
        name="Look Through",
        description="Look through the camera of a view when it is clicked in the list",
        default=True,
    )
    photograph_opacity: bpy.props.FloatProperty(
        name="Photograph",
        description="Opacity of the photograph over the room when looking through its camera",
        default=0.5,
        min=0.0,
        max=1.0,
        subtype="FACTOR",
        update=_photograph_changed,
    )
    photograph_over_mesh: bpy.props.BoolProperty(
        name="Show Photograph",
        description="Show the photograph over the room when looking through its camera",
        default=True,
        update=_photograph_changed,
    )
    photograph_over_results: bpy.props.BoolProperty(
        name="Show Photograph",
        description="Show the photograph over the room's results when looking through its camera",
        update=_photograph_changed,
    )
    name_prefix: bpy.props.StringProperty(description="What the names of all views start with")
    train_count: bpy.props.IntProperty(description="Number of ticked views for estimation")
    held_back_count: bpy.props.IntProperty(description="Number of ticked views that are held back")
    warning_count: bpy.props.IntProperty(description="Number of ticked views with a warning")
    megapixels: bpy.props.FloatProperty(
        description="Millions of pixels of a ticked photograph for estimation, mean; 0 if unknown"
    )
    misfit: bpy.props.FloatProperty(
        description="Median of the views' misfits in pixels; negative if unknown", default=-1.0
    )
    unseen_share: bpy.props.FloatProperty(
        description="Share of the room's surface that no ticked view sees; negative before a check",
        default=-1.0,
    )

    completed: bpy.props.BoolProperty(
        name="Only These Surfaces",
        description="Estimate with the surfaces that the room has now: what you have deleted stays away."
        " Otherwise the estimation looks for what a scan lacks, and adds it",
    )

    def photograph_switch(self) -> str:
        """Name of the property that says whether photographs are shown: as long as the room has no results
        they help to align it, afterwards they would be in the way of what the artist wants to see.
        """
        results = self.id_data.fipt.materials
        over_results = results.object_count and results.shown != "ORIGINAL"
        return "photograph_over_results" if over_results else "photograph_over_mesh"

    def room_objects(self, scene: bpy.types.Scene) -> list[bpy.types.Object]:
        """The mesh objects of a scene's room, without the fixtures that applying results created."""
        members = self.room_members(scene)
        return [member for member in members if member.type == "MESH" and FIXTURE_SOURCES not in member]

    def room_members(self, scene: bpy.types.Scene) -> list[bpy.types.Object]:
        """All objects of the collection that holds a scene's room."""
        from ..blend.outliner import ROOM, find_collection

        room = self.room or find_collection(scene, ROOM)
        return [] if room is None else list(room.all_objects)

    def count_views(self) -> None:
        """Update what the panel shows of all views together."""
        # By characters, as names need no folders; the list asks only for whole folders.
        self.name_prefix = os.path.commonprefix([view.name for view in self.views])  # noqa: RUF071
        used = [view for view in self.views if view.enabled and view.camera in bpy.data.objects]
        self.train_count = sum(view.split == "train" for view in used)
        self.held_back_count = len(used) - self.train_count
        sizes = [bpy.data.objects[view.camera].get(RESOLUTION) for view in used if view.split == "train"]
        areas = [int(size[0]) * int(size[1]) / 1e6 for size in sizes if size is not None]
        self.megapixels = sum(areas) / len(areas) if areas else 0.0
        self.warning_count = sum(bool(view.warning) for view in used)
        if self.unseen_share >= 0.0:
            from ..blend.capture.survey import coverage_changed

            coverage_changed(self.id_data)

    @contextmanager
    def counting_later(self) -> Iterator[None]:
        """Change several views without counting after each; call `count_views` afterwards."""
        global _counting
        _counting = False
        try:
            yield
        finally:
            _counting = True
