"""Detail of photographs on texels: a wall with a known texture, under known light, seen by three cameras."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from fipt_blender.core.capture.images import Picture, write_exr
from fipt_blender.core.capture.views import View
from fipt_blender.core.light.baking import ShadingStore
from fipt_blender.core.light.shadings import roughness_levels
from fipt_blender.core.pixels.store import PixelStore
from fipt_blender.core.run.messages import Reporter
from fipt_blender.core.run.result_contents import Stages
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.settings import make_settings
from fipt_blender.core.surface.smoothing import SmoothingGrid
from fipt_blender.core.textures import detail
from fipt_blender.core.textures.texel_views import Seen
from fipt_blender.core.textures.texels import Texels
from samples.combinations import pairs
from samples.small_captures import write_views
from samples.small_rooms import mesh_room

SIZE, FACTOR = 128, 4  # pixels of a photograph, and in one of light, along each axis
FOCAL = 75.0
TEXELS = 80  # on the wall, along each axis
PLACES = ((0.3, 0.6, 1.6), (1.0, 1.0, 1.5), (1.6, 1.3, 1.7))  # of the cameras, which look down on a wall of 2 x 2 m


def texture(x, y):
    """(N, 3) base colour: squares of 62 mm, too small for pixels of light (80 to 90 mm)."""
    squares = (np.floor(x / 0.062) + np.floor(y / 0.062)) % 2
    return (0.3 + 0.3 * squares)[..., None] * np.array([1.0, 0.8, 0.6])


def plain(x, y):
    """(N, 3) one base colour."""
    return np.full((*x.shape, 3), (0.45, 0.36, 0.27))


def smooth_light(x, y):
    """(N,) L_d that changes slowly."""
    return 1.0 + 0.25 * np.sin(1.5 * x) + 0.1 * y


def stepped_light(x, y):
    """(N,) L_d with the edge of a shadow."""
    return np.where(x + 0.3 * y < 1.13, 1.2, 0.5)


def wall(offset=0.0):
    """(4, 3) corners and (2, 3) triangles of a square in a plane."""
    return np.float32([(0, 0, offset), (2, 0, offset), (2, 2, offset), (0, 2, offset)]), np.int32(
        [(0, 1, 2), (0, 2, 3)]
    )


def make_room(shelf=False):
    """The wall, and before a part of it a shelf."""
    vertices, triangles = wall()
    if shelf:
        board = wall(0.4)[0] * np.float32([0.3, 0.3, 1.0]) + np.float32([0.7, 0.7, 0.0])
        vertices, triangles = np.concatenate([vertices, board]), np.concatenate([triangles, triangles + 4])
    return mesh_room(vertices, triangles, np.zeros(len(triangles)))


def photograph(view, color, light, shelf):
    """(H, W, 3) radiance, means over 4 x 4 places in each pixel, and what the centres see."""
    quarters = (0.125, 0.375, 0.625, 0.875)
    return np.mean([shade(*hits(view, dx, dy, shelf), color, light) for dy in quarters for dx in quarters], axis=0)


def hits(view, dx, dy, shelf):
    """Points (H, W, 3) that the places of the pixels see, and whether they are on the shelf."""
    row, column = np.mgrid[0 : view.height, 0 : view.width]
    along = np.stack([(column + dx - view.cx) / view.fx, (row + dy - view.cy) / view.fy, np.ones(row.shape)], axis=-1)
    along = along @ view.camera_to_world[:3, :3].T
    eye = view.camera_to_world[:3, 3]
    point = eye + along * ((0.0 - eye[2]) / along[..., 2:])
    upper = eye + along * ((0.4 - eye[2]) / along[..., 2:])
    on_shelf = np.zeros(row.shape, bool)
    if shelf:
        on_shelf = ((upper[..., :2] > 0.7) & (upper[..., :2] < 1.3)).all(axis=-1)
    return np.where(on_shelf[..., None], upper, point), on_shelf


def shade(point, on_shelf, color, light):
    x, y = point[..., 0], point[..., 1]
    radiance = color(x, y) * light(x, y)[..., None]
    outside = (x < 0) | (x > 2) | (y < 0) | (y > 2)
    return np.where(on_shelf[..., None], (3.0, 0.1, 0.1), np.where(outside[..., None], 0.0, radiance))


def scene(folder, color, light, gains=(1.0, 1.0, 1.0), noise=0.0, shelf=False):
    """The input of three cameras whose photographs have these gains."""
    rng = np.random.default_rng(3)
    photographs, lights, columns = [], [], []
    for index, place in enumerate(PLACES):
        pose = np.diag([1.0, -1.0, -1.0, 1.0])
        pose[:3, 3] = place
        view = View(
            f"train/{index}", "train", folder / f"{index}.exr", SIZE, SIZE, FOCAL, FOCAL, SIZE / 2, SIZE / 2, pose
        )
        image = photograph(view, color, light, shelf) * gains[index]
        write_exr(view.image, image * (1.0 + noise * rng.normal(size=image.shape)))
        small = view.resized(SIZE // FACTOR, SIZE // FACTOR)
        point, on_shelf = hits(small, 0.5, 0.5, shelf)
        x, y = point[..., 0].reshape(-1), point[..., 1].reshape(-1)
        on_wall = (x >= 0) & (x <= 2) & (y >= 0) & (y <= 2)
        triangle = np.where(on_shelf.reshape(-1), 2 + (x < y), np.where(on_wall, (x < y).astype(int), -1))
        mean = image.reshape(small.height, FACTOR, small.width, FACTOR, 3).mean(axis=(1, 3)).reshape(-1, 3)
        lit = [
            light(*np.moveaxis(hits(small, *at, shelf)[0][..., :2], -1, 0)) for at in pairs((0.25, 0.75), (0.25, 0.75))
        ]
        shading = np.mean(lit, axis=0).reshape(-1)
        photographs.append(view)
        lights.append(small)
        columns.append((mean / gains[index], point.reshape(-1, 3), triangle, shading))
    radiance, position, triangle, shading = (np.concatenate(column) for column in zip(*columns, strict=True))
    count = len(triangle)
    normal = np.tile(np.float32([0, 0, 1]), (count, 1))
    ranges = np.arange(len(PLACES) + 1) * (SIZE // FACTOR) ** 2
    radiance, position = radiance.astype(np.float32), position.astype(np.float32)
    every, ones = np.ones(count, bool), np.ones(count, np.float32)
    columns = (position, normal, triangle.astype(np.int32), every, ~every, radiance, ones)
    store = PixelStore(lights, ranges, radiance, *columns)
    diffuse = np.repeat(shading[:, None], 3, axis=1).astype(np.float16)
    shadings = ShadingStore(diffuse, np.zeros((count, 2, 2, 3), np.float16), roughness_levels(2, 0.1, 1.0))
    return detail.DetailInput(photographs, store, shadings)


def wall_texels(color=plain):
    """Texels of the wall with the estimate's base colour, row by row."""
    row, column = np.mgrid[0:TEXELS, 0:TEXELS]
    x, y = (2.0 * (column.reshape(-1) + 0.5) / TEXELS, 2.0 * (row.reshape(-1) + 0.5) / TEXELS)
    ones, place = np.ones(len(x), np.float32), np.stack([x, y, 0.0 * x], axis=1).astype(np.float32)
    surface = (place, (x < y).astype(np.int32), color(x, y).astype(np.float32), ones, 0.0 * ones)
    return Texels(*surface, np.ones((len(x), 3), np.float32), 2.0 / TEXELS * ones)


def improved(given, shelf=False, estimate=plain):
    """(texels, base colour) with detail; wall and shelf are different parts."""
    room, texels = make_room(shelf), wall_texels(estimate)
    part = np.array([0, 0, 1, 1][: len(room.triangles)], np.int32)
    return texels, detail.add_detail(given, room, part, texels)


def middle(texels):
    """Texels away from the wall's border."""
    return ((texels.position[:, :2] > 0.25) & (texels.position[:, :2] < 1.75)).all(axis=1)


def mean_texture(texels):
    """Truth: the texture's mean over each texel."""
    x, y = texels.position[:, 0].astype(float), texels.position[:, 1].astype(float)
    shifts = (np.arange(4) - 1.5) * 0.5 / TEXELS
    return np.mean([texture(x + dx, y + dy) for dx in shifts for dy in shifts], axis=0)


@pytest.fixture(scope="module")
def textured(tmp_path_factory):
    """(texels, base colour, photographs that were read) of the wall with its texture in smooth light."""
    given = scene(tmp_path_factory.mktemp("textured"), texture, smooth_light)
    read = []
    true = Picture.shown
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Picture, "shown", lambda one: read.append(one.path.name) or true(one))
        return *improved(given), read


def test_a_texture_finer_than_the_pixels_of_light_comes_back(textured):
    texels, color, read = textured
    assert read == ["0.exr", "1.exr", "2.exr"]  # one at a time and once
    inside, truth = middle(texels), mean_texture(texels)
    assert np.corrcoef(color[inside, 0], truth[inside, 0])[0, 1] > 0.95
    assert np.abs(color - truth)[inside].mean() < 0.4 * np.abs(texels.base_color - truth)[inside].mean()


def test_gains_and_the_level_of_photographs_do_not_change_it(tmp_path, textured):
    texels, unlike = improved(scene(tmp_path, texture, smooth_light, gains=(0.4, 1.0, 2.5)))
    assert np.abs(textured[1] - unlike)[middle(texels)].max() < 0.02


def test_the_edge_of_a_shadow_is_not_painted(tmp_path):
    texels, color = improved(scene(tmp_path, plain, stepped_light))
    assert np.abs(color - texels.base_color).max() < 0.05
    assert np.sqrt(((color - texels.base_color)[middle(texels)] ** 2).mean()) < 0.01


def test_a_texture_keeps_its_detail_at_the_edge_of_a_shadow(tmp_path):
    texels, color = improved(scene(tmp_path, texture, stepped_light))
    x, y = texels.position[:, 0], texels.position[:, 1]
    near = middle(texels) & (np.abs(x + 0.3 * y - 1.13) < 0.1)
    assert np.corrcoef(color[near, 0], mean_texture(texels)[near, 0])[0, 1] > 0.4


def test_codes_become_light_by_the_response_that_was_found(tmp_path):
    given = scene(tmp_path, texture, smooth_light)
    light = photograph(given.photographs[0], texture, smooth_light, shelf=False)
    path = tmp_path / "0.png"
    codes = np.round(255.0 * (light / 2.0) ** (1 / 1.6)).astype(np.uint8)  # brighter and flatter than sRGB's
    Image.fromarray(codes).save(path)
    view = replace(given.photographs[0], image=path, encoded=True)
    response = 1.6 * np.log(np.maximum(np.arange(256), 0.5) / 255.0)
    encoded = replace(given, photographs=[view, *given.photographs[1:]], response=response)
    radiance = detail.photograph(encoded, 0)
    bright = light > 0.1
    assert np.abs(radiance[bright] / light[bright] - 1.0).max() < 0.05


def test_noise_of_a_wall_of_one_colour_is_not_painted(tmp_path):
    texels, color = improved(scene(tmp_path, plain, smooth_light, noise=0.05))
    assert (color - texels.base_color)[middle(texels)].std() < 0.004  # one view has 0.02


def test_what_hides_a_wall_is_not_painted_onto_it(tmp_path):
    texels, color = improved(scene(tmp_path, plain, smooth_light, shelf=True), shelf=True)
    assert np.abs(color - texels.base_color).max() < 0.03


def test_views_without_more_pixels_than_light_tell_nothing(tmp_path):
    given = scene(tmp_path, texture, smooth_light)
    same = replace(given, photographs=given.pixels.views)
    texels, color = improved(same)
    assert np.array_equal(color, texels.base_color)


def test_what_one_large_photograph_shows_among_small_ones_stays_finite(tmp_path):
    """No second view says what is noise: the estimate stays as it is, also where a node of the grid has no weight."""
    given = scene(tmp_path, texture, smooth_light)
    mixed = replace(given, photographs=[given.photographs[0], *given.pixels.views[1:]])
    assert mixed.larger() == [0]
    texels, color = improved(mixed)
    assert np.array_equal(color, texels.base_color)


def test_weights_whose_squares_vanish_stay_finite():
    """Where the light's error is huge, in the dark, a view has next to no weight."""
    texels, room = wall_texels(), make_room()
    cells = SmoothingGrid.around(texels.position, np.array([0, 0]), texels.triangle, 0.2)
    totals, every = detail.Totals.of(len(texels)), np.arange(len(texels))
    for shift in (-0.1, 0.1):
        weight = np.where(texels.position[:, 0] < 1.0, 1e-25, 1.0).astype(np.float32)
        seen = Seen(every, texels.base_color + np.float32(shift), weight, np.zeros(len(texels), np.float32))
        totals.add(seen, seen.color, texels.base_color)
    color = totals.result(texels, cells, np.zeros(len(room.triangles), np.int32))
    assert np.isfinite(color).all() and np.array_equal(color[weight < 1.0], texels.base_color[weight < 1.0])


def estimated_run(folder, given):
    """A run whose results were made of the pixels and shadings in its stage `light`."""
    run = RunFolder(folder / "run")
    run.create(make_settings())
    write_views(run, given.photographs)
    detail.remember_light(run, detail.SolvedLight(given.pixels, given.shadings))
    run.results.mkdir(exist_ok=True)
    for path in (run.stages_json, run.results / "stages.json"):
        write_json(path, Stages({"light": "a", "quality": "b"}, {"light": {}, "quality": {}}, {}))
    return run


@pytest.mark.parametrize(
    ("later", "found"),
    [
        (Stages({"light": "a", "quality": "c"}, {"light": {}}, {}), True),  # begun anew after the light
        (Stages({"light": "c", "quality": "c"}, {}, {}), False),
        (Stages({"light": "c", "quality": "c"}, {"light": {}}, {}), False),
        (Stages({"light": "a", "quality": "c"}, {"light": {}}, {}, ("light",)), False),
    ],
)
def test_a_stopped_estimation_is_told_of_where_it_took_the_detail(tmp_path, later, found):
    run = estimated_run(tmp_path, scene(tmp_path, texture, smooth_light))
    reporter = Reporter()
    assert detail.load_input(run, reporter) is not None and not reporter.warnings
    write_json(run.stages_json, later)
    assert (detail.load_input(run, reporter) is not None) == found
    assert [warning["code"] for warning in reporter.warnings] == ([] if found else ["detail-lost"])


def test_detail_is_only_read_where_the_setting_and_the_sizes_ask_for_it(tmp_path):
    run = RunFolder(tmp_path / "run")
    run.create(make_settings(changes={"detail": False}))
    write_json(run.stage / "views.json", {"views": [], "shadings": "shadings"})
    assert detail.load_input(run) is None


def test_smoothing_keeps_constants_and_does_not_cross_parts():
    rng = np.random.default_rng(0)
    position = rng.uniform(0, 1, (5000, 3)).astype(np.float32) * np.float32([1, 1, 0])
    triangle = (position[:, 0] > 0.5).astype(np.int32)
    cells = SmoothingGrid.around(position, np.array([0, 1]), triangle, 0.2)
    rows, ones = np.arange(5000), np.ones(5000, np.float32)
    values = np.where(triangle, 3.0, 1.0)[:, None]
    assert np.allclose(cells.smooth(rows, position, ones, values), values, atol=1e-5)
    fine = np.sin(position[:, :1] * 2 * np.pi / 0.05)
    assert np.abs(cells.smooth(rows, position, ones, fine)).mean() < 0.2
