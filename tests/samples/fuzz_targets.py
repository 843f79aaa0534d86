"""What fuzz.py damages: every reader of files of others, with a sample of fuzz_samples.py."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.hints import read_hints
from fipt_blender.core.run.runfolder import RunFolder
from samples import capture_files, fuzz_samples, metashape_writers, rgbd_frames, rig_writers


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


def _ingest_with_options(sample: Path, out: Path) -> None:
    try:
        options = json.loads((sample / "options.json").read_text())
        given = [f"{key}={value}" for key, value in options.items()]
    except (AttributeError, RecursionError, ValueError) as error:
        raise FiptError.of("options", str(error), "Not a fault of the reader.") from None
    os.chdir(sample)
    try:
        fuzz_samples.import_sample(sample / "capture", out, *given)
    except SystemExit as error:  # argparse has told what is wrong
        raise FiptError.of("options", str(error), "Correct them.") from None


def _load_capture(sample: Path, out: Path) -> None:
    from fipt_blender.core.capture.views import load_capture

    load_capture(RunFolder(sample))


def _program(write: Callable[[Path, list[rig_writers.Shot]], None]) -> Callable[[Path], None]:
    """A writer of another program's cameras with images that can be ingested."""

    def write_all(folder: Path) -> None:
        write(folder, fuzz_samples.three_shots())
        for index, path in enumerate(sorted(folder.rglob("*.jpg"))):
            path.unlink()
            pixels = np.random.default_rng(index).random((8, 12, 3), np.float32)
            write_exr(path.with_suffix(".exr"), pixels, half=True)
        for mesh in [path for path in folder.rglob("*") if path.suffix in (".obj", ".ply", ".glb")]:
            mesh.unlink()  # of the names and headers alone
        capture_files.write_mesh(folder / "mesh.obj")

    return write_all


def _preparation(sample: Path, out: Path) -> None:
    """What a step of `prepare` does with the file before it works on photographs."""
    from fipt_blender.prepare import preparation

    found = preparation.read_preparation(preparation.PreparationFolder(sample))
    for group in found.used_groups:
        for photograph in found.of(group):
            assert found.file(photograph).is_relative_to(found.source)


def _named_meshes(sample: Path, out: Path) -> None:
    """The checks before Blender's importers."""
    from fipt_blender.blend.capture.mesh_names import check_mesh_file

    refused = None
    for name in ("a.obj", "a.gltf"):
        try:
            check_mesh_file(sample / name)
        except FiptError as error:
            refused = error
    if refused is not None:
        raise refused


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
    from fipt_blender.core.capture.formats.registry import read_rig
    from fipt_blender.core.checks.align import alignment_points

    rig = read_rig(sample, "rgbd", CaptureOptions())
    alignment_points(sample, replace(rig, depths=checked_depths(rig.depths)))


def _points(sample: Path, out: Path) -> None:
    """The sparse points of a solve."""
    from fipt_blender.core.capture.formats.registry import read_points

    read_points(sample, "opensfm")


def _image_files(sample: Path, out: Path) -> None:
    """All that is read of images: values, codes, ids and headers."""
    from fipt_blender.core.capture import images
    from fipt_blender.prepare.exif import describe

    refused = None
    for path in sorted(sample.iterdir()):
        for read in (images.read_ids, images.read_radiance, images.read_codes, lambda file: describe(file, "a")):
            try:
                read(path)
            except FiptError as error:
                refused = error if read is not images.read_ids else refused  # which refuses most of them
    if refused is not None:
        raise refused


PROGRAMS: dict[str, Callable[[Path, list[rig_writers.Shot]], None]] = {
    "metashape": _metashape,
    "blocksexchange": rig_writers.write_blocksexchange,
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
    "3d-scanner-app": lambda folder, shots: rig_writers.write_scanner_app(
        folder, [replace(shot, name=f"frame_{index:05d}.jpg") for index, shot in enumerate(shots)]
    ),
    "scannetpp": lambda folder, shots: rig_writers.write_scannetpp(folder, shots, held_back=2),
}


TARGETS = (
    Target("colmap-binary", lambda folder: fuzz_samples.write_colmap(folder, text=False), fuzz_samples.import_sample),
    Target("colmap-text", lambda folder: fuzz_samples.write_colmap(folder, text=True), fuzz_samples.import_sample),
    Target("transforms", fuzz_samples.write_transforms, fuzz_samples.import_sample),
    Target("fipt-real", fuzz_samples.write_fipt_real, fuzz_samples.import_sample),
    Target("fipt-synthetic", fuzz_samples.write_fipt_synthetic, fuzz_samples.import_sample),
    *(Target(name, _program(write), fuzz_samples.import_sample) for name, write in PROGRAMS.items()),
    Target("rgbd", _rgbd, fuzz_samples.import_sample),
    Target("depth-points", _rgbd, _depth_points),
    Target("points", fuzz_samples.write_points, _points),
    Target("images", fuzz_samples.write_image_files, _image_files),
    Target("capture", fuzz_samples.write_capture, _load_capture),
    Target("hints", fuzz_samples.write_known, lambda sample, out: read_hints(sample / "hints.json")),
    Target("options", fuzz_samples.write_options, _ingest_with_options),
    Target("preparation", fuzz_samples.write_preparation, _preparation, ("fipt_blender.prepare.preparation",)),
    Target("named-meshes", fuzz_samples.write_named_meshes, _named_meshes, ("fipt_blender.blend.capture.mesh_names",)),
)
