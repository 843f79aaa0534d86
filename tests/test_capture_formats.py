"""Readers of COLMAP, transforms.json and FIPT return the cameras from which the capture was written."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fipt_blender.core.capture.files import view_name
from fipt_blender.core.capture.formats.registry import FORMATS, detect_format, read_rig
from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.options import CaptureOptions
from samples.capture_files import (
    level_pose,
    make_samples,
    write_colmap,
    write_fipt_real,
    write_fipt_synthetic,
    write_mesh,
    write_transforms,
)
from samples.ingesting import edited_json
from samples.refusals import error_of
from samples.rig_checks import read


def assert_same_cameras(rig, samples):
    assert len(rig.views) == len(samples)
    for view, sample in zip(rig.views, samples, strict=True):
        assert view.image.is_file() and view.image.stem == sample.stem
        assert (view.width, view.height) == (sample.width, sample.height)
        assert view.lens.model == sample.lens.model
        np.testing.assert_allclose(view.lens.parameters, sample.lens.parameters, atol=1e-9)
        np.testing.assert_allclose(view.camera_to_world, sample.pose, atol=1e-5)


@pytest.mark.parametrize("model", ["PINHOLE", "OPENCV"])
@pytest.mark.parametrize("text", [True, False])
def test_colmap(tmp_path, text, model):
    samples = make_samples(5, up=(0.0, -1.0, 0.0), model=model)
    write_colmap(tmp_path, samples, text)
    write_mesh(tmp_path / "scene.obj")
    write_exr(tmp_path / "parts" / "001_0001.exr", np.ones((48, 32)))
    for path in (tmp_path, tmp_path / "sparse" / "0"):  # found from the capture and from the model
        rig = read(path)
        assert rig.source == "colmap" and rig.up_axis is None and not rig.notes
        assert_same_cameras(rig, samples)
        assert rig.mesh is not None and rig.mesh.samefile(tmp_path / "scene.obj")
        assert [view.parts is not None for view in rig.views] == [False, True, False, False, False]


@pytest.mark.parametrize("text", [True, False])
def test_colmap_reads_the_largest_model_unless_one_is_named(tmp_path, text):
    for name, count in (("small", 2), ("large", 4)):
        write_colmap(tmp_path / name, make_samples(count), text)
    (tmp_path / "large" / "sparse" / "0").rename(tmp_path / "small" / "sparse" / "1")
    rig = read(tmp_path / "small")
    assert len(rig.views) == 4
    (note,) = rig.notes
    assert note.code == "several-models" and f"{tmp_path / 'small' / 'sparse' / '0'} (2)" in note.text
    assert len(read(tmp_path / "small" / "sparse" / "0").views) == 2


PLACE = "property float x\nproperty float y\nproperty float z\n"


def test_colmap_point_cloud_is_no_mesh(tmp_path):
    write_colmap(tmp_path, make_samples(2), text=True)
    header = "ply\nformat ascii 1.0\nelement vertex 1\n{}end_header\n0 0 0\n"
    (tmp_path / "dense").mkdir()
    (tmp_path / "dense" / "fused.ply").write_text(header.format(PLACE))
    assert read(tmp_path).mesh is None
    faces = "element face 1\nproperty list uchar int vertex_indices\n"
    (tmp_path / "dense" / "meshed-poisson.ply").write_text(header.format(PLACE + faces))
    assert read(tmp_path).mesh == tmp_path / "dense" / "meshed-poisson.ply"


@pytest.mark.parametrize("kept", [(), (0,), (1, 3)])
def test_colmap_text_without_second_lines_or_points(tmp_path, kept):
    samples = make_samples(4)
    write_colmap(tmp_path, samples, True)
    file = tmp_path / "sparse" / "0" / "images.txt"
    before = read_rig(tmp_path, "colmap", CaptureOptions()).views
    lines = [line for line in file.read_text().splitlines() if line.strip() and not line.startswith("#")]
    file.write_text("".join(f"{line}\n{'1.5 2.5 -1' + chr(10) if i in kept else ''}" for i, line in enumerate(lines)))
    (file.parent / "points3D.txt").unlink()
    after = read_rig(tmp_path, "colmap", CaptureOptions()).views
    assert [view.image for view in after] == [view.image for view in before] and len(after) == 4


def test_the_only_mesh_needs_no_certain_name(tmp_path):
    write_transforms(tmp_path, make_samples(2))
    for known in ("scene", "mesh"):
        for file in tmp_path.glob(f"{known}.*"):
            file.unlink()
    write_mesh(tmp_path / "Flat, 2nd floor.OBJ")
    assert read(tmp_path).mesh == tmp_path / "Flat, 2nd floor.OBJ"
    (tmp_path / "points.ply").write_text("ply\nformat ascii 1.0\nelement vertex 0\nend_header\n")
    assert read(tmp_path).mesh == tmp_path / "Flat, 2nd floor.OBJ"  # a point cloud is none
    write_mesh(tmp_path / "furniture.obj")
    assert read(tmp_path).mesh is None  # which one is the room is not known
    write_mesh(tmp_path / "mesh.obj")
    assert read(tmp_path).mesh == tmp_path / "mesh.obj"


@pytest.mark.parametrize("model", ["PINHOLE", "OPENCV"])
def test_transforms(tmp_path, model):
    samples = make_samples(4, model=model)
    write_transforms(tmp_path, samples)
    write_mesh(tmp_path / "mesh.obj")
    write_exr(tmp_path / "semantics" / "002_0001.exr", np.ones((32, 48)))
    for path in (tmp_path, tmp_path / "transforms.json"):
        rig = read(path)
        assert rig.source == "transforms" and rig.up_axis == "z" and rig.mesh == tmp_path / "mesh.obj"
        assert_same_cameras(rig, samples)
        assert [view.semantics is not None for view in rig.views] == [False, False, True, False]


def test_transforms_with_global_intrinsics_and_names_without_suffix(tmp_path):
    samples = make_samples(4)[::2]
    write_transforms(tmp_path, samples)
    with edited_json(tmp_path / "transforms.json") as data:
        data.update({key: data["frames"][0][key] for key in ("w", "h", "fl_x", "fl_y", "cx", "cy")})
        data["frames"] = [
            {"file_path": "./" + f["file_path"][:-4], "transform_matrix": f["transform_matrix"][:3]}
            for f in data["frames"]
        ]
    assert_same_cameras(read(tmp_path), samples)


def test_transforms_take_the_size_from_the_image_and_need_a_field_of_view(tmp_path):
    write_transforms(tmp_path, make_samples(2))
    with edited_json(tmp_path / "transforms.json") as data:
        data["camera_angle_x"] = 1.0
        for frame in data["frames"]:
            for key in ("w", "h", "fl_x", "fl_y", "cx", "cy"):
                del frame[key]
    for view, width, height in zip(read(tmp_path).views, (48, 32), (32, 48), strict=True):
        focal = 0.5 * width / math.tan(0.5)
        assert (view.width, view.height) == (width, height)
        np.testing.assert_allclose(view.lens.parameters, (focal, focal, 0.5 * width, 0.5 * height))
    with edited_json(tmp_path / "transforms.json") as data:
        del data["camera_angle_x"]
    assert error_of(read, tmp_path).code == "intrinsics-missing"
    with edited_json(tmp_path / "transforms.json") as data:
        data["x_fov"] = 90.0  # instant-ngp's, in degrees
    assert [view.lens.parameters[:2] for view in read(tmp_path).views] == [pytest.approx((s, s)) for s in (24, 16)]
    with edited_json(tmp_path / "transforms.json") as data:
        data["frames"][0]["transform_matrix_start"] = data["frames"][0].pop("transform_matrix")
    assert error_of(read, tmp_path).code == "pose-unsupported"
    (tmp_path / "transforms_train.json").write_text("[]")  # poses as nerfstudio exports them
    (tmp_path / "transforms.json").unlink()
    assert error_of(read, tmp_path).code == "cameras-missing"


@pytest.mark.parametrize(
    ("extra", "model", "parameters"),
    [
        ({"camera_model": "OPENCV_FISHEYE", "k1": 0.1, "k4": 0.2}, "OPENCV_FISHEYE", (0.1, 0.0, 0.0, 0.2)),
        ({"is_fisheye": True, "k2": 0.1}, "OPENCV_FISHEYE", (0.0, 0.1, 0.0, 0.0)),
        ({"k1": 0.1, "p2": 0.01}, "OPENCV", (0.1, 0.0, 0.0, 0.01)),
        ({"k1": 0.1, "k3": 0.01}, "FULL_OPENCV", (0.1, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0)),
        ({"camera_model": "OPENCV", "k1": 0.0}, "PINHOLE", ()),
        ({"camera_model": "CYLINDRICAL"}, None, ()),
        ({"camera_model": "OPENCV", "k4": 0.1}, None, ()),
        # What instant-ngp calls its lenses; its equirectangular has equal areas.
        ({"latlong": True}, "EQUIRECTANGULAR", ()),
        ({"equirectangular": True}, None, ()),
        ({"ftheta_p0": 0.0}, None, ()),
        ({"orthographic": True}, None, ()),
    ],
)
def test_transforms_distortion(tmp_path, extra, model, parameters):
    write_transforms(tmp_path, make_samples(1), **extra)
    if model is None:
        assert error_of(read, tmp_path).code == "camera-model"
        return
    lens = read(tmp_path).views[0].lens
    assert lens.model == model
    np.testing.assert_allclose(lens.parameters[4:], parameters)


def test_transforms_before_the_applied_transform(tmp_path):
    samples = make_samples(3)
    applied = np.array([[0.0, 1, 0, 0.5], [1, 0, 0, 0], [0, 0, -1, 0]])
    written = []
    for sample in samples:
        pose = np.vstack([applied, [0, 0, 0, 1]]) @ sample.pose
        pose[:3, 3] *= 2.0
        written.append(type(sample)(sample.stem, sample.width, sample.height, sample.lens, pose))
    write_transforms(tmp_path, written, applied_transform=applied.tolist(), applied_scale=2.0)
    assert_same_cameras(read(tmp_path), written)
    rig = read(tmp_path, undo_applied_transform=True)
    assert_same_cameras(rig, samples)
    assert rig.up_axis is None


def test_transforms_splits_masks_and_up_axis(tmp_path):
    write_transforms(tmp_path, make_samples(3), up_axis="y")
    with edited_json(tmp_path / "transforms.json") as data:
        data["val_filenames"] = ["images/001_0001.exr"]
        data["frames"][0]["mask_path"] = "masks/0.png"
    write_exr(tmp_path / "masks" / "0.png", np.ones((32, 48)))
    rig = read(tmp_path)
    assert [view.split for view in rig.views] == [None, "held_back", None]
    assert not rig.notes and rig.up_axis == "y"
    assert [view.mask for view in rig.views] == [tmp_path / "masks" / "0.png", None, None]
    whole = (tmp_path / "transforms.json").read_text()  # one file a split
    (tmp_path / "transforms_test.json").write_text(whole)
    (tmp_path / "transforms.json").rename(tmp_path / "transforms_train.json")
    splits = [view.split for view in read(tmp_path).views]
    assert splits == ["train", "held_back", "train", *["held_back"] * 3]


@pytest.mark.parametrize("named", [True, False])
def test_fipt_synthetic(tmp_path, named):
    rng = np.random.default_rng(1)
    poses = [level_pose(rng, np.array([0.0, 1.0, 0.0])) for _ in range(5)]
    write_fipt_synthetic(tmp_path, {"train": poses[:3], "val": poses[3:]}, named)
    write_mesh(tmp_path / "scene.obj")
    rig = read(tmp_path)
    for path in (tmp_path / "train", tmp_path / "val" / "transforms.json"):
        again = read(path)  # another reader's cameras would look backwards
        assert again.source == "fipt-synthetic"
        assert all(map(np.array_equal, *([v.camera_to_world for v in r.views] for r in (rig, again))))
    assert rig.source == "fipt-synthetic" and rig.up_axis == "y" and rig.mesh == tmp_path / "scene.obj"
    names = ["train/000", "train/001", "train/002", "val/000", "val/001"]
    assert [view.name for view in rig.views] == names
    assert [view.split for view in rig.views] == ["train"] * 3 + ["held_back"] * 2
    focal = 12.0 / math.tan(0.6)
    for view, pose in zip(rig.views, poses, strict=True):
        np.testing.assert_allclose(view.camera_to_world, pose, atol=1e-5)
        np.testing.assert_allclose(view.lens.parameters, (focal, focal, 12.0, 8.0))
        assert view.image.is_file() and view.parts.is_file() and view.semantics.is_file()


def test_fipt_real(tmp_path):
    samples = make_samples(4, up=(0.0, -1.0, 0.0))
    write_fipt_real(tmp_path, samples)
    write_mesh(tmp_path / "scene.obj")
    write_exr(tmp_path / "segmentation" / "003.exr", np.ones((48, 32)))
    rig = read(tmp_path)
    assert rig.source == "fipt-real" and rig.up_axis is None and rig.mesh == tmp_path / "scene.obj"
    assert_same_cameras(rig, samples)
    assert [view.semantics is not None for view in rig.views] == [False, False, False, True]


@pytest.mark.parametrize(
    ("file", "change", "code"),
    [
        ("cam.txt", lambda lines: lines[:-1], "rig-damaged"),
        ("cam.txt", lambda lines: ["x", *lines[1:]], "rig-damaged"),
        ("K_list.txt", lambda lines: ["1", *lines[1:4]], "rig-damaged"),
        ("cam.txt", lambda lines: [*lines[:3], "0.5 0.5 0.5", *lines[4:]], "pose-not-rotation"),
        ("K_list.txt", lambda lines: [lines[0], "80 0 96", "0 80 64", *lines[3:]], "image-size"),
    ],
)
def test_damaged_fipt_real(tmp_path, file, change, code):
    write_fipt_real(tmp_path, make_samples(2))
    lines = (tmp_path / file).read_text().splitlines()
    (tmp_path / file).write_text("\n".join(change(lines)))
    assert error_of(read, tmp_path).code == code


def test_unknown_format_lists_what_was_sought(tmp_path):
    caught = error_of(detect_format, tmp_path)
    assert caught.code == "format-unknown"
    assert all(name in caught.text for name in FORMATS)
    (tmp_path / "day").mkdir()
    (tmp_path / "day" / "IMG_1.JPG").touch()
    for path in (tmp_path, tmp_path / "day", tmp_path / "day" / "IMG_1.JPG"):
        caught = error_of(detect_format, path)
        assert caught.code == "cameras-missing" and len(caught.remedy.splitlines()) == 1
    (tmp_path / "day" / "IMG_1.JPG").unlink()
    caught = error_of(detect_format, tmp_path / "nowhere")
    assert caught.code == "capture-missing"
    write_transforms(tmp_path, make_samples(1))
    assert error_of(read_rig, tmp_path, "colmap", CaptureOptions()).code == "format-unknown"


def test_nerfstudio_folder_is_read_as_transforms_unless_told(tmp_path):
    samples = make_samples(2)
    write_colmap(tmp_path, samples, text=False)
    write_transforms(tmp_path, samples)
    assert detect_format(tmp_path) == "transforms"
    notes = {note.code: note for note in read(tmp_path).notes}
    assert "read in the format transforms" in notes["formats-several"].text
    assert "--format colmap" in notes["formats-several"].remedy
    told = read_rig(tmp_path, "colmap", CaptureOptions())
    assert told.source == "colmap" and "formats-several" not in {note.code for note in told.notes}


def test_a_capture_nearby_is_named(tmp_path):
    write_transforms(tmp_path / "data" / "room", make_samples(2))
    for path in (tmp_path, tmp_path / "data" / "room" / "notes.txt"):
        path.touch() if path.suffix else None
        error = error_of(detect_format, path)
        assert error.code == "capture-elsewhere" and f"{tmp_path / 'data' / 'room'}." in error.remedy


@pytest.mark.parametrize(
    ("path", "name"),
    [("./images/a.jpg", "images/a"), ("../x/b.0001.exr", "x/b.0001"), ("C:\\x\\c.png", "x/c"), ("/d/e", "d/e")],
)
def test_view_names_stay_inside_a_folder(path, name):
    assert view_name(path) == name
