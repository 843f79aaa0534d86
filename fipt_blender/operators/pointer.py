# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What lies under the mouse pointer, for operators that place something in a 3D viewport."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import bpy
from mathutils import Vector

if TYPE_CHECKING:
    from ..blend.insert.surfaces import Surface

# Events that move the view or zoom; modal operators pass them on. The mouse wheel zooms as well.
NAVIGATION = ("MIDDLEMOUSE", "TRACKPADPAN", "TRACKPADZOOM", "MOUSEROTATE", "MOUSESMARTZOOM", "NDOF_MOTION")


def view_under_pointer(
    context: bpy.types.Context, event: bpy.types.Event
) -> tuple[bpy.types.Region, bpy.types.SpaceView3D] | None:
    """The 3D viewport under the pointer; None where a sidebar, toolbar or header covers it."""
    x, y = event.mouse_x, event.mouse_y
    for area in context.window.screen.areas:
        if area.type != "VIEW_3D":
            continue
        regions = [
            region
            for region in area.regions
            if region.x <= x < region.x + region.width and region.y <= y < region.y + region.height
        ]
        if regions and all(region.type == "WINDOW" for region in regions):
            return regions[0], area.spaces.active
    return None


class PointerRay(NamedTuple):
    """The ray through the pointer: origin and unit direction in the world, whether backs are not drawn."""

    origin: Vector
    direction: Vector
    skip_backs: bool


def ray_under_pointer(context: bpy.types.Context, event: bpy.types.Event) -> PointerRay | None:
    """The ray from the eye through the pointer; None where it is not over a 3D viewport."""
    from bpy_extras.view3d_utils import region_2d_to_origin_3d, region_2d_to_vector_3d

    view = view_under_pointer(context, event)
    if view is None:
        return None
    region, space = view
    # In quad view each region has its own matrix; the space's is that of the last one.
    data = getattr(region, "data", None) or space.region_3d
    position = (event.mouse_x - region.x, event.mouse_y - region.y)
    return PointerRay(
        region_2d_to_origin_3d(region, data, position),
        region_2d_to_vector_3d(region, data, position),
        space.shading.type == "SOLID" and space.shading.show_backface_culling,
    )


def surface_under_pointer(context: bpy.types.Context, event: bpy.types.Event) -> Surface | None:
    """The visible surface under the pointer, in world coordinates; None where there is none."""
    from ..blend.insert.surfaces import find_surface

    ray = ray_under_pointer(context, event)
    if ray is None:
        return None
    return find_surface(context.scene, context.evaluated_depsgraph_get(), *ray)
