# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of the engine command `ingest`, and the arguments that set them."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from pathlib import Path

from .. import conventions
from ..run.errors import FiptError
from ..run.shapes import SCALES
from .depth_images import DEFAULT_VOXEL, FusionOptions
from .formats import FORMATS
from .rig import ReadOptions

DEFAULT_HOLD_BACK = 8


@dataclass(frozen=True)
class IngestOptions:
    """Options of the command.

    Attributes:
        format: a name of `FORMATS`, or "auto".
        mesh: the room's mesh in the capture's coordinates; None for the one found beside the camera file.
        up_axis: a name of `conventions.UP_AXES`, or "auto": that of the format if defined, else the axis
            closest to the cameras' mean up direction.
        scale: metres per unit of the capture.
        hold_back: every Nth view is held back in captures that have no held-back views; 0 for none.
        clamp_negative: set negative radiance of any size to zero.
        align_mesh: move the cameras to the mesh by the solve's sparse points.
        plane_room: make a room of planes from the solve's sparse points where the capture has no mesh.
        dense_stereo: make a mesh from the photographs by COLMAP's dense stereo where the capture has none.
        most_views: photographs that are used, evenly spread over all of a capture; 0 for all.
        fusion: how depth images are fused where the capture has no mesh, and the mesh's budget of triangles.
        read: options of the readers.
    """

    format: str = "auto"
    mesh: Path | None = None
    up_axis: str = "auto"
    scale: float = 1.0
    hold_back: int = DEFAULT_HOLD_BACK
    clamp_negative: bool = False
    align_mesh: bool = False
    plane_room: bool = False
    dense_stereo: bool = False
    most_views: int = 0
    fusion: FusionOptions = field(default_factory=FusionOptions)
    read: ReadOptions = field(default_factory=ReadOptions)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("capture", type=Path, help="folder of the capture, or its camera file")
    parser.add_argument("run", type=Path, help="run folder; created with default settings if missing")
    parser.add_argument("--format", choices=("auto", *FORMATS), default="auto", help="layout of the capture")
    parser.add_argument("--mesh", type=Path, help="the room's mesh, in the capture's coordinates")
    parser.add_argument(
        "--up-axis",
        choices=("auto", *conventions.UP_AXES),
        default="auto",
        help="axis of the capture that points up (write --up-axis=-y for negative ones)",
    )
    parser.add_argument(
        "--scale", type=float, default=1.0, metavar="METRES", help="metres per unit of the capture"
    )
    parser.add_argument(
        "--hold-back",
        type=int,
        default=DEFAULT_HOLD_BACK,
        metavar="N",
        help="hold back every Nth view if the capture defines no held-back views; 0 for none",
    )
    parser.add_argument(
        "--images", type=Path, metavar="FOLDER", help="folder of the photographs (not for fipt-synthetic)"
    )
    parser.add_argument("--clamp-negative", action="store_true", help="set negative radiance to zero")
    parser.add_argument(
        "--align-mesh",
        action="store_true",
        help="the mesh is from another program: align the cameras to it by the solve's points",
    )
    parser.add_argument(
        "--plane-room",
        action="store_true",
        help="without a mesh: a room of planes that fits the solve's points",
    )
    parser.add_argument(
        "--dense-stereo",
        action="store_true",
        help="without a mesh: one from the photographs by dense stereo; needs a pycolmap with CUDA",
    )
    parser.add_argument(
        "--own-paths",
        action="store_true",
        help="transforms.json: its paths may lead out of its folder; only for files that you wrote yourself",
    )
    parser.add_argument(
        "--undo-applied-transform",
        action="store_true",
        help="transforms.json: the mesh has the coordinates before nerfstudio's applied_transform",
    )
    parser.add_argument(
        "--views", type=int, default=0, metavar="N", help="use N photographs, evenly spread; 0 for all"
    )
    parser.add_argument(
        "--voxel",
        type=float,
        default=DEFAULT_VOXEL,
        help="meters, of meshes that are fused from depth images",
    )
    parser.add_argument(
        "--close-holes",
        type=float,
        default=0.0,
        metavar="METRES",
        help="close holes of fused meshes up to that",
    )
    parser.add_argument(
        "--triangles",
        type=int,
        default=0,
        metavar="N",
        help="simplify a mesh with more triangles to about N; 0 for none",
    )
    parser.add_argument(
        "--depth-unit", type=float, default=0.001, metavar="METRES", help="unit of 16-bit depth images"
    )


def options_of(arguments: argparse.Namespace) -> IngestOptions:
    """The options that the command's arguments set."""
    return IngestOptions(
        format=arguments.format,
        mesh=arguments.mesh,
        up_axis=arguments.up_axis,
        scale=arguments.scale,
        hold_back=arguments.hold_back,
        clamp_negative=arguments.clamp_negative,
        align_mesh=arguments.align_mesh,
        plane_room=arguments.plane_room,
        dense_stereo=arguments.dense_stereo,
        most_views=arguments.views,
        fusion=FusionOptions(arguments.voxel, arguments.close_holes, arguments.triangles),
        read=ReadOptions(
            arguments.images, arguments.undo_applied_transform, arguments.depth_unit, arguments.own_paths
        ),
    )


def check_options(options: IngestOptions) -> None:
    """Refuse impossible values.

    Raises:
        FiptError: ``setting-invalid``.
    """
    if options.hold_back < 0 or options.hold_back == 1:
        raise FiptError(
            "setting-invalid",
            f"Every Nth view can't be held back with N = {options.hold_back}.",
            "Set it to 0 (none) or to at least 2.",
        )
    if options.most_views < 0 or not 0.0 < options.read.depth_unit <= 1.0:
        raise FiptError(
            "setting-invalid",
            f"{options.most_views} views or depth units of {options.read.depth_unit:g} m are impossible.",
            "Set a number of photographs of at least 0, and a unit above 0 and up to 1 m.",
        )
    low, high = SCALES
    if not low <= options.scale <= high:
        raise FiptError(
            "setting-invalid",
            f"A unit of {options.scale:g} m is impossible.",
            f"Set a scale from {low:g} to {high:g} meters per unit.",
        )
    options.fusion.check()
