"""Pairs of points as scripts pick them: the cameras come to the mesh; bad picks are refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from fipt_blender import machine
from fipt_blender.blend.capture import cameras
from fipt_blender.blend.capture.cameras import camera_pose
from fipt_blender.blend.capture.importing import find_alignment
from fipt_blender.blend.capture.pairs import place_camera, take_alignment
from fipt_blender.blend.capture.view_geometry import view_geometry
from fipt_blender.core import conventions
from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.run.contents import CapturedView
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.kinds import as_matrix
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.jobs import running
from samples import rig_writers
from samples.camera_poses import look_at
from samples.engine_here import engine_here
from samples.operator_calls import refused

ops = bpy.ops.fipt

pytestmark = pytest.mark.usefixtures("registered")
POINTS = np.array([[2.0, 2.0, 0.0], [-2.0, 1.5, 0.2], [1.0, -2.0, 2.4], [-1.5, -1.0, 1.0], [0.5, 2.0, 2.0]])


def toward_the_middle(angle: float) -> np.ndarray:
    """A level camera 5 m beside the mesh, which looks at it."""
    middle = np.array([1.0, 0.0, 1.2 + 0.2 * np.sin(angle)])
    return look_at(middle + [5.0 * np.cos(angle), 5.0 * np.sin(angle), 0.0], middle)


@pytest.fixture
def truth(tmp_path):
    """Four views of a mesh in the scene, whose cameras stand elsewhere, at another scale; the true views."""
    scene = bpy.context.scene
    run = RunFolder(tmp_path)
    off = np.eye(4)
    off[:3, :3] = 0.3 * np.array(Matrix.Rotation(2.0, 3, (0.2, 0.5, 1.0)))
    off[:3, 3] = (4.0, -1.0, 0.5)
    mesh = bpy.data.meshes.new("Wall")
    mesh.from_pydata([tuple(point) for point in POINTS], [], [(0, 1, 2)])
    item = bpy.data.objects.new("Wall", mesh)
    item.location = (1.0, 0.0, 0.0)
    scene.collection.objects.link(item)
    views = []
    lens = {"width": 200, "height": 100, "fx": 40.0, "fy": 42.0, "cx": 103.0, "cy": 49.0}
    for index in range(4):
        pose = toward_the_middle(1.5 * index + 0.3)
        view = {"name": f"{index:03d}", "split": "train", "image": "a.exr", "parts": None, "semantics": None}
        views.append(CapturedView(**view, **lens, camera_to_world=as_matrix(pose)))
        solved = replace(views[-1], camera_to_world=as_matrix(conventions.transform_poses(off, pose)))
        parent = find_alignment(scene)
        cameras.add_camera(scene, run, solved, photograph=False, parent=parent)
        listed = scene.fipt.capture.views.add()
        listed.name = listed.camera = solved.name
    scene.fipt.capture.alignment.scale = (2.0, 2.0, 2.0)  # the artist's own; the mesh is not its child
    return views


def sights(point: np.ndarray, views: list[CapturedView]) -> list[tuple[str, tuple[float, float]]]:
    """The views that see a point, with its pixels."""
    found = []
    for view in views:
        geometry = view_geometry(view)
        (pixel,), _ = conventions.project(point[None], geometry)
        if np.isfinite(pixel).all() and (pixel >= 0.0).all() and (pixel <= (200.0, 100.0)).all():
            found.append((view.name, tuple(pixel)))
    return found


def pick(point: np.ndarray, views: list[CapturedView]) -> None:
    chosen = sights(point, views)[:2]
    values = dict(zip(("view", "second_view"), (name for name, _ in chosen), strict=False))
    pixels = dict(zip(("pixel", "second_pixel"), (pixel for _, pixel in chosen), strict=False))
    assert ops.pick_pair(object="Wall", location=tuple(point), **values, **pixels) == {"FINISHED"}


@pytest.fixture
def seen(truth) -> list[np.ndarray]:
    """The mesh's points that two views see."""
    places = POINTS + (1.0, 0.0, 0.0)
    found = [place for place in places if len(sights(place, truth)) > 1]
    assert len(found) >= 3
    return found


def test_cameras_come_to_the_mesh_and_the_wrong_pair_is_seen_and_removed(truth, seen):
    scene = bpy.context.scene
    settings, wall = scene.fipt.alignment, scene.objects["Wall"]
    pick(seen[0], truth)
    assert settings.error < 0.0 and "too few" in settings.problem
    assert "too few" in refused(ops.align_by_pairs)
    for point in seen[1:]:
        pick(point, truth)
    good = settings.error
    assert 0.0 <= good < 1e-3 and settings.problem == ""
    name, (u, v) = sights(seen[0], truth)[0]
    ops.pick_pair(object="Wall", location=tuple(seen[0]), view=name, pixel=(min(u + 30.0, 199.0), v))
    errors = [pair.error for pair in settings.pairs]
    assert settings.error > 20.0 * good + 0.01 and max(errors) == pytest.approx(max(errors[0], errors[-1]))
    assert "no row 9" in refused(ops.remove_pair, index=9)
    assert ops.remove_pair(index=len(seen)) == {"FINISHED"}
    assert len(settings.pairs) == len(seen) and settings.error == pytest.approx(good, abs=1e-6)
    assert ops.align_by_pairs() == {"FINISHED"}
    for view in truth:
        pose = camera_pose(scene.objects[view.name])
        np.testing.assert_allclose(pose, np.array(view.camera_to_world), atol=1e-3)
    assert tuple(wall.location) == (1.0, 0.0, 0.0) and 0.0 <= settings.error < 1e-3
    wall.location.x += 5.0  # the pairs follow the mesh, and survive its deletion
    ops.align_by_pairs()
    pose = camera_pose(scene.objects[truth[0].name])
    np.testing.assert_allclose(pose[0, 3], truth[0].camera_to_world[0][3] + 5.0, atol=1e-3)
    bpy.data.objects.remove(wall)
    assert "too few" in refused(ops.align_by_pairs)


def test_bad_picks_are_refused(truth):
    for item, view, u, words in (
        ("Gone", "000", 1.0, "no mesh object 'Gone'"),
        ("Wall", "x", 1.0, "no view 'x'"),
        ("Wall", "000", 300.0, "outside the photograph"),
    ):
        assert words in refused(ops.pick_pair, object=item, location=(0.0, 0.0, 0.0), view=view, pixel=(u, 1.0))
    assert not bpy.context.scene.fipt.alignment.pairs
    assert not ops.align_by_pairs.poll() and not ops.remove_pair.poll()


def test_the_artists_own_cameras_stay(truth, seen):
    scene = bpy.context.scene
    for view in truth:
        item = scene.objects[view.name]
        scene.collection.objects.link(item)
        bpy.data.collections["Photographs"].objects.unlink(item)
    for point in seen[:3]:
        pick(point, truth)
    before = [tuple(scene.objects[view.name].location) for view in truth]
    assert "your own" in refused(ops.align_by_pairs)
    assert [tuple(scene.objects[view.name].location) for view in truth] == before


def test_the_engines_placement_is_taken(truth, tmp_path):
    scene = bpy.context.scene
    before = {view.name: camera_pose(scene.objects[view.name]) for view in truth}
    matrix = np.eye(4)
    matrix[:3, :3] = 1.5 * np.array(Matrix.Rotation(0.5, 3, "Z"))
    matrix[0, 3] = 1.0
    (tmp_path / "align").mkdir()
    data = {"format": "fipt-align", "version": 1, "similarity": matrix.tolist(), "text": "90% lie near"}
    write_json(tmp_path / "align" / "align.json", data)
    scene.fipt.capture.views[0].checked = True
    take_alignment(scene, RunFolder(tmp_path))
    assert scene.fipt.alignment.summary == "90% lie near" and not scene.fipt.capture.views[0].checked
    for name, pose in before.items():
        expected = conventions.transform_poses(matrix, pose)
        np.testing.assert_allclose(camera_pose(scene.objects[name]), expected, atol=1e-4)
    (tmp_path / "align" / "align.json").write_text("{}")
    with pytest.raises(FiptError):
        take_alignment(scene, RunFolder(tmp_path))


BOXES = [
    ((0, 0, 0), (5, 4, 2.6)),
    ((0, 0, 0), (0.6, 2.2, 1.9)),
    ((2.0, 1.2, 0.65), (3.6, 2.1, 0.75)),
    ((4.2, 2.6, 0), (5, 4, 0.8)),
]
POSES = [look_at([4.0, 1.0, 1.5], [1.0, 3.0, 1.0]), look_at([1.5, 3.0, 1.4], [4.0, 1.0, 1.0])]
POSES += [look_at([2.0, 2.5, 1.6], [0.0, 1.0, 1.0])]
NEAR = np.array(Matrix.Translation((0.05, -0.03, 0.04)) @ Matrix.Rotation(0.02, 4, "Z"))


def quads() -> np.ndarray:
    """(6 B, 4, 3) faces of the boxes."""
    faces = []
    for low, high in BOXES:
        for axis in range(3):
            for side in (low[axis], high[axis]):
                others = [a for a in range(3) if a != axis]
                face = np.full((4, 3), float(side))
                for corner, (i, j) in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):
                    face[corner, others] = (low, high)[i][others[0]], (low, high)[j][others[1]]
                faces.append(face)
    return np.array(faces)


def write_solve(folder: Path, from_room: np.ndarray) -> None:
    """OpenSfM's cameras and 400 points on the boxes, in other coordinates."""
    rng = np.random.default_rng(0)
    faces = quads()
    sides = faces[:, [1, 3]] - faces[:, :1]
    areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    chosen = rng.choice(len(faces), 400, p=areas / areas.sum())
    points = faces[chosen, 0] + np.einsum("nk,nkc->nc", rng.random((400, 2)), sides[chosen])
    points += 0.003 * rng.normal(size=points.shape)
    (shot,) = rig_writers.make_shots(rig_writers.Style(off_centre=(0.0, 0.0)), 1)
    shots = []
    for index, pose in enumerate(POSES):
        solved = conventions.transform_poses(from_room, pose)
        name = f"{index}.jpg"
        shots.append(replace(shot, name=name, width=24, height=16, rotation=solved[:3, :3].T, centre=solved[:3, 3]))
        write_exr(folder / "images" / f"{index}.exr", 1.0 + rng.random((16, 24, 3), np.float32))
    moved = conventions.transform_points(from_room, points)
    rig_writers.write_opensfm(folder, [shots], "perspective", moved)


def test_cameras_come_to_an_imported_mesh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine.DEFAULTS, "data_folder", str(tmp_path / "data"))
    monkeypatch.setattr(machine.DEFAULTS, "device", "llvm")
    from_room = np.eye(4)
    from_room[:3, :3] = 0.4 * np.array(Matrix.Rotation(1.2, 3, "Z"))
    from_room[:3, 3] = (3.0, 1.0, -2.0)
    write_solve(tmp_path / "solve", from_room)
    scene = bpy.context.scene
    with engine_here():
        assert ops.import_capture(filepath=str(tmp_path / "solve")) == {"FINISHED"}
    mesh = bpy.data.meshes.new("Scan")
    corners = quads().reshape(-1, 3)
    mesh.from_pydata(corners.tolist(), [], np.arange(len(corners)).reshape(-1, 4).tolist())
    item = bpy.data.objects.new("Scan", mesh)
    scene.collection.objects.link(item)
    bpy.context.view_layer.objects.active = item
    item.select_set(True)
    assert ops.set_room() == {"FINISHED"}
    for view, pose in zip(scene.fipt.capture.views, POSES, strict=True):  # as pairs leave them
        place_camera(view.camera_object(), NEAR @ pose)
    with engine_here():
        assert ops.refine_alignment() == {"FINISHED"}
    for view, pose in zip(scene.fipt.capture.views, POSES, strict=True):
        np.testing.assert_allclose(camera_pose(view.camera_object()), pose, atol=0.01)
    assert "% of the points" in scene.fipt.alignment.summary
    before = [tuple(view.camera_object().location) for view in scene.fipt.capture.views]
    item.location.x += 20.0
    with engine_here():
        refused(ops.refine_alignment)
    assert running.last("align").error["code"] == "alignment-failed"
    assert [tuple(view.camera_object().location) for view in scene.fipt.capture.views] == before
