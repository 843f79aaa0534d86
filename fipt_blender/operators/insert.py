# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Adds balls that show the room's light. All other objects are placed by Blender's own means."""

from __future__ import annotations

from typing import Annotated

import bpy

from ..core.run.declared import Option
from .action import action
from .polls import in_object_mode

KINDS = (
    ("GRAY_BALL", "Gray", "Matte, 18% gray: shows where the light comes from", "SPHERE"),
    ("MIRROR_BALL", "Mirror", "Chrome: reflects its surroundings", "SHADING_RENDERED"),
)


@action("Add Ball", needs=(in_object_mode,))
def add_ball(
    context: bpy.types.Context,
    kind: Annotated[str, Option("Surface of the ball", choices=KINDS)] = "GRAY_BALL",
    size: Annotated[
        float,
        Option(
            "Diameter of the ball. If 0, one that suits the room",
            "Diameter",
            zero=True,
            shown={"subtype": "DISTANCE"},
        ),
    ] = 0.0,
) -> None:
    """Add a ball that stands on the 3D cursor, as on a film set."""
    from ..blend.insert import balls
    from ..blend.outliner import select_only

    scene = context.scene
    size = size or balls.ball_size(scene.fipt.capture.room_objects(scene))
    select_only(context.view_layer, balls.add_ball(scene, scene.cursor.location, kind.lower(), size))
