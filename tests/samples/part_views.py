"""Views around a thing in the middle of a room, with part masks, and runs of scans of that room."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.views import View
from fipt_blender.core.pixels.camera_rays import trace_pixels
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.surface.room import Room
from samples.camera_poses import look_at
from samples.made_rooms import clean_run
from samples.small_rooms import write_room

SIZE, FOCAL = 64, 40.0
THING_PART, ROOM_PART = 7, 1


def looking_views(folder: Path, room: Room, radiance: float = 1.0) -> list[View]:
    """Views from around the middle of the room, downwards and nearly level, with masks of its objects."""
    views = []
    for number in range(12):
        angle = 2.0 * np.pi * number / 12
        place = np.array([1.7 * np.cos(angle), 1.7 * np.sin(angle), (0.5, 1.3, 2.2)[number % 3]])
        pose = look_at(place, [0.0, 0.0, 0.5])
        image, parts = folder / f"{number}.exr", folder / f"parts_{number}.exr"
        view = View(str(number), "train", image, SIZE, SIZE, FOCAL, FOCAL, SIZE / 2, SIZE / 2, pose, parts=parts)
        surface = trace_pixels(room, view)
        lost = room.triangle_object[np.array(surface.triangle)] == 1
        write_exr(image, np.full((SIZE, SIZE, 3), radiance, np.float32))
        write_exr(parts, np.where(lost, THING_PART, ROOM_PART).reshape(SIZE, SIZE).astype(np.float32))
        views.append(view)
    return views


def numbered_anew(ids: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The same regions with other ids above 0."""
    return rng.permutation(np.arange(1, ids.max() + 2))[ids]


def with_own_ids(views: list[View], rng: np.random.Generator) -> list[View]:
    """The views with masks of the same regions, whose ids mean nothing in other views."""
    changed = []
    for view in views:
        path = view.parts.with_name(f"own_{view.name}.exr")
        place = np.unique(view.part_ids(), return_inverse=True)[1].reshape(view.height, view.width)
        write_exr(path, numbered_anew(place, rng) + rng.integers(90))
        changed.append(replace(view, parts=path))
    return changed


def write_run(root: Path, room: Room, parts: str) -> RunFolder:
    run = RunFolder(root)
    write_room(root, room)
    write_json(run.room_json, {"objects": ["scan"], "materials": ["scan"], "parts": parts})
    clean_run(run)
    return run
