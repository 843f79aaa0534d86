# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""IES profiles: reading them, and the light that they send in Cycles."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from fipt_blender.blend.lights import ies
from fipt_blender.blend.pictures.cycles import RenderOptions, render_pixels
from fipt_blender.core.run.errors import FiptError
from samples.rendered_rooms import diffuse_floor


def profile_file(folder: Path, candela: list[float], vertical: list[float], multiplier: float = 1.0) -> Path:
    """A file with one horizontal angle."""
    lines = ["IESNA:LM-63-2002", "[TEST] made", "TILT=NONE"]
    lines += [f"1 1000 {multiplier} {len(vertical)} 1 1 2 0 0 0", "1.0 1.0 60"]
    lines += [" ".join(map(str, values)) for values in (vertical, [0.0], candela)]
    path = folder / "lamp.ies"
    path.write_text("\r\n".join(lines) + "\r\n", encoding="utf-8")
    return path


def test_mean_intensity(tmp_path):
    even = ies.read_profile(profile_file(tmp_path, [5.0] * 3, [0.0, 90.0, 180.0], multiplier=2.0))
    assert even.mean() == pytest.approx(10.0)
    below = ies.read_profile(profile_file(tmp_path, [8.0] * 10, np.linspace(0.0, 90.0, 10).tolist()))
    assert below.mean() == pytest.approx(4.0)


@pytest.mark.parametrize(
    "text",
    ["",
     "IESNA:LM-63-2002\nTILT=lamp.txt\n1", "IESNA\nTILT=NONE\n1 1 1 3 1 2 1 0 0 0 1 1 1",
     "IESNA\nTILT=NONE\n1 1 1 3",
     "IESNA\nTILT=NONE\n1 1 1 3 1 1 1 0 0 0 1 1 1 0 90 180 0 1 2",
     "IESNA\nTILT=NONE\n1 1 1 -3 1 1 1 0 0 0 1 1 1",
     "IESNA\nTILT=NONE\n1 1 1 2 1 1 1 0 0 0 1 1 1 90 0 0 1 1"],
)  # fmt: skip
def test_other_files_are_refused(tmp_path, text):
    path = tmp_path / "lamp.ies"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(FiptError) as error:
        ies.read_profile(path)
    assert error.value.code == "ies-unreadable"


def test_missing_and_large_files_are_refused(tmp_path):
    with pytest.raises(FiptError, match="can't be read"):
        ies.read_profile(tmp_path / "none.ies")
    large = tmp_path / "large.ies"
    large.write_bytes(b" " * (ies.MAX_BYTES + 1))
    with pytest.raises(FiptError, match="larger"):
        ies.read_profile(large)


def lit_floor(light: bpy.types.Object, scene: bpy.types.Scene) -> float:
    """Radiance of a floor below a light, seen from the side of it."""
    camera = bpy.data.objects.new("c", bpy.data.cameras.new("c"))
    scene.collection.objects.link(camera)
    camera.data.type, camera.data.ortho_scale = "ORTHO", 0.05
    camera.matrix_world = Matrix.Translation((0.0, 0.0, 0.5))
    scene.camera = camera
    scene.render.resolution_x = scene.render.resolution_y = 3
    return float(render_pixels(scene, RenderOptions(64, denoise=False)).mean())


def test_an_even_profile_changes_nothing_and_a_half_one_doubles(tmp_path):
    scene = bpy.context.scene
    diffuse_floor(4.0, 0.5)
    data = bpy.data.lights.new("lamp", "AREA")
    data.energy = 10.0
    light = bpy.data.objects.new("lamp", data)
    light.location.z = 2.0
    scene.collection.objects.link(light)
    ies.set_profile(light, ies.read_profile(profile_file(tmp_path, [3.0] * 3, [0.0, 90.0, 180.0])))
    assert light.data.type == "POINT" and len(bpy.data.texts) == 1
    even = lit_floor(light, scene)
    light.data.use_nodes = False
    assert even == pytest.approx(lit_floor(light, scene), rel=0.01)
    below = profile_file(tmp_path, [700.0] * 10, np.linspace(0.0, 90.0, 10).tolist())
    ies.set_profile(light, ies.read_profile(below))
    assert lit_floor(light, scene) == pytest.approx(2.0 * even, rel=0.03)
    assert len(bpy.data.texts) == 1
    ies.remove_profile(light)
    assert light.data.type == "AREA" and not bpy.data.texts
