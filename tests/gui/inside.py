"""The story's questions about the scene, its job and its lights; run inside Blender, change nothing."""

from __future__ import annotations

import importlib
import itertools
import json
import sys
from pathlib import Path
from typing import Any

import bpy
from mathutils import Vector


def ours(name: str) -> Any:
    """A module of the extension."""
    package = next(key for key in sys.modules if key.split(".")[-1] == "fipt_blender")
    return importlib.import_module(f"{package}.{name}")


def counts() -> dict[str, int]:
    """Counts of what the story creates."""
    scene = bpy.context.scene
    capture = scene.fipt.capture
    return {
        "objects": len(scene.objects),
        "cameras": sum(item.type == "CAMERA" for item in scene.objects),
        "views": len(capture.views),
        "held_back": sum(view.split == "held_back" for view in capture.views),
        "room": len(capture.room_objects(scene)),
        "checked": sum(view.checked for view in capture.views),
    }


def objects() -> list[str]:
    """Names of all objects of the scene."""
    return sorted(item.name for item in bpy.context.scene.objects)


def photographs() -> dict[str, Any]:
    """The list of the section Photographs."""
    settings = bpy.context.scene.fipt.photographs
    return {
        "path": settings.path,
        "sizes": [len(group.photographs) for group in settings.groups],
        "used": [group.used for group in settings.groups],
        "registered": settings.registered_count,
        "capture": str(settings.capture_folder() or ""),
    }


def drop(files: list[str]) -> None:
    """Run the operator that Blender runs where files are dropped on the sidebar, as it does."""
    handler = bpy.types.FIPT_FH_photographs
    module, _, name = handler.bl_import_operator.partition(".")
    names = [{"name": Path(file).name} for file in files]
    with bpy.context.temp_override(**_view()):
        operator = getattr(getattr(bpy.ops, module), name)
        operator("INVOKE_DEFAULT", directory=str(Path(files[0]).parent), files=names)


def job(kind: str) -> dict[str, Any]:
    """State of the running job of a kind, or of the last one; an empty state if there was none."""
    running = ours("jobs.running")
    info = running.current()
    if info is None or info.kind != kind:
        info = running.last(kind)
    if info is None:
        return {"state": "", "stopping": False, "fraction": 0.0, "error": None, "stage": ""}
    return {
        "state": info.state,
        "stopping": info.stopping,
        "fraction": info.fraction,
        "error": info.error,
        "stage": info.stage_text,
    }


def busy() -> bool:
    """Whether any job runs."""
    return ours("jobs.running").current() is not None


def engine_status() -> dict[str, Any]:
    """What the preferences show about the engine: whether it is ready, and the error if not."""
    status = ours("machine").status()
    return {"ready": bool((status.get("engine") or {}).get("ready")), "error": status.get("error")}


def view_through() -> str:
    """The camera through which the 3D view looks; "" for none."""
    for area in bpy.context.window_manager.windows[0].screen.areas:
        if area.type == "VIEW_3D" and area.spaces.active.region_3d.view_perspective == "CAMERA":
            camera = area.spaces.active.camera or bpy.context.scene.camera
            return camera.name if camera else ""
    return ""


def seen() -> dict[str, str]:
    """The split of the view through which the 3D view looks ("" for none), and its shading."""
    name = view_through()
    split = [view.split for view in bpy.context.scene.fipt.capture.views if view.camera == name]
    return {"split": "".join(split), "shading": _view()["area"].spaces.active.shading.type}


def view_cameras() -> list[str]:
    """Name of each view's camera, in the list's order."""
    return [view.camera for view in bpy.context.scene.fipt.capture.views]


def room_corners() -> list[dict[str, Any]]:
    """Corners of the room's bounding box that are corners of its mesh, with the views that see them."""
    scene = bpy.context.scene
    objects = scene.fipt.capture.room_objects(scene)
    points = [item.matrix_world @ vertex.co for item in objects for vertex in item.data.vertices]
    low, high = ([function(p[axis] for p in points) for axis in range(3)] for function in (min, max))
    found = []
    for corner in itertools.product(*zip(low, high, strict=True)):
        nearest = min(points, key=lambda point: (point - Vector(corner)).length)
        seen = [index for index, view in enumerate(scene.fipt.capture.views) if _sees(view, nearest)]
        middle = 0.5 * (Vector(low) + Vector(high))
        aim = nearest + 0.01 * (middle - nearest)
        found.append({"point": list(nearest), "aim": list(aim), "views": seen})
    return found


def _sees(view: Any, point: Vector) -> bool:
    """Whether a point is well inside a view's picture, and nothing is before it."""
    scene, camera = bpy.context.scene, bpy.data.objects[view.camera]
    width, height = camera["fipt_resolution"]
    local = camera.matrix_world.inverted() @ point
    frame = camera.data.view_frame()
    if local.z >= 0.0:
        return False
    x, y = (local.to_2d() / -local.z)[:]
    left, right = (function(corner.x / -corner.z for corner in frame) for function in (min, max))
    half = 0.5 * (right - left) * height / width
    if not (left * 0.8 < x < right * 0.8 and abs(y) < 0.8 * half):
        return False
    origin = camera.matrix_world.translation
    toward = point - origin
    hit, place, *_ = scene.ray_cast(bpy.context.evaluated_depsgraph_get(), origin, toward.normalized())
    return not hit or (place - origin).length > toward.length - 0.05


def pairs() -> dict[str, Any]:
    """The pairs of points, and how far they are off."""
    settings = bpy.context.scene.fipt.alignment
    return {
        "count": len(settings.pairs),
        "sights": [len(pair.sights) for pair in settings.pairs],
        "points": [list(bpy.data.objects[pair.name].matrix_world @ Vector(pair.point)) for pair in settings.pairs],
        "error": settings.error,
        "problem": settings.problem,
    }


def camera_places() -> list[list[float]]:
    """Where each view's camera is, in the list's order."""
    return [list(bpy.data.objects[name].matrix_world.translation) for name in view_cameras()]


def textured() -> dict[str, int]:
    """Room objects, and those whose materials all take their base colour from an image."""
    room = bpy.context.scene.fipt.capture.room_objects(bpy.context.scene)
    return {"objects": len(room), "textured": sum(_is_textured(item) for item in room)}


def _is_textured(item: bpy.types.Object) -> bool:
    materials = [slot.material for slot in item.material_slots]
    return bool(materials) and all(
        material is not None
        and material.node_tree is not None
        and any(node.type == "TEX_IMAGE" and node.image for node in material.node_tree.nodes)
        for material in materials
    )


def light_rows() -> list[dict[str, Any]]:
    """The list of lights."""
    return [
        {
            "name": light.object.name if light.object else "",
            "kind": light.object.type if light.object else "",
            "on": light.on,
        }
        for light in bpy.context.scene.fipt.lights.lights
    ]


def emission_strengths(name: str) -> list[float]:
    """Current emission strength of a fixture, one number per material."""
    strengths = []
    for slot in bpy.data.objects[name].material_slots:
        for node in slot.material.node_tree.nodes:
            if node.type == "EMISSION":
                strengths.append(float(node.inputs["Strength"].default_value))
            elif node.type == "BSDF_PRINCIPLED":
                strengths.append(float(node.inputs["Emission Strength"].default_value))
    return strengths


def picture() -> str:
    """The file of the last picture, "" before the first one."""
    return bpy.context.scene.fipt.insert.picture


def change(before: str, after: str) -> float:
    """Difference of two pictures of one view: median over blocks of pixels of |ln(after/before)|."""
    import numpy as np

    first, second = (_blocks(path) for path in (before, after))
    return float(np.median(np.abs(np.log(second / first))))


def _blocks(path: str, size: int = 8) -> Any:
    """Medians of luminance over blocks, so that fireflies do not count."""
    import numpy as np

    image = bpy.data.images.load(path)
    try:
        width, height = image.size
        values = np.empty(width * height * image.channels, np.float32)
        image.pixels.foreach_get(values)
    finally:
        bpy.data.images.remove(image)
    rows, columns = height // size, width // size
    gray = values.reshape(height, width, -1)[: rows * size, : columns * size, :3].mean(2)
    blocks = gray.reshape(rows, size, columns, size).swapaxes(1, 2).reshape(-1, size * size)
    return np.maximum(np.median(blocks, 1), 1e-4)


def beam() -> dict[str, Any]:
    """Where the active light's beam ends, in the 3D view's region, and the light's rotation."""
    from bpy_extras.view3d_utils import location_3d_to_region_2d

    item = bpy.context.view_layer.objects.active
    graph = bpy.context.evaluated_depsgraph_get()
    end = ours("blend.lights.new_lights").beam_end(bpy.context.scene, graph, item, 2.0)
    view = _view()
    pixel = location_3d_to_region_2d(view["region"], view["area"].spaces.active.region_3d, end)
    return {"pixel": list(pixel), "turn": [round(value, 4) for value in item.matrix_world.to_euler()]}


def part_rows() -> dict[str, Any]:
    """The list of parts, the adjustment of the active one, assets, and the mode."""
    settings = bpy.context.scene.fipt.materials
    active = settings.part()
    return {
        "names": [row.name for row in settings.parts],
        "active": active.name if active else "",
        "roughness": active.roughness_offset if active else 0.0,
        "roughness_value": active.roughness_value if active else 0.0,
        "hue": active.hue if active else 0.0,
        "assets": sum(material.asset_data is not None for material in bpy.data.materials),
        "mode": bpy.context.mode,
    }


def _view() -> dict[str, Any]:
    """The first 3D view of the first window, for `temp_override`."""
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    region = next(region for region in area.regions if region.type == "WINDOW")
    return {"window": window, "area": area, "region": region}


def hints() -> dict[str, Any]:
    """The hints, the engine's questions, the icon of the chosen one, and what the last estimate tells of its hints."""
    state = bpy.context.scene.fipt
    doubt, pictures = state.hints.doubt(), ours("blend.previews").doubt_pictures
    statistics = Path(bpy.path.abspath(state.run_folder)) / "results" / "statistics.json"
    return {
        "hints": [
            {"object": hint.object and hint.object.name, "material": hint.material} for hint in state.hints.hints
        ],
        "questions": [doubt.text for doubt in state.hints.doubts],
        "icon": pictures.icon(Path(doubt.picture)) if doubt else -1,
        "told": json.loads(statistics.read_text()).get("hints", []) if statistics.is_file() else [],
    }
