# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Step `scale`: writes sparse/0 in a frame with Z up and, where a length is known, in metres.

A length comes from two picked points, from a printed marker, or from the transform to a mesh.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pycolmap
from PIL import Image

from ..core.run.errors import FiptError
from ..core.run.extras import optional
from ..core.run.kinds import as_matrix
from ..core.run.messages import Reporter
from . import scale
from .facts import ScaleFacts
from .models import points, poses, rays, read_model, seen_points, transform_model, write_model
from .preparation import Preparation, PreparationFolder
from .solve_step import copy_file, model_folder

MARKER_TOLERANCE = 0.03  # relative disagreement of a marker's edges above which the scale is doubtful
_PICK_AGAIN = "Pick the point in other views, at a place with texture."


def key(folder: PreparationFolder, preparation: Preparation) -> Any:
    """What the frame depends on besides the cameras."""
    settings = preparation.settings
    chosen: dict[str, Any] = {"source": settings.scale}
    if settings.scale == "points":
        chosen |= {"length": settings.scale_length, "picks": settings.scale_picks}
    elif settings.scale == "marker":
        chosen |= {"length": settings.scale_length, "dictionary": settings.marker_dictionary}
    elif settings.scale == "mesh":
        chosen |= {"matrix": settings.scale_matrix}
    return chosen


def run(folder: PreparationFolder, preparation: Preparation, reporter: Reporter) -> ScaleFacts:
    """Write sparse/0 in the room's frame; returns facts for the report.

    Raises:
        FiptError: ``scale-length``, ``scale-picks``, ``scale-matrix``, ``scale-view``, ``scale-point``,
            ``marker-dictionary``, ``marker-missing``, ``package-optional``, and those of reading and writing.
    """
    model = read_model(model_folder(folder))
    settings = preparation.settings
    doubt = None
    if settings.scale == "mesh":
        frame = scale.parse_similarity(settings.scale_matrix)
        unit = float(np.cbrt(np.linalg.det(frame[:3, :3])))
    else:
        if settings.scale == "none":
            unit = 1.0
            reporter.warning(
                "scale-unknown",
                "The real size of the room is not known: lengths, and the power of lamps, are wrong.",
                "Give the distance of two points or the size of a printed marker, or align the cameras with "
                "a mesh in meters after the import.",
            )
        else:
            _check_length(settings.scale_length)
            if settings.scale == "points":
                length = _picked_length(model, settings.scale_picks)
            else:
                length, difference = _marker_length(folder, model, settings.marker_dictionary, reporter)
                doubt = round(float(difference), 4)
            unit = settings.scale_length / length
        frame = scale.room_frame(poses(model), points(model), unit)
    transform_model(model, frame)
    write_model(folder.sparse, model)
    known = None if settings.scale == "none" else unit
    return ScaleFacts(settings.scale, known, as_matrix(frame), doubt)


def _check_length(length: float) -> None:
    if not (np.isfinite(length) and length > 0.0):
        raise FiptError(
            "scale-length", f"The known length is {length:g} m.", "Give the length in meters, above zero."
        )


def _picked_length(model: pycolmap.Reconstruction, text: str) -> float:
    """The distance of the two picked points in the solve's unit."""
    first, second = (_picked_point(model, picks) for picks in scale.parse_picks(text))
    length = float(np.linalg.norm(first - second))
    if length == 0.0:
        raise FiptError("scale-point", "The two picked points are the same.", "Pick two points.")
    return length


def _picked_point(model: pycolmap.Reconstruction, picks: list[scale.Pick]) -> np.ndarray:
    """A picked point (3,): where rays of several views meet, or at the depth of solved points near it."""
    images = [_placed(model, pick.view) for pick in picks]
    found = [rays(image, np.array([[pick.x, pick.y]])) for image, pick in zip(images, picks, strict=True)]
    origins = np.array([origin for origin, _ in found])
    directions = np.array([direction[0] for _, direction in found])
    place = scale.nearest_to_rays(origins, directions) if len(picks) > 1 else None
    if place is not None:
        return place
    image, pick = images[0], picks[0]
    positions, depths = seen_points(model, image)
    diagonal = float(np.hypot(image.camera.width, image.camera.height))
    try:
        depth = scale.depth_of_pick(np.array([pick.x, pick.y]), positions, depths, diagonal)
    except ValueError as error:
        raise FiptError(
            "scale-point",
            f"The depth of the point at {pick.x:g}, {pick.y:g} in {pick.view} is not known: {error}.",
            _PICK_AGAIN,
        ) from None
    forward = image.cam_from_world().inverse().matrix()[:, 2]
    return np.asarray(origins[0] + directions[0] * depth / (directions[0] @ forward))


def _placed(model: pycolmap.Reconstruction, view: str) -> pycolmap.Image:
    image = model.find_image_with_name(f"{view}.exr")
    if image is None or not image.has_pose:
        raise FiptError(
            "scale-view", f"The view '{view}' has no camera.", "Pick the point in a view that has one."
        )
    return image


def _marker_length(
    folder: PreparationFolder, model: pycolmap.Reconstruction, dictionary: str, reporter: Reporter
) -> tuple[float, float]:
    """The marker's edge in the solve's unit, and the relative disagreement of its estimates."""
    detector = MarkerDetector(dictionary)
    seen: dict[int, list[tuple[np.ndarray, np.ndarray]]] = {}
    names = sorted(model.images[index].name for index in model.reg_image_ids())
    for index, name in enumerate(names):
        image = model.find_image_with_name(name)
        copy = copy_file(folder, name.removesuffix(".exr"))
        picture = np.asarray(Image.open(copy, formats=["JPEG"]).convert("L"))
        for number, corners in detector.find(picture).items():
            seen.setdefault(number, []).append(rays(image, corners))
        reporter.progress((index + 1) / len(names))
    edges, differences = [], []
    for found in seen.values():
        placed = _corners(found)
        if placed is not None:
            edge, difference = scale.marker_edge(placed)
            edges.append(edge)
            differences.append(difference)
    if not edges:
        raise FiptError(
            "marker-missing",
            f"No marker of the dictionary {dictionary} is seen from two positions; "
            f"{len(seen)} are seen at all.",
            "Photograph the marker flat, sharp and large from several positions, or pick two points instead.",
        )
    length, spread = scale.agreed_scale(edges)
    difference = max(spread, *differences)
    if difference > MARKER_TOLERANCE:
        reporter.warning(
            "marker-inaccurate",
            f"Estimates of the marker's edge differ by {100.0 * difference:.0f} %.",
            "Check that it lies flat and was not moved, and that all markers have the same size.",
        )
    return length, difference


def _corners(found: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray | None:
    """(4, 3) corners of a marker that several views see, None where they can't be placed."""
    origins = np.array([origin for origin, _ in found])
    places = [
        scale.nearest_to_rays(origins, np.array([directions[corner] for _, directions in found]))
        for corner in range(4)
    ]
    return None if any(place is None for place in places) else np.array(places)


DICTIONARIES = tuple(f"{bits}X{bits}_{count}" for bits in (4, 5, 6, 7) for count in (50, 100, 250, 1000)) + (
    "ARUCO_ORIGINAL",
)


class MarkerDetector:
    """Finds the markers of one dictionary in eight-bit pictures.

    Raises:
        FiptError: ``package-optional`` without OpenCV, ``marker-dictionary`` for an unknown dictionary.
    """

    def __init__(self, dictionary: str) -> None:
        if dictionary not in DICTIONARIES:
            raise FiptError(
                "marker-dictionary",
                f"There is no dictionary of markers '{dictionary}'.",
                f"Use one of: {', '.join(DICTIONARIES)}.",
            )
        cv2 = optional("markers", "A printed marker")
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{dictionary}"))
        self._detector = cv2.aruco.ArucoDetector(known, parameters)

    def find(self, picture: np.ndarray) -> dict[int, np.ndarray]:
        """Corners (4, 2) in pixels of each marker by its number; a number seen twice is left out.

        Args:
            picture: (height, width) uint8.
        """
        corners, numbers, _ = self._detector.detectMarkers(picture)
        if numbers is None:
            return {}
        flat = [int(number) for number in numbers.ravel()]
        # OpenCV counts from the center of the first pixel.
        return {
            number: np.asarray(four, np.float64).reshape(4, 2) + 0.5
            for number, four in zip(flat, corners, strict=True)
            if flat.count(number) == 1
        }
