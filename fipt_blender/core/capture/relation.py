# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras and mesh of a capture belong together, near the origin: one check for all formats.

What cameras see of a mesh tells whether it is where they are. Files that programs write beside a mesh of
other coordinates are followed where it fits with them. Far coordinates are moved by one offset, cameras and
mesh alike, in double precision: single precision has steps of half a metre at northings of maps.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from ..alignment.surface import sample_surface
from ..alignment.turns import turn_by
from ..conventions import transform_points, transform_poses
from ..run.documents import decoded, load_document, read_limited
from ..run.errors import FiptError, Problem, problem
from .distortion import lens_pinhole
from .mesh_file import read_mesh
from .panorama import pinhole_views
from .rig import DepthView, Rig, RigView

FAR = 1000.0  # distance from the origin, in units and in the cameras' spread, beyond which all is moved
SAMPLES, VIEWS, CELLS = 20_000, 60, 8  # points of the mesh; photographs; cells along each side of an image
# Share of the images that shows the mesh: below the first, the mesh is elsewhere; above the second, and with
# so many of the cameras within its box, it fits. A box is taken larger by a share of its size.
LEAST_SEEN, FITTING_SEEN, FITTING_INSIDE, LARGER = 0.1, 0.5, 0.9, 0.05
INSIDE = 0.6  # share of the cameras in the mesh's box, below which a placement with all inside is named
# Cameras' spread over the mesh's diagonal: in rooms it is larger than the first. Below the second, the mesh
# may have another unit; below the third, all cameras are at one place.
USUAL_PATH, SMALL_PATH, ONE_PLACE = 1.0 / 30.0, 1.0 / 150.0, 1e-4
# Degrees of longitude and latitude: spread of cameras in a room, and by how much smaller than their heights'.
DEGREES, DEGREES_PER_METRE = 1e-3, 1.0 / 500.0
# Points of the solve, where it has so many: those within this share of the mesh's diagonal lie on it. Of a
# real room 92 % did, of the same mesh turned, recentred or in feet 24 % at most.
ENOUGH_POINTS, MOST_POINTS, NEAR, ON_MESH, CURED = 100, 2000, 0.02, 0.4, 0.6
UNITS = (0.001, 0.01, 0.0254, 0.3048, 1.0, 1.0 / 0.3048, 1.0 / 0.0254, 100.0, 1000.0)  # that a mesh may need
PLAIN_UNITS = (0.001, 0.01, 1.0, 100.0, 1000.0)  # without points, by which others could not be told apart
BETTER = 0.1  # what a file beside the mesh must improve the sum of both shares by
MOST_SIDE_BYTES = 100_000  # of a file beside a mesh
_UNIT = re.compile(r'UNIT\s*\[\s*"([^"]*)"\s*,\s*([0-9.eE+-]+)')
_TOGETHER = "export cameras and mesh again, both from one program and in one local coordinate system"


@dataclass(frozen=True)
class _Dataparser:
    """dataparser_transforms.json of nerfstudio: x_mesh = scale * (transform @ x_cameras)."""

    transform: list
    scale: float


@dataclass(frozen=True, eq=False)
class Related:
    """Cameras and mesh in the coordinates that are used from here on.

    Attributes:
        rig: its cameras and depth images.
        vertices: (V, 3) float64 of the mesh, or None without a mesh that can be read here.
        triangles: (T, 3) of the mesh.
        moved: whether the vertices are no longer those of the file.
        offset: (3,) what must be added for the source's coordinates.
        fits: False where a note says that cameras and mesh do not belong together.
    """

    rig: Rig
    vertices: np.ndarray | None
    triangles: np.ndarray
    moved: bool
    offset: np.ndarray
    fits: bool


def relate(capture: Path, rig: Rig, mesh: Path | None, solved: np.ndarray) -> Related:
    """Relate the cameras of a capture to its mesh, and move both to the origin.

    Args:
        capture: folder or camera file.
        mesh: in whatever coordinates.
        solved: (N, 3) points of the solve in the coordinates of the cameras.

    Raises:
        FiptError: ``pose-unsupported`` for positions in degrees; ``mesh-unreadable``.
    """
    places = np.array([view.camera_to_world[:3, 3] for view in rig.views]).reshape(-1, 3)
    usable = len(places) > 0 and all(np.isfinite(view.camera_to_world).all() for view in rig.views)
    folders = [capture if capture.is_dir() else capture.parent, *([mesh.parent] if mesh else [])]
    folders = list(dict.fromkeys(folders))
    notes = _coordinate_notes(places, folders) if usable else []
    vertices, triangles, place = None, np.zeros((0, 3), np.int64), np.eye(4)
    if mesh is not None:
        try:
            vertices, triangles = read_mesh(mesh)
        except FiptError:
            if mesh.suffix.lower() in (".ply", ".obj"):  # of others, Blender's importers read more
                raise
    fits = True
    if usable and vertices is not None and len(triangles):
        points = vertices
        with suppress(FiptError):  # a mesh without area
            points = sample_surface(vertices, triangles, np.random.default_rng(0), SAMPLES).points
        cameras = _Cameras(rig, points, solved)
        place, more = _placed(cameras, folders)
        judged = _judged(mesh, cameras, place)
        fits = not judged
        notes += more + judged
    offset = _offset(places) if usable else np.zeros(3)
    if offset.any():
        shown = ", ".join(f"{value:.0f}" for value in offset)
        notes.append(problem("georeferenced", shown=shown))
    shift = np.eye(4)
    shift[:3, 3] = -offset
    place = shift @ place
    moved = vertices is not None and not np.array_equal(place, np.eye(4))
    if vertices is not None and moved:
        vertices = transform_points(place, vertices)
    return Related(
        replace(_moved(rig, shift), notes=(*rig.notes, *notes)), vertices, triangles, moved, offset, fits
    )


def _moved(rig: Rig, shift: np.ndarray) -> Rig:
    """The rig in other coordinates."""
    if np.array_equal(shift, np.eye(4)):
        return rig

    def view(each: RigView) -> RigView:
        return replace(each, camera_to_world=transform_poses(shift, each.camera_to_world))

    def depth(each: DepthView) -> DepthView:
        pose = transform_poses(shift, each.camera_to_world)
        return replace(each, camera_to_world=pose, photograph=each.photograph and view(each.photograph))

    return replace(rig, views=tuple(map(view, rig.views)), depths=tuple(map(depth, rig.depths)))


def _offset(places: np.ndarray) -> np.ndarray:
    """Whole units (3,) from the origin to cameras (V, 3) that are far from it, else zeros."""
    middle = np.median(places, axis=0)
    far = float(np.abs(middle).max()) > FAR * max(float(np.ptp(places, axis=0).max()), 1.0)
    return np.round(middle) if far else np.zeros(3)


def _coordinate_notes(places: np.ndarray, folders: Sequence[Path]) -> list[Problem]:
    """What the cameras' positions (V, 3) and the files of map programs tell of the coordinates.

    Raises:
        FiptError: ``pose-unsupported``.
    """
    texts = [text for folder in folders for file in sorted(folder.glob("*.prj")) if (text := _text(file))]
    flat, high = float(np.ptp(places[:, :2], axis=0).max()), float(np.ptp(places[:, 2]))
    small = (np.abs(places[:, :2]) <= (180.0, 90.0)).all()
    measured = 0.0 < flat <= min(DEGREES, DEGREES_PER_METRE * high)
    if small and (measured or (0.0 < flat <= DEGREES and any("GEOGCS" in text[:20] for text in texts))):
        raise FiptError("pose-unsupported.coordinate-notes")
    for text in texts:
        units = _UNIT.findall(text)  # the last one is that of the projected coordinates
        if text.lstrip().startswith("PROJ") and units and abs(float(units[-1][1]) - 1.0) > 1e-6:
            return [problem("mesh-unit", units=units[-1][0], units_2=units[-1][1])]
    return []


def _text(file: Path) -> str:
    with suppress(OSError, ValueError):
        return decoded(read_limited(file, MOST_SIDE_BYTES))
    return ""


class _Cameras:
    """Some of a rig's cameras, and points (N, 3) of a mesh that they may see.

    Attributes:
        places: (V, 3) of all cameras.
        points: of the mesh as its file has it.
    """

    def __init__(self, rig: Rig, points: np.ndarray, solved: np.ndarray) -> None:
        views = [face for view in rig.views[:: -(-len(rig.views) // VIEWS)] for face in pinhole_views(view)]
        self._views = [(view, lens_pinhole(view.lens, view.width, view.height)) for view in views]
        self.places = np.array([view.camera_to_world[:3, 3] for view in rig.views])
        self.points = points
        self.solved = solved[:: -(-len(solved) // MOST_POINTS)] if len(solved) >= ENOUGH_POINTS else None
        self._tree = cKDTree(points)

    def on_mesh(self, place: np.ndarray) -> float:
        """Share of the solve's points on the mesh after a similarity (4, 4)."""
        assert self.solved is not None, "asked only where there are points"
        near = NEAR * float(np.linalg.norm(np.ptp(self.points, axis=0)))
        distances = self._tree.query(transform_points(np.linalg.inv(place), self.solved))[0]
        return float((np.asarray(distances) < near).mean())

    def fit(self, place: np.ndarray) -> tuple[float, float]:
        """Share of the images that shows the mesh after a similarity (4, 4), of cameras within its box."""
        points = transform_points(place, self.points)
        shown = []
        for view, pinhole in self._views:
            local = (points - view.camera_to_world[:3, 3]) @ view.camera_to_world[:3, :3]
            x, y, z = local[local[:, 2] > 0.0].T
            column = np.floor((pinhole.fx * x / z + pinhole.cx) / pinhole.width * CELLS)
            row = np.floor((pinhole.fy * y / z + pinhole.cy) / pinhole.height * CELLS)
            inside = (column >= 0) & (column < CELLS) & (row >= 0) & (row < CELLS)
            shown.append(len(np.unique(row[inside] * CELLS + column[inside])) / CELLS**2)
        low, high = points.min(axis=0), points.max(axis=0)
        low, high = low - LARGER * (high - low), high + LARGER * (high - low)
        within = ((self.places >= low) & (self.places <= high)).all(axis=1)
        return float(np.mean(shown)), float(within.mean())

    def size(self, place: np.ndarray) -> tuple[float, float]:
        """Spread of the cameras, and diagonal of the mesh's box after a similarity."""
        points = transform_points(place, self.points)
        return float(np.linalg.norm(np.ptp(self.places, axis=0))), float(
            np.linalg.norm(np.ptp(points, axis=0))
        )

    def fits(self, place: np.ndarray) -> bool:
        """Whether the mesh has the solve's points, or is a room around the cameras, after a similarity."""
        if self.solved is not None:
            return self.on_mesh(place) >= CURED
        seen, inside = self.fit(place)
        path, diagonal = self.size(place)
        return seen >= FITTING_SEEN and inside >= FITTING_INSIDE and path >= USUAL_PATH * diagonal


def _placed(cameras: _Cameras, folders: Sequence[Path]) -> tuple[np.ndarray, list[Problem]]:
    """The similarity (4, 4) from the mesh's file to the cameras, as files beside them tell and it fits."""
    best, note = np.eye(4), []
    score = sum(cameras.fit(best)) + BETTER
    for file in (file for folder in folders for file in sorted(folder.iterdir())):
        place = _side_placement(file)
        if place is not None and sum(cameras.fit(place)) > score:
            best, score = place, sum(cameras.fit(place))
            note = [problem("mesh-moved", file=file)]
    return best, note


def _side_placement(file: Path) -> np.ndarray | None:
    """The similarity (4, 4) from a mesh to cameras that a file beside them tells; None of any other file."""
    place = np.eye(4)
    with suppress(OSError, ValueError, TypeError, np.linalg.LinAlgError):
        if file.name == "dataparser_transforms.json":
            data = load_document(file, _Dataparser)
            place[:3] = data.scale * np.array(data.transform, np.float64)[:3]
            return np.linalg.inv(place)
        if file.name.lower().endswith("offset.xyz"):
            place[:3, 3] = [float(word) for word in _text(file).replace(",", " ").split()]
            return place
    return None


def _judged(mesh: Path | None, cameras: _Cameras, place: np.ndarray) -> list[Problem]:
    """A warning where cameras and mesh do not belong together, with a remedy that was tried, if one fits."""
    seen, inside = cameras.fit(place)
    path, diagonal = cameras.size(place)
    elsewhere, other_unit = seen < LEAST_SEEN, path < SMALL_PATH * diagonal
    beside = ""
    if cameras.solved is not None:
        on_mesh = cameras.on_mesh(place)
        elsewhere, other_unit = on_mesh < ON_MESH, False
        beside = f", {100.0 * on_mesh:.0f} % of the solve's points lie on it"
    if not elsewhere and len(cameras.places) > 2 and path < ONE_PLACE * diagonal:
        text = f"All {len(cameras.places)} cameras are at one place: nothing is seen from two sides."
        remedy = "Check that the camera file has positions. Photographs from one tripod do not suffice."
        return [Problem("cameras-one-place", text, remedy)]
    doubtful = cameras.solved is None and (other_unit or inside < INSIDE)
    if cameras.fits(place) or not (elsewhere or doubtful):
        return []
    cures = _cures(cameras)
    if not elsewhere and len(cures) != 1:
        return []
    text = (
        f"Cameras and mesh do not belong together: the photographs would show {mesh} in {100.0 * seen:.0f} %"
        f" of their pixels{beside}, {100.0 * inside:.0f} % of the cameras are within its box of"
        f" {diagonal:.3g} units, and their middle is {_distance(cameras, place):.3g} units from its middle."
    )
    if len(cures) == 1:
        remedy = f"The mesh fits around the cameras if it is {cures[0]}: export it like this."
    else:
        remedy = f"Choose the cameras' own mesh, {_TOGETHER}, or align them (Capture > Alignment)."
    return [Problem("mesh-elsewhere", text, remedy)]


def _cures(cameras: _Cameras) -> list[str]:
    """What exporters do with meshes that makes this one fit; one at most where there are points.

    Otherwise it is another unit, the tightest, or else a turn between Y and Z up, of which both may fit.
    """
    if cameras.solved is not None:
        moves = product(range(3), (0, 90, 180, 270), UNITS)
        words, best = max((_place(*move) for move in moves), key=lambda each: cameras.on_mesh(each[1]))
        return [words] if cameras.fits(best) else []
    for turns in ((0,), (90, 270)):
        places = [[_place(0, turn, unit) for unit in PLAIN_UNITS] for turn in turns]
        fitting = [[words for words, place in several if cameras.fits(place)] for several in places]
        if any(fitting):
            return [several[0] for several in fitting if several]
    return []


def _place(axis: int, turn: int, unit: float) -> tuple[str, np.ndarray]:
    """The similarity (4, 4) of a turn in degrees about an axis and of a unit, and what it is called."""
    place = np.eye(4)
    place[:3, :3] = unit * turn_by(np.radians(turn) * np.eye(3)[axis])
    turned = f"turned by {turn} degrees about {'XYZ'[axis]}" if turn else ""
    return " and ".join(filter(None, (turned, "" if unit == 1.0 else f"scaled by {unit:.4g}"))), place


def _distance(cameras: _Cameras, place: np.ndarray) -> float:
    points = transform_points(place, cameras.points)
    return float(
        np.linalg.norm(cameras.places.mean(axis=0) - 0.5 * (points.min(axis=0) + points.max(axis=0)))
    )
