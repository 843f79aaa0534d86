# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""State of the section Capture: where the photographs come from, the views, and the room's mesh."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import bpy

VIEW_KEY = "fipt_view"  # custom property of a camera: the name of its view
FIXTURE_KEY = "fipt_sources"  # custom property of fixtures split off the room: they are results, not input
FORMATS = (
    ("auto", "Automatic", "Recognise the capture by its files"),
    ("colmap", "COLMAP", "A COLMAP model, binary or text"),
    ("transforms", "transforms.json", "As nerfstudio, instant-ngp and NeRF write it"),
    ("fipt-synthetic", "FIPT Synthetic", "train and val folders with Image, IndexMA and segmentation"),
    ("fipt-real", "FIPT Real", "cam.txt and K_list.txt beside the folder Image"),
)
UP_AXES = (
    ("auto", "Automatic", "What the format says, else the axis nearest to the cameras' own up"),
    *((axis, axis.upper(), f"The capture's {axis.upper()} axis points up") for axis in
      ("x", "y", "z", "-x", "-y", "-z")),
)  # fmt: skip


_counting = True  # off while many views change at once


def _views_changed(self: FIPT_CaptureView, context: bpy.types.Context) -> None:
    if _counting:
        self.id_data.fipt.capture.count_views()


def _active_changed(self: FIPT_CaptureSettings, context: bpy.types.Context) -> None:
    """A click in the list looks through the camera; scripts that fill the list set no camera."""
    if self.follow and 0 <= self.active_view < len(self.views):
        from ..blend.look import look_through

        look_through(self.id_data, self.views[self.active_view], context)


def _opacity_changed(self: FIPT_CaptureSettings, context: bpy.types.Context) -> None:
    from ..blend.look import refresh_photograph

    refresh_photograph(self.id_data)


def _get_alignment_scale(self: FIPT_CaptureSettings) -> float:
    return float(self.alignment.scale[0]) if self.alignment is not None else 1.0


def _set_alignment_scale(self: FIPT_CaptureSettings, value: float) -> None:
    if self.alignment is not None:
        self.alignment.scale = (value,) * 3


class FIPT_CaptureView(bpy.types.PropertyGroup):
    """One photograph with its camera. `name` is the view's name in capture.json."""

    camera: bpy.props.StringProperty(name="Camera", description="The view's camera object")
    enabled: bpy.props.BoolProperty(
        name="Use",
        description="Whether the estimate uses this photograph",
        default=True,
        update=_views_changed,
    )
    split: bpy.props.EnumProperty(
        name="Use For",
        description="What this photograph is for",
        items=[
            ("train", "Estimating", "Materials and lights are estimated from it", "IMAGE_DATA", 0),
            ("held_back", "Judging", "Kept aside, to compare renders of the result with", "HIDE_OFF", 1),
        ],
        default="train",
        update=_views_changed,
    )
    image: bpy.props.StringProperty(name="Photograph", description="The photograph's file")
    checked: bpy.props.BoolProperty(description="Whether the view has been checked since it was imported")
    image_missing: bpy.props.BoolProperty(description="Whether the photograph's file is missing")
    room_share: bpy.props.FloatProperty(description="Share of the photograph's pixels that see the room")
    clipped_share: bpy.props.FloatProperty(description="Share of the pixels that look over-exposed")
    warning: bpy.props.StringProperty(description="What is wrong with the view; empty where nothing is")

    def camera_object(self) -> bpy.types.Object | None:
        """The view's camera in its scene, by name and where it was renamed by its mark; None if deleted."""
        item = bpy.data.objects.get(self.camera)
        if item is not None and item.get(VIEW_KEY) == self.name and self.id_data in item.users_scene:
            return item
        return view_cameras(self.id_data).get(self.name)


class FIPT_CaptureSettings(bpy.types.PropertyGroup):
    """The section Capture."""

    path: bpy.props.StringProperty(
        name="Capture",
        description="Folder with the photographs and their cameras (COLMAP, transforms.json, FIPT), or the"
        " camera file itself",
        subtype="FILE_PATH",
    )
    format: bpy.props.EnumProperty(name="Layout", description="Layout of the capture", items=FORMATS)
    mesh: bpy.props.StringProperty(
        name="Mesh",
        description="The room's mesh, in the capture's coordinates; empty takes the one beside the cameras",
        subtype="FILE_PATH",
    )
    images: bpy.props.StringProperty(
        name="Photographs",
        description="Folder with the HDR photographs, where they lie elsewhere than the cameras say",
        subtype="DIR_PATH",
    )
    scale: bpy.props.FloatProperty(
        name="Scale",
        description="Metres that one unit of the capture is long",
        default=1.0,
        min=1e-6,
        soft_min=0.001,
        soft_max=1000.0,
        precision=4,
    )
    up_axis: bpy.props.EnumProperty(
        name="Up", description="Axis of the capture that points up", items=UP_AXES
    )
    hold_back: bpy.props.IntProperty(
        name="Hold Back Every",
        description="Keep every how-manieth photograph aside to judge the result by, where the capture names"
        " none itself; 0 for none",
        default=8,
        min=0,
        soft_max=50,
    )
    clamp_negative: bpy.props.BoolProperty(
        name="Clamp Negative",
        description="Take negative values in photographs as black, whatever their size",
    )
    undo_applied_transform: bpy.props.BoolProperty(
        name="Undo Applied Transform",
        description="transforms.json only: the mesh has the coordinates from before nerfstudio turned the"
        " world",
    )
    room: bpy.props.PointerProperty(
        name="Room",
        description="Collection whose meshes are the room; empty for the collection FIPT Room",
        type=bpy.types.Collection,
    )
    alignment: bpy.props.PointerProperty(
        name="Alignment",
        description="Empty that carries the cameras and the imported mesh: move, turn or scale it to align"
        " the capture with the scene",
        type=bpy.types.Object,
    )
    alignment_scale: bpy.props.FloatProperty(
        name="Scale",
        description="Scale of the alignment, alike along all axes",
        min=1e-6,
        soft_min=0.01,
        soft_max=100.0,
        precision=4,
        get=_get_alignment_scale,
        set=_set_alignment_scale,
    )
    imported_path: bpy.props.StringProperty(description="What the views were imported from")
    previous_run: bpy.props.StringProperty(description="Run folder before an import, should that fail")
    views: bpy.props.CollectionProperty(type=FIPT_CaptureView)
    active_view: bpy.props.IntProperty(
        name="View",
        description="Click to look through the view's camera with its photograph",
        options=set(),
        update=_active_changed,
    )
    follow: bpy.props.BoolProperty(
        name="Look Through",
        description="A click in the list looks through the view's camera",
        default=True,
    )
    photograph_opacity: bpy.props.FloatProperty(
        name="Photograph",
        description="How strongly the photograph covers the room when looking through its camera",
        default=0.5,
        min=0.0,
        max=1.0,
        subtype="FACTOR",
        update=_opacity_changed,
    )
    train_count: bpy.props.IntProperty(description="Ticked views to estimate from")
    held_back_count: bpy.props.IntProperty(description="Ticked views to judge by")
    warning_count: bpy.props.IntProperty(description="Ticked views with a warning")
    unseen_share: bpy.props.FloatProperty(
        description="Share of the room's surface that no ticked view sees; below zero before a check",
        default=-1.0,
    )

    def room_objects(self, scene: bpy.types.Scene) -> list[bpy.types.Object]:
        """The mesh objects that form the room of a scene, without fixtures that results split off."""
        from ..blend.outliner import ROOM, find_collection

        room = self.room or find_collection(scene, ROOM)
        if room is None:
            return []
        return [item for item in room.all_objects if item.type == "MESH" and FIXTURE_KEY not in item]

    def count_views(self) -> None:
        """Bring up to date what the panel shows of all views together."""
        used = [view for view in self.views if view.enabled and view.camera in bpy.data.objects]
        self.train_count = sum(view.split == "train" for view in used)
        self.held_back_count = len(used) - self.train_count
        self.warning_count = sum(bool(view.warning) for view in used)
        if self.unseen_share >= 0.0:
            from ..blend.survey import coverage_changed

            coverage_changed(self.id_data)

    @contextmanager
    def counting_later(self) -> Iterator[None]:
        """Change many views without counting each time; `count_views` belongs after it."""
        global _counting
        _counting = False
        try:
            yield
        finally:
            _counting = True


def view_cameras(scene: bpy.types.Scene) -> dict[str, bpy.types.Object]:
    """The scene's cameras by the name of the view that they show."""
    cameras = [item for item in scene.objects if item.type == "CAMERA" and VIEW_KEY in item]
    return {item[VIEW_KEY]: item for item in reversed(cameras)}


CLASSES = (FIPT_CaptureView, FIPT_CaptureSettings)
