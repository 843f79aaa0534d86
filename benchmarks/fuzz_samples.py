# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Small valid samples for every reader, for fuzz.py and the tests of damaged inputs."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.capture.rig import Lens
from fipt_blender.core.run.documents import read_json
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.hints import Hint, read_hints, write_hints
from fipt_blender.core.run.run_files import read_atlas, read_emitters, read_room_files
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.settings import make_settings
from fipt_blender.core.run.shapes import ROOM_ARRAYS, STAGES
from samples import metashape_writers, rgbd_frames, rig_writers


@dataclass(frozen=True)
class Target:
    """One reader.

    Attributes:
        name: of the reader.
        write: makes a valid sample in an empty folder.
        read: reads it; gets the folder of the sample and an empty folder for what it writes.
        modules: that it imports, slowly.
    """

    name: str
    write: Callable[[Path], None]
    read: Callable[[Path, Path], None]
    modules: tuple[str, ...] = ("fipt_blender.core.capture.ingest",)


def _ingest(sample: Path, out: Path, *options: str) -> None:
    """The whole import: cameras, photographs and what is written, and the result read again."""
    from fipt_blender.core.capture import ingest
    from fipt_blender.core.capture.views import load_capture
    from fipt_blender.core.run.messages import Reporter

    run = RunFolder(out / "run")
    run.create(make_settings("draft"))
    parser = argparse.ArgumentParser()
    ingest.add_arguments(parser)
    with (out / "messages").open("w") as stream:
        ingest.run(parser.parse_args([str(sample), str(run.root), *options]), Reporter(stream))
    for view in load_capture(run).views:
        view.radiance()


def write_options(folder: Path) -> None:
    """A COLMAP model with points, and options of its import in a file of our own."""
    (folder / "capture").mkdir()
    write_colmap(folder / "capture", text=True)
    options = {"--scale": 1.0, "--up-axis": "y", "--hold-back": 2, "--views": 3, "--triangles": 0}
    options |= {"--voxel": 0.02, "--close-holes": 0.1, "--depth-unit": 0.001}
    options |= {"--mesh": "capture/scene.obj", "--images": "capture/images"}
    (folder / "options.json").write_text(json.dumps(options))


def _ingest_with_options(sample: Path, out: Path) -> None:
    try:
        options = json.loads((sample / "options.json").read_text())
        given = [f"{key}={value}" for key, value in options.items()]
    except (AttributeError, RecursionError, ValueError) as error:
        raise FiptError("options", str(error), "Not a fault of the reader.") from None
    os.chdir(sample)
    try:
        _ingest(sample / "capture", out, *given)
    except SystemExit as error:  # argparse has told what is wrong
        raise FiptError("options", str(error), "Correct them.") from None


def _load_capture(sample: Path, out: Path) -> None:
    from fipt_blender.core.capture.views import load_capture

    load_capture(RunFolder(sample))


def _poses(count: int) -> list[np.ndarray]:
    poses = []
    for index in range(count):
        pose = np.eye(4)
        pose[:3, 3] = (0.3 * index, 0.1, 1.0)
        poses.append(pose)
    return poses


def _write_images(folder: Path, count: int) -> None:
    rng = np.random.default_rng(0)
    for index in range(count):
        write_exr(folder / f"{index:03d}.exr", rng.random((8, 12, 3), np.float32), half=True)


def _write_mesh(folder: Path) -> None:
    (folder / "scene.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")


def write_colmap(folder: Path, text: bool) -> None:
    """A COLMAP model of three cameras with points, its images and a mesh."""
    import pycolmap

    model = pycolmap.Reconstruction()
    for index, pose in enumerate(_poses(3), start=1):
        camera = pycolmap.Camera(
            camera_id=index, model="OPENCV", width=12, height=8, params=[9, 9, 6, 4, 0, 0, 0, 0]
        )
        model.add_camera_with_trivial_rig(camera)
        points = pycolmap.Point2DList([pycolmap.Point2D(np.array([1.0, 2.0]))] * 2)
        image = pycolmap.Image(name=f"{index - 1:03d}.jpg", camera_id=index, image_id=index, points2D=points)
        inverse = np.linalg.inv(pose)
        rigid = pycolmap.Rigid3d(pycolmap.Rotation3d(inverse[:3, :3].copy()), inverse[:3, 3])
        model.add_image_with_trivial_frame(image, rigid)
    track = pycolmap.Track([pycolmap.TrackElement(1, 0), pycolmap.TrackElement(2, 1)])
    model.add_point3D(np.array([0.5, 0.5, 3.0]), track)
    (folder / "sparse" / "0").mkdir(parents=True)
    (model.write_text if text else model.write_binary)(str(folder / "sparse" / "0"))
    _write_images(folder / "images", 3)
    _write_mesh(folder)


def write_transforms(folder: Path) -> None:
    """transforms.json with id images."""
    frames = [
        {"file_path": f"images/{index:03d}.exr", "transform_matrix": pose.tolist()}
        for index, pose in enumerate(_poses(3))
    ]
    data = {"w": 12, "h": 8, "fl_x": 9.0, "fl_y": 9.0, "cx": 6.0, "cy": 4.0, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps({**data, "train_filenames": ["images/000.exr"]}))
    _write_images(folder / "images", 3)
    _write_ids(folder / "parts", 3)
    _write_mesh(folder)


def _write_ids(folder: Path, count: int) -> None:
    from PIL import Image

    folder.mkdir(parents=True)
    for index in range(count):
        Image.fromarray(np.full((8, 12), index + 1, np.uint8)).save(folder / f"{index:03d}.png")


def write_fipt_real(folder: Path) -> None:
    """cam.txt and K_list.txt."""
    cameras, matrices = ["3"], ["3"]
    for pose in _poses(3):
        origin, forward, up = pose[:3, 3], pose[:3, 2], -pose[:3, 1]
        cameras += [" ".join(f"{value:.6f}" for value in row) for row in (origin, origin + forward, up)]
        matrices += ["9 0 6", "0 9 4", "0 0 1"]
    (folder / "cam.txt").write_text("\n".join(cameras))
    (folder / "K_list.txt").write_text("\n".join(matrices))
    _write_images(folder / "Image", 3)
    for path in sorted((folder / "Image").iterdir()):
        path.rename(path.with_stem(f"{path.stem}_0001"))
    _write_mesh(folder)


def write_fipt_synthetic(folder: Path) -> None:
    """train and val folders."""
    for split in ("train", "val"):
        frames = [{"transform_matrix": pose.tolist()} for pose in _poses(2)]
        for index in range(2):
            write_exr(folder / split / "Image" / f"{index:03d}_0001.exr", np.ones((8, 12, 3), np.float32))
            write_exr(folder / split / "IndexMA" / f"{index:03d}_0001.exr", np.ones((8, 12, 3), np.float32))
            write_exr(folder / split / "segmentation" / f"{index:03d}.exr", np.ones((8, 12, 3), np.float32))
        (folder / split / "transforms.json").write_text(json.dumps({"camera_angle_x": 1.2, "frames": frames}))
    _write_mesh(folder)


def _shots() -> list[rig_writers.Shot]:
    """Three cameras of the size of the sample's images."""
    shots = []
    for index, pose in enumerate(_poses(3)):
        values = (f"{index:03d}.jpg", 12, 8, 9.0, 9.0, 6.0, 4.0, pose[:3, :3].T, pose[:3, 3])
        shots.append(rig_writers.Shot(*values, k=(-0.02, 0.01)))
    return shots


def _program(write: Callable[[Path, list[rig_writers.Shot]], None]) -> Callable[[Path], None]:
    """A writer of another program's cameras with images that can be ingested."""

    def write_all(folder: Path) -> None:
        write(folder, _shots())
        for index, path in enumerate(sorted(folder.rglob("*.jpg"))):
            path.unlink()
            pixels = np.random.default_rng(index).random((8, 12, 3), np.float32)
            write_exr(path.with_suffix(".exr"), pixels, half=True)
        _write_mesh(folder)

    return write_all


def write_capture(folder: Path) -> None:
    """capture.json as `ingest` writes it, with its images."""
    with tempfile.TemporaryDirectory() as temporary:
        source = Path(temporary) / "source"
        source.mkdir()
        write_transforms(source)
        _ingest(source, Path(temporary))
        capture = json.loads((Path(temporary) / "run" / "capture.json").read_text())
    _write_images(folder / "images", 3)
    for index, view in enumerate(capture["views"]):
        view.update(image=f"images/{index:03d}.exr", parts=None)
    (folder / "capture.json").write_text(json.dumps({**capture, "mesh": None}))


def write_run_files(folder: Path) -> None:
    """The room, the atlas, the emitters and the records of a run folder."""
    run = RunFolder(folder)
    run.create(make_settings("draft"))
    room = {name: np.zeros([2 if n == "T" else 4 if n == "V" else n for n in sizes], kind)
            for name, (kind, sizes) in ROOM_ARRAYS.items()}  # fmt: skip
    np.savez(run.room_npz, **room)
    write_json(run.room_json, {"objects": ["a"], "materials": ["b"], "parts": "auto"})
    np.savez(run.atlas_npz, corner_uv=np.zeros((2, 3, 2), np.float32), triangle_image=np.zeros(2, np.int32))
    write_json(run.atlas_json, {"mode": "uv", "images": [{"name": "Room.001", "width": 8, "height": 8}]})
    fixture = {"name": "a", "triangles": [0, 1], "radiance": [1, 1, 1], "back_radiance": [0, 0, 0]}
    write_json(run.emitters_json, {"fixtures": [fixture], "environment": None})
    write_json(run.stage / "stages.json", {"keys": {"a": "b"}, "stages": {}, "warnings": {}, "values": {}})


def _read_run_files(sample: Path, out: Path) -> None:
    run = RunFolder(sample)
    room, _ = read_room_files(run)
    read_atlas(run, len(room["triangles"]))
    read_emitters(run, len(room["triangles"]))
    read_json(run.stage / "stages.json", STAGES)
    run.read()


def write_finished_run(folder: Path) -> None:
    """A run folder with photographs, renders and hints, of which a report can be written."""
    write_run_files(folder)
    write_capture(folder)
    run = RunFolder(folder)
    name = json.loads(run.capture_json.read_text())["views"][0]["name"]
    write_exr(run.renders / "a.exr", np.ones((8, 12, 3), np.float32))
    write_exr(run.environment_exr, np.ones((4, 8, 3), np.float32))
    write_json(run.renders_json, {"renders": [{"kind": "render", "view": name, "image": "renders/a.exr"}]})
    fixture = {"name": "a", "triangles": [0], "radiance": [1, 1, 1], "back_radiance": [0, 0, 0], "area": 1}
    environment = {"image": "environment.exr", "observed_share": 0.5}
    write_json(run.emitters_json, {"fixtures": [fixture], "environment": environment})
    write_json(run.statistics_json, {"stages": [{"name": "a", "seconds": 1, "rays": 2}], "peak_memory_gb": 1})
    write_hints(run.hints_json, [Hint(points=((0.0, 0.0, 0.0),), name="a", roughness=(0.1, 0.5))])


def _report(sample: Path, out: Path) -> None:
    """The run folder's documents, and the report, which is written into a copy."""
    from fipt_blender.core.report.page import write_report

    run = RunFolder(out / "run")
    shutil.copytree(sample, run.root)
    read_hints(run.hints_json)
    write_report(run)


def write_preparation(folder: Path) -> None:
    """prepare.json of two photographs."""
    from fipt_blender.core.photographs import preparation

    (folder / "photographs").mkdir()
    _write_images(folder / "photographs", 2)
    files = tuple(preparation.Photograph(f"{index:03d}.exr", "linear", 12, 8, 1, 0.01) for index in range(2))
    groups = tuple(preparation.Group(file.path[:3], (file.path,)) for file in files)
    preparation.write_preparation(
        preparation.PreparationFolder(folder), preparation.Preparation(folder / "photographs", files, groups)
    )


def _preparation(sample: Path, out: Path) -> None:
    """What a step of `prepare` does with the file before it works on photographs."""
    from fipt_blender.core.photographs import preparation

    found = preparation.read_preparation(preparation.PreparationFolder(sample))
    for group in found.used_groups:
        for photograph in found.of(group):
            assert found.file(photograph).is_relative_to(found.source)


def write_named_meshes(folder: Path) -> None:
    """OBJ with a material library and glTF with a buffer, as Blender's importers read them."""
    material = "newmtl a\nmap_Kd -s 1 1 1 textures/a.png\n"
    (folder / "a.mtl").write_text(material)
    (folder / "a.obj").write_text("mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n")
    (folder / "a.bin").write_bytes(np.eye(3, dtype="<f4").tobytes())
    view, accessor = {"buffer": 0, "byteLength": 36}, {"bufferView": 0, "componentType": 5126, "count": 3}
    data = {
        "asset": {"version": "2.0"},
        "buffers": [{"uri": "a.bin", "byteLength": 36}],
        "images": [{"uri": "a.png"}],
        "bufferViews": [view],
        "accessors": [{**accessor, "type": "VEC3"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}],
    }
    (folder / "a.gltf").write_text(json.dumps(data))


def _named_meshes(sample: Path, out: Path) -> None:
    """The checks before Blender's importers, and what a resumed job compares."""
    from fipt_blender.blend.capture.mesh_files import check_mesh_file
    from fipt_blender.jobs.fingerprints import mesh_fingerprint

    refused = None
    for name in ("a.obj", "a.gltf"):
        mesh_fingerprint(sample / name)
        try:
            check_mesh_file(sample / name)
        except FiptError as error:
            refused = error
    if refused is not None:
        raise refused


def _write_model(kind: str) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        from samples import mask_models

        if kind == "sam":
            mask_models.write_sam(folder, mask_models.make_sam())
        else:
            mask_models.write_segmenter(folder, mask_models.make_eomt())

    return write


def _open_model(sample: Path, out: Path) -> None:
    from fipt_blender.core.photographs.masks_model import open_masks_model

    open_masks_model(sample)


def _metashape(folder: Path, shots: list[rig_writers.Shot]) -> None:
    rig_writers.write_photographs(folder, shots)
    metashape_writers.write_metashape(
        folder, [metashape_writers.metashape_chunk(metashape_writers.Chunk(shots), component=True)]
    )


def _rgbd(folder: Path) -> None:
    rgbd_frames.write_frames(folder, 2, (12, 16), 9.0)


def _depth_points(sample: Path, out: Path) -> None:
    """What cameras with depth are aligned by."""
    from fipt_blender.core.capture.depth_images import checked_depths
    from fipt_blender.core.capture.depth_points import alignment_points
    from fipt_blender.core.capture.formats import read_rig

    rig = read_rig(sample, "rgbd", CaptureOptions())
    alignment_points(sample, replace(rig, depths=checked_depths(rig.depths)))


def write_meshes(folder: Path) -> None:
    """A wavy surface of 242 triangles as OBJ and PLY."""
    from fipt_blender.core.depth.extraction import FusedMesh
    from fipt_blender.core.depth.ply import write_ply

    steps = np.arange(12)
    x, y = (part.ravel() for part in np.meshgrid(steps, steps))
    vertices = np.stack([x, y, np.sin(x)], axis=1).astype(np.float32)
    first = np.add.outer(12 * steps[:-1], steps[:-1]).ravel()
    triangles = (first[:, None] + [0, 1, 13, 0, 13, 12]).reshape(-1, 3).astype(np.int32)
    write_ply(folder / "mesh.ply", FusedMesh(vertices, triangles))
    lines = ["v {:.6g} {:.6g} {:.6g}".format(*vertex) for vertex in vertices]
    lines += ["f {} {} {}".format(*(triangle + 1)) for triangle in triangles]
    (folder / "mesh.obj").write_text("\n".join([*lines, ""]))


def _simplify(sample: Path, out: Path) -> None:
    """Simplification of mesh files, and the surface to which cameras are aligned."""
    from fipt_blender.core.alignment.mesh_file import read_mesh
    from fipt_blender.core.alignment.surface import sample_surface
    from fipt_blender.core.capture.source import simplified_mesh
    from fipt_blender.core.depth.ply import write_ply

    for name in ("mesh.ply", "mesh.obj"):
        found = simplified_mesh(sample / name, 100)
        if found is not None:
            write_ply(out / "small.ply", found[0])
        surface = sample_surface(*read_mesh(sample / name), np.random.default_rng(0), 500)
        surface.nearest_triangle(surface.points[:50] + 0.1)


def write_points(folder: Path) -> None:
    """A solve of OpenSfM with points on the walls of a box."""
    rig_writers.write_opensfm(folder, [_shots()], "perspective")
    rng = np.random.default_rng(3)
    points = rng.random((150, 3))
    points[np.arange(150), rng.integers(0, 3, 150)] = rng.integers(0, 2, 150)
    path = folder / "reconstruction.json"
    data = json.loads(path.read_text())
    data[0]["points"] = {str(i): {"coordinates": point} for i, point in enumerate((6 * points - 3).tolist())}
    path.write_text(json.dumps(data))


def _plane_room(sample: Path, out: Path) -> None:
    """The room of planes of a solve's points."""
    from fipt_blender.core.capture.formats import read_rig
    from fipt_blender.core.capture.source import room_of_points, write_room

    rig = read_rig(sample, "opensfm", CaptureOptions())
    write_room(out / "planes.obj", room_of_points(sample, rig))


def write_depth_map(folder: Path) -> None:
    """A depth map as dense stereo writes it."""
    depth = np.linspace(1.0, 3.0, 48, dtype="<f4")
    (folder / "a.geometric.bin").write_bytes(b"8&6&1&" + depth.tobytes())


def _depth_map(sample: Path, out: Path) -> None:
    from fipt_blender.core.capture.dense_stereo import read_depth_map

    try:
        read_depth_map(sample / "a.geometric.bin")
    except ValueError as error:  # `stereo_depths` makes the error for users of it
        raise FiptError("stereo-failed", str(error), "Check the photographs.") from None


PROGRAMS: dict[str, Callable[[Path, list[rig_writers.Shot]], None]] = {
    "metashape": _metashape,
    "realityscan-csv": metashape_writers.write_realityscan_csv,
    "realityscan-xmp": metashape_writers.write_realityscan_xmp,
    "meshroom": lambda folder, shots: rig_writers.write_meshroom(
        folder, [replace(shot, k=(-0.02,)) for shot in shots], (1, 2, 8)
    ),
    "opensfm": lambda folder, shots: rig_writers.write_opensfm(folder, [shots], "perspective"),
    "openmvg": lambda folder, shots: rig_writers.write_openmvg(
        folder, [replace(shot, k=(-0.02, 0.01, 0.0)) for shot in shots], "pinhole_radial_k3", "disto_k3"
    ),
    "bundler": rig_writers.write_bundler,
    "nvm": lambda folder, shots: rig_writers.write_nvm(folder, [shots], 0.02),
    "polycam": lambda folder, shots: rig_writers.write_polycam(folder, shots, np.eye(4), corrected=True),
    "record3d": lambda folder, shots: rig_writers.write_record3d(
        folder, [replace(shot, name=f"{index}.jpg") for index, shot in enumerate(shots)], each_frame=True
    ),
    "scannetpp": lambda folder, shots: rig_writers.write_scannetpp(folder, shots, held_back=2),
}
_TRANSFORMERS = ("transformers", "fipt_blender.core.photographs.masks_model")
PINHOLE = Lens("PINHOLE", (9.0, 9.0, 6.0, 4.0))
TARGETS = (
    Target("colmap-binary", lambda folder: write_colmap(folder, text=False), _ingest),
    Target("colmap-text", lambda folder: write_colmap(folder, text=True), _ingest),
    Target("transforms", write_transforms, _ingest),
    Target("fipt-real", write_fipt_real, _ingest),
    Target("fipt-synthetic", write_fipt_synthetic, _ingest),
    *(Target(name, _program(write), _ingest) for name, write in PROGRAMS.items()),
    Target("rgbd", _rgbd, _ingest),
    Target("depth-points", _rgbd, _depth_points),
    Target("meshes", write_meshes, _simplify),
    Target("plane-room", write_points, _plane_room),
    Target("depth-map", write_depth_map, _depth_map),
    Target("capture", write_capture, _load_capture),
    Target("run-files", write_run_files, _read_run_files),
    Target("report", write_finished_run, _report, ("fipt_blender.core.report.page",)),
    Target("options", write_options, _ingest_with_options),
    Target("preparation", write_preparation, _preparation, ("fipt_blender.core.photographs.preparation",)),
    Target("named-meshes", write_named_meshes, _named_meshes, ("fipt_blender.jobs.fingerprints",)),
    Target("model-sam", _write_model("sam"), _open_model, _TRANSFORMERS),
    Target("model-eomt", _write_model("eomt"), _open_model, _TRANSFORMERS),
)
