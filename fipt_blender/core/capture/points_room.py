# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A room of planes for a capture without a mesh, from the sparse points of its camera solve."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..depth.plane_room import PlaneRoom, plane_room
from ..run.runfolder import atomic_path
from .formats import read_points
from .rig import Note, Rig


def room_of_points(capture: Path, rig: Rig) -> PlaneRoom:
    """The room, in the coordinates of the rig.

    Raises:
        FiptError: ``alignment-points`` where the format has no points, ``room-points`` where they are too
            few, or one of the reader's.
    """
    poses = np.array([view.camera_to_world for view in rig.views])
    return plane_room(read_points(capture, rig.source), poses[:, :3, 3], -poses[:, :3, 1].mean(axis=0))


def write_room(path: Path, room: PlaneRoom) -> None:
    """Write an OBJ file with one object for each piece, completely or not at all.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    lines, first = [], 1
    for piece in room.pieces:
        lines.append(f"o {piece.name}")
        lines += ["v {:.9g} {:.9g} {:.9g}".format(*vertex) for vertex in piece.vertices]
        lines += ["f " + " ".join(str(first + index) for index in face) for face in piece.faces]
        first += len(piece.vertices)
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join([*lines, ""]), encoding="utf-8")


def room_note(room: PlaneRoom) -> Note:
    """What the room is, and which of its parts no points support."""
    names = [piece.name for piece in room.pieces]
    walls, boxes = (sum(name.startswith(kind) for name in names) for kind in ("Wall", "Box"))
    guessed = f" No points support {', '.join(room.guessed)}." if room.guessed else ""
    return Note(
        "plane-room",
        f"The room is a stand-in of {walls} walls, floor, ceiling and {boxes} boxes, fitted to the points of"
        f" the camera solve.{guessed}",
        "Look through some views and correct the objects in Edit Mode; what a photograph shows off them gets"
        " wrong materials. A scan or a model gives better results.",
    )
