"""The accuracy command: its files, predictions and metrics, on small arrays whose answers are known."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import metrics, predict, truth
from benchmarks.metrics import Maps
from benchmarks.tracer.forward import LitRoom
from benchmarks.tracer.surfaces import TriangleMaterials
from fipt_blender.core import conventions
from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.views import Capture, View
from fipt_blender.core.report import comparison
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.surface.adjacency import face_vectors
from samples.small_rooms import area_lights, mesh_room, table


def make_view(folder: Path) -> View:
    """Looks down from 2 m at the origin; 8 x 6 pixels."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 2.0
    return View("val/000", "held_back", folder / "val" / "Image" / "000_0001.exr", 8, 6, 8.0, 8.0, 4.0, 3.0, pose)


def make_maps() -> Maps:
    values = np.random.default_rng(0).uniform(0.1, 0.9, (6, 8, 14)).astype(np.float32)
    colors = np.split(values[..., :9], 3, axis=2)
    return Maps(*colors, values[..., 9], values[..., 10], values[..., 11:], np.ones((6, 8), bool))


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
    normals = face_vectors(np.asarray(relight.vertices, float), relight.triangles)[0]
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
    return LitRoom(room, materials, area_lights(room, table([0, 1], [5.0] * 3)))


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
        maps = predict.predict_maps(lit, make_view(tmp_path), filtered, spp=256)
        assert maps.hit.all()
        assert np.allclose(maps.emission[:, :4], 5.0) and np.allclose(maps.emission[:, 4:], 0.0)
        assert np.allclose(maps.kd[:, :4], 0.0)
        assert np.allclose(maps.kd[:, 4:], 0.75 * np.array([0.6, 0.4, 0.2]), atol=1e-5)
        assert np.allclose(maps.roughness[:, 4:], 0.5) and np.allclose(maps.metallic[:, 4:], 0.25)
        specular = maps.a_prime[:, 4:] - maps.kd[:, 4:]
        ks = 0.03 + 0.25 * np.array([0.6, 0.4, 0.2])
        assert (specular > 0.5 * ks).all() and (specular < 1.5 * ks).all()


# -------------------------------------------------------------------------------------------------- metrics


def sample_maps() -> Maps:
    """2 x 4 pixels: one misses the mesh, one emits, two are glossy, four are diffuse."""
    shape = (2, 4)
    roughness = np.ones(shape)
    roughness[0, 2:] = 0.3
    emission = np.zeros((*shape, 3))
    emission[0, 1] = [0.0, 2.0, 0.0]
    hit = np.ones(shape, bool)
    hit[0, 0] = False
    grey = np.full((*shape, 3), 0.4)
    return Maps(grey, grey, grey, roughness, np.zeros(shape), emission, hit)


def test_protocols_differ_in_what_counts() -> None:
    """An error of 0.2 in kd everywhere: four of eight pixels count, or are averaged with four right ones."""
    true = sample_maps()
    predicted = dataclasses.replace(true, kd=true.kd + 0.2)
    strict = metrics.map_metrics([predicted], [true], True)["kd_psnr"]
    paper = metrics.map_metrics([predicted], [true], False)["kd_psnr"]
    assert strict == pytest.approx(-10 * np.log10(0.04), abs=1e-9)
    assert paper == pytest.approx(-10 * np.log10(0.02), abs=1e-9)


def test_only_diffuse_pixels_count_for_kd_and_emitters_for_none() -> None:
    true = sample_maps()
    kd = true.kd.copy()
    kd[0] = 9.0
    roughness = true.roughness.copy()
    roughness[0, :2] = 0.0
    predicted = dataclasses.replace(true, kd=kd, roughness=roughness)
    found = metrics.map_metrics([predicted], [true], True)
    assert found["kd_psnr"] == found["sigma_psnr"] == 100.0


def test_errors_at_borders_and_inside_are_told_apart() -> None:
    """Errors of 0.2 at the two columns of a border and of 0.02 elsewhere, in views of different size."""

    def view(rows: int) -> tuple[Maps, Maps]:
        shape = (rows, 6)
        grey, rough = np.full((*shape, 3), 0.4), np.ones(shape)
        material = np.repeat([[1, 1, 1, 2, 2, 2]], rows, axis=0)
        true = Maps(grey, grey, grey, rough, 0 * rough, 0 * grey, np.ones(shape, bool), material)
        off = np.where(metrics.near_borders(material), 0.2, 0.02)
        wrong = dataclasses.replace(true, kd=grey + off[..., None], roughness=rough + off, metallic=off)
        return wrong, true

    pairs = [view(2), view(5)]
    found = metrics.border_metrics([wrong for wrong, _ in pairs], [true for _, true in pairs])
    for name in ("kd_psnr", "sigma_psnr", "metallic_psnr"):
        assert found["edge"][name] == pytest.approx(-20 * np.log10(0.2))
        assert found["inside"][name] == pytest.approx(-20 * np.log10(0.02))
    assert found["edge"]["a_prime_psnr"] == found["inside"]["a_prime_psnr"] == 100.0
    assert found["edge_share"] == pytest.approx(1.0 / 3.0)


def test_errors_are_pooled_over_views() -> None:
    kept = [np.ones((1, 1), bool), np.ones((1, 3), bool)]
    true = [np.zeros((1, 1)), np.zeros((1, 3))]
    predicted = [np.full((1, 1), 0.2), np.zeros((1, 3))]
    assert metrics.pooled_psnr(predicted, true, kept, True) == pytest.approx(20.0)
    nothing = [np.zeros((1, 1), bool), np.zeros((1, 3), bool)]
    assert metrics.pooled_psnr(predicted, true, nothing, True) is None


def test_quantisation_hides_small_errors_only_in_the_papers_protocol() -> None:
    kept, true = [np.ones((2, 2), bool)], [np.full((2, 2), 100.0 / 255.0)]
    predicted = [true[0] + 0.4 / 255.0]
    assert metrics.pooled_psnr(predicted, true, kept, False) == 100.0
    assert metrics.pooled_psnr(predicted, true, kept, True) == pytest.approx(-20 * np.log10(0.4 / 255.0))


def test_emission() -> None:
    true, predicted = np.zeros((2, 2, 3)), np.zeros((2, 2, 3))
    true[0] = [np.e - 1.0, 0.0, 0.0]
    predicted[:, 0] = [0.0, 0.0, np.e - 1.0]
    assert metrics.emission_iou([predicted], [true]) == pytest.approx(1.0 / 3.0)
    assert metrics.log_l2([predicted], [true]) == pytest.approx(4.0 / 12.0)
    assert metrics.emission_iou([np.zeros((1, 1, 3))], [np.zeros((1, 1, 3))]) == 1.0


def test_rendered_images() -> None:
    true = np.full((2, 2, 3), 0.5)
    true[0] = 7.0
    predicted = true.copy()
    predicted[1] = (0.5**comparison.GAMMA + 0.1) ** 2.2
    predicted[0] = 3.0  # clipped in both
    assert metrics.image_psnr(predicted, true) == pytest.approx(-10 * np.log10(0.005))
    assert metrics.image_psnr(predicted, true, strict=True) == pytest.approx(20.0)
    assert metrics.image_psnr(true * 0 + 2, true * 0 + 2, strict=True) is None
    mean = metrics.mean_image_psnr([predicted, predicted], [true, predicted])
    assert mean == pytest.approx((metrics.image_psnr(predicted, true) + 100.0) / 2.0)
    assert metrics.mean_image_psnr([], []) is None


@pytest.mark.parametrize("filtered", [False, True])
def test_filtered_ground_truth_is_recognised(filtered: bool) -> None:
    """A disc of roughness 0.3 on 1, sampled at pixel centres or averaged over 8 x 8 positions a pixel."""
    side, fine = 32, 8
    x, y = np.meshgrid(*[(np.arange(side * fine) + 0.5) / fine] * 2)
    disc = np.where((x - 15.3) ** 2 + (y - 17.1) ** 2 < 90.0, 0.3, 1.0).reshape(side, fine, side, fine)
    roughness = disc.mean(axis=(1, 3)) if filtered else disc[:, fine // 2, :, fine // 2]
    maps = dataclasses.replace(sample_maps(), roughness=roughness)
    assert truth.maps_are_filtered([maps]) is filtered
    assert truth.maps_are_filtered([dataclasses.replace(maps, roughness=np.ones((9, 9)))]) is False
