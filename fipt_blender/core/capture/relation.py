"""The coordinates of cameras and mesh: corrected as the user says, and near the origin.

Files that programs write beside a mesh of other coordinates are followed where it fits with them. Far
coordinates are moved by one offset, cameras and mesh alike, in double precision: single precision has steps
of half a metre at northings of maps. :mod:`.mistakes` judges whether both belong together.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..conventions import transform_points, transform_poses
from ..run.documents import decoded, load_document, read_limited
from ..run.errors import FiptError, Problem, problem
from .corrections import Correction, named
from .distortion import lens_pinhole
from .mesh_file import read_mesh
from .mistakes import Scene, Sight
from .options import CaptureOptions
from .panorama import pinhole_views
from .rig import DepthView, Pinhole, Rig, RigView

FAR = 1000.0  # distance from the origin, in units and in the cameras' spread, beyond which all is moved
ONE_PLACE = 1e-4  # cameras' spread over the mesh's diagonal, below which all are at one place
# Degrees of longitude and latitude: spread of cameras in a room, and by how much smaller than their heights'.
DEGREES, DEGREES_PER_METRE = 1e-3, 1.0 / 500.0
# Cameras are far from others at this many times the median distance from their middle; of so many or more.
ASTRAY, LEAST_PATH = 6.0, 8
BETTER = 0.1  # what a file beside the mesh must improve the sum of both shares by
MOST_SIDE_BYTES = 100_000  # of a file beside a mesh
_UNIT = re.compile(r'UNIT\s*\[\s*"([^"]*)"\s*,\s*([0-9.eE+-]+)')


@dataclass(frozen=True)
class _Dataparser:
    """dataparser_transforms.json of nerfstudio: x_mesh = scale * (transform @ x_cameras)."""

    transform: list
    scale: float


@dataclass(frozen=True, eq=False)
class Related:
    """Cameras and mesh in the coordinates that are used from here on."""

    rig: Rig  # its cameras and depth images
    vertices: np.ndarray | None  # (V, 3) float64 of the mesh, or None without a mesh that can be read here
    triangles: np.ndarray  # (T, 3) of the mesh
    moved: bool  # whether the vertices are no longer those of the file
    offset: np.ndarray  # (3,) what must be added for the source's coordinates
    solved: np.ndarray  # (N, 3) points of the solve in the cameras' coordinates, without the offset


def relate(
    capture: Path, rig: Rig, mesh: Path | None, solved: np.ndarray, options: CaptureOptions
) -> Related:
    """Relate the cameras of a capture to its mesh, and move both to the origin.

    Args:
        capture: folder or camera file.
        mesh: in whatever coordinates.
        solved: (N, 3) points of the solve in the coordinates of the cameras.
    """
    place = np.eye(4)
    for each in named(rig.source, options.correct):
        if each.poses is not None:
            rig = _posed(rig, each.poses)
        if each.mesh is not None:
            place = each.mesh @ place
    places = np.array([view.camera_to_world[:3, 3] for view in rig.views]).reshape(-1, 3)
    usable = len(places) > 0 and all(np.isfinite(view.camera_to_world).all() for view in rig.views)
    folders = [capture if capture.is_dir() else capture.parent, *([mesh.parent] if mesh else [])]
    folders = list(dict.fromkeys(folders))
    notes = _coordinate_notes(places, folders) if usable else []
    vertices, triangles = None, np.zeros((0, 3), np.int64)
    if mesh is not None:
        try:
            vertices, triangles = read_mesh(mesh)
        except FiptError as error:
            # Of others, Blender's importers may read more.
            if mesh.suffix.lower() in (".ply", ".obj") or error.code == "mesh-format":
                raise
    if usable and vertices is not None and len(triangles):
        if np.array_equal(place, np.eye(4)):
            place, more = _placed(rig, vertices, triangles, folders)
            notes += more
        notes += _one_place(places, transform_points(place, vertices))
    if usable:
        notes += _astray(rig.views, places, None if vertices is None else transform_points(place, vertices))
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
        if np.linalg.det(place[:3, :3]) < 0.0:  # of a mirrored mesh, fronts stay fronts
            triangles = triangles[:, ::-1]
    rig = _posed(rig, lambda poses: transform_poses(shift, poses)) if offset.any() else rig
    rig = replace(rig, notes=(*rig.notes, *notes))
    return Related(rig, vertices, triangles, moved, offset, solved - offset)


def _posed(rig: Rig, change: Callable[[np.ndarray], np.ndarray]) -> Rig:
    """The rig with other poses, by what makes them of poses (V, 4, 4)."""

    def posed(pose: np.ndarray) -> np.ndarray:
        usable = np.isfinite(pose).all() and np.linalg.det(pose) != 0.0  # others are refused later
        return change(pose[None])[0] if usable else pose

    def view(each: RigView) -> RigView:
        return replace(each, camera_to_world=posed(each.camera_to_world))

    def depth(each: DepthView) -> DepthView:
        pose = posed(each.camera_to_world)
        return replace(each, camera_to_world=pose, photograph=each.photograph and view(each.photograph))

    return replace(rig, views=tuple(map(view, rig.views)), depths=tuple(map(depth, rig.depths)))


def sight(pose: np.ndarray, pinhole: Pinhole, radiance: np.ndarray | None = None) -> Sight:
    """What `mistakes` needs of a photograph; see `Sight`."""
    width, height = pinhole.width, pinhole.height
    lens = pinhole.fx / width, pinhole.fy / height, pinhole.cx / width, pinhole.cy / height
    return Sight(pose, *lens, radiance)


def _one_place(places: np.ndarray, vertices: np.ndarray) -> list[Problem]:
    """A warning where all cameras (V, 3) are at one place in a mesh (N, 3)."""
    path, diagonal = (float(np.linalg.norm(np.ptp(each, axis=0))) for each in (places, vertices))
    told = len(places) > 2 and path < ONE_PLACE * diagonal
    return [problem("cameras-one-place", count=len(places))] if told else []


def _astray(views: Sequence[RigView], places: np.ndarray, vertices: np.ndarray | None) -> list[Problem]:
    """A warning of cameras (V, 3) far from all others, as at the end of a path where a solve runs away.

    Args:
        vertices: (N, 3) of the mesh, in whose box no camera is far; None without.
    """
    away = np.linalg.norm(places - np.median(places, axis=0), axis=1)
    usual = float(np.median(away))
    far = away > ASTRAY * usual
    if vertices is not None and len(vertices):
        far &= ~((places >= vertices.min(axis=0)) & (places <= vertices.max(axis=0))).all(axis=1)
    if not usual > 0.0 or not far.any() or len(places) < LEAST_PATH:
        return []
    gap = np.linalg.norm(places[far][:, None] - places[~far][None], axis=2).min()
    if gap <= usual:  # a long path leads there
        return []
    names = [view.name for view, is_far in zip(views, far, strict=True) if is_far]
    shown = ", ".join(names[:3]) + (f", ... {names[-1]}" if len(names) > 3 else "")
    return [problem("cameras-astray", count=len(names), views=len(views), shown=shown,
                    least=away[far].min() / usual, most=away[far].max() / usual)]  # fmt: skip


def _offset(places: np.ndarray) -> np.ndarray:
    """Whole units (3,) from the origin to cameras (V, 3) that are far from it, else zeros."""
    middle = np.median(places, axis=0)
    far = float(np.abs(middle).max()) > FAR * max(float(np.ptp(places, axis=0).max()), 1.0)
    return np.round(middle) if far else np.zeros(3)


def _coordinate_notes(places: np.ndarray, folders: Sequence[Path]) -> list[Problem]:
    """What the cameras' positions (V, 3) and the files of map programs tell of the coordinates."""
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


def _placed(
    rig: Rig, vertices: np.ndarray, triangles: np.ndarray, folders: Sequence[Path]
) -> tuple[np.ndarray, list[Problem]]:
    """The similarity (4, 4) from the mesh's file to the cameras, as files beside them tell and it fits."""
    found = [(file, place) for folder in folders for file in sorted(folder.iterdir())
             if (place := _side_placement(file)) is not None]  # fmt: skip
    if not found:
        return np.eye(4), []
    faces = (face for view in rig.views for face in pinhole_views(view))
    sights = [sight(face.camera_to_world, lens_pinhole(face.lens, face.width, face.height)) for face in faces]
    scene = Scene.of(sights, (vertices, triangles), np.zeros((0, 3)))
    assert scene is not None, "there is a mesh"
    best, note, score = np.eye(4), [], sum(scene.fit()[:2]) + BETTER
    for file, place in found:
        fit = scene.fit(Correction("", "", mesh=place))
        if sum(fit[:2]) > score:
            best, score, note = place, sum(fit[:2]), [problem("mesh-moved", file=file)]
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
