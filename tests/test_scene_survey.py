"""The survey: which triangles the views see, warnings about their photographs, available parts."""

from __future__ import annotations

import io
import json
from argparse import Namespace
from pathlib import Path

import numpy as np

from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.checks import survey
from fipt_blender.core.run.messages import Reporter, parse_message
from fipt_blender.core.surface.room import Room
from samples.camera_poses import look_at
from samples.refusals import error_of
from samples.scans import joined
from samples.small_rooms import BOX, bulb, make_room, write_room

WIDTH, HEIGHT = 48, 32
FLOOR, CEILING, BACK, FRONT = (0, 1), (2, 3), (4, 5), (10, 11)


def write_survey_input(folder: Path, room: Room, poses: dict[str, np.ndarray], **changes) -> None:
    """What Blender writes before it starts the command."""
    folder.mkdir()
    views = []
    pixels = np.random.default_rng(1).lognormal(0.0, 1.0, (HEIGHT, WIDTH, 3))
    for name, pose in poses.items():
        write_exr(folder / f"{name}.exr", pixels)
        views.append(
            {"name": name, "split": "train", "image": f"{name}.exr", "width": WIDTH, "height": HEIGHT,
             "fx": 26.0, "fy": 26.0, "cx": WIDTH / 2, "cy": HEIGHT / 2, "camera_to_world": pose.tolist(),
             "parts": None, "semantics": None, **changes.get(name, {})}
        )  # fmt: skip
    head = {"format": "fipt-capture", "version": 1, "source": "transforms", "mesh": None}
    data = {**head, "world_from_source": np.eye(4).tolist(), "views": views}
    (folder / "capture.json").write_text(json.dumps(data))
    write_room(folder, room)


def run_survey(folder: Path, triangles: int) -> tuple[dict, np.ndarray, dict[str, np.ndarray]]:
    """survey.json, what each view sees (V, T), and the labels of each source."""
    stream = io.StringIO()
    survey.run(Namespace(folder=folder, device="llvm"), Reporter(stream))
    last = parse_message(stream.getvalue().splitlines()[-1])
    assert last is not None and last["type"] == "done" and len(last["files"]) == 2
    data = json.loads((folder / "survey.json").read_text())
    with np.load(folder / "survey.npz") as arrays:
        seen = np.unpackbits(arrays["seen"], axis=1, count=triangles).astype(bool)
        labels = {name[6:]: arrays[name] for name in arrays.files if name.startswith("parts/")}
    return data, seen, labels


def test_seen_triangles_and_shares_of_the_room(tmp_path):
    poses = {
        "back": look_at([0.0, -1.0, 1.5], [0.0, 2.0, 1.5]),
        "away": look_at([0.0, -4.0, 1.5], [0.0, -9.0, 1.5]),
        "window": look_at([1.9, 0.0, 1.5], [2.2, -2.0, 1.5]),
    }
    room = make_room([quad for index, quad in enumerate(BOX) if index != 4])  # no right wall
    write_survey_input(tmp_path / "in", room, poses)
    data, seen, labels = run_survey(tmp_path / "in", len(room.triangles))
    assert seen[0, list(FLOOR + CEILING + BACK)].all() and not seen[0, 8:].any()
    assert not seen[1].any()
    shares = [view["room_share"] for view in data["views"]]
    assert 0.8 < shares[0] < 0.95 and shares[1] == 0.0 and 0.0 < shares[2] < 0.5
    warnings = [view["warning"] for view in data["views"]]
    assert warnings[0] == "" and warnings[1] == "sees nothing of the room" and "only" in warnings[2]
    assert data["parts"] == {"auto": "materials", "counts": {"materials": 5, "objects": 5, "loose": 5}}
    assert set(labels) == {"materials", "objects", "loose"}


def test_triangles_between_the_rays_are_seen_and_hidden_ones_not(tmp_path):
    """A bulb of 2 mm falls between the coarse rays; another stands behind the wall."""
    room = make_room(BOX, objects=np.zeros(6, int))
    for y in (1.0, 2.5):
        room = joined(room, *bulb([0.3, y, 1.4], 0.002), 0)
    write_survey_input(tmp_path / "in", room, {"a": look_at([0.0, -1.5, 1.5], [0.0, 2.0, 1.5])})
    _, seen, labels = run_survey(tmp_path / "in", len(room.triangles))
    toward = seen[0, 12:20]
    assert 3 <= toward.sum() <= 5  # the half that faces the camera
    assert not seen[0, 20:].any()
    assert len(np.unique(labels["loose"])) == 3  # the box, and two bulbs
    with np.load(tmp_path / "in" / "survey.npz") as arrays:
        areas = arrays["areas"]
    # Surfaces behind the camera count as a gap; those behind the wall and the bulbs' far sides are hidden.
    assert (areas[:12] > 0.0).all() and not areas[20:].any()
    assert ((areas[12:20] > 0.0) == toward).all()


def test_missing_unusable_and_clipped_photographs_are_named(tmp_path):
    pose = look_at([0.0, -1.0, 1.5], [0.0, 2.0, 1.5])
    names = ("good", "gone", "small", "clipped", "ldr", "hidden")
    room = make_room(BOX)
    folder = tmp_path / "in"
    write_survey_input(folder, room, {name: pose for name in names}, hidden={"split": "unused"})
    (folder / "gone.exr").unlink()
    write_exr(folder / "small.exr", np.ones((4, 4, 3)))
    random = np.random.default_rng(2)
    write_exr(folder / "clipped.exr", np.minimum(random.lognormal(0.0, 1.0, (HEIGHT, WIDTH, 3)), 2.0))
    write_exr(folder / "ldr.exr", random.integers(0, 256, (HEIGHT, WIDTH, 3)) / 255.0)
    data, seen, _ = run_survey(folder, len(room.triangles))
    views = {view["name"]: view for view in data["views"]}
    assert views["good"]["warning"] == "" and views["hidden"]["warning"] == ""
    assert views["gone"]["image_missing"] and "missing" in views["gone"]["warning"]
    assert "4 x 4" in views["small"]["warning"]
    assert views["clipped"]["clipped_share"] > 0.1 and "over-exposed" in views["clipped"]["warning"]
    assert "8-bit" in views["ldr"]["warning"]
    assert (seen[:1] == seen).all()  # what a camera sees does not depend on its file


def test_masks_of_ticked_views_become_parts_with_own_ids_too(tmp_path):
    """Three photographs whose regions have ids of their own, and two of which one has a mask."""
    room, halves = make_room(BOX, objects=np.zeros(6, int)), np.repeat([0, 1], HEIGHT // 2)[:, None].repeat(WIDTH, 1)
    for case, ids in (("own", [[1, 2], [2, 1], [5, 9]]), ("shared", [[7, 9], None])):
        folder, masks = tmp_path / case, {f"view{number}": each for number, each in enumerate(ids)}
        parts = {name: {"parts": f"ids_{name}.exr"} for name, each in masks.items() if each}
        poses = {name: look_at([0.3 * n - 0.3, -1.0, 1.5], [0.0, 2.0, 1.5]) for n, name in enumerate(masks)}
        write_survey_input(folder, room, poses, **parts)
        for name in parts:
            write_exr(folder / f"ids_{name}.exr", np.array(masks[name])[halves].astype(np.float32))
        data, _, labels = run_survey(folder, len(room.triangles))
        assert data["parts"]["auto"] == "masks" and data["parts"]["counts"]["masks"] == 2
        ceiling, floor = (set(labels["masks"][list(side)]) for side in (CEILING, FLOOR))
        assert len(ceiling) == len(floor) == 1 and ceiling != floor
    assert (ceiling, floor) == ({0}, {1})
    write_exr(folder / "ids_view0.exr", np.zeros((4, WIDTH), np.float32))
    error = error_of(run_survey, folder, len(room.triangles))
    assert error.code == "mask-size" and "ids_view0.exr" in error.text
