"""Small valid samples for every reader, for fuzz_targets.py and the tests of damaged inputs."""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from fipt_blender.core.capture.rig import Lens
from fipt_blender.core.run.hints import Hint, write_hints
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.settings import make_settings
from samples import capture_files, rig_writers

PINHOLE = Lens("PINHOLE", (9.0, 9.0, 6.0, 4.0))


def import_sample(sample: Path, out: Path, *options: str) -> None:
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
    options |= {"--voxel": 0.02, "--depth-unit": 0.001}
    options |= {"--mesh": "capture/mesh.obj", "--images": "capture/images"}
    (folder / "options.json").write_text(json.dumps(options))


def _samples(count: int) -> list[capture_files.Sample]:
    """Small photographs and their cameras, side by side."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, 3] = [(0.3 * index, 0.1, 1.0) for index in range(count)]
    return [capture_files.Sample(f"{index:03d}", 12, 8, PINHOLE, pose) for index, pose in enumerate(poses)]


def write_colmap(folder: Path, text: bool) -> None:
    """A COLMAP model of three cameras with points, its images and a mesh."""
    import pycolmap

    model = pycolmap.Reconstruction()
    for index, sample in enumerate(_samples(3), start=1):
        camera = pycolmap.Camera(camera_id=index, model="OPENCV", width=12, height=8, params=[9, 9, 6, 4, 0, 0, 0, 0])
        model.add_camera_with_trivial_rig(camera)
        points = pycolmap.Point2DList([pycolmap.Point2D(np.array([1.0, 2.0]))] * 2)
        image = pycolmap.Image(name=f"{index - 1:03d}.jpg", camera_id=index, image_id=index, points2D=points)
        inverse = np.linalg.inv(sample.pose)
        rigid = pycolmap.Rigid3d(pycolmap.Rotation3d(inverse[:3, :3].copy()), inverse[:3, 3])
        model.add_image_with_trivial_frame(image, rigid)
    track = pycolmap.Track([pycolmap.TrackElement(1, 0), pycolmap.TrackElement(2, 1)])
    model.add_point3D(np.array([0.5, 0.5, 3.0]), track)
    (folder / "sparse" / "0").mkdir(parents=True)
    (model.write_text if text else model.write_binary)(str(folder / "sparse" / "0"))
    capture_files.write_images(folder / "images", _samples(3))
    capture_files.write_mesh(folder / "mesh.obj")


def write_transforms(folder: Path) -> None:
    """transforms.json with id images."""
    frames = [
        {"file_path": f"images/{sample.stem}.exr", "transform_matrix": sample.pose.tolist()} for sample in _samples(3)
    ]
    data = {"w": 12, "h": 8, "fl_x": 9.0, "fl_y": 9.0, "cx": 6.0, "cy": 4.0, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps({**data, "train_filenames": ["images/000.exr"]}))
    capture_files.write_images(folder / "images", _samples(3))
    _write_ids(folder / "parts", 3)
    capture_files.write_mesh(folder / "mesh.obj")


def _write_ids(folder: Path, count: int) -> None:
    from PIL import Image

    folder.mkdir(parents=True)
    for index in range(count):
        Image.fromarray(np.full((8, 12), index + 1, np.uint8)).save(folder / f"{index:03d}.png")


def write_fipt_real(folder: Path) -> None:
    """cam.txt and K_list.txt."""
    shots = [replace(sample, stem=f"{sample.stem}_0001") for sample in _samples(3)]
    capture_files.write_fipt_real(folder, shots)
    capture_files.write_mesh(folder / "mesh.obj")


def write_fipt_synthetic(folder: Path) -> None:
    """train and val folders."""
    poses = [sample.pose for sample in _samples(2)]
    capture_files.write_fipt_synthetic(folder, {"train": poses, "val": poses}, named=False)
    capture_files.write_mesh(folder / "mesh.obj")


def three_shots() -> list[rig_writers.Shot]:
    """Three cameras of the size of the sample's images."""
    shots = []
    for sample in _samples(3):
        values = (f"{sample.stem}.jpg", 12, 8, *PINHOLE.parameters, sample.pose[:3, :3].T, sample.pose[:3, 3])
        shots.append(rig_writers.Shot(*values, k=(-0.02, 0.01)))
    return shots


def write_capture(folder: Path) -> None:
    """capture.json as `ingest` writes it, with its images."""
    with tempfile.TemporaryDirectory() as temporary:
        source = Path(temporary) / "source"
        source.mkdir()
        write_transforms(source)
        import_sample(source, Path(temporary))
        capture = json.loads((Path(temporary) / "run" / "capture.json").read_text())
    capture_files.write_images(folder / "images", _samples(3))
    for index, view in enumerate(capture["views"]):
        view.update(image=f"images/{index:03d}.exr", parts=None)
    (folder / "capture.json").write_text(json.dumps({**capture, "mesh": None}))


def write_known(folder: Path) -> None:
    """hints.json."""
    write_hints(folder / "hints.json", [Hint(points=((0.0, 0.0, 0.0),), name="a", roughness=(0.1, 0.5))])


def write_preparation(folder: Path) -> None:
    """prepare.json of two photographs."""
    from fipt_blender.prepare import preparation

    (folder / "photographs").mkdir()
    capture_files.write_images(folder / "photographs", _samples(2))
    files = tuple(preparation.Photograph(f"{index:03d}.exr", "linear", 12, 8, 1, 0.01) for index in range(2))
    groups = tuple(preparation.Group(file.path[:3], (file.path,)) for file in files)
    preparation.write_preparation(
        preparation.PreparationFolder(folder), preparation.Preparation(folder / "photographs", files, groups)
    )


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


def write_points(folder: Path) -> None:
    """A solve of OpenSfM with points on the walls of a box."""
    rig_writers.write_opensfm(folder, [three_shots()], "perspective")
    rng = np.random.default_rng(3)
    points = rng.random((150, 3))
    points[np.arange(150), rng.integers(0, 3, 150)] = rng.integers(0, 2, 150)
    path = folder / "reconstruction.json"
    data = json.loads(path.read_text())
    data[0]["points"] = {str(i): {"coordinates": point} for i, point in enumerate((6 * points - 3).tolist())}
    path.write_text(json.dumps(data))


def write_image_files(folder: Path) -> None:
    """Images of all formats that are not EXR, with profiles, and an EXR of several parts."""
    from PIL import Image

    from samples.image_files import icc_profile, write_exr_layers, write_tiff
    from samples.photographs import exif

    pixels = np.random.default_rng(0).integers(0, 256, (8, 12, 3)).astype(np.uint8)
    options = {"icc_profile": icc_profile("P3", "table"), "exif": exif(0.01, orientation=6)}
    for suffix in ("jpg", "png", "tif", "webp"):
        Image.fromarray(pixels).save(folder / f"a.{suffix}", **options)
    Image.fromarray(pixels[..., 0]).save(folder / "grey.png", bits=4)
    Image.fromarray(pixels).convert("P").save(folder / "palette.png")
    write_tiff(folder / "planar.tif", pixels.astype(np.float32), planar=True)
    header = b"#?RADIANCE\nEXPOSURE=2\nPRIMARIES=.68 .32 .265 .69 .15 .06 .3127 .3290\n"
    header += b"FORMAT=32-bit_rle_rgbe\n\n-Y 8 +X 12\n"
    (folder / "a.hdr").write_bytes(header + np.dstack([pixels, pixels[..., :1]]).tobytes())
    layers = {name: dict.fromkeys("RGB", np.ones((8, 12), np.float32)) for name in ("N", "C")}
    write_exr_layers(folder / "a.exr", layers, parts=True)
