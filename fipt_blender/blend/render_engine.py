# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene's render engine, which we switch so that the room looks right, and Revert switches back."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress

import bpy

from .marks import KEPT_ENGINE, remove_marks, room_with_results


def switch_engine(scene: bpy.types.Scene, engines: Sequence[str]) -> bool:
    """Make the first of these engines that this Blender has the scene's; returns whether it has one.

    Where results are applied, `restore_engine` brings back the engine that the artist chose last, however
    often we switch.
    """
    before = scene.render.engine
    for engine in engines:
        try:
            scene.render.engine = engine
        except TypeError:  # of another version, or its add-on is disabled
            continue
        if engine != before and room_with_results(scene):
            kept = json.loads(scene.get(KEPT_ENGINE, "{}"))
            chosen = kept["chosen"] if kept.get("ours") == before else before
            scene[KEPT_ENGINE] = json.dumps({"chosen": chosen, "ours": engine})
        return True
    return False


def restore_engine(scene: bpy.types.Scene) -> None:
    """Restore the engine, unless the artist has chosen another one since `switch_engine`."""
    kept = json.loads(scene.get(KEPT_ENGINE, "{}"))
    remove_marks(scene, KEPT_ENGINE)
    if kept and scene.render.engine == kept["ours"]:
        with suppress(TypeError):  # an add-on that was removed since
            scene.render.engine = kept["chosen"]
