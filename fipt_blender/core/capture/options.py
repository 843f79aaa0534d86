# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How a capture is read: the options of the engine's `ingest` and of the command line's `estimate`.

Needs the standard library and numpy alone, since Blender's side imports it.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from ..conventions import UP_AXES
from ..run.errors import FiptError
from ..run.shapes import SCALES

FORMATS = (
    *("fipt-synthetic", "fipt-real", "scannetpp", "transforms", "colmap", "metashape", "blocksexchange"),
    *("realityscan", "meshroom", "opensfm", "openmvg", "bundler", "nvm", "polycam", "record3d"),
    *("3d-scanner-app", "stray-scanner", "rgbd"),
)
VOXELS = (0.002, 1.0)  # metres
LEAST_TRIANGLES = 100  # of a budget; fewer are no room


# What each field of `CaptureOptions` means.
TEXTS = {
    "mesh": "the room's mesh (default: the one beside the cameras)",
    "format": "layout of the capture (default: auto)",
    "up_axis": "up axis of the capture; --up-axis=-y for -y",
    "scale": "meters per unit of the capture (default: 1)",
    "hold_back": "hold back every N-th view where the capture holds back none; 0 for none (default: 8)",
    "images": "folder of the photographs, searched first",
    "layer": "layer or part of EXR photographs that have several",
    "clamp_negative": "treat negative radiance in photographs as zero",
    "align_mesh": "align the cameras to a mesh from another program by the solve's points",
    "panorama": (
        "an equirectangular panorama that the cameras lack, upright, at --panorama-place; black pixels of the"
        " image of its name in the folder masks beside it are left out"
    ),
    "panorama_place": "where it was taken: meters in the imported scene, Z up; =-1,0,1.5 if X is negative",
    "panorama_heading": "degrees by which its centre is turned from Y to the left (default: 0)",
    "views": "use N photographs, evenly spread (default: all)",
    "voxel": "meters, of a mesh fused from depth images; 0 to follow their pixels (default: 0)",
    "triangles": "simplify a mesh with more triangles to about N; 0 for none",
    "mesh_from_photographs": (
        "without a mesh and depth images, make a rough mesh of the photographs alone; takes seconds for each"
    ),
    "depth_unit": "unit of 16-bit depth images in meters (default: 0.001)",
    "own_paths": "transforms.json: its paths may lead anywhere; only for files that you wrote yourself",
    "undo_applied_transform": (
        "transforms.json: the mesh has the coordinates from before nerfstudio's applied_transform"
    ),
}
_CHOICES = {"format": ("auto", *FORMATS), "up_axis": ("auto", *UP_AXES)}
# Of the fields' types: what reads an argument, and its name in the help.
_TYPES: dict[str, tuple[Callable[[str], Any], str | None]] = {
    "Path | None": (Path, "PATH"),
    "int": (int, "N"),
    "float": (float, "N"),
    "str": (str, None),
    "tuple[float, ...]": (lambda text: tuple(map(float, text.split(","))), "X,Y,Z"),
}


@dataclass(frozen=True)
class FusionOptions:
    """How depth images are fused; see `CaptureOptions`."""

    voxel: float = 0.0
    triangles: int = 0


@dataclass(frozen=True, kw_only=True)
class CaptureOptions:
    """How a capture is read; `TEXTS` says what the fields mean. Lengths are in metres.

    `up_axis` "auto" is that of the format, else what `upright.find_upright` finds.
    """

    mesh: Path | None = None
    format: str = "auto"
    up_axis: str = "auto"
    scale: float = 1.0
    hold_back: int = 8
    images: Path | None = None
    layer: str = ""
    clamp_negative: bool = False
    align_mesh: bool = False
    panorama: Path | None = None
    panorama_place: tuple[float, ...] = (0.0, 0.0, 1.5)
    panorama_heading: float = 0.0
    views: int = 0
    voxel: float = 0.0
    triangles: int = 0
    mesh_from_photographs: bool = False
    depth_unit: float = 0.001
    own_paths: bool = False
    undo_applied_transform: bool = False

    @property
    def fusion(self) -> FusionOptions:
        """Those of depth images."""
        return FusionOptions(self.voxel, self.triangles)

    def check(self) -> None:
        """Refuse impossible values.

        Raises:
            FiptError: ``setting-invalid``.
        """
        (low, high), (finest, coarsest) = SCALES, VOXELS
        checks = (
            (
                self.hold_back >= 0 and self.hold_back != 1,
                f"Every Nth view can't be held back with N = {self.hold_back}.",
                "Set it to 0 (none) or to at least 2.",
            ),
            (
                self.views >= 0 and 0.0 < self.depth_unit <= 1.0,
                f"{self.views} views or depth units of {self.depth_unit:g} m are impossible.",
                "Set a number of photographs of at least 0, and a unit above 0 and up to 1 m.",
            ),
            (
                low <= self.scale <= high,
                f"A unit of {self.scale:g} m is impossible.",
                f"Set a scale from {low:g} to {high:g} meters per unit.",
            ),
            (
                len(self.panorama_place) == 3
                and all(map(math.isfinite, (*self.panorama_place, self.panorama_heading))),
                f"A panorama can't be placed at {self.panorama_place}.",
                "Give three coordinates in meters: --panorama-place=X,Y,Z.",
            ),
            (
                self.voxel == 0.0 or finest <= self.voxel <= coarsest,
                f"Voxels of {self.voxel:g} m are impossible.",
                f"Set voxels from {finest:g} to {coarsest:g} meters, or 0 to follow the depth images.",
            ),
            (
                self.triangles == 0 or self.triangles >= LEAST_TRIANGLES,
                f"A room can't have {self.triangles} triangles.",
                f"Set at least {LEAST_TRIANGLES} triangles, or 0 to keep all.",
            ),
        )
        for holds, text, remedy in checks:
            if not holds:
                raise FiptError("setting-invalid", text, remedy)

    def arguments(self) -> list[str]:
        """Arguments of `ingest`, each one word: a separate "-y" would be taken for an option."""
        words = []
        for option in fields(CaptureOptions):
            value = getattr(self, option.name)
            if value != option.default:
                value = value.absolute() if isinstance(value, Path) else value
                value = ",".join(map(str, value)) if isinstance(value, tuple) else value
                words.append(_flag(option.name) if value is True else f"{_flag(option.name)}={value}")
        return words


def add_options(parser: argparse.ArgumentParser, without: Collection[str] = ()) -> None:
    """Arguments for all options but those `without`, which keep their defaults."""
    for option in fields(CaptureOptions):
        name, text = option.name, TEXTS[option.name]
        if name in without:
            parser.set_defaults(**{name: option.default})
        elif option.type == "bool":
            parser.add_argument(_flag(name), action="store_true", help=text)
        else:
            kind, value = _TYPES[str(option.type)]
            shown: dict[str, Any] = {"metavar": value, "choices": _CHOICES.get(name), "help": text}
            parser.add_argument(_flag(name), type=kind, default=option.default, **shown)


def options_of(arguments: argparse.Namespace) -> dict[str, Any]:
    """The fields of `CaptureOptions` that parsed arguments set."""
    return {option.name: getattr(arguments, option.name) for option in fields(CaptureOptions)}


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"
