# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Printed ArUco markers in the photographs, through OpenCV, which is an optional package."""

from __future__ import annotations

import numpy as np

from ..run.errors import FiptError
from .extras import optional

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
        cv2 = optional("cv2", "A printed marker")
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
