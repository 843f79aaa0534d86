"""What a run shows: parts.json, pictures while it works, textures and maps of rooms without lamps and with openings."""

from __future__ import annotations

import argparse
import io
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from fipt_blender.core.capture.images import read_radiance, write_exr
from fipt_blender.core.capture.views import View
from fipt_blender.core.estimate.part_list import write_part_list
from fipt_blender.core.estimate.previews import Preview
from fipt_blender.core.material.groups import Units
from fipt_blender.core.optics.lights import EmitterTable
from fipt_blender.core.parts.labels import Parts, label_parts
from fipt_blender.core.pixels.store import create_pixels, fill_pixels
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.messages import Reporter, parse_message
from fipt_blender.core.run.parts import read_parts
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.textures import bake
from samples.small_captures import (
    COLORS,
    FEW,
    PANEL,
    PANEL_RADIANCE,
    UNTRAINED,
    few_sources,
    fixtures_of,
    panel_capture,
    photograph,
    run_here,
    warnings_of,
    window_capture,
    write_run,
)
from samples.small_rooms import BOX, make_room, table

# Floor, ceiling and four walls of a box; a row of pixels sees all but the last wall.
SEEN = np.repeat(np.arange(10), 3)


class Fields:
    """Base colour x, roughness 0.5, metallic 1; cells at x = 0.1 and 0.3 in unit 0, one in unit 1."""

    def __init__(self, units):
        self.units = units
        points = np.array([[0.1, 0, 0], [0.3, 0, 0], [0.5, 0, 0]], np.float32)
        self.cells = SimpleNamespace(part=np.array([0, 0, 1], np.int32), points=points)

    def query(self, positions, triangles):
        count = len(positions)
        assert (self.units.triangle[triangles] == self.cells.part).all()
        return np.repeat(positions[:, :1], 3, axis=1), np.full(count, 0.5), np.ones(count)

    def confidence(self, positions, triangles):
        return np.tile([1.0, 0.5, 0.0], (len(positions), 1))


def named(objects, **names):
    """The box with named objects: one for each side, or one for all."""
    room = make_room(BOX, np.arange(6) if len(objects) > 1 else np.zeros(6, int))
    return replace(room, objects=objects, **names)


def listed(tmp_path, room, parts, views=(), units=None, fields=None):
    run = RunFolder(tmp_path)
    run.results.mkdir(exist_ok=True)
    units = units or Units(parts.triangle_part, np.ones(int(parts.triangle_part.max()) + 1, bool))
    pixels = SimpleNamespace(ranges=[0, len(SEEN)], triangle=SEEN)
    write_part_list(run, room, parts, views, pixels, fields or Fields(units))
    np.savez(run.parts_npz, triangle_part=units.triangle, single=units.single)
    return run, read_parts(run, room.triangle_object, room.objects).parts


def test_objects_give_names_counts_and_values(tmp_path):
    names = ("floor_boards", "Ceiling", "Wall", "Wall.001", "Wall.002", "Wall.003")
    room = named(names, parts="objects", materials=names)
    run, parts = listed(tmp_path, room, label_parts(room, "objects", [], []))
    assert [part.name for part in parts] == ["Floor boards", *names[1:]]
    assert [part.pixels for part in parts] == [6, 6, 6, 6, 6, 0]
    assert parts[0].key == "object:floor_boards"
    assert parts[0].base_color == pytest.approx((0.2, 0.2, 0.2))
    assert (parts[1].roughness, parts[1].metallic, parts[1].confidence) == (0.5, 1.0, (1.0, 0.5, 0.0))
    assert parts[2].base_color is None and parts[2].confidence is None  # it has no cell
    assert read_document(run.parts_json, dict)["parts"][0]["area"] == pytest.approx(16.0)


def test_places_name_the_parts_of_one_mesh(tmp_path):
    room = named(("scan",), parts="masks")
    part = np.repeat(np.arange(6, dtype=np.int32), 2)
    part[-1] = 6  # half of the last wall is above a floor's area, but its part is not large
    _, parts = listed(tmp_path, room, Parts(part, "part", np.arange(7) + 40))
    names = [each.name for each in parts]
    assert names[:4] == ["Floor", "Ceiling", "Wall", "Wall 2"]
    assert [each.key for each in parts] == [f"mask:{index + 40}" for index in range(7)]


def test_semantic_masks_give_classes(tmp_path):
    room = named(("scan",), parts="semantics")
    folder = tmp_path / "semantics"
    folder.mkdir()
    write_json(folder / "classes.json", {"7": "painted wall"})
    ids = np.full((1, len(SEEN)), 9)
    ids[0, SEEN >= 4] = 7
    view = SimpleNamespace(parts=None, semantics=folder / "a.png", semantic_ids=lambda: ids)
    parts = label_parts(room, "semantics", [ids], [SEEN])
    _, found = listed(tmp_path, room, parts, [view], Units(parts.triangle_part, np.zeros(2, bool)))
    assert [(each.name, each.class_name, each.single) for each in found] == [
        ("Painted wall", "painted wall", False),
        ("Class 9", None, False),
    ]


def test_no_parts_leave_the_objects(tmp_path):
    units = Units(np.full(12, -1, np.int32), np.zeros(0, bool))
    fields = SimpleNamespace(units=units, cells=SimpleNamespace(part=np.full(3, -1), points=None))
    room = named(tuple("abcdef"), parts="none")
    _, found = listed(tmp_path, room, Parts(units.triangle, "none"), units=units, fields=fields)
    assert [part.name for part in found] == list("ABCDEF")


def test_slots_name_the_parts_of_a_modelled_mesh(tmp_path):
    """Brass is not called after the rod that is made of it; a material that nobody named has no name."""
    material = np.repeat([0, 1, 0, 2, 3, -1], 2).astype(np.int32)
    names = ("Curtain_rod", "Table", "Knob", "Shelf", "Door", "Rug")
    materials = ("Brass", "Brushed_steel", "Material.001", "Gloss")
    room = replace(named(names, parts="auto", materials=materials), triangle_material=material)
    ids = np.repeat([5, 6, 5, 7, 8, 9], 2)
    view = SimpleNamespace(parts="a.png", semantics=None)
    parts = label_parts(room, "masks", [ids[None]], [np.arange(12)])
    _, found = listed(tmp_path, room, parts, [view])
    assert [each.name for each in found] == ["Rug", "Brass", "Brushed steel", "Shelf", "Gloss"]
    assert [each.key for each in found][:3] == ["object:Rug", "material:Brass", "material:Brushed_steel"]


WIDTH, HEIGHT = 24, 16


def downward_view(folder: Path, name: str, x: float, height: float) -> View:
    """A camera that looks straight down at (x, 0, 0)."""
    image = folder / f"{name}.exr"
    write_exr(image, np.full((HEIGHT, WIDTH, 3), 0.5, np.float32))
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = [x, 0.0, height]
    return View(name, "train", image, WIDTH, HEIGHT, 20.0, 20.0, WIDTH / 2, HEIGHT / 2, pose)


@pytest.fixture
def preview(tmp_path: Path) -> Preview:
    """Of a floor, mostly shown by the first view, and of a panel beside it, only shown by the second."""
    room = make_room(
        [[[-3, -3, 0], [3, -3, 0], [3, 3, 0], [-3, 3, 0]], [[9, -1, 0], [10, -1, 0], [10, 1, 0], [9, 1, 0]]]
    )
    views = [downward_view(tmp_path, "floor", 0.0, 4.0)]
    views.append(downward_view(tmp_path, "panel", 9.5, 2.0))
    pixels = create_pixels(tmp_path / "pixels", views)
    fill_pixels(pixels, room, lambda done: None)
    return Preview(tmp_path / "previews", pixels, np.array([0, 0, 1, 1]))


def pictures(preview: Preview, emitters: EmitterTable) -> list[np.ndarray]:
    """Base colour and emission."""

    def colors(rows: np.ndarray) -> np.ndarray:
        return np.full((len(rows), 3), 0.5, np.float32)

    return [np.asarray(Image.open(path)) for path in preview.estimate("training", colors, emitters)]


def test_emission_is_of_a_view_that_shows_a_lamp(preview: Preview) -> None:
    color, emission = pictures(preview, table([2, 3], [30.0, 30.0, 30.0]))
    assert emission.max() > 200 and color.min() > 0  # the whole picture of the base color shows the floor
    color, emission = pictures(preview, table([0], [30.0, 30.0, 30.0]))
    lit = emission.max(axis=2) > 200  # here it is the same view
    assert lit.any() and not lit.all() and (lit == (color.max(axis=2) == 0)).all()
    assert not pictures(preview, EmitterTable.empty())[1].any()


pytestmark = pytest.mark.filterwarnings("error:.*invalid value:RuntimeWarning")


def bake_here(run: RunFolder) -> list[dict]:
    """The engine command `textures` on a square for each quadrilateral of the room; returns its messages."""
    with np.load(run.room_npz) as room:
        quads = len(room["triangles"]) // 2
    side, corners = 16, np.array([(1, 1), (15, 1), (15, 15), (1, 15)])[[0, 1, 2, 0, 2, 3]].reshape(2, 3, 2)
    uv = np.concatenate([corners + (side * index, 0) for index in range(quads)]) / (side * quads, side)
    np.savez(run.atlas_npz, corner_uv=uv.astype(np.float32), triangle_image=np.zeros(2 * quads, np.int32))
    image = {"name": "Room", "width": side * quads, "height": side}
    write_json(run.atlas_json, {"mode": "uv", "images": [image]})
    stream = io.StringIO()
    bake.run(argparse.Namespace(run=run.root), Reporter(stream))
    return [message for line in stream.getvalue().splitlines() if (message := parse_message(line))]


def assert_textures_and_maps_follow(run: RunFolder, open_mesh: bool) -> None:
    """What the textures and the maps of views show of the estimate."""
    assert bake_here(run)[-1]["type"] == "done"
    views = read_document(run.results / "maps" / "maps.json", dict)["views"]
    (image,) = read_document(run.textures_json, dict)["images"]
    for entry in (image, *views):
        for path in list(entry.values())[1:]:
            assert np.isfinite(read_radiance(run.resolve(path))).all(), path
    maps = [
        {name: read_radiance(run.resolve(path)) for name, path in entry.items() if name != "view"} for entry in views
    ]
    assert len(maps) == 3
    seen = np.stack([of_view["roughness"][..., 0] > 0.0 for of_view in maps])
    emission = np.stack([of_view["emission"].max(axis=2) for of_view in maps])
    assert seen.any() and emission.any() == bool(fixtures_of(run))
    # A pixel that shows both a lamp and a wall has at most three of its four places on the lamp.
    assert (emission[seen] < 0.8 * emission.max() + 1e-6).all()
    assert (seen | (emission > 0.0)).all() != open_mesh
    for of_view, reflecting in zip(maps, seen, strict=True):
        assert not of_view["base_color"][~reflecting].any() and not of_view["confidence"][~reflecting].any()


def test_a_window_becomes_an_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Light from outside through a missing wall; no lamp."""
    few_sources(monkeypatch)
    radiance = [5.0, 4.0, 3.0]
    changes = {**UNTRAINED, **FEW, "rounds": 0, "unseen_light": True, "environment_width": 32}
    run = write_run(tmp_path / "run", window_capture(radiance), **changes)
    messages = run_here(run, train=False)
    data = read_document(run.emitters_json, dict)
    assert data["fixtures"] == [] and data["environment"]["image"] == "environment.exr"
    assert 0.02 < data["environment"]["observed_share"] < 0.5
    found = read_radiance(run.environment_exr)
    assert found.shape == (16, 32, 3)
    ratio = np.log(found / np.array(radiance))
    seen = np.abs(ratio).max(axis=-1) < 1e-4
    assert seen.mean() > 0.06, "what photographs show is taken as it is"
    # The rest is like it, or follows from the light on the surfaces.
    assert np.abs(ratio).max() < 0.25 and np.sqrt((ratio**2).mean()) < 0.08
    assert warnings_of(messages) == [] and str(run.environment_exr) in messages[-1]["files"]
    assert_textures_and_maps_follow(run, open_mesh=True)


def test_a_room_without_lamp_is_a_warning(tmp_path: Path) -> None:
    """A closed mesh, all surfaces of one radiance: white walls explain it without a lamp."""
    capture = panel_capture()
    grey = replace(capture, images=[np.full_like(image, 0.4) for image in capture.images])
    changes = {**UNTRAINED, **FEW, "rounds": 0, "force": True}  # photographs without content are refused
    run = write_run(tmp_path / "run", grey, **changes)
    messages = run_here(run, train=False)
    assert warnings_of(messages) == ["no-emitter"] and messages[-1]["type"] == "done"
    assert read_document(run.emitters_json, dict) == {"fixtures": [], "environment": None}
    assert_textures_and_maps_follow(run, open_mesh=False)


def test_a_lamp_in_a_room_whose_mesh_is_open(tmp_path: Path) -> None:
    """No mesh of two walls, behind which it is dark: a scan that has not been completed."""
    quads = [*BOX[:4], PANEL]
    capture = photograph(quads, [*COLORS[:4], [0.0] * 3], table([8, 9], PANEL_RADIANCE), None)
    run = write_run(tmp_path / "run", capture, rounds=0, **UNTRAINED, **FEW)
    assert run_here(run, train=False)[-1]["type"] == "done"
    assert [fixture["triangles"] for fixture in fixtures_of(run)] == [[8, 9]]
    assert_textures_and_maps_follow(run, open_mesh=True)
