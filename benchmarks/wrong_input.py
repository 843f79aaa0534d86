# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the check of the input finds in captures that are made wrong: `wrong_input.py CAPTURE... [--halve]`.

Only the check before the stages runs (`core/checks/consensus.py`). One line for each capture and fault: poses
found and missed, right ones that are blamed, and the error's code and text.
"""

from __future__ import annotations

import argparse
import io
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from fipt_blender.core.alignment.mesh_file import read_mesh
from fipt_blender.core.alignment.turns import turn_by
from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.ingest import ingest
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.capture.views import View, load_capture
from fipt_blender.core.conventions import transform_points
from fipt_blender.core.device.variant import set_variant
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.messages import Reporter
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.settings import make_settings

# Share of the views, degrees and metres by which their poses are wrong.
POSES = ((0.1, 15.0, 0.3), (0.3, 15.0, 0.3), (0.5, 15.0, 0.3), (0.3, 2.0, 0.0))
FEW = 9  # views of the fewest


def disturbed(
    views: Sequence[View], share: float, degrees: float, metres: float, seed: int
) -> tuple[list[View], set[int]]:
    """The views with a share of wrong poses, each turned and moved in its own direction; which these are."""
    rng = np.random.default_rng(seed)
    chosen = set(rng.permutation(len(views))[: round(share * len(views))].tolist())
    result = list(views)
    for index in sorted(chosen):
        axis, away = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
        pose = views[index].camera_to_world.copy()
        pose[:3, :3] = pose[:3, :3] @ turn_by(np.radians(degrees) * axis)
        pose[:3, 3] += metres * away
        result[index] = replace(views[index], camera_to_world=pose)
    return result, chosen


def meshes(vertices: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Names and vertices (V, 3) of wrong meshes."""
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    for name, turn, around in (
        ("mirrored X", np.diag([-1.0, 1.0, 1.0]), np.zeros(3)),
        ("mirrored X at its middle", np.diag([-1.0, 1.0, 1.0]), middle),
        ("millimetres", 1000.0 * np.eye(3), np.zeros(3)),
        ("inches", np.eye(3) / 0.0254, np.zeros(3)),
        ("kilometres", 0.001 * np.eye(3), np.zeros(3)),
        ("Y up", np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]), np.zeros(3)),
    ):
        yield name, (vertices - around) @ turn.T + around
    yield "moved by 1 m", vertices + (1.0, 0.0, 0.0)
    yield "moved by 5 m", vertices + (5.0, 0.0, 0.0)


def halved(view: View, folder: Path) -> View:
    """The view with half as many pixels along each side."""
    height, width = view.height // 2, view.width // 2
    pixels = view.radiance()[: 2 * height, : 2 * width].reshape(height, 2, width, 2, 3).mean(axis=(1, 3))
    path = folder / f"{view.name.replace('/', '-')}.exr"
    write_exr(path, pixels.astype(np.float32))
    return replace(view.resized(width, height), image=path, encoded=False, mask=None, parts=None)


def examine(capture: Path, halve: bool, seed: int) -> None:
    """Print what is found in one capture."""
    from fipt_blender.core.checks.consensus import check_input
    from fipt_blender.core.surface.room import Room, triangle_normals

    with tempfile.TemporaryDirectory() as temporary:
        run = RunFolder(Path(temporary) / "run")
        ingest(capture, run, CaptureOptions(), Reporter(io.StringIO()))
        source = load_capture(run)
        views = [halved(view, run.root) for view in source.train] if halve else source.train
        if source.mesh is None:
            raise FiptError("mesh-missing", f"{capture} has no mesh.", "Give a capture with a mesh.")
        vertices, triangles = read_mesh(source.mesh)
        vertices = transform_points(source.world_from_source, vertices)

        def say(name: str, some: Sequence[View], chosen: set[int], places: np.ndarray) -> None:
            normals = triangle_normals(places, triangles).repeat(3, axis=0).reshape(-1, 3, 3)
            none = np.zeros(len(triangles), np.int32)
            arrays = places.astype(np.float32), triangles.astype(np.int32), normals.astype(np.float32)
            try:
                blamed = set(check_input(Room(*arrays, none, none), some, make_settings("draft")))
                text = (
                    f"{len(blamed & chosen)} of {len(chosen)} found, {len(blamed - chosen)} right ones blamed"
                )
            except FiptError as error:
                text = f"{error.code}: {error.text}"
            print(f"{capture.name} | {name} | {text}", flush=True)

        say("right", views, set(), vertices)
        say(f"right, {FEW} views", views[:: max(1, len(views) // FEW)][:FEW], set(), vertices)
        for share, degrees, metres in POSES:
            some, chosen = disturbed(views, share, degrees, metres, seed)
            say(f"{100.0 * share:.0f} % by {degrees:g} degrees, {metres:g} m", some, chosen, vertices)
        for name, places in meshes(vertices):
            say(name, views, set(), places)


def main(argv: Sequence[str]) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("captures", type=Path, nargs="+", metavar="CAPTURE")
    parser.add_argument("--halve", action="store_true", help="photographs of half the width and height")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args(list(argv))
    set_variant("llvm")
    for capture in arguments.captures:
        examine(capture, arguments.halve, arguments.seed)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
