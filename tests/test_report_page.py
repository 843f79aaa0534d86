"""The report of small run folders: complete, empty, with hostile names."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.checks.quality import JudgedView, Quality
from fipt_blender.core.report.comparison import psnr, to_display
from fipt_blender.core.report.fixture_names import fixture_names
from fipt_blender.core.report.page import MAPS, write_report
from fipt_blender.core.report.pictures import write_quality
from fipt_blender.core.run.parts import RoomPart, RoomParts
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.settings import make_settings
from samples.pages import Page
from samples.refusals import error_of

NASTY = "<script>alert('x')</script> & \"é\""
SIZE = (24, 12)


def image(seed: int, scale: float = 0.5) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return (scale * rng.random((SIZE[1], SIZE[0], 3))).astype(np.float32)


@pytest.fixture
def run(tmp_path) -> RunFolder:
    """A complete run folder with hostile names."""
    run = RunFolder(tmp_path / "run & <b>co")
    run.create(make_settings("draft"))
    views = []
    for index, split in enumerate(("train", "train", "held_back")):
        path = run.root / f"photo{index}.exr"
        write_exr(path, image(index))
        view = {"name": f"{split}/{NASTY}{index}", "split": split, "image": path.name, "parts": None}
        view |= {"width": SIZE[0], "height": SIZE[1], "fx": 20.0, "fy": 20.0, "cx": 12.0, "cy": 6.0}
        views.append({**view, "semantics": None, "camera_to_world": np.eye(4).tolist()})
    capture = {"format": "fipt-capture", "version": 1, "source": "transforms", "mesh": None}
    write_json(run.capture_json, {**capture, "world_from_source": np.eye(4).tolist(), "views": views})
    renders = []
    for kind in ("rerender", "relight", "insert"):
        write_exr(run.renders / f"{kind}.exr", image(2) * 1.1)
        renders.append({"kind": kind, "view": views[2]["name"], "image": f"renders/{kind}.exr"})
    write_json(run.renders_json, {"renders": renders})
    maps = {name: f"results/maps/000_{name}.exr" for name in MAPS}
    for path in maps.values():
        write_exr(run.root / path, image(5))
    write_json(run.results / "maps" / "maps.json", {"views": [{"view": NASTY, **maps}]})
    fixture = {"name": NASTY, "triangles": [1, 2], "radiance": [10.0, 8.0, 4.0], "back_radiance": [0, 0, 0]}
    fixture |= {"area": 0.25, "centroid": [0, 0, 2], "power": [7.9, 6.3, 3.1]}
    environment = {"image": "environment.exr", "observed_share": 0.12}
    write_json(run.emitters_json, {"fixtures": [fixture], "environment": environment})
    write_exr(run.environment_exr, image(9))
    stages = [{"name": "bake", "seconds": 2.0, "rays": 3_000_000}, {"name": NASTY, "seconds": 1.0}]
    write_json(run.statistics_json, {"stages": stages, "peak_memory_gb": 1.5, "device": "llvm"})
    warning = {"code": "c", "text": NASTY, "remedy": "Mind it."}
    write_json(run.job_json, {"seconds": {"ingest": 61.0}, "warnings": [warning]})
    return run


def test_the_page_is_whole_and_all_its_images_exist(run):
    page = Page(write_report(run))
    images = page.values("src")
    assert len(images) == 3 + 2 + 2 + 4 + 1 + 2  # three renders, maps, environment, photographs
    for address in images:
        with Image.open(run.report / address) as picture:
            assert picture.size == SIZE
    assert "1.50" in page.text and "0.25" in page.text and "Mind it." in page.text
    assert "1 min 1 s" in page.text and "12 % of all directions" in page.text


def test_what_the_result_was_judged_by_is_shown_side_by_side(run):
    pictures = np.random.default_rng(1).random((3, SIZE[1], SIZE[0], 3)).astype(np.float32)
    better = JudgedView("better", pictures, np.full((2, 3), 0.001))
    judged = JudgedView(NASTY, pictures, np.array([[0.01] * 3, [0.003] * 3]))
    before = len(Page(write_report(run)).values("src"))
    write_quality(run, Quality(27.14, 29.4, 28.3, 31.6, 0.85, (better, judged)))
    page = Page(write_report(run))
    assert "27.1 dB" in page.text and "29.4" in page.text
    assert "85 %" in page.text and "28.3 dB" in page.text and "31.6" in page.text
    assert (
        page.text.index("Render, 20.0 dB") < page.text.index("Projection, 25.2 dB") < page.text.index("Render, 30.0 dB")
    )
    assert len(page.values("src")) == before + 6
    for address in page.values("src"):
        assert (run.report / address).is_file()


def test_lamps_are_called_as_in_blender(run):
    corners = np.array([[0, 0, 0], [4, 0, 0], [0, 3, 0], [1, 1, 3], [2, 1, 3], [1, 2, 3]], np.float32)
    triangles = np.array([[0, 1, 2], [3, 5, 4], [3, 5, 4]], np.int32)
    run.room_npz.parent.mkdir(exist_ok=True)
    np.savez(
        run.room_npz,
        vertices=corners,
        triangles=triangles,
        corner_normals=np.tile(np.float32([0, 0, 1]), (3, 3, 1)),
        triangle_object=np.array([0, 1, 1], np.int32),
        triangle_material=np.full(3, -1, np.int32),
        triangle_polygon=np.array([0, 0, 1], np.int32),
    )
    write_json(run.room_json, {"objects": ["Floor", f"Lamp {NASTY}"], "materials": [], "parts": "none"})
    page = Page(write_report(run))
    assert "Lamp script alert" in page.text and "script" not in [tag for tag, _ in page.tags]


def test_names_are_escaped_and_nothing_comes_from_elsewhere(run):
    path = write_report(run)
    page = Page(path)
    assert "script" not in [tag for tag, _ in page.tags] and "b" in [tag for tag, _ in page.tags]
    assert "<b>co" not in path.read_text(encoding="utf-8")
    assert NASTY in page.text and "run & <b>co" in page.text
    assert all(re.fullmatch(r"images/[\w.-]+", address) for address in page.values("src", "href"))
    text = path.read_text(encoding="utf-8")
    assert "http:" not in text and "https:" not in text and "url(" not in text


def test_an_empty_run_still_gives_a_page(tmp_path):
    run = RunFolder(tmp_path / "run")
    run.create(make_settings("draft"))
    page = Page(write_report(run))
    assert "No surface was found to emit light." in page.text and "draft" in page.text


@pytest.mark.parametrize("path", ["../secret.exr", "renders/../../secret.exr"])
def test_a_path_that_leads_out_of_the_run_is_refused(run, path):
    write_exr(run.root.parent / "secret.exr", image(1))
    write_json(run.renders_json, {"renders": [{"kind": "relight", "view": "x", "image": path}]})
    caught = error_of(write_report, run)
    assert caught.code == "path-outside" and not (run.report / "index.html").exists()


def test_psnr_of_a_known_error():
    truth = np.full((4, 4, 3), 0.5**2.2, np.float32)
    estimate = np.full((4, 4, 3), 0.6**2.2, np.float32)
    assert psnr(estimate, truth) == pytest.approx(20.0, abs=1e-3)
    assert psnr(truth, truth) == float("inf")
    assert psnr(truth * 50.0, truth * 70.0, exposure=1.0) == float("inf")  # both clip to white
    values = np.array([[[np.nan, np.inf, -np.inf], [-1.0, 2.0, 1.0]]], np.float32)
    assert to_display(values).tolist() == [[[0.0, 1.0, 0.0], [0.0, 1.0, 1.0]]]  # what images can hold


SHELL = ((0.0, 0.0, 0.0), (6.0, 5.0, 3.0))
_FACES = [
    (0, 2, 3), (0, 3, 1), (4, 5, 7), (4, 7, 6), (0, 1, 5), (0, 5, 4), (2, 6, 7), (2, 7, 3), (0, 4, 6),
    (0, 6, 2), (1, 3, 7), (1, 7, 5),
]  # fmt: skip


def room_of(*boxes: tuple[str, tuple, tuple]) -> tuple[SimpleNamespace, list[np.ndarray]]:
    """A room of boxes (object, low, high), and the triangles of each."""
    vertices, triangles, owner = [], [], []
    objects = list(dict.fromkeys(name for name, _, _ in boxes))
    for name, low, high in boxes:
        triangles += [tuple(index + len(vertices) for index in face) for face in _FACES]
        vertices += [(x, y, z) for z in (low[2], high[2]) for y in (low[1], high[1]) for x in (low[0], high[0])]
        owner += [objects.index(name)] * 12
    room = SimpleNamespace(
        vertices=np.array(vertices, np.float32),
        triangles=np.array(triangles, np.int32),
        triangle_object=np.array(owner, np.int32),
        triangle_material=np.full(len(triangles), -1, np.int32),
        objects=objects,
        materials=[],
    )
    return room, list(np.arange(len(triangles)).reshape(-1, 12))


def name_of(*boxes: tuple[str, tuple, tuple], faces: slice = slice(None), parts: RoomParts | None = None) -> str:
    """The name of the lamp that the last box is, or some of its triangles."""
    room, pieces = room_of(*boxes)
    (name,) = fixture_names(room, [SimpleNamespace(triangles=pieces[-1][faces])], parts)
    return name


def test_lamps_have_the_names_of_their_objects_and_bulbs_of_the_lamp_that_holds_them():
    assert name_of(("Shell", *SHELL), ("Reading_Lamp.002", (1, 1, 1), (1.2, 1.2, 1.2))) == "Reading lamp"
    table_lamp = ("Table_lamp", (1.0, 1.0, 0.8), (1.3, 1.3, 1.2))
    bulb = ("Bulb", (1.1, 1.1, 1.25), (1.2, 1.2, 1.35))
    assert name_of(("Shell", *SHELL), table_lamp, bulb) == "Table lamp bulb"
    far = ("Bulb", (4.1, 4.1, 1.25), (4.2, 4.2, 1.35))
    assert name_of(("Shell", *SHELL), table_lamp, far) == "Table bulb"


@pytest.mark.parametrize(
    ("low", "high", "name"),
    [
        ((2, 2, 2.98), (3, 3, 3.0), "Ceiling panel"),
        ((1, 2, 2.96), (4, 2.1, 3.0), "Ceiling strip"),
        ((0.0, 2, 1.5), (0.02, 3, 2.3), "Wall panel"),
        ((2, 2, 0.01), (2.4, 2.5, 0.5), "Floor lamp"),
        ((2, 2, 0.9), (2.1, 2.1, 1.0), "Table bulb"),
        ((2, 2, 2.2), (2.5, 2.4, 2.5), "Hanging lamp"),
    ],
)
def test_place_and_shape_in_a_room_that_is_one_mesh(low, high, name):
    # A box has no mean normal: of a panel on a wall only the side towards the room emits.
    faces = slice(10 if name == "Wall panel" else 0, None)
    assert name_of(("scan", *SHELL), ("scan", low, high), faces=faces) == name


@pytest.mark.parametrize(
    ("class_name", "name"), [("floor lamp", "Floor lamp"), ("walls", "Wall bulb"), ("", "Table bulb")]
)
def test_classes_of_parts_tell_where_objects_do_not(class_name, name):
    parts = RoomParts(
        np.repeat([0, 1], 12).astype(np.int32), [RoomPart(0, "a", "A"), RoomPart(1, "b", "B", class_name=class_name)]
    )
    assert name_of(("scan", *SHELL), ("scan", (2, 2, 0.9), (2.1, 2.1, 1.0)), parts=parts) == name
