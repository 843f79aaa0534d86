"""Estimations of small rooms with lamps that are hard to find or bright spots that are not lamps."""

import io
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from benchmarks.ldr import Camera, draw_gains, photograph, write_photograph
from benchmarks.tracer.environment import EnvironmentLight
from benchmarks.tracer.surfaces import TriangleMaterials
from fipt_blender.core.capture.encoded import srgb_decoded
from fipt_blender.core.conventions import direction_to_equirect
from fipt_blender.core.estimate.input import prepare_input
from fipt_blender.core.light.emitters import Fixture
from fipt_blender.core.material.fields import RoomFields
from fipt_blender.core.optics.lights import EmitterTable
from fipt_blender.core.run.messages import Reporter
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.surface.room import Room
from samples.small_captures import (
    CAMERAS,
    COLORS,
    PANEL,
    PANEL_RADIANCE,
    PANEL_TRIANGLES,
    UNTRAINED,
    SmallCapture,
    fixtures_of,
    matt,
    photograph_room,
    run_here,
    warnings_of,
    write_run,
)
from samples.small_rooms import BOX, bulb, make_room, mesh_room, surface_points, table

BLACK = [0.0, 0.0, 0.0]
FIRST = 2 * len(BOX)  # triangle after those of the box


@dataclass(frozen=True)
class Lamps:
    """What the first estimate finds, in units of the capture's median radiance."""

    fixtures: list[Fixture]
    scale: float


def radiances(root: Path, capture: SmallCapture, **changes: Any) -> dict[tuple[int, ...], list[float]]:
    """By the triangles of what is found to emit; the stages that follow hardly ever change it."""
    run = write_run(root / "run", capture, rounds=0, diffuse_spp=4, light_spp=4, specular_spp=1, **changes)
    reporter = Reporter(io.StringIO())
    given = prepare_input(run, run.read(), reporter)
    last = [stage.name for stage in given.stages].index("fixtures-0")
    found = replace(given, stages=given.stages[: last + 1]).chain(reporter).run(Lamps)
    return {tuple(lamp.triangles.tolist()): (lamp.radiance * found.scale).tolist() for lamp in found.fixtures}


def furnished(
    quads: list, colors: list, *meshes: tuple[np.ndarray, np.ndarray, list[float]]
) -> tuple[Room, np.ndarray]:
    """A room of quadrilaterals and meshes (vertices, triangles, colour), one object each, and its colours."""
    room = make_room(quads)
    vertices, triangles, objects = [room.vertices], [room.triangles], [room.triangle_object]
    tints = [np.repeat(np.array(colors, float), 2, axis=0)]
    for number, (points, faces, color) in enumerate(meshes):
        triangles.append(faces + sum(map(len, vertices)))
        vertices.append(points)
        objects.append(np.full(len(faces), len(quads) + number))
        tints.append(np.tile(color, (len(faces), 1)))
    parts = [np.concatenate(arrays) for arrays in (vertices, triangles, objects)]
    return mesh_room(*parts, parts="objects"), np.concatenate(tints)


def ceiling(x: float, y: float, width: float, depth: float) -> list[list[float]]:
    """A panel below the ceiling that shines downwards."""
    corners = [(0, 0), (0, depth), (width, depth), (width, 0)]
    return [[x + dx, y + dy, 2.95] for dx, dy in corners]


def lamps_of(*fixtures: tuple[int, list[float]]) -> EmitterTable:
    """Fixtures of a number of triangles and a radiance, which follow those of the box."""
    counts, front = [count for count, _ in fixtures], np.array([radiance for _, radiance in fixtures], np.float32)
    ids = np.arange(FIRST, FIRST + sum(counts), dtype=np.int32)
    return EmitterTable(ids, np.repeat(front, counts, axis=0), np.zeros((len(ids), 3), np.float32))


def test_many_small_lamps_and_a_bulb_of_two_centimetres(tmp_path: Path) -> None:
    """In two close cameras the bulb's width is two pixels; in all others it is smaller than a pixel."""
    panels = [ceiling(-1.7 + 0.8 * i, -1.7 + 1.1 * j, 0.2, 0.2) for i in range(5) for j in range(4)]
    room, colors = furnished([*BOX, *panels], [*COLORS, *[BLACK] * 20], (*bulb([0.4, 0.3, 1.4], 0.01), BLACK))
    lamps = lamps_of((40, [10.0, 9.0, 8.0]), (8, [3000.0, 2500.0, 2000.0]))
    near = [[[0.55, 0.2, 1.33], [0.4, 0.3, 1.4]], [[0.3, 0.5, 1.5], [0.4, 0.3, 1.4]]]
    upwards = [[[x, y, 0.3], [0.3 * x, 0.3 * y, 2.9]] for x, y in ((-1.5, -1.5), (1.5, 1.5), (1.5, -1.5))]
    cameras = [*CAMERAS[1:4:2], *near, *upwards]
    found = radiances(tmp_path, photograph_room(room, matt(colors), lamps, cameras=cameras, scale=2, spp=32))
    whole = tuple(range(FIRST + 40, FIRST + 48))
    # Hardly any pixel sees it alone.
    assert found.pop(whole) == pytest.approx([3000.0, 2500.0, 2000.0], rel=0.35)
    assert sorted(found) == [(FIRST + 2 * i, FIRST + 2 * i + 1) for i in range(20)]
    for radiance in found.values():
        assert radiance == pytest.approx([10.0, 9.0, 8.0], rel=0.05)


def test_a_shade_lit_from_inside_is_no_lamp_but_its_bulb_is(tmp_path: Path) -> None:
    angle = 2.0 * np.pi * np.arange(8) / 8
    ring = 0.25 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.concatenate([np.column_stack([ring, np.full(8, z)]) for z in (1.5, 1.9)]).astype(np.float32)
    faces = [[[i, (i + 1) % 8, 8 + (i + 1) % 8], [i, 8 + (i + 1) % 8, 8 + i]] for i in range(8)]
    shade = (points, np.array(faces, np.int32).reshape(-1, 3), [0.7, 0.6, 0.4])
    room, colors = furnished(BOX, COLORS, shade, (*bulb([0.0, 0.0, 1.7], 0.06), BLACK))
    lamps = table(list(range(FIRST + 16, FIRST + 24)), [300.0, 250.0, 200.0])
    into = [[[0.6, -0.6, 2.6], [0.0, 0.0, 1.7]], [[-0.5, 0.4, 0.7], [0.0, 0.0, 1.8]]]
    capture = photograph_room(room, matt(colors), lamps, cameras=[*CAMERAS[:3], *into], scale=2, spp=32)
    found = radiances(tmp_path, capture)
    assert list(found) == [tuple(range(FIRST + 16, FIRST + 24))]
    assert list(found.values()) == [pytest.approx([300.0, 250.0, 200.0], rel=0.1)]


def test_a_fixture_in_three_views_only_and_a_wall_washed_by_a_bright_lamp(tmp_path: Path) -> None:
    """Just below the lamp the wall is six times as bright as elsewhere."""
    plate = [[1.95, -0.3, 1.5], [1.95, -0.3, 1.9], [1.95, 0.3, 1.9], [1.95, 0.3, 1.5]]
    tints = [*COLORS[:2], [0.8, 0.8, 0.8], *COLORS[3:], BLACK, BLACK]
    room, colors = furnished([*BOX, plate, ceiling(-0.6, 1.6, 1.2, 0.3)], tints)
    lamps = lamps_of((2, [12.0, 10.0, 8.0]), (2, [60.0, 55.0, 50.0]))
    toward = [[[-1.5, y, 1.7], [1.9, 0.1 * y, 1.5]] for y in (-1.6, 1.4, 0.0)]
    places = ((1, 1, 1), (1, -1, 2.2), (1.3, 0, 0.5), (0.3, -1.5, 0.6), (1.5, -0.6, 1.6), (1.7, 1.7, 1.3))
    away = [[[x, y, 1.5], [-1.9, -0.5 * y, z]] for x, y, z in places]
    back = [[[-0.8, -1.5, 1.0], [-0.3, 2.0, 2.3]], [[0.5, -1.2, 1.6], [0.0, 2.0, 2.4]]]
    found = radiances(tmp_path, photograph_room(room, matt(colors), lamps, cameras=[*toward, *away, *back], spp=64))
    assert sorted(found) == [(FIRST, FIRST + 1), (FIRST + 2, FIRST + 3)]
    assert found[FIRST, FIRST + 1] == pytest.approx([12.0, 10.0, 8.0], rel=1e-3)
    assert found[FIRST + 2, FIRST + 3] == pytest.approx([60.0, 55.0, 50.0], rel=0.02)


def test_a_mirror_that_shows_a_lamp_is_no_lamp(tmp_path: Path) -> None:
    mirror = [[-1.98, -0.9, 0.6], [-1.98, 0.9, 0.6], [-1.98, 0.9, 2.4], [-1.98, -0.9, 2.4]]
    room, colors = furnished([*BOX, PANEL, mirror], [*COLORS, BLACK, [0.95] * 3])
    smooth = np.arange(len(colors)) >= FIRST + 2
    materials = TriangleMaterials(colors, np.where(smooth, 0.02, 1.0), smooth * 1.0)
    lamps = table([FIRST, FIRST + 1], [30.0, 25.0, 20.0])
    toward = [[[1.5, -1.5, 1.4], [-2.0, 0.2, 1.6]], [[1.5, 1.5, 1.2], [-2.0, -0.2, 1.7]]]
    toward += [[[0.6, -0.9, 1.5], [-2.0, 0.1, 1.9]], [[0.3, 0.2, 0.6], [-2.0, 0.0, 1.6]]]
    capture = photograph_room(room, materials, lamps, cameras=[*CAMERAS[:2], *toward], scale=2, spp=32)
    assert max(float(image.max()) for image in capture.images[2:]) > 20.0  # they do show it
    found = radiances(tmp_path, capture)
    assert list(found) == [(FIRST, FIRST + 1)]
    assert found[FIRST, FIRST + 1] == pytest.approx([30.0, 25.0, 20.0], rel=0.02)


def test_sun_on_the_floor_through_a_window_is_no_lamp(tmp_path: Path) -> None:
    """The right wall has a window onto a bright sky; a small sun throws a patch on the floor."""
    low, high = ([[2, y, z] for y, z in ((-2, a), (-2, b), (2, b), (2, a))] for a, b in ((0, 1), (2.2, 3)))
    sides = [[[2, y, z] for y, z in ((a, 1), (a, 2.2), (b, 2.2), (b, 1))] for a, b in ((-2, -0.7), (0.7, 2))]
    quads = [*BOX[:4], BOX[5], low, high, *sides]
    room, colors = furnished(quads, [*COLORS[:4], COLORS[5], *[COLORS[4]] * 4])
    sky = np.tile(np.array([2.0, 2.2, 2.5], np.float32), (64, 128, 1))
    sun = direction_to_equirect(np.array([[1.0, 0.15, 1.0]]) / np.linalg.norm([1.0, 0.15, 1.0]))[0]
    row, column = int((1.0 - sun[1]) * 64), int(sun[0] * 128)
    sky[row : row + 2, column : column + 2] = [1500.0, 1400.0, 1200.0]
    outwards = [[[-1.5, 0.0, 1.2], [2.0, 0.1, 1.6]], [[-1.2, -0.2, 0.4], [0.6, 0.0, 1.8]]]
    capture = photograph_room(
        room, matt(colors), EmitterTable.empty(), EnvironmentLight(sky), [*CAMERAS, *outwards], spp=256
    )
    floor = max(float(np.quantile(image, 0.99)) for image in capture.images)
    assert floor > 1.5  # there is such a patch
    assert radiances(tmp_path, capture) == {}


def cabinet(front: float) -> list[list[list[float]]]:
    """Five sides of a wall cabinet on the back wall, facing outwards, whose front is at y = `front`."""
    x0, x1, y, z0, z1 = -0.6, 0.6, 2.0, 1.1, 1.9
    near = [[x0, front, z0], [x1, front, z0], [x1, front, z1], [x0, front, z1]]
    far = [[x0, y, z0], [x1, y, z0], [x1, y, z1], [x0, y, z1]]
    sides = [[near[(i + 1) % 4], near[i], far[i], far[(i + 1) % 4]] for i in range(4)]
    return [near, *sides]


def test_a_cabinet_whose_front_is_indented_makes_no_phantom_lamps(tmp_path: Path) -> None:
    """The paper's failure case (supplementary): the front of the mesh is two pixels behind the real one."""
    colors = [*COLORS, *[[0.5, 0.35, 0.2]] * 5, BLACK]
    objects = np.array([*range(6), *[6] * 5, 7])
    real = make_room([*BOX, *cabinet(1.5), PANEL], objects, parts="objects")
    tints = np.repeat(np.array(colors, float), 2, axis=0)
    lamp = [FIRST + 10, FIRST + 11]
    toward = [[[x, -1.0, z], [0.3 * x, 1.5, 1.5]] for x, z in ((-1.2, 1.2), (0.0, 1.8), (1.2, 1.0))]
    capture = photograph_room(
        real, matt(tints), table(lamp, [20.0, 18.0, 16.0]), cameras=[*CAMERAS[:3], *toward], scale=2, spp=32
    )
    indented = make_room([*BOX, *cabinet(1.6), PANEL], objects, parts="objects")
    run = write_run(tmp_path / "run", replace(capture, room=indented), rounds=0, **UNTRAINED)
    run_here(run, train=False)
    (found,) = fixtures_of(run)
    assert found["triangles"] == lamp
    points, _, triangle = surface_points(indented, 4000, np.random.default_rng(0), np.array([FIRST, FIRST + 1]))
    color, _, metallic = RoomFields.load(run).query(points, triangle)
    wrong = np.abs(color * (1.0 - metallic[:, None]) - tints[triangle]).mean(axis=1)
    # Only where the front's edges cast their shadows elsewhere is anything painted on it.
    assert np.median(wrong) < 0.03 and np.quantile(wrong, 0.9) < 0.08 and metallic.max() < 0.1


def test_bars_before_a_window_are_no_lamps_and_a_dim_panel_is_one(tmp_path: Path) -> None:
    """No pixel sees only a bar; the panel is three times as bright as white paint in its place."""
    window = [[-0.8, 1.98, 1.0], [0.8, 1.98, 1.0], [0.8, 1.98, 2.2], [-0.8, 1.98, 2.2]]
    dim = [[-1.98, -1.2, 0.5], [-1.98, 0.8, 0.5], [-1.98, 0.8, 2.5], [-1.98, -1.2, 2.5]]
    bars = [
        [[x + dx, 1.8, z] for dx, z in ((0.0, 1.0), (0.02, 1.0), (0.02, 2.2), (0.0, 2.2))]
        for x in (-0.6, -0.3, 0.0, 0.3, 0.6)
    ]
    room, colors = furnished([*BOX, window, dim, *bars], [*COLORS, BLACK, BLACK, *[[0.7] * 3] * 5])
    lamps = lamps_of((2, [40.0, 38.0, 36.0]), (2, [9.0, 8.5, 8.0]))
    toward = [[[x, -1.5, 1.5], [-0.5 * x, 1.98, 1.6]] for x in (-1.0, 0.2, 1.2)]
    across = [[[1.5, y, 1.5], [-1.98, -0.2, 1.5]] for y in (-1.0, 0.6)]
    capture = photograph_room(room, matt(colors), lamps, cameras=[*toward, *across], scale=2, spp=32)
    found = radiances(tmp_path, capture)
    assert sorted(found) == [(FIRST, FIRST + 1), (FIRST + 2, FIRST + 3)]
    assert found[FIRST + 2, FIRST + 3] == pytest.approx([9.0, 8.5, 8.0], rel=1e-3)


CAMERA = Camera(2.2, 0.1, 0.2, 0.1, suffix=".png")
MORE = [[[1.5, 0.2, 1.8], [-1.2, -0.4, 0.6]], [[-0.3, 1.7, 1.5], [0.1, -1.5, 0.8]]]


def write_encoded(root: Path, capture: SmallCapture) -> tuple[RunFolder, np.ndarray]:
    """The run folder of PNG files that a camera with automatic exposure took, and its (V, 3) gains."""
    run = write_run(root, capture, rounds=0, **UNTRAINED)
    data, every = json.loads(run.capture_json.read_text()), []
    for index, (view, image) in enumerate(zip(data["views"], capture.images, strict=True)):
        rng = np.random.default_rng([5, index])
        gains = draw_gains(image, rng)
        every.append(gains)
        path = run.images / f"{index:03d}.png"
        write_photograph(path, photograph(image, gains, CAMERA, rng), CAMERA, gains[1])
        view |= {"image": f"images/{path.name}", "encoded": True, "exposure": None}
    write_json(run.capture_json, data)
    return run, np.array(every)


def test_a_clipped_panel_is_found_with_its_radiance(tmp_path: Path) -> None:
    """Photographs that are not HDR."""
    room, colors = furnished([*BOX, PANEL], [*COLORS, BLACK])
    lamps = table(PANEL_TRIANGLES, PANEL_RADIANCE)
    capture = photograph_room(room, matt(colors), lamps, cameras=[*CAMERAS[:4], *MORE], scale=2, spp=32)
    run, gains = write_encoded(tmp_path / "run", capture)
    messages = run_here(run, train=False)
    assert messages[-1]["type"] == "done"
    assert warnings_of(messages).count("lamps-clipped") == 1
    statistics = json.loads(run.statistics_json.read_text())
    photometry = statistics["photometry"]
    exposures = np.array([view["exposure_ev"] for view in photometry["views"].values()])
    offsets = exposures - np.log2(gains).mean(axis=1)
    assert np.abs(offsets - np.median(offsets)).max() < 0.12
    # Displayed by sRGB's curve, each view is as bright as its photograph.
    unit = photometry["median_shown"] / statistics["radiance_scale"] * 2.0 ** -np.median(offsets)
    for index, view in enumerate(photometry["views"].values()):
        codes = np.asarray(Image.open(run.images / f"{index:03d}.png"))
        good = ((codes > 10) & (codes < 245)).all(axis=-1)
        shown = unit * 2.0 ** view["shown_ev"] * capture.images[index][good]
        assert np.median(np.log2(shown / srgb_decoded(codes[good] / 255.0))) == pytest.approx(0.0, abs=0.15)
    (fixture,) = fixtures_of(run)
    assert set(fixture["triangles"]) == set(PANEL_TRIANGLES)
    # One scale is left open: found exposures are relative to the median view's.
    found = np.array(fixture["radiance"]) * 2.0 ** np.median(offsets)
    assert found == pytest.approx(np.array(PANEL_RADIANCE), rel=0.25)
