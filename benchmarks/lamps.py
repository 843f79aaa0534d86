# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How many lamps of a capture an estimate found, invented and lost."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from fipt_blender.core.alignment.mesh_file import read_mesh
from fipt_blender.core.capture.views import load_capture
from fipt_blender.core.conventions import transform_points
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.surface.room import load_room

# Surfaces are the same lamp within this distance in metres: scans of 4 cm are off by less.
NEAR = 0.05
POINTS = 2000  # on each lamp


@dataclass(frozen=True)
class LampCounts:
    """Lamps of an estimate.

    Attributes:
        true: fixtures of which more than half lies on a true lamp.
        false: the other fixtures. false_area: theirs together, square metres.
        lost: true lamps of which fixtures have less than half.
    """

    true: int
    false: int
    false_area: float
    lost: int


def points_on(corners: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, 3) points distributed evenly over triangles with corners (T, 3, 3)."""
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = corners[rng.choice(len(corners), count, p=area / area.sum())]
    share = np.sort(rng.random((count, 2)), axis=1)
    weights = np.stack([share[:, 0], share[:, 1] - share[:, 0], 1.0 - share[:, 1]], axis=1)
    return np.asarray(np.einsum("nc,nck->nk", weights, chosen))


def count_lamps(found: Sequence[np.ndarray], true: Sequence[np.ndarray], seed: int = 0) -> LampCounts:
    """Compare fixtures with true lamps; each has the corners (T, 3, 3) of its triangles, in metres."""
    rng = np.random.default_rng(seed)
    points = [[points_on(corners, POINTS, rng) for corners in each] for each in (found, true)]

    def shares(some: Sequence[np.ndarray], others: Sequence[np.ndarray]) -> list[float]:
        """Share of each one's points that lie on one of the others."""
        if not others:
            return [0.0] * len(some)
        tree = cKDTree(np.concatenate(others))
        return [float(np.mean(tree.query(each)[0] < NEAR)) for each in some]

    right = [share > 0.5 for share in shares(points[0], points[1])]
    areas = [
        0.5 * float(np.linalg.norm(np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]), axis=1).sum())
        for c in found
    ]
    return LampCounts(
        true=sum(right),
        false=len(right) - sum(right),
        false_area=sum(area for area, known in zip(areas, right, strict=True) if not known),
        lost=sum(share < 0.5 for share in shares(points[1], points[0])),
    )


def lamps_of_run(run: RunFolder, capture: Path) -> LampCounts:
    """The lamps of a finished run against `emitters.json` of its capture.

    Raises:
        FiptError: ``truth-missing`` where the capture does not tell its lamps.
    """
    if not (capture / "emitters.json").is_file():
        raise FiptError("truth-missing", f"{capture} has no emitters.json.", "Use a rendered capture.")
    vertices, triangles = read_mesh(capture / "scene.obj")
    corners = transform_points(load_capture(run).world_from_source, vertices)[triangles]
    true = [
        corners[slice(*lamp["triangles"])] for lamp in json.loads((capture / "emitters.json").read_text())
    ]
    room = load_room(run)
    fixtures = read_document(run.emitters_json, dict)["fixtures"]
    found = [room.vertices[room.triangles[fixture["triangles"]]].astype(float) for fixture in fixtures]
    return count_lamps(found, true)
