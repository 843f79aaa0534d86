"""How many lamps of a capture an estimate found, invented and lost."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from fipt_blender.core.capture.views import load_capture
from fipt_blender.core.conventions import transform_points
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.result_contents import Emitters
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.surface.room import load_room

# Surfaces are the same lamp within this distance in metres: scans of 4 cm are off by less.
NEAR = 0.05
POINTS = 2000  # on each lamp
CERTAIN = 0.95  # probability from which a fixture is taken for certain


@dataclass(frozen=True)
class LampCounts:
    """Lamps of an estimate.

    Attributes:
        true: fixtures of which more than half lies on a true lamp.
        false: the other fixtures. false_area: theirs together, square metres.
        lost: true lamps of which fixtures have less than half.
        certain, certain_area: false fixtures that the estimate takes for certain, and their square metres.
        flux: power of the fixtures on true lamps over that of these lamps.
        claims: probability of each fixture, and 1 if it is true, for the reliability of probabilities.
    """

    true: int
    false: int
    false_area: float
    lost: int
    certain: int = 0
    certain_area: float = 0.0
    flux: float | None = None
    claims: tuple[tuple[float, int], ...] = ()


def points_on(corners: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, 3) points distributed evenly over triangles with corners (T, 3, 3)."""
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = corners[rng.choice(len(corners), count, p=area / area.sum())]
    share = np.sort(rng.random((count, 2)), axis=1)
    weights = np.stack([share[:, 0], share[:, 1] - share[:, 0], 1.0 - share[:, 1]], axis=1)
    return np.asarray(np.einsum("nc,nck->nk", weights, chosen))


def count_lamps(
    found: Sequence[np.ndarray],
    true: Sequence[np.ndarray],
    seed: int = 0,
    likely: Sequence[float] | None = None,
    power: tuple[Sequence[float], float] | None = None,
) -> LampCounts:
    """Compare fixtures with true lamps; each has the corners (T, 3, 3) of its triangles, in metres.

    Args:
        likely: probability of each fixture; None: 1.
        power: of each fixture, and of all true lamps together.
    """
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
    probability = likely or [1.0] * len(found)
    sure = [value >= CERTAIN for value in probability]
    wrong = [(area, known) for area, known, fine in zip(areas, sure, right, strict=True) if not fine]
    flux = None
    if power is not None and power[1] > 0.0:
        flux = sum(each for each, fine in zip(power[0], right, strict=True) if fine) / power[1]
    return LampCounts(
        certain=sum(known for _, known in wrong),
        certain_area=sum(area for area, known in wrong if known),
        flux=flux,
        claims=tuple(zip(probability, map(int, right), strict=True)),
        true=sum(right),
        false=len(right) - sum(right),
        false_area=sum(area for area, _ in wrong),
        lost=sum(share < 0.5 for share in shares(points[1], points[0])),
    )


def _corners(path: Path) -> np.ndarray:
    """(T, 3, 3) of an OBJ file of triangles, in its order: importers sort them by objects."""
    lines = [line.split() for line in path.read_text(encoding="utf-8").splitlines() if line]
    vertices = np.array([words[1:4] for words in lines if words[0] == "v"], float)
    faces = [[int(word.partition("/")[0]) - 1 for word in words[1:]] for words in lines if words[0] == "f"]
    return vertices[np.array(faces)]


def lamps_of_run(run: RunFolder, capture: Path, least: float = 0.0) -> LampCounts:
    """A run's lamps of a probability of at least `least`, against `emitters.json` of its capture.

    Raises:
        FiptError: ``truth-missing`` where the capture does not tell its lamps.
    """
    if not (capture / "emitters.json").is_file():
        raise FiptError.of("truth-missing", f"{capture} has no emitters.json.", "Use a rendered capture.")
    corners = transform_points(load_capture(run).world_from_source, _corners(capture / "scene.obj"))
    table = json.loads((capture / "emitters.json").read_text())
    true = [corners[slice(*lamp["triangles"])] for lamp in table]
    shining = float(sum(np.pi * lamp["area"] * np.mean(lamp["radiance"]) for lamp in table))
    room = load_room(run)
    fixtures = [
        each for each in read_document(run.emitters_json, Emitters).fixtures if each.probability >= least
    ]
    found = [room.vertices[room.triangles[list(each.triangles)]].astype(float) for each in fixtures]
    likely = [each.probability for each in fixtures]
    power = [float(np.mean(each.power or 0.0)) for each in fixtures]
    return count_lamps(found, true, likely=likely, power=(power, shining))
