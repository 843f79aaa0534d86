# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The options of the main job and of reading a capture."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from ..core.run.errors import FiptError
from ..core.run.settings import Settings

BLEND_NAME = "room.blend"
PARTS = ("auto", "masks", "semantics", "materials", "objects", "loose", "none")
RENDER_KINDS = ("rerender", "relight", "insert")


@dataclass(frozen=True, kw_only=True)
class CaptureOptions:
    """How a capture is read; the defaults are those of the engine's command `ingest`.

    Attributes:
        mesh: the room's mesh file, or None for the one found beside the cameras.
        format: layout of the capture, "auto" to recognise it.
        up_axis: axis of the source's coordinates that points up, "auto" for what the format says.
        scale: metres per source unit.
        hold_back: every N-th view is held back where the capture names none; 0 for none, None for the
            engine's default.
        images: folder in which the photographs are looked for first.
        clamp_negative: whether negative radiance is read as zero.
        align_mesh: whether the cameras are moved to the mesh by the solve's sparse points.
        plane_room: whether a room of planes is made from the solve's points where there is no mesh.
        dense_stereo: whether a mesh is made from the photographs by dense stereo where there is none.
        views: number of photographs that are used, evenly spread; 0 for all.
        voxel: metres, of meshes that are fused from depth images; None for the engine's default.
        close_holes: metres; holes of fused meshes that are not wider are closed; None for none.
        triangles: budget of the mesh; one with more is simplified. 0 for none.
        depth_unit: metres per unit of 16-bit depth images, or None for the engine's default.
        own_paths: transforms.json only; whether its paths may lead anywhere, since we wrote it ourselves.
        undo_applied_transform: transforms.json only; whether the mesh has the coordinates from before
            nerfstudio's `applied_transform`.
    """

    mesh: Path | None = None
    format: str = "auto"
    up_axis: str = "auto"
    scale: float = 1.0
    hold_back: int | None = None
    images: Path | None = None
    clamp_negative: bool = False
    align_mesh: bool = False
    plane_room: bool = False
    dense_stereo: bool = False
    views: int = 0
    voxel: float | None = None
    close_holes: float | None = None
    triangles: int = 0
    depth_unit: float | None = None
    own_paths: bool = False
    undo_applied_transform: bool = False


@dataclass(frozen=True, kw_only=True)
class MainJobOptions(CaptureOptions):
    """What the user chooses for one run of the main job, besides how the capture is read.

    Attributes:
        capture: folder or camera file of the capture.
        output: the run folder, created if it does not exist.
        settings: constants of the method.
        parts: source of the material parts; one of PARTS.
        masks_model: folder or checkpoint of a model that finds masks of views that have none; None for none.
        renders: Cycles renders to make; of RENDER_KINDS.
        render_view: name of the view to render; "" chooses a held-back one.
        render_spp: Cycles samples per pixel.
        resume: whether finished steps of an earlier run are kept.
        engine_python: the engine's interpreter, or None to find it.
        cluster: address of a Dask scheduler whose workers share the work on the views; None for this machine
            alone. The results are the same.
        hints: file of what is known of surfaces (hints.json), for the whole estimation; None: none or, with
            `resume`, those of the run.
        hints_again: the same for an estimate again, from the stages of a finished run.
    """

    capture: Path
    output: Path
    settings: Settings = field(default_factory=Settings)
    parts: str = "auto"
    masks_model: Path | None = None
    renders: tuple[str, ...] = RENDER_KINDS
    render_view: str = ""
    render_spp: int = 64
    resume: bool = False
    engine_python: str | None = None
    cluster: str | None = None
    hints: Path | None = None
    hints_again: Path | None = None


def ingest_arguments(options: CaptureOptions) -> list[str]:
    """Arguments of the engine's `ingest`, each one word: a separate "-y" would be taken for an option."""
    arguments = [f"--format={options.format}", f"--up-axis={options.up_axis}", f"--scale={options.scale!r}"]
    if options.mesh is not None:
        arguments.append(f"--mesh={options.mesh.absolute()}")
    if options.hold_back is not None:
        arguments.append(f"--hold-back={options.hold_back}")
    if options.images is not None:
        arguments.append(f"--images={options.images.absolute()}")
    for name in ("views", "triangles"):
        if getattr(options, name):
            arguments.append(f"--{name}={getattr(options, name)}")
    for name in ("voxel", "close_holes", "depth_unit"):
        value = getattr(options, name)
        if value is not None:
            arguments.append(f"--{name.replace('_', '-')}={value!r}")
    if options.clamp_negative:
        arguments.append("--clamp-negative")
    if options.align_mesh:
        arguments.append("--align-mesh")
    if options.plane_room:
        arguments.append("--plane-room")
    if options.dense_stereo:
        arguments.append("--dense-stereo")
    if options.own_paths:
        arguments.append("--own-paths")
    if options.undo_applied_transform:
        arguments.append("--undo-applied-transform")
    return arguments


def capture_source(path: Path) -> Path:
    """The folder of a model's file: of all files, only transforms.json is a capture by itself."""
    return path.parent if path.is_file() and path.suffix.lower() != ".json" else path


def check_options(options: MainJobOptions) -> None:
    """Check the paths before anything is written.

    Raises:
        FiptError: see ``make_main_job``.
    """
    if not options.capture.exists():
        raise FiptError(
            "capture-missing",
            f"The capture {options.capture} does not exist.",
            "Give the capture's folder or its camera file.",
        )
    if options.mesh is not None and not options.mesh.is_file():
        raise FiptError(
            "mesh-missing",
            f"The mesh file {options.mesh} does not exist.",
            "Give the room's mesh file (--mesh).",
        )
    if options.masks_model is not None and not options.masks_model.exists():
        raise FiptError(
            "model-unusable",
            f"The masks model {options.masks_model} does not exist.",
            "Give a checkpoint of MobileSAM, or the folder of a model (--masks-model).",
        )
    if options.output.exists() and not options.output.is_dir():
        raise FiptError(
            "run-foreign",
            f"{options.output} is a file.",
            "Choose a new or empty folder for the output (--output).",
        )
    if options.output.resolve() == options.capture.resolve():
        raise FiptError(
            "output-inside-capture",
            f"The output folder {options.output} is the capture itself.",
            "Choose a new or empty folder for the output (--output).",
        )
    if not set(options.renders) <= set(RENDER_KINDS):
        raise FiptError(
            "render-unknown",
            f"There is no render of kind {', '.join(sorted(set(options.renders) - set(RENDER_KINDS)))}.",
            f"Choose from: {', '.join(RENDER_KINDS)}.",
        )
