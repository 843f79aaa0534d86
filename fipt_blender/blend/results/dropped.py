# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A material that is dropped on a face of the room replaces that of the whole part.

Blender puts it into the slot of that face's object; the rest of the part may be on other objects. Imported
while Blender starts: needs bpy alone.
"""

from __future__ import annotations

import bpy

from ..marks import room_with_results


def register() -> None:
    """Watch changes of the room."""
    bpy.app.handlers.depsgraph_update_post.append(_follow)


def unregister() -> None:
    """Stop watching."""
    bpy.app.handlers.depsgraph_update_post.remove(_follow)


@bpy.app.handlers.persistent
def _follow(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    if not scene.fipt.materials.object_count or bpy.app.is_job_running("RENDER"):
        return
    changed = {update.id.original for update in depsgraph.updates if update.is_updated_geometry}
    changed |= {update.id.original for update in depsgraph.updates if update.is_updated_shading}
    if not changed:
        return
    items = [item for item in room_with_results(scene) if item in changed or item.data in changed]
    if items:
        from .replacing import adopt

        keys = adopt(scene, items)
        rows = scene.fipt.materials.parts
        for index in (index for index, row in enumerate(rows) if row.key in keys):
            scene.fipt.materials.active_part = index  # beside whose list Restore Estimate is
