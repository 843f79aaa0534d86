"""A material that is dropped on a face of the room replaces that of the whole part.

Blender puts it into the slot of that face's object; the rest of the part may be on other objects. Imported
while Blender starts: needs bpy alone.

Blender has stored the undo step of the drop before it reports the change, so that undo does not know what
follows here and may leave it as it is. Therefore it is taken back before undo and redo, and done again after
them where the slot still has the material.
"""

from __future__ import annotations

import bpy

from ..marks import MATERIAL, REPLACEMENT, remove_marks, room_with_results

# Slots by mesh and index, or estimated materials by their names, with the names of the materials before;
# "" for none.
_State = dict[tuple[str, int], str]
_SELF = -1  # in place of an index: the replacement of an estimated material
_made: list[_State] = []
_INTERVAL = 0.5  # seconds between looks for copied scenes
_scenes = 1  # number of the file's scenes whose materials are their own


def register() -> None:
    """Watch changes of the room."""
    for handlers, function in _HANDLERS:
        handlers.append(function)
    bpy.app.timers.register(own_copies, persistent=True)


def unregister() -> None:
    """Stop watching."""
    for handlers, function in _HANDLERS:
        handlers.remove(function)
    if bpy.app.timers.is_registered(own_copies):
        bpy.app.timers.unregister(own_copies)
    _made.clear()


@bpy.app.handlers.persistent
def _follow(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    if bpy.app.is_job_running("RENDER") or not scene.fipt.materials.object_count:
        return
    changed = {update.id.original for update in depsgraph.updates if update.is_updated_geometry}
    changed |= {update.id.original for update in depsgraph.updates if update.is_updated_shading}
    if not changed:
        return
    items = [item for item in room_with_results(scene) if item in changed or item.data in changed]
    if items:
        _adopt(scene, items)


def own_copies() -> float:
    """Give full copies of a scene materials of their own, before the artist edits one of them herself.

    A timer, since Blender does not report a copy, but the first change after it; returns seconds to the next.
    """
    global _scenes
    if bpy.app.is_job_running("RENDER"):
        return _INTERVAL
    if len(bpy.data.scenes) > _scenes:
        from ..own_materials import own_materials

        for scene in reversed(bpy.data.scenes):  # a copy comes after its original, which keeps its own
            if scene.fipt.materials.object_count:
                own_materials(scene)
    _scenes = len(bpy.data.scenes)
    return _INTERVAL


@bpy.app.handlers.persistent
def _after_step(scene: bpy.types.Scene, *_: object) -> None:
    # Blender does not report all changes by undo and redo as updates.
    _forget()
    own_copies()
    if scene.fipt.materials.object_count:
        _adopt(scene, room_with_results(scene))


def _adopt(scene: bpy.types.Scene, items: list[bpy.types.Object]) -> None:
    from .replacing import adopt

    before = _state(scene)
    keys = adopt(scene, items)
    if not keys:
        return
    after = _state(scene)
    _made.append({place: name for place, name in before.items() if after.get(place) != name})
    rows = scene.fipt.materials.parts
    for index in (index for index, row in enumerate(rows) if row.key in keys):
        scene.fipt.materials.active_part = index  # beside whose list Restore Estimate is


def _state(scene: bpy.types.Scene) -> _State:
    """The materials of the slots of the scene's results, and the replacements of the estimated ones."""
    state: _State = {}
    for item in room_with_results(scene):
        for index, material in enumerate(item.data.materials):
            state[item.data.name, index] = "" if material is None else material.name
    for material in bpy.data.materials:
        if MATERIAL in material:
            replacement = material.get(REPLACEMENT)
            state[material.name, _SELF] = "" if replacement is None else replacement.name
    return state


@bpy.app.handlers.persistent
def _take_back(*_: object) -> None:
    while _made:
        for (name, index), before in _made.pop().items():
            material = bpy.data.materials.get(before)
            if index == _SELF:
                estimate = bpy.data.materials.get(name)
                if estimate is not None and material is not None:
                    estimate[REPLACEMENT] = material
                elif estimate is not None:
                    remove_marks(estimate, REPLACEMENT)
                continue
            mesh = bpy.data.meshes.get(name)
            if mesh is not None and index < len(mesh.materials):
                mesh.materials[index] = material


@bpy.app.handlers.persistent
def _forget(*_: object) -> None:
    global _scenes
    _scenes = 1
    _made.clear()


_HANDLERS = (
    (bpy.app.handlers.depsgraph_update_post, _follow),
    (bpy.app.handlers.undo_pre, _take_back),
    (bpy.app.handlers.redo_pre, _take_back),
    (bpy.app.handlers.undo_post, _after_step),
    (bpy.app.handlers.redo_post, _after_step),
    (bpy.app.handlers.load_post, _forget),
)
