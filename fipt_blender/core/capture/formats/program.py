# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What formats have in common whose cameras are in one file of a program that solves them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..options import CaptureOptions
from ..places import MESH_STEMS, Places
from ..rig import Note, Rig, RigView, WellFormed
from .rig_files import camera_file, largest_model

# The views of each model that the solver could not connect with the others, and warnings.
Models = tuple[Sequence[Sequence[RigView]], tuple[Note, ...]]


@dataclass(frozen=True)
class Program:
    """A format of `registry`.

    Attributes:
        NAME, LOOKS_FOR: see `registry`.
        suffixes: of the camera file.
        known: whether a file is one by the text of its beginning.
        models: reads it, given where its photographs are.
        points: reads its sparse points (N, 3); None where it has none.
        folders: of a capture, in which the program writes it.
        up: the axis that points up; None where the program does not define it.
        meshes: names and folders of the program's meshes.
    """

    NAME: str
    LOOKS_FOR: str
    suffixes: tuple[str, ...]
    known: Callable[[str], bool]
    models: Callable[[Path, Places], Models]
    points: Callable[[Path], np.ndarray] | None = None
    folders: tuple[str, ...] = (".",)
    up: str | None = None
    meshes: tuple[tuple[str, ...], tuple[str, ...]] = (MESH_STEMS, (".",))

    def find(self, path: Path) -> Path | None:
        """The camera file at a path or in a folder, None without one."""
        return camera_file(path, self.suffixes, self.known, self.folders)

    def places(self, file: Path, options: CaptureOptions) -> Places:
        """Where the photographs and meshes of a camera file are."""
        return Places.around(file, options, folders=self.folders)

    def read(self, file: Path, options: CaptureOptions) -> Rig:
        """Read the views with a pose of the largest model.

        Raises:
            FiptError: ``rig-damaged`` or one of the reader's.
        """
        places = self.places(file, options)
        with WellFormed(file):
            models, notes = self.models(file, places)
        views, several = largest_model(models, str(file))
        return places.rig(self.NAME, views, self.up, places.mesh(*self.meshes), (*several, *notes))
