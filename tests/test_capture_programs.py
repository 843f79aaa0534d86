"""Readers of other programs' cameras: poses to 1e-5, and pixels of points in the room to 1e-4."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fipt_blender.core.capture import options
from fipt_blender.core.capture.distortion import lens_camera
from fipt_blender.core.capture.formats.radial import MOST_ERROR
from fipt_blender.core.capture.formats.registry import FORMATS, detect_format
from samples import rig_writers as write
from samples.camera_poses import random_rotation
from samples.metashape_writers import (
    Chunk,
    metashape_chunk,
    metashape_sensor,
    write_metashape,
    write_realityscan_csv,
    write_realityscan_xmp,
)
from samples.refusals import error_of
from samples.rig_checks import CENTRED, assert_same, read, room_points

BROWN3 = write.Style((-0.12, 0.03, -0.006), (0.002, -0.001))
WIDE3 = replace(BROWN3, aspect=1.01)
FISHEYE = write.Style((-0.1, 0.02, -0.004, 0.001), fisheye=True)
RADIAL = write.Style((-0.1, 0.02), off_centre=CENTRED)


def meshroom(*version: int, style: write.Style) -> tuple:
    return lambda folder, shots: write.write_meshroom(folder, shots, version), style, "y"


def openmvg(kind: str, key: str, style: write.Style) -> tuple:
    return lambda folder, shots: write.write_openmvg(folder, shots, kind, key), style, None


def opensfm(kind: str, style: write.Style) -> tuple:
    return lambda folder, shots: write.write_opensfm(folder, [shots], kind), style, "z"


def metashape(style: write.Style, component: bool) -> tuple:
    def writer(folder: Path, shots: list[write.Shot]) -> None:
        write.write_photographs(folder, shots)
        write_metashape(folder, [metashape_chunk(moved_chunk(shots), component)])

    return writer, style, None


def blocksexchange(orientation: str, angles: bool) -> tuple:
    return lambda folder, shots: write.write_blocksexchange(folder, shots, orientation, angles), WIDE3, None


# What writes a program's cameras, their lenses, and the axis that is up; the first word is the format.
PROGRAMS = {
    "meshroom 1.0.0": meshroom(1, 0, 0, style=BROWN3),
    **{f"meshroom 1.2.{last}": meshroom(1, 2, last, style=WIDE3) for last in (0, 3, 6, 8, 11)},
    **{
        f"meshroom 1.2.{last} {len(style.k)}": meshroom(1, 2, last, style=style)
        for last in (6, 9)
        for style in (write.Style(), write.Style((-0.1,)), FISHEYE)
    },
    "opensfm perspective": opensfm("perspective", RADIAL),
    "opensfm brown": opensfm("brown", WIDE3),
    "opensfm fisheye": opensfm("fisheye", replace(RADIAL, fisheye=True)),
    "opensfm fisheye_opencv": opensfm("fisheye_opencv", replace(FISHEYE, aspect=1.01)),
    "openmvg pinhole": openmvg("pinhole", "", write.Style()),
    "openmvg k1": openmvg("pinhole_radial_k1", "disto_k1", write.Style((-0.1,))),
    "openmvg k3": openmvg("pinhole_radial_k3", "disto_k3", write.Style((-0.1, 0.02, -0.004))),
    "openmvg t2": openmvg("pinhole_brown_t2", "disto_t2", BROWN3),
    "openmvg fisheye": openmvg("fisheye", "fisheye", FISHEYE),
    "bundler": (write.write_bundler, RADIAL, None),
    **{f"metashape {part}": metashape(WIDE3, part) for part in (False, True)},
    **{f"metashape fisheye {part}": metashape(replace(FISHEYE, p=(0.002, -0.001)), part) for part in (False, True)},
    "realityscan csv": (write_realityscan_csv, BROWN3, "z"),
    "realityscan xmp": (write_realityscan_xmp, BROWN3, "z"),
    **{f"blocksexchange {axes} {by}": blocksexchange(axes, by) for axes in write.ORIENTATIONS for by in (False, True)},
}


@pytest.mark.parametrize("name", PROGRAMS)
def test_cameras_come_back(tmp_path: Path, name: str) -> None:
    """From the capture's folder, and from the camera file."""
    writer, style, up = PROGRAMS[name]
    shots = write.make_shots(style)
    writer(tmp_path, shots)
    files = [path for path in tmp_path.rglob("*") if path.suffix in (".sfm", ".json", ".out", ".xml", ".csv")]
    for path in (tmp_path, *files):
        rig = read(path)
        assert (rig.source, rig.up_axis, rig.notes) == (name.split()[0], up, ())
        assert_same(rig, shots)


# -------------------------------------------------------------------------------- Meshroom, OpenSfM, OpenMVG


def test_meshroom_projects_are_read_from_their_cache(tmp_path: Path) -> None:
    shots = write.make_shots(count=2)
    nodes = tmp_path / "MeshroomCache" / "StructureFromMotion"
    write.write_meshroom(nodes / "a", shots[:1], (1, 2, 8))
    write.write_meshroom(nodes / "b", shots, (1, 2, 8))
    os.utime(nodes / "a" / "cameras.sfm", (1.0, 1.0))
    for file in list(tmp_path.rglob("*.jpg")):
        file.unlink()
    write.write_photographs(tmp_path / "photos", shots)
    mesh = tmp_path / "MeshroomCache" / "Texturing" / "c" / "texturedMesh.obj"
    mesh.parent.mkdir(parents=True)
    mesh.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    rig = read(tmp_path)
    assert_same(rig, shots)
    assert rig.mesh == mesh and rig.views[0].image.parent == tmp_path / "photos"


def test_meshroom_rigs_and_views_without_a_pose(tmp_path: Path) -> None:
    first, second = write.make_shots(BROWN3, 2)
    write.write_meshroom(tmp_path, [first, second], (1, 2, 8))
    data = json.loads((tmp_path / "cameras.sfm").read_text())
    inside = np.linalg.inv(first.pose) @ second.pose
    part = {"rotation": [str(v) for v in inside[:3, :3].ravel()], "center": [str(v) for v in inside[:3, 3]]}
    same = {"rotation": ["1", "0", "0", "0", "1", "0", "0", "0", "1"], "center": ["0", "0", "0"]}
    data["rigs"] = [{"rigId": "5", "subPoses": [{"pose": same}, {"pose": part}]}]
    data["views"][1].update(rigId="5", subPoseId="1", isPoseIndependant="false", poseId="0")
    data["views"].append({**data["views"][0], "viewId": "9", "poseId": "9"})
    data["poses"] = data["poses"][:1]
    (tmp_path / "cameras.sfm").write_text(json.dumps(data))
    assert_same(read(tmp_path), [first, second])


def test_opensfm_reads_the_largest_reconstruction(tmp_path: Path) -> None:
    """Also of OpenDroneMap, which keeps the cameras in map coordinates and a second mesh beside."""
    shots = write.make_shots(write.Style(off_centre=CENTRED))
    folder = tmp_path / "opensfm"
    write.write_opensfm(folder, [shots], "perspective")
    (folder / "reconstruction.json").rename(folder / "reconstruction.geocoords.json")
    write.write_opensfm(folder, [shots[:1], shots[1:]], "perspective")
    (tmp_path / "odm_meshing").mkdir()
    for name in ("odm_25dmesh.ply", "odm_mesh.ply"):
        (tmp_path / "odm_meshing" / name).write_text("ply\nformat ascii 1.0\nelement face 1\nend_header\n")
    rig = read(tmp_path)
    assert_same(rig, shots[1:])
    assert [note.code for note in rig.notes] == ["several-models", "formats-several"]
    assert rig.mesh is not None and rig.mesh.name == "odm_mesh.ply"


@pytest.mark.parametrize("kind", ["spherical", "something new"])
def test_models_without_a_pinhole_are_refused(tmp_path: Path, kind: str) -> None:
    shots = write.make_shots(write.Style(off_centre=CENTRED), 2)
    write.write_openmvg(tmp_path / "openmvg", shots, kind, "")
    write.write_opensfm(tmp_path / "opensfm", [shots], "dual")
    write.write_meshroom(tmp_path / "meshroom", shots, (1, 2, 8))
    path = tmp_path / "meshroom" / "cameras.sfm"
    path.write_text(path.read_text().replace('"pinhole"', f'"{kind}"'))
    for name, shown in (("openmvg", kind), ("opensfm", "dual"), ("meshroom", kind)):
        error = error_of(read, tmp_path / name)
        assert error.code == "camera-model" and shown in error.text


# ---------------------------------------------------------------------------------------------- Bundler, NVM


def test_bundler_needs_the_list_of_its_photographs(tmp_path: Path) -> None:
    write.write_bundler(tmp_path, write.make_shots(RADIAL))
    (tmp_path / "list.txt").unlink()
    error = error_of(read, tmp_path)
    assert error.code == "rig-damaged" and "list.txt" in error.text


def test_nvm_distortion_is_the_other_way_round(tmp_path: Path) -> None:
    """VisualSFM's polynomial leads from the photograph to the pinhole: a point's pixel satisfies it."""
    shots = write.make_shots(write.Style(off_centre=CENTRED))
    write.write_nvm(tmp_path, [shots], distortion=0.15)
    rig = read(tmp_path)
    assert rig.source == "nvm" and not rig.notes
    for view, shot in zip(rig.views, shots, strict=True):
        np.testing.assert_allclose(view.camera_to_world, shot.pose, atol=1e-5)
        camera = lens_camera(view.lens, view.width, view.height)
        local = (room_points(shot) - shot.centre) @ shot.rotation.T
        centre = np.array([shot.width / 2, shot.height / 2])
        distorted = (np.asarray(camera.img_from_cam(local)) - centre) / shot.fx
        undone = distorted * (1.0 + 0.15 * (distorted**2).sum(axis=1, keepdims=True))
        np.testing.assert_allclose(undone * shot.fx, local[:, :2] / local[:, 2:] * shot.fx, atol=1e-3)


def test_nvm_models_names_and_fixed_calibration(tmp_path: Path) -> None:
    shots = [replace(shot, fx=400.0, fy=404.0, cx=250.0, cy=150.0) for shot in write.make_shots()[::2]]
    shots[0] = replace(shots[0], name="IMG 0000.jpg")
    write.write_nvm(tmp_path, [shots[:1], shots], fixed="FixedK 400 250 404 150 0")
    path = tmp_path / "model.nvm"
    path.write_text(path.read_text().replace("IMG 0000.jpg", 'IMG"0000.jpg'))
    rig = read(tmp_path)
    assert [note.code for note in rig.notes] == ["several-models"]
    assert_same(rig, sorted(shots, key=lambda shot: shot.name))


# ------------------------------------------------------------------------------ Polycam, Record3D, ScanNet++


@pytest.mark.parametrize("corrected", [True, False])
def test_polycam_poses_are_in_the_coordinates_of_the_mesh(tmp_path: Path, corrected: bool) -> None:
    shots = write.make_shots(write.Style(aspect=1.01))
    alignment = np.eye(4)
    alignment[:3, :3], alignment[:3, 3] = random_rotation(np.random.default_rng(2)), (1.0, 2.0, 3.0)
    write.write_polycam(tmp_path, shots, alignment, corrected)
    rig = read(tmp_path)
    assert rig.source == "polycam" and rig.up_axis == "y" and rig.mesh == tmp_path / "raw.glb"
    assert_same(rig, shots)


def test_polycam_alignment_that_is_no_similarity(tmp_path: Path) -> None:
    write.write_polycam(tmp_path, write.make_shots(count=1), np.diag([1.0, 2.0, 1.0, 1.0]), True)
    assert error_of(read, tmp_path).code == "rig-damaged"


@pytest.mark.parametrize("each_frame", [True, False])
def test_record3d(tmp_path: Path, each_frame: bool) -> None:
    first, *others = write.make_shots(write.Style(aspect=1.01))[::2]
    shots = [replace(shot, name=f"{i}.jpg") for i, shot in enumerate((first, *others))]
    if not each_frame:
        shots = [replace(shot, fx=first.fx, fy=first.fy) for shot in shots]
    write.write_record3d(tmp_path, shots, each_frame)
    rig = read(tmp_path)
    assert rig.source == "record3d" and rig.up_axis == "y"
    assert_same(rig, shots)


def test_scanner_app(tmp_path: Path) -> None:
    shots = [replace(shot, name=f"frame_{i:05d}.jpg") for i, shot in enumerate(write.make_shots())]
    write.write_scanner_app(tmp_path, shots)
    Image.fromarray(np.full((12, 16), 1500, np.uint16)).save(tmp_path / "depth_00002.png")
    rig = read(tmp_path)
    assert rig.source == "3d-scanner-app" and rig.up_axis == "y" and rig.mesh == tmp_path / "export.obj"
    assert_same(rig, shots)
    assert [(depth.photograph.name, depth.unit) for depth in rig.depths] == [("frame_00002", 0.001)]
    assert rig.depths[0].fx == pytest.approx(shots[2].fx * 16 / shots[2].width) and not rig.notes


def test_scannetpp(tmp_path: Path) -> None:
    first, *others = write.make_shots(write.Style((-0.03, 0.004, 0.001, -0.0005), aspect=1.01, fisheye=True))[::2]
    shots = [first, *(replace(shot, fx=first.fx, fy=first.fy) for shot in others)]
    write.write_scannetpp(tmp_path, shots, held_back=1)
    for path in (tmp_path, tmp_path / "dslr", tmp_path / "dslr" / "nerfstudio" / "transforms.json"):
        rig = read(path)
        assert rig.source == "scannetpp"
        assert_same(rig, shots)
        assert [view.split for view in rig.views] == [None, "held_back"]
        assert rig.mesh == tmp_path / "scans" / "mesh_aligned_0.05.ply"
        masks = tmp_path / "dslr" / "resized_anon_masks"
        assert [view.mask for view in rig.views] == [masks / "IMG_0000.png", masks / "IMG_0002.png"]


# ----------------------------------------------------------------------------------------------- all of them


def all_formats(root: Path) -> dict[str, Path]:
    """A capture in each format, by its name."""
    shots = write.make_shots(write.Style(off_centre=CENTRED), 2)
    write.write_photographs(root / "metashape", shots)
    write_metashape(root / "metashape", [metashape_chunk(Chunk(shots))])
    write_realityscan_csv(root / "realityscan", shots)
    write.write_blocksexchange(root / "blocksexchange", shots)
    write.write_meshroom(root / "meshroom", shots, (1, 2, 8))
    write.write_opensfm(root / "opensfm", [shots], "perspective")
    write.write_openmvg(root / "openmvg", shots, "pinhole", "")
    write.write_bundler(root / "bundler", shots)
    write.write_nvm(root / "nvm", [shots])
    return {path.name: path for path in root.iterdir()}


def test_command_line_and_panel_offer_all_formats() -> None:
    assert {name for name, *_ in options.FORMATS} == {"auto", *FORMATS}


def test_photographs_are_found_in_a_named_folder(tmp_path: Path) -> None:
    paths = all_formats(tmp_path / "captures")
    chosen = tmp_path / "photographs"
    write.write_photographs(chosen, write.make_shots(count=2))
    for name, path in paths.items():
        rig = read(path, images=chosen)
        assert detect_format(path) == rig.source == name
        assert [view.image for view in rig.views] == [chosen / "IMG_0000.jpg", chosen / "IMG_0001.jpg"]


def moved_chunk(shots: list[write.Shot]) -> Chunk:
    rotation = random_rotation(np.random.default_rng(5))
    return Chunk(shots, 0.0254, rotation, np.array([12.0, -3.0, 0.5]))


def test_metashape_with_a_fourth_radial_coefficient_is_fitted(tmp_path: Path) -> None:
    shots = write.make_shots(write.Style((-0.2, 0.06, -0.02, 0.004), (0.002, -0.001)))
    write.write_photographs(tmp_path, shots)
    write_metashape(tmp_path, [metashape_chunk(Chunk(shots))])
    assert_same(read(tmp_path), shots, pixels=MOST_ERROR)


def test_metashape_rig_follows_its_master(tmp_path: Path) -> None:
    first, second = write.make_shots(BROWN3, count=2)
    chunk = moved_chunk([first, second])
    inside = np.linalg.inv(chunk.inside(first)) @ chunk.inside(second)
    rotation, translation = write.text(inside[:3, :3]), write.text(inside[:3, 3])
    offset = f"<rotation>{rotation}</rotation><translation>{translation}</translation>"
    document = metashape_chunk(replace(chunk, shots=[first]))
    document = document.replace("</sensors>", metashape_sensor(1, second, offset) + "</sensors>")
    slave = f'<camera id="1" sensor_id="1" master_id="0" label="{Path(second.name).stem}"/>'
    write.write_photographs(tmp_path, [first, second])
    write_metashape(tmp_path, [document.replace("</cameras>", slave + "</cameras>")])
    assert_same(read(tmp_path), [first, second])


def test_metashape_reads_the_largest_of_several_chunks(tmp_path: Path) -> None:
    shots = write.make_shots(count=4)
    write.write_photographs(tmp_path, shots)
    chunks = [metashape_chunk(Chunk(part)) for part in (shots[:1], shots[1:])]
    write_metashape(tmp_path, chunks)
    rig = read(tmp_path)
    assert_same(rig, shots[1:])
    assert [note.code for note in rig.notes] == ["several-models"] and "(1, 3 " in rig.notes[0].text


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ('type="frame"', 'type="spherical"', "camera-model"),
        ("<k1>", "<b2>0.5</b2><k1>", "camera-model"),
        ("<f>", "<g>", "rig-damaged"),
        ("</cx>", "x</cx>", "rig-damaged"),
        ('<?xml version="1.0" encoding="UTF-8"?>', '<!DOCTYPE a [<!ENTITY b "c">]>', "rig-damaged"),
        ("<scale>0.0254", "<scale>-1", "rig-damaged"),
        ("calibration", "covariance", "intrinsics-missing"),
    ],
)
def test_metashape_that_cannot_be_used(tmp_path: Path, old: str, new: str, code: str) -> None:
    write_metashape(tmp_path, [metashape_chunk(moved_chunk(write.make_shots(BROWN3, 1)))])
    document = (tmp_path / "cameras.xml").read_text()
    assert old in document
    (tmp_path / "cameras.xml").write_text(document.replace(old, new))
    assert error_of(read, tmp_path).code == code


def test_realityscan_2_has_other_names_of_columns(tmp_path: Path) -> None:
    shots = write.make_shots(count=2)
    write_realityscan_csv(tmp_path, shots)
    file = tmp_path / "cameras.csv"
    text = file.read_text()
    file.write_text(text.replace("heading", "yaw").replace(",f,px,py", ", f_35mm,px_norm,py_norm"))
    assert_same(read(tmp_path), shots)


def test_realityscan_xmp_values_may_be_attributes(tmp_path: Path) -> None:
    shots = write.make_shots(BROWN3, 1)
    write_realityscan_xmp(tmp_path, shots)
    path = tmp_path / f"{Path(shots[0].name).stem}.xmp"
    document = path.read_text()
    start, end = document.index("      <xcr:Rotation>"), document.index("      <xcr:Position>")
    attribute = document[start:end].strip().replace("<xcr:Rotation>", 'xcr:Rotation="').replace("</xcr:Rotation>", '"')
    path.write_text((document[:start] + document[end:]).replace('xcr:Skew="0"', f'xcr:Skew="0" {attribute}'))
    assert_same(read(tmp_path), shots)


@pytest.mark.parametrize(
    ("old", "new"), [("brown4t2", "division"), ('Skew="0"', 'Skew="0.1"'), ('Ratio="1"', 'Ratio="1.1"')]
)
def test_realityscan_lenses_that_are_not_supported(tmp_path: Path, old: str, new: str) -> None:
    write_realityscan_xmp(tmp_path, write.make_shots(BROWN3, 1))
    path = tmp_path / "IMG_0000.xmp"
    path.write_text(path.read_text().replace(old, new))
    assert error_of(read, tmp_path).code == "camera-model"


def test_blocksexchange_angles_of_the_documented_sample(tmp_path: Path) -> None:
    """Bentley's sample has one pose in both forms."""
    matrix = np.array(
        [
            [-0.9999982912233401, -0.001636319085375301, -0.0008602425863163225],
            [-0.001631068695467463, 0.9999802528616577, -0.00606906089589293],
            [0.0008701565192966738, -0.006067647409696231, -0.9999812130648239],
        ]
    )
    shot = write.make_shots(count=1)[0]
    write.write_blocksexchange(tmp_path, [shot], angles=True)
    document = (tmp_path / "block.xml").read_text()
    start, end = document.index("<Rotation>"), document.index("</Rotation>")
    angles = write.tags({"Omega": 179.6523471469934, "Phi": 0.04985630236313049, "Kappa": 179.9065465708369})
    (tmp_path / "block.xml").write_text(f"{document[:start]}<Rotation>{angles}{document[end:]}")
    np.testing.assert_allclose(read(tmp_path).views[0].camera_to_world[:3, :3].T, matrix, atol=1e-8)


def test_blocksexchange_largest_component_and_photographs_without_a_pose(tmp_path: Path) -> None:
    shots = write.make_shots(count=5)
    write.write_blocksexchange(tmp_path, shots)
    parts = (tmp_path / "block.xml").read_text().split("</Photogroup>")
    parts[1] = parts[1].replace("<Component>1", "<Component>2")
    parts[2] = parts[2].replace("<Component>1", "<Component>0")
    parts[4] = parts[4].replace("Center>", "Unknown>")
    (tmp_path / "block.xml").write_text("</Photogroup>".join(parts))
    rig = read(tmp_path)
    assert_same(rig, [shots[0], shots[3]])
    assert [note.code for note in rig.notes] == ["several-models", "pose-lost"]
    assert "2 photographs" in rig.notes[1].text and "IMG_0002.jpg" in rig.notes[1].text


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("Perspective", "Fisheye", "camera-model"),
        ("<Skew>0", "<Skew>0.1", "camera-model"),
        ("<PrincipalPoint>", "<PrincipalPoint><xmm>0</xmm>", "camera-model"),
        ("FocalLengthPixels", "Unknown", "intrinsics-missing"),
        ("XRightYDown", "XForwardYDown", "rig-damaged"),
        ("<K3>", "<K3>x", "rig-damaged"),
        ("<z>", "<w>", "rig-damaged"),
        ("Pose>", "PoseMetadata>", "no-views"),
        ("M_00>", "Heading>", "pose-unsupported"),
        ("<Definition>", "<Definition>EPSG:4326", "pose-unsupported"),
    ],
)
def test_blocksexchange_that_cannot_be_used(tmp_path: Path, old: str, new: str, code: str) -> None:
    write.write_blocksexchange(tmp_path, write.make_shots(BROWN3, 1))
    document = (tmp_path / "block.xml").read_text()
    assert old in document
    (tmp_path / "block.xml").write_text(document.replace(old, new))
    assert error_of(read, tmp_path).code == code
