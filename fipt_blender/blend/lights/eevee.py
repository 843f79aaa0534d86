"""A room that looks right in EEVEE: fixtures as Blender lights, and a light probe volume of the room's size.

EEVEE renders neither the light of emissive surfaces nor, without a baked volume, light that was reflected.
"""

from __future__ import annotations

import math

import bpy
import numpy as np
from mathutils import Matrix

from ...core.run.errors import FiptError
from ..marks import BAKED, PROBE, VISIBILITY, fixtures_of, light_probe, remove_marks
from ..outliner import LIGHTS, collection
from ..render_settings import set_once
from ..room.mesh_arrays import world_bounds
from .calibration import scene_unit
from .convert import fixture_to_lights

SPACING = 0.4  # metres between the samples of the volume
# Samples by which the volume exceeds the room on each side: EEVEE fades it into the world before its border,
# and walls there would get the world's light.
_BORDER = 1
_SWITCHED_ON = ("use_raytracing", "use_shadows")
# Radiances below which lights end, and at which reflected light is clamped: Blender's defaults, for a picture
# whose middle is a value of 0.18.
_RADIANCES = {"light_threshold": 0.01, "clamp_surface_indirect": 10.0}
ENGINES = ("BLENDER_EEVEE_NEXT", "BLENDER_EEVEE")  # 4.2 to 4.5; from 5.0


def prepare(scene: bpy.types.Scene) -> list[str]:
    """Make EEVEE the scene's engine, with its lights and a volume; `bake` must follow.

    `render_settings.restore` undoes the change of settings and engine.

    Returns:
        Names of the fixtures whose Blender lights differ from them in shape.
    """
    bounds = world_bounds(scene.fipt.capture.room_objects(scene))
    if bounds is None:
        raise FiptError("room-missing.prepare")
    use_eevee(scene)
    inexact = []
    for item in fixtures_of(scene):
        if VISIBILITY not in item:
            _, exact = fixture_to_lights(scene, item)
            if not exact:
                inexact.append(item.name)
    place_volume(scene, *bounds)
    return inexact


def use_eevee(scene: bpy.types.Scene) -> None:
    """Make EEVEE the scene's engine, with ray tracing, whatever the exposure of the photographs.

    Shadows are not jittered: that darkens direct light and, more so, the baked volume (docs/results.md).
    """
    values = [{"render.engine": engine} for engine in ENGINES]
    if not any([set_once(scene, value, again=True) for value in values]):
        raise FiptError("engine-missing.use-eevee")
    median = scene_unit(scene) * scene.fipt.lights.median_radiance
    scale = median / 0.18 if median > 0.0 else 1.0
    wanted: dict[str, float] = {name: scale * value for name, value in _RADIANCES.items()}
    wanted |= dict.fromkeys(_SWITCHED_ON, True)
    set_once(scene, {f"eevee.{name}": value for name, value in wanted.items()}, again=True)


def place_volume(scene: bpy.types.Scene, low: np.ndarray, high: np.ndarray) -> bpy.types.Object:
    """The light probe volume around a room's bounds (3,); an earlier one of ours is moved."""
    item = light_probe(scene)
    if item is None:
        data = bpy.data.lightprobes.new("FIPT Light Probe", "VOLUME")
        item = bpy.data.objects.new(data.name, data)
        item[PROBE] = 1
        collection(scene, LIGHTS).objects.link(item)
    room = np.maximum(high - low, 0.1)
    samples = np.array(resolution(room))
    extent = room * (samples + 2 * _BORDER) / samples
    remove_marks(item, BAKED)
    item.matrix_world = Matrix.LocRotScale((0.5 * (low + high)).tolist(), None, (0.5 * extent).tolist())
    data = item.data
    data.resolution_x, data.resolution_y, data.resolution_z = (samples + 2 * _BORDER).tolist()
    data.capture_distance = float(np.linalg.norm(extent))
    # What lights the room shines as Blender lights; the fixtures' surfaces would light it twice.
    data.capture_world, data.capture_indirect, data.capture_emission = True, True, False
    data.clamp_direct = data.clamp_indirect = 0.0
    return item


def resolution(extent: np.ndarray) -> tuple[int, int, int]:
    """Samples of the volume inside a room of these extents (3,) in metres along each axis."""
    x, y, z = (min(max(math.ceil(float(size) / SPACING), 4), 32) for size in extent)
    return x, y, z
