"""State of the panel Alignment: picked points, and how well the cameras fit."""

from __future__ import annotations

import bpy


def _marks_changed(self: FIPT_AlignmentSettings, context: bpy.types.Context) -> None:
    from ..blend.capture.look import redraw_views

    redraw_views()


class FIPT_AlignmentSight(bpy.types.PropertyGroup):
    """Where a point of the mesh appears in a photograph. `name` is the view's name."""

    pixel: bpy.props.FloatVectorProperty(
        name="Pixel", description="Position in the photograph in pixels from its top left corner", size=2
    )


class FIPT_AlignmentPair(bpy.types.PropertyGroup):
    """A point of the mesh and the same point in photographs. `name` is the object's name."""

    point: bpy.props.FloatVectorProperty(
        name="Point", description="Point in the space of the mesh object", size=3, subtype="XYZ"
    )
    sights: bpy.props.CollectionProperty(type=FIPT_AlignmentSight)
    error: bpy.props.FloatProperty(
        name="Error",
        description="Distance between the point of the mesh and the one in the photographs; negative where it"
        " is not known",
        default=-1.0,
        subtype="DISTANCE",
    )


class FIPT_AlignmentSettings(bpy.types.PropertyGroup):
    """The panel Alignment."""

    pairs: bpy.props.CollectionProperty(type=FIPT_AlignmentPair)
    active_pair: bpy.props.IntProperty(name="Pair", description="A point of the mesh and of photographs")
    error: bpy.props.FloatProperty(
        name="Error",
        description="Root mean square of the pairs' errors; negative where they do not decide a placement",
        default=-1.0,
        subtype="DISTANCE",
    )
    problem: bpy.props.StringProperty(description="Why the pairs do not decide a placement")
    show_marks: bpy.props.BoolProperty(
        name="Show Marks",
        description="Draw the picked points in the viewport and over the photographs",
        default=True,
        update=_marks_changed,
    )
    summary: bpy.props.StringProperty(description="How well the cameras fit after Refine by Points")
