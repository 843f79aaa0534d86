"""What lies under the mouse pointer: a point of a mesh, or a position in a view's photograph."""

from __future__ import annotations

import bpy
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d, region_2d_to_origin_3d, region_2d_to_vector_3d
from mathutils import Vector

from ..ray_hits import hits
from .cameras import camera_geometry
from .pairs import PickedSight, camera_view

SNAP_PIXELS = 12.0  # distance on the screen within which a click goes to a corner of the face


def mesh_under(
    context: bpy.types.Context,
    region: bpy.types.Region,
    space: bpy.types.SpaceView3D,
    position: tuple[float, float],
    snap: bool = True,
) -> tuple[str, Vector] | None:
    """Name of the mesh object under a position of the region, and the point in the world; None without one.

    Args:
        context: of the operator.
        region, space: the viewport.
        position: in pixels of the region.
        snap: go to the nearest corner of the face, if it is near on the screen.
    """
    data = space.region_3d
    origin = region_2d_to_origin_3d(region, data, position)
    direction = region_2d_to_vector_3d(region, data, position)
    depsgraph = context.evaluated_depsgraph_get()
    skip_backs = space.shading.type == "SOLID" and space.shading.show_backface_culling
    found = hits(context.scene, depsgraph, origin, direction, skip_backs)
    hit = next((hit for hit in found if hit.object.type == "MESH"), None)
    if hit is None:
        return None
    point = hit.position
    if snap and hit.face >= 0:
        mesh = hit.object.evaluated_get(depsgraph).data
        corners = [hit.matrix @ mesh.vertices[index].co for index in mesh.polygons[hit.face].vertices]
        point = snapped(region, data, position, corners) or point
    return hit.object.original.name, point


def snapped(
    region: bpy.types.Region,
    data: bpy.types.RegionView3D,
    position: tuple[float, float],
    corners: list[Vector],
) -> Vector | None:
    """The corner that is nearest on the screen, None if none is within SNAP_PIXELS."""
    best, least = None, SNAP_PIXELS * bpy.context.preferences.system.ui_scale
    for corner in corners:
        place = location_3d_to_region_2d(region, data, corner)
        if place is not None and (distance := (place - Vector(position)).length) <= least:
            best, least = corner, distance
    return best


def photograph_under(
    context: bpy.types.Context,
    region: bpy.types.Region,
    space: bpy.types.SpaceView3D,
    position: tuple[float, float],
) -> PickedSight | None:
    """The position in the photograph of the view that the region looks through; None outside of it."""
    camera = context.scene.camera
    view = camera_view(camera)
    if not view or space.region_3d.view_perspective != "CAMERA":
        return None
    geometry = camera_geometry(context.scene, camera)
    direction = np.array(region_2d_to_vector_3d(region, space.region_3d, position), np.float64)
    x, y, z = geometry.camera_to_world[:3, :3].T @ direction
    if z <= 0.0:
        return None
    u, v = geometry.fx * x / z + geometry.cx, geometry.fy * y / z + geometry.cy
    inside = 0.0 <= u <= geometry.width and 0.0 <= v <= geometry.height
    return PickedSight(view, float(u), float(v)) if inside else None
