"""Step `scale`: writes sparse/0 with Z up, the floor near zero and, where a length is known, in metres.

A length comes from two picked points, from a printed marker, or from the transform to a mesh. Poses are
camera-to-world with OpenCV axes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pycolmap
from PIL import Image

from ..core import conventions
from ..core.alignment.turns import rotation_between
from ..core.capture.upright import common_up
from ..core.run.errors import FiptError
from ..core.run.extras import optional
from ..core.run.kinds import as_matrix
from ..core.run.messages import Reporter
from .facts import ScaleFacts
from .preparation import Preparation, PreparationFolder
from .solve_step import poses, read_model, write_model
from .solving import copy_name

FLOOR_PERCENTILE = 2.0  # of the heights of points; below the floor are only wrong points
LEAST_ANGLE = np.radians(1.0)  # between rays; below, a position along them is not determined
MOST_ERROR = np.radians(1.0)  # of a ray; those that pass farther from a point are of something else
_PICK_SHARE = 0.08  # of the image's diagonal within which a solved point gives the depth of a picked pixel
MARKER_TOLERANCE = 0.03  # relative disagreement of a marker's edges above which the scale is doubtful
DICTIONARIES = tuple(f"{bits}X{bits}_{count}" for bits in (4, 5, 6, 7) for count in (50, 100, 250, 1000)) + (
    "ARUCO_ORIGINAL",
)


@dataclass(frozen=True)
class Pick:
    """A position that the user has picked in a view, in pixels."""

    view: str
    x: float
    y: float


def key(folder: PreparationFolder, preparation: Preparation) -> Any:
    """What the frame depends on besides the cameras."""
    used = {
        "points": ("scale_length", "scale_picks"),
        "marker": ("scale_length", "marker_dictionary"),
        "mesh": ("scale_matrix",),
    }
    settings = preparation.settings
    return [settings.scale, *(getattr(settings, name) for name in used.get(settings.scale, ()))]


def run(folder: PreparationFolder, preparation: Preparation, reporter: Reporter) -> ScaleFacts:
    """Write sparse/0 in the room's frame; returns facts for the report."""
    model, settings = read_model(folder.model), preparation.settings
    unit, doubt = 1.0, None
    if settings.scale in ("points", "marker"):
        if not (np.isfinite(settings.scale_length) and settings.scale_length > 0.0):
            raise FiptError("scale-length", scale_length=settings.scale_length)
        if settings.scale == "points":
            length = _picked_length(model, settings.scale_picks)
        else:
            length, difference = _marker_length(folder, model, settings.marker_dictionary, reporter)
            doubt = round(difference, 4)
        unit = settings.scale_length / length
    if settings.scale == "mesh":
        frame = parse_similarity(settings.scale_matrix)
        unit = float(np.cbrt(np.linalg.det(frame[:3, :3])))
    else:
        points = np.array([point.xyz for point in model.points3D.values()]).reshape(-1, 3)
        frame = room_frame(poses(model), points, unit)
    if settings.scale == "none":
        reporter.warning("scale-unknown")
    model.transform(pycolmap.Sim3d(frame[:3]))
    write_model(folder.sparse, model)
    known = None if settings.scale == "none" else unit
    return ScaleFacts(settings.scale, known, as_matrix(frame), doubt)


def room_frame(poses: np.ndarray, points: np.ndarray, meters_per_unit: float) -> np.ndarray:
    """The similarity (4, 4) from the solve's frame to the room's: Z up, metres, floor at zero.

    The origin is below the middle of the cameras.

    Args:
        poses: (V, 4, 4) in the solve's frame.
        points: (P, 3) solved points; may be empty.
        meters_per_unit: length of the solve's unit.
    """
    similarity = np.eye(4)
    similarity[:3, :3] = meters_per_unit * rotation_between(common_up(poses).up, np.array([0.0, 0.0, 1.0]))
    centers = conventions.transform_points(similarity, poses[:, :3, 3])
    heights = conventions.transform_points(similarity, points)[:, 2] if len(points) else centers[:, 2]
    floor = float(np.percentile(heights, FLOOR_PERCENTILE))
    similarity[:3, 3] = [-centers[:, 0].mean(), -centers[:, 1].mean(), -floor]
    return similarity


def triangulated(images: Sequence[pycolmap.Image], pixels: np.ndarray) -> np.ndarray | None:
    """The point (3,) that placed views see at pixels (N, 2); views that see something else are dropped.

    Returns:
        None where the rays are nearly parallel or do not meet, or there is only one.
    """
    if len(images) < 2:
        return None
    options = pycolmap.EstimateTriangulationOptions()
    options.residual_type = pycolmap.TriangulationResidualType.ANGULAR_ERROR
    options.min_tri_angle = LEAST_ANGLE
    options.ransac.max_error = MOST_ERROR
    options.ransac.random_seed = 0
    places, cameras = [image.cam_from_world() for image in images], [image.camera for image in images]
    found = pycolmap.estimate_triangulation(pixels, places, cameras, options)
    return None if found is None else np.asarray(found["xyz"])


def parse_picks(text: str) -> tuple[list[Pick], list[Pick]]:
    """Two points from a text such as ``"desk-1 812 440, desk-2 790 431; desk-1 102 455"``."""
    points = [
        [_pick(part) for part in point.split(",") if part.strip()]
        for point in text.split(";")
        if point.strip()
    ]
    if len(points) != 2 or not all(points):
        raise FiptError("scale-picks.parse-picks", text=text)
    return points[0], points[1]


def _pick(text: str) -> Pick:
    words = text.strip().rsplit(maxsplit=2)
    try:
        pick = Pick(words[0], float(words[1]), float(words[2]))
    except (IndexError, ValueError):
        raise FiptError("scale-picks.pick-2", text=text.strip()) from None
    if not np.isfinite([pick.x, pick.y]).all():
        raise FiptError("scale-picks.pick", text=text.strip())
    return pick


def parse_similarity(text: str) -> np.ndarray:
    """A similarity (4, 4) from 12 or 16 numbers, row by row, without reflection."""
    try:
        values = np.array([float(word) for word in text.replace(",", " ").split()])
    except ValueError:
        values = np.empty(0)
    if values.size in (12, 16) and np.isfinite(values).all():
        matrix = np.eye(4)
        matrix[:3] = values[:12].reshape(3, 4)
        linear = matrix[:3, :3]
        scale = np.cbrt(np.linalg.det(linear))
        even = scale > 0.0 and np.abs(linear.T @ linear / scale**2 - np.eye(3)).max() < 1e-3
        if even and (values.size == 12 or np.allclose(values[12:], [0.0, 0.0, 0.0, 1.0])):
            return matrix
    raise FiptError("scale-matrix")


def _picked_length(model: pycolmap.Reconstruction, text: str) -> float:
    """The distance of the two picked points in the solve's unit."""
    first, second = (_picked_point(model, picks) for picks in parse_picks(text))
    length = float(np.linalg.norm(first - second))
    if length == 0.0:
        raise FiptError("scale-point.pick-scale-points")
    return length


def _picked_point(model: pycolmap.Reconstruction, picks: list[Pick]) -> np.ndarray:
    """A picked point (3,): where rays of several views meet, or at the depth of solved points near it."""
    images = []
    for pick in picks:
        image = model.find_image_with_name(f"{pick.view}.exr")
        if image is None or not image.has_pose:
            raise FiptError("scale-view.picked-point", view=pick.view)
        images.append(image)
    place = triangulated(images, np.array([[pick.x, pick.y] for pick in picks]))
    return _at_depth(model, images[0], picks[0]) if place is None else place


def _at_depth(model: pycolmap.Reconstruction, image: pycolmap.Image, pick: Pick) -> np.ndarray:
    """The point (3,) at a picked pixel whose depth is the median of the nearest solved points'."""
    seen = [point for point in image.points2D if point.has_point3D()]
    distances = np.array([np.linalg.norm(point.xy - [pick.x, pick.y]) for point in seen])
    reach = _PICK_SHARE * np.hypot(image.camera.width, image.camera.height)
    near = [seen[index] for index in np.argsort(distances)[:5] if distances[index] <= reach]
    if not near:
        raise FiptError("scale-point.at-depth", x=pick.x, y=pick.y, view=pick.view)
    pose = image.cam_from_world()
    depth = np.median([(pose * model.points3D[point.point3D_id].xyz)[2] for point in near])
    ray = np.asarray(image.camera.cam_ray_from_img(np.array([[pick.x, pick.y]])))[0]
    return np.asarray(pose.inverse() * (ray / ray[2] * depth))


def _marker_length(
    folder: PreparationFolder, model: pycolmap.Reconstruction, dictionary: str, reporter: Reporter
) -> tuple[float, float]:
    """The marker's edge in the solve's unit, and the relative disagreement of its estimates."""
    find = marker_finder(dictionary)
    seen: dict[int, list[tuple[pycolmap.Image, np.ndarray]]] = {}
    placed = sorted((model.images[index] for index in model.reg_image_ids()), key=lambda image: image.name)
    for index, image in enumerate(placed):
        copy = folder.solve / "copies" / copy_name(image.name.removesuffix(".exr"))
        picture = np.asarray(Image.open(copy, formats=["JPEG"]).convert("L"))
        for number, corners in find(picture).items():
            seen.setdefault(number, []).append((image, corners))
        reporter.progress((index + 1) / len(placed))
    squares = []
    for found in seen.values():
        images, four = [image for image, _ in found], np.array([corners for _, corners in found])
        places = [triangulated(images, four[:, corner]) for corner in range(4)]
        if all(place is not None for place in places):
            squares.append(marker_edge(np.array(places)))
    if not squares:
        raise FiptError("marker-missing", dictionary=dictionary, number_of_seen=len(seen))
    edges, differences = np.array(squares).T
    length = float(np.median(edges))
    difference = float(max(np.abs(edges / length - 1.0).max(), differences.max()))
    if difference > MARKER_TOLERANCE:
        reporter.warning("marker-inaccurate", difference=100.0 * difference)
    return length, difference


def marker_edge(corners: np.ndarray) -> tuple[float, float]:
    """Edge length of a square from its four corners, and by how much its sides and diagonals disagree.

    Args:
        corners: (4, 3) in order around the square.

    Returns:
        The mean edge, and the standard deviation of the six estimates of it over the mean.
    """
    sides = np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)
    diagonals = np.linalg.norm(corners[:2] - corners[2:], axis=1) / np.sqrt(2.0)
    estimates = np.concatenate([sides, diagonals])
    mean = float(estimates.mean())
    return mean, float(estimates.std() / mean) if mean > 0.0 else float("inf")


def marker_finder(dictionary: str) -> Callable[[np.ndarray], dict[int, np.ndarray]]:
    """What finds the markers of one dictionary in eight-bit pictures (height, width).

    It returns the corners (4, 2) in pixels of each marker by its number; a number seen twice is left out.
    """
    if dictionary not in DICTIONARIES:
        raise FiptError("marker-dictionary", dictionary=dictionary, dictionaries=", ".join(DICTIONARIES))
    cv2 = optional("markers", "A printed marker")
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{dictionary}"))
    detector = cv2.aruco.ArucoDetector(known, parameters)

    def find(picture: np.ndarray) -> dict[int, np.ndarray]:
        corners, numbers, _ = detector.detectMarkers(picture)
        flat = [] if numbers is None else numbers.ravel().tolist()
        # OpenCV counts from the center of the first pixel.
        found = {number: four.reshape(4, 2) + 0.5 for number, four in zip(flat, corners, strict=True)}
        return {number: four for number, four in found.items() if flat.count(number) == 1}

    return find
