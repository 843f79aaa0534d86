"""Baking analytic fields: lookups in the textures at random surface points return the fields."""

import numpy as np
import pytest

from fipt_blender.core.capture import images
from fipt_blender.core.capture.images import read_radiance
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.settings import make_settings
from fipt_blender.core.textures import bake, raster
from samples.refusals import error_of
from samples.small_rooms import mesh_room, write_room

TEXELS = 40  # a metre


class AnalyticFields:
    """Smooth functions of position; the second object was not seen."""

    def query(self, positions, triangles):
        x, y, z = positions.astype(np.float64).T
        base_color = np.stack([0.5 + 0.4 * np.sin(2 * x), 0.2 + 0.3 * y, 0.5 + 0.4 * np.cos(3 * z)], axis=1)
        return base_color, 0.2 + 0.3 * x, 0.5 + 0.5 * np.sin(y + z)

    def confidence(self, positions, triangles):
        return np.where(triangles[:, None] < 2, (1.0, 0.5, 0.25), 0.0)


@pytest.fixture
def run(tmp_path):
    """Two squares that share an edge in space (at x = 1); in the atlas they are apart and one is rotated."""
    folder = RunFolder(tmp_path / "run")
    folder.create(make_settings())
    vertices = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0.5), (2, 1, 0.5)], np.float32)
    triangles = np.array([(0, 1, 2), (0, 2, 3), (1, 4, 5), (1, 5, 2)], np.int32)
    write_room(folder.root, mesh_room(vertices, triangles, np.array([0, 0, 1, 1])))
    width, height = 112, 64
    a = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * TEXELS + 8.3
    b = np.array([(0, 0), (0, 1), (-1, 1), (-1, 0)]) * TEXELS + (100.6, 10.1)  # turned by a quarter
    uv = np.array([a[[0, 1, 2]], a[[0, 2, 3]], b[[0, 1, 2]], b[[0, 2, 3]]]) / (width, height)
    np.savez(folder.atlas_npz, corner_uv=uv.astype(np.float32), triangle_image=np.zeros(4, np.int32))
    write_json(folder.atlas_json, {"mode": "uv", "images": [{"name": "Room.001", "width": width, "height": height}]})
    return folder


def surface_points(folder, count=2000):
    """Random points: positions (N,3), UVs (N,2), triangle (N,)."""
    random = np.random.default_rng(0)
    with np.load(folder.room_npz) as room, np.load(folder.atlas_npz) as atlas:
        triangle = random.integers(0, 4, count)
        weights = random.dirichlet((1, 1, 1), count)
        weights[: count // 4, 0] = 0.0  # a quarter of them on edges, where seams are
        weights /= weights.sum(axis=1, keepdims=True)
        corners = room["vertices"][room["triangles"]]
        return (
            np.einsum("nk,nkc->nc", weights, corners[triangle]),
            np.einsum("nk,nkc->nc", weights, atlas["corner_uv"][triangle]),
            triangle,
        )


def look_up(image, uv):
    """Bilinear lookup with V upwards, as in renderers."""
    height, width = image.shape[:2]
    x = uv[:, 0] * width - 0.5
    y = (1.0 - uv[:, 1]) * height - 0.5
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - x0)[:, None], (y - y0)[:, None]
    pixels = [image[np.clip(y0 + dy, 0, height - 1), np.clip(x0 + dx, 0, width - 1)] for dy in (0, 1) for dx in (0, 1)]
    upper, lower = (left * (1 - fx) + right * fx for left, right in (pixels[:2], pixels[2:]))
    return upper * (1 - fy) + lower * fy


def read_map(folder, name):
    entry = read_document(folder.textures_json, dict)["images"][0]
    return read_radiance(folder.root / entry[name])


def test_baked_field_equals_the_field_on_the_surface(run):
    fields = AnalyticFields()
    bake.bake(run, fields)
    positions, uv, triangle = surface_points(run)
    base_color, roughness, metallic = fields.query(positions, triangle)
    # The steepest field changes by 1.2 a metre; a bound of half a texel covers interpolation and half floats.
    bound = 1.2 * 0.5 / TEXELS
    assert np.abs(look_up(read_map(run, "base_color"), uv) - base_color).max() < bound
    assert np.abs(look_up(read_map(run, "roughness"), uv)[:, 0] - roughness).max() < bound
    assert np.abs(look_up(read_map(run, "metallic"), uv)[:, 0] - metallic).max() < bound
    # On the edge that both share the texels of either answer.
    inside = np.abs(positions[:, 0] - 1.0) > 1.0 / TEXELS
    expected = fields.confidence(positions, triangle)[inside]
    assert np.array_equal(look_up(read_map(run, "confidence"), uv)[inside], expected)


def test_each_image_holds_the_triangles_of_its_own(run):
    fields = AnalyticFields()
    atlas = read_document(run.atlas_json, dict)
    entry = atlas["images"][0]
    names = ["Room.001", "Room.002", "Room.003"]
    write_json(run.atlas_json, {**atlas, "images": [{**entry, "name": name} for name in names]})
    with np.load(run.atlas_npz) as arrays:
        image_of = np.array([0, 0, 2, 2], np.int32)  # and none in the second
        np.savez(run.atlas_npz, corner_uv=arrays["corner_uv"], triangle_image=image_of)
    told = []
    files = bake.bake(run, fields, told.append)
    entries = read_document(run.textures_json, dict)["images"]
    assert [each["name"] for each in entries] == names
    assert files == [run.root / each[name] for each in entries for name in bake.MAPS] + [run.textures_json]
    assert told == sorted(told) and told[-1] == 1.0
    positions, uv, triangle = surface_points(run)
    _, roughness, _ = fields.query(positions, triangle)
    for index in (0, 2):
        rows = image_of[triangle] == index
        found = look_up(read_radiance(run.root / entries[index]["roughness"]), uv[rows])[:, 0]
        assert np.abs(found - roughness[rows]).max() < 1.2 * 0.5 / TEXELS


def test_an_image_that_cannot_be_written_ends_the_baking(run, monkeypatch):
    def full(*arguments, **options):
        raise FiptError.of("disk-full", "The disk is full.", "Make room.")

    monkeypatch.setattr(images, "write_exr", full)
    assert "full" in str(error_of(bake.bake, run, AnalyticFields()))
    assert not run.textures_json.exists()


def test_colour_attributes_hold_the_field_at_corners(run):
    write_json(run.atlas_json, {"mode": "color_attribute", "images": []})
    fields = AnalyticFields()
    bake.bake(run, fields)
    with np.load(run.textures / "corner_fields.npz") as corner, np.load(run.room_npz) as room:
        positions = room["vertices"][room["triangles"]].reshape(-1, 3)
        expected = fields.query(positions, np.repeat(np.arange(4), 3))
        assert np.abs(corner["base_color"].reshape(-1, 3) - expected[0]).max() < 2e-3
        assert corner["confidence"][:2].reshape(-1, 3).tolist() == [[1.0, 0.5, 0.25]] * 6
        assert not corner["confidence"][2:].any()
        assert np.abs(corner["roughness"].ravel() - expected[1]).max() < 2e-3


# --- rasteriser ------------------------------------------------------------------------------------------


def test_every_triangle_gets_a_texel_however_thin():
    random = np.random.default_rng(1)
    start = random.uniform(4, 60, (200, 2))
    end = np.clip(start + random.uniform(-10, 10, (200, 2)), 2, 62)
    corners = np.stack([start, end, end + random.uniform(-0.01, 0.01, (200, 2))], axis=1)
    hit = {int(t) for _, triangle, *_ in raster.covered_texels(corners, 64, 64, 0.75) for t in triangle}
    assert hit == set(range(200))


def cross(first, second):
    """The cross product of vectors (..., 2) of the plane; that of numpy 2.5 takes three dimensions only."""
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]


def test_small_triangles_are_found_like_by_trying_all():
    random = np.random.default_rng(4)
    size = 10.0 ** random.uniform(-6, 0.5, (300, 1, 1))
    corners = random.uniform(0, 24, (300, 1, 2)) + size * random.normal(size=(300, 3, 2))
    texel, triangle, weights = raster.nearest_triangle_map(corners, 24, 24)
    centers = np.stack([np.tile(np.arange(24), 24), np.repeat(np.arange(24), 24)], axis=1) + 0.5
    distance = np.full((576, 300), np.inf)
    for start, end in ((0, 1), (1, 2), (2, 0)):
        edge = corners[:, end] - corners[:, start]
        offset = centers[:, None] - corners[None, :, start]
        along = np.clip((offset * edge).sum(axis=2) / np.maximum((edge**2).sum(axis=1), 1e-30), 0.0, 1.0)
        away = np.linalg.norm(offset - along[..., None] * edge, axis=2)
        distance = np.minimum(distance, away)
    # Inside a triangle the distance is zero: a centre is on the same side of all edges.
    sides = [cross(corners[:, (k + 1) % 3] - corners[:, k], centers[:, None] - corners[None, :, k]) for k in range(3)]
    distance[(np.sign(sides) == np.sign(sides[0])).all(axis=0)] = 0.0
    nearest = distance.argmin(axis=1)
    expected = np.flatnonzero(distance.min(axis=1) <= 0.75)
    assert np.array_equal(texel, expected) and np.array_equal(triangle, nearest[expected])
    point = np.einsum("nk,nkc->nc", weights, corners[triangle])
    assert np.allclose(np.linalg.norm(point - centers[texel], axis=1), distance[texel, triangle], atol=1e-5)


def test_texel_centres_are_exact_and_shared_edges_count_once():
    size = 97
    corners = np.array([[(3.2, 4.1), (90.7, 6.0), (80.3, 91.9)], [(3.2, 4.1), (80.3, 91.9), (10.0, 88.0)]])
    for texel, triangle, weights, distance in raster.covered_texels(corners, size, size):
        centre = np.stack([texel % size, texel // size], axis=1) + 0.5
        assert np.abs(np.einsum("nk,nkc->nc", weights, corners[triangle]) - centre).max() < 1e-3
        assert not distance.any()
    count = raster.cover_count(corners, size, size)
    area = sum(0.5 * abs(cross(triangle[1] - triangle[0], triangle[2] - triangle[0])) for triangle in corners)
    assert (count > 0).sum() == pytest.approx(area, rel=0.01)
    assert count.max() == 1
    assert (raster.cover_count(np.concatenate([corners, corners]), size, size) > 1).sum() > 0.99 * area


def test_padding_keeps_islands_and_fills_everything():
    random = np.random.default_rng(2)
    filled = np.zeros((70, 51), bool)
    filled[10:20, 5:15] = filled[50:53, 40:42] = True
    image = random.uniform(0.2, 0.8, (70, 51, 3)).astype(np.float32)
    padded = bake.pad(image, filled)
    assert np.array_equal(padded[filled], image[filled])
    assert padded.min() >= 0.2 - 1e-6 and padded.max() <= 0.8 + 1e-6
    assert not bake.pad(0.0 * image, np.zeros_like(filled)).any()
    # Near an island the padding is its border's, not an average of everything.
    constant = np.zeros((70, 51, 1), np.float32)
    constant[10:20, 5:15] = 1.0
    assert (bake.pad(constant, filled)[10:20, 15:23] == 1.0).all()
