# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The accuracy command's files and predictions on a box whose answers are known."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import predict, truth
from benchmarks.metrics import Maps
from benchmarks.tracer.forward import LitRoom
from benchmarks.tracer.surfaces import TriangleMaterials
from fipt_blender.core import conventions
from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.views import Capture, View
from fipt_blender.core.optics.lights import AreaLights, EmitterTable
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.surface.room import triangle_normals
from samples.small_rooms import mesh_room


def make_view(folder: Path) -> View:
    """Looks down from 2 m at the origin; 8 x 6 pixels."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 2.0
    return View("val/000", "held_back", folder / "val" / "Image" / "000_0001.exr", 8, 6, 8.0, 8.0, 4.0, 3.0, pose)


def make_maps() -> Maps:
    values = np.random.default_rng(0).uniform(0.1, 0.9, (6, 8, 14)).astype(np.float32)
    return Maps(
        values[..., :3], values[..., 3:6], values[..., 6:9], values[..., 9], values[..., 10],
        values[..., 11:], np.ones((6, 8), bool),
    )  # fmt: skip


def test_maps_come_back_from_the_layout(tmp_path: Path) -> None:
    view, maps = make_view(tmp_path), make_maps()
    truth.write_maps(tmp_path, view, maps)
    with pytest.raises(FiptError, match="IndexMA"):
        truth.read_maps(view)
    write_exr(tmp_path / "val" / "IndexMA" / "000_0001.exr", np.ones((6, 8)))
    found = truth.read_maps(view)
    for name in ("kd", "a_prime", "base_color", "roughness", "metallic", "emission", "hit"):
        assert np.array_equal(getattr(found, name), getattr(maps, name)), name
    assert found.material is not None and (found.material == 1).all()
    assert (tmp_path / "val" / "albedo" / "000.exr").exists()


@pytest.mark.parametrize("turned", [False, True])
def test_relight_faces_its_normal(tmp_path: Path, turned: bool) -> None:
    """The light's front follows the given normal in Blender's world, however its faces are wound."""
    face = [[0, 1, 2], [0, 2, 3]] if turned else [[2, 1, 0], [3, 2, 0]]
    data = {
        "light": {
            "vertices": [[0, 2, 0], [1, 2, 0], [1, 2, 1], [0, 2, 1]],  # Y up
            "faces": face,
            "radiance": [3, 2, 1],
            "normal": [0, -1, 0],
        },
        "views": [{"image": "relight/000_0001.exr", "val_index": 0, "transform_matrix": np.eye(4).tolist()}],
    }
    (tmp_path / "relight.json").write_text(json.dumps(data))
    capture = Capture("fipt-synthetic", conventions.world_from_source("y"), None, (make_view(tmp_path),))
    relight = truth.read_relight(tmp_path, capture)
    assert relight is not None
    normals = triangle_normals(relight.vertices, relight.triangles)
    assert np.allclose(normals, [0, 0, -1])
    loop = np.cross(relight.vertices[1] - relight.vertices[0], relight.vertices[2] - relight.vertices[1])
    assert loop[2] < 0  # counter-clockwise seen from below
    assert np.allclose(relight.vertices[:, 2], 2.0)
    assert relight.views[0].image == tmp_path / "relight" / "000_0001.exr"
    assert truth.read_relight(tmp_path / "nowhere", capture) is None


def floor_with_lamp(border: float) -> LitRoom:
    """A floor that emits left of x = `border`, and has a known material right of it."""
    left, right = [[-3, -3, 0], [border, -3, 0], [border, 3, 0], [-3, 3, 0]], [[3, -3, 0], [3, 3, 0]]
    vertices = np.array(left + right, np.float32)
    triangles = np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]], np.int32)
    room = mesh_room(vertices, triangles, np.zeros(4))
    materials = TriangleMaterials(np.tile([0.6, 0.4, 0.2], (4, 1)), np.full(4, 0.5), np.full(4, 0.25))
    table = EmitterTable(np.array([0, 1], np.int32), np.full((2, 3), 5.0, np.float32), np.zeros((2, 3), np.float32))
    return LitRoom(room, materials, AreaLights(vertices, triangles, table))


def test_a_pixel_at_a_border_weighs_its_materials(tmp_path: Path) -> None:
    """Pixels are 0.25 m wide there: 0.4 of each pixel in the fifth column emits, the rest is rough."""
    maps = predict.predict_maps(floor_with_lamp(0.1), make_view(tmp_path), True, spp=128)
    assert np.allclose(maps.emission[:, 4], 0.4 * 5.0, atol=0.06)
    assert np.allclose(maps.roughness[:, 4], 0.6 * 0.5, atol=0.006)
    assert np.allclose(maps.emission[:, 5:], 0.0) and np.allclose(maps.emission[:, :4], 5.0)


def test_predicted_maps_of_a_floor_with_a_lamp(tmp_path: Path) -> None:
    """Left half emits, right half has a known material; a' agrees with its integral within noise."""
    lit = floor_with_lamp(0.0)
    for filtered in (False, True):
        maps = predict.predict_maps(lit, make_view(tmp_path), filtered, spp=1024)
        assert maps.hit.all()
        assert np.allclose(maps.emission[:, :4], 5.0) and np.allclose(maps.emission[:, 4:], 0.0)
        assert np.allclose(maps.kd[:, :4], 0.0)
        assert np.allclose(maps.kd[:, 4:], 0.75 * np.array([0.6, 0.4, 0.2]), atol=1e-5)
        assert np.allclose(maps.roughness[:, 4:], 0.5) and np.allclose(maps.metallic[:, 4:], 0.25)
        specular = maps.a_prime[:, 4:] - maps.kd[:, 4:]
        ks = 0.03 + 0.25 * np.array([0.6, 0.4, 0.2])
        assert (specular > 0.5 * ks).all() and (specular < 1.5 * ks).all()
