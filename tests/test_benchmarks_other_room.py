# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""benchmarks/other_room.py: a capture of the meshes of a Mitsuba scene file; the script ends its process."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "examples")]

from room_files import read_capture  # noqa: E402

SCALE = 0.5
# A room of 8 x 6 x 8 units, seen from inside, with a lamp of 1 x 1 units that the scene file moves up by 2.
BOX = [(x, y, z) for x in (-4, 4) for y in (0, 6) for z in (-4, 4)]
SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def obj(vertices: Sequence[Sequence[int]], quads: Sequence[Sequence[int]]) -> str:
    """An OBJ file of triangles without normals and UVs."""
    lines = [f"v {x} {y} {z}" for x, y, z in vertices]
    for a, b, c, d in quads:
        lines += [f"f {a + 1} {b + 1} {c + 1}", f"f {a + 1} {c + 1} {d + 1}"]
    return "\n".join(lines)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The capture of a box with a lamp and a panel."""
    folder = tmp_path_factory.mktemp("other_room")
    (folder / "box.obj").write_text(obj(BOX, SIDES))
    (folder / "lamp.obj").write_text(obj([(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)], [(0, 1, 2, 3)]))
    moved = '<matrix value="1 0 0 0  0 1 0 2  0 0 1 0  0 0 0 1"/>'
    (folder / "scene.xml").write_text(
        '<scene version="0.5.0">'
        '<shape type="obj"><string name="filename" value="lamp.obj"/>'
        f'<transform name="toWorld">{moved}</transform><ref id="Plastic"/></shape>'
        '<shape type="sphere"><float name="radius" value="1"/></shape>'
        '<shape type="obj"><string name="filename" value="box.obj"/><ref id="Paint"/></shape>'
        "</scene>"
    )
    panel = [[-1, 5.9, -1], [1, 5.9, -1], [1, 5.9, 1], [-1, 5.9, 1]]
    plan = {
        "scale": SCALE,
        "lamps": {"Bulb": {"meshes": ["lamp"], "radiance": [3.0, 2.0, 1.0]}},
        "panels": {"Panel": {"corners": panel, "normal": [0, -1, 0], "radiance": [5.0, 5.0, 5.0]}},
        "materials": {},
        "textures": {},
        "classes": {"Paint": 2},
        "cameras": {"low": [-4, 0, -4], "high": [4, 6, 4], "look_low": [-2, 1, -2], "look_high": [2, 3, 2]},
    }
    (folder / "plan.json").write_text(json.dumps(plan))
    command = [sys.executable, str(ROOT / "benchmarks" / "other_room.py")]
    command += [str(folder / "scene.xml"), str(folder / "plan.json"), "--output", str(folder / "made")]
    subprocess.run([*command, "--views", "7"], check=True, capture_output=True)
    return folder / "made"


def test_meshes_are_scaled_and_moved(made: Path) -> None:
    capture = read_capture(made)
    assert len(capture.corners) == 2 + 12 + 2
    np.testing.assert_allclose(capture.corners.min((0, 1)), [-2, 0, -2])
    np.testing.assert_allclose(capture.corners.max((0, 1)), [2, 3, 2])
    lamp = next(m["id"] for m in capture.materials if m["name"] == "Bulb")
    np.testing.assert_allclose(capture.corners[capture.material == lamp][..., 1], 2 * SCALE)


def test_lamps_emit_and_the_panel_faces_down(made: Path) -> None:
    capture = read_capture(made)
    assert {e["name"]: e["radiance"] for e in capture.emitters} == {"Bulb": [3, 2, 1], "Panel": [5, 5, 5]}
    for emitter in capture.emitters:
        first, end = emitter["triangles"]
        assert end - first == 2
    panel = next(m["id"] for m in capture.materials if m["name"] == "Panel")
    corners = capture.corners[capture.material == panel]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (across[:, 1] < 0).all()
    np.testing.assert_allclose(capture.normals[capture.material == panel].reshape(-1, 3), [[0, -1, 0]] * 6)


def test_normals_follow_the_triangles_where_the_file_has_none(made: Path) -> None:
    capture = read_capture(made)
    corners = capture.corners
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    np.testing.assert_allclose(capture.normals, np.repeat(across[:, None], 3, 1), atol=1e-3)


def test_cameras_stand_in_the_room(made: Path) -> None:
    capture = read_capture(made)
    assert (len(capture.poses["train"]), len(capture.poses["val"])) == (7, 1)
    for pose in capture.poses["train"] + capture.poses["val"]:
        x, y, z = pose[:3, 3]
        assert abs(x) < 1.75 and abs(z) < 1.75 and 0.8 <= y <= 2.3
        np.testing.assert_allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3), atol=1e-9)
        assert np.linalg.det(pose[:3, :3]) > 0
