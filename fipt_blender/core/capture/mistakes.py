"""Whether cameras, sparse points, mesh and photographs belong together, and which usual mistake explains it
if not: one check for all formats, at the import and before an estimation.

Points of the mesh (else of the solve) are looked up in small photographs, where the nearest ones in a cell of
the image are visible. Each correction is tried alone, and then some usual pairs: what explains all is named,
of several that do all of them. It can't tell mistakes apart that no photograph shows: in rooms that are their
own mirror image, or whose photographs are plain or noisy, mesh and points alone decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ..alignment.surface import sample_surface
from ..conventions import transform_points
from ..run.errors import FiptError, Problem, problem
from .averaging import means
from .corrections import Correction, both, corrections

SAMPLES, VIEWS, CELLS = 10_000, 60, 8  # points of the mesh; photographs; cells along each side of an image
COMPARED, MOST_SIGHTS = 24, 200  # photographs that are compared; about, cameras of all
WIDTH = 64  # pixels, about, of the photographs that are compared
FLOOR = 0.05  # radiance in units of a photograph's median, below which differences count less
# A point is visible that is not farther away than this, in distances of the nearest one in its cell, of which
# there are so many along each side. (Of the example's right poses, 0.79 agree; with 8 cells and 1.25, 0.71.)
REACH, DEPTH_CELLS = 1.08, 16
# Share of the images that shows the mesh: below the first, the mesh is elsewhere; above the second, and with
# so many of the cameras within its box, it fits. A box is taken larger by a share of its size.
LEAST_SEEN, FITTING_SEEN, FITTING_INSIDE, LARGER = 0.1, 0.5, 0.9, 0.05
INSIDE = 0.6  # share of the cameras in the mesh's box, below which it is doubted
# Cameras' spread over the mesh's diagonal: in rooms it is larger than the first. Below the second, the mesh
# may have another unit.
USUAL_PATH, SMALL_PATH = 1.0 / 30.0, 1.0 / 150.0
# Points of the solve, where it has so many: those within this share of the mesh's diagonal lie on it. Of a
# real room 92 % did, of the same mesh turned, recentred or in feet 24 % at most. All points are before two
# cameras or more; with wrong poses, few are.
ENOUGH_POINTS, MOST_POINTS, NEAR, ON_MESH, CURED, WATCHED = 100, 2000, 0.02, 0.4, 0.6, 0.6
# Correlation of neighbouring pixels of a photograph below which it is mostly noise and is not compared. Rooms
# have 0.83 and more, photographs traced with few samples 0.4 to 0.8.
CLEAR = 0.75
LEAST_SPREAD = 0.1  # standard deviation of log radiance in the shared points, below which pairs say nothing
LEAST_SHARED = 30  # points that a pair of photographs must share
DISAGREE = 0.5  # median correlation of twice as many pairs, below which poses or mesh are wrong for sure
# Share of 1 by which the largest distance from the cameras' middle, in the origin, may be off.
NORMALIZED = 1e-3
SAME = 0.99  # share of the mesh that lies where another correction puts it, if they do the same
LEAST_PAIRS = 4  # that say something of a placement
# Median correlation of the pairs: below the first, something is wrong; below the second, if other signs say
# so. What is above the third explains it, if it reduces 1 - correlation to less than the share. Others that
# leave at most this factor more explain it as well.
MEND, WELL, EXPLAINED, LACK, ALIKE = 0.75, 0.95, 0.85, 0.5, 1.5


@dataclass(frozen=True, eq=False)
class Sight:
    """A photograph's camera, and what it shows on few pixels."""

    pose: np.ndarray  # (4, 4) camera to world, OpenCV axes
    # fx, fy, cx, cy: intrinsics in units of the image's width and height
    fx: float
    fy: float
    cx: float
    cy: float
    radiance: np.ndarray | None = None  # (h, w, 3), NaN where masked; None where it is not compared

    def shows(self, points: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points (N, 3) in the image from a pose: index (M,), place (M, 2) from 0 to 1, and depth (M,)."""
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        depth = local[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            place = local[:, :2] / depth[:, None] * (self.fx, self.fy) + (self.cx, self.cy)
        inside = np.flatnonzero((depth > 0.0) & ((place >= 0.0) & (place < 1.0)).all(axis=1))
        return inside, place[inside], depth[inside]


def small(radiance: np.ndarray, masked: np.ndarray | None = None) -> np.ndarray | None:
    """A photograph (H, W, 3) on few pixels, in units of its median; None where it is noise, or shows nothing.

    Args:
        masked: (H, W) bool, pixels that show nothing.
    """
    width = min(WIDTH, radiance.shape[1])
    height = max(2, round(radiance.shape[0] * width / radiance.shape[1]))
    found = means(radiance, width, min(height, radiance.shape[0]))
    median = float(np.median(found))
    found = found / max(median, 1e-12)
    gray = np.log(np.maximum(found, 0.0) + FLOOR).mean(axis=2)
    if not median > 0.0 or gray.std() < LEAST_SPREAD or not is_clear(gray):
        return None
    if masked is not None:
        found[means(masked[..., None].astype(np.float32), width, len(found))[..., 0] > 0.0] = np.nan
    return found


def is_clear(gray: np.ndarray) -> bool:
    """Whether neighbouring pixels (h, w) of a photograph's log radiance are alike: it is not mostly noise."""
    for one, other in ((gray[:, 1:], gray[:, :-1]), (gray[1:], gray[:-1])):
        one, other = one - one.mean(), other - other.mean()
        if (one * other).sum() < CLEAR * np.sqrt((one**2).sum() * (other**2).sum()):
            return False
    return True


class Fit(NamedTuple):
    """How cameras and mesh go together."""

    seen: float  # share of the images that shows the mesh
    inside: float  # share of the cameras within its box
    path: float  # spread of the cameras over its diagonal
    on_mesh: float  # share of the solve's points on the mesh; 1 without
    watched: float  # share of them before two cameras or more; 1 without
    agreement: float  # median correlation of the photographs' pairs
    pairs: int  # that were compared

    @property
    def agrees(self) -> bool:
        """Whether photographs confirm it."""
        return self.pairs >= LEAST_PAIRS and self.agreement >= MEND


@dataclass(frozen=True, eq=False)
class Scene:
    """What belongs together or not."""

    sights: Sequence[Sight]  # cameras and photographs
    points: np.ndarray  # (N, 3) on the mesh, or of the solve without one
    solved: np.ndarray | None  # (M, 3) points of the solve in the cameras' coordinates; None with too few
    has_mesh: bool  # whether the points are those of a mesh

    @classmethod
    def of(
        cls, sights: Sequence[Sight], mesh: tuple[np.ndarray, np.ndarray] | None, solved: np.ndarray
    ) -> Scene | None:
        """The scene of vertices and triangles and of the solve's points; None with neither.

        Args:
            solved: (N, 3), in the coordinates of the cameras.
        """
        step = -(-len(sights) // MOST_SIGHTS)
        sights = [each for i, each in enumerate(sights) if i % step == 0 or each.radiance is not None]
        few = solved[:: -(-len(solved) // MOST_POINTS)] if len(solved) >= ENOUGH_POINTS else None
        if mesh is None:
            return None if few is None else cls(sights, few, few, False)
        try:
            points = sample_surface(*mesh, np.random.default_rng(0), SAMPLES).points
        except FiptError:  # a mesh without area
            points = mesh[0]
        return cls(sights, points, few, True)

    @property
    def is_telling(self) -> bool:
        """Whether enough photographs can be compared."""
        return sum(sight.radiance is not None for sight in self.sights) >= LEAST_PAIRS

    @property
    def is_normalized(self) -> bool:
        """Whether the cameras' middle is the origin, as programs for training networks put it."""
        places = np.array([sight.pose[:3, 3] for sight in self.sights])
        middle, reach = places.mean(axis=0), float(np.linalg.norm(places, axis=1).max())
        return bool(np.linalg.norm(middle) < NORMALIZED * reach)

    def fit(self, correction: Correction | None = None) -> Fit:
        """How all goes together after a correction."""
        poses, place = np.array([sight.pose for sight in self.sights]), np.eye(4)
        if correction is not None and correction.poses is not None:
            poses = correction.poses(poses)
        if correction is not None and correction.mesh is not None:
            place = correction.mesh
        points, solved = transform_points(place, self.points), self.solved
        low, high = points.min(axis=0), points.max(axis=0)
        diagonal, margin = float(np.linalg.norm(high - low)), LARGER * (high - low)
        places = poses[:, :3, 3]
        within = ((places >= low - margin) & (places <= high + margin)).all(axis=1)
        path = float(np.linalg.norm(np.ptp(places, axis=0))) / max(diagonal, 1e-300)
        on_mesh = watched = 1.0
        if solved is not None:
            if self.has_mesh:
                on_mesh = float((cKDTree(points).query(solved)[0] < NEAR * diagonal).mean())
            before = np.zeros(len(solved), np.int64)
            for sight, pose in zip(self.sights, poses, strict=True):
                before[sight.shows(solved, pose)[0]] += 1
            watched = float((before >= min(2, len(poses))).mean())
        step = max(1, -(-len(poses) // VIEWS))
        shown = []
        for sight, pose in zip(self.sights[::step], poses[::step], strict=True):
            cells = np.floor(sight.shows(points, pose)[1] * CELLS)
            shown.append(len(np.unique(cells @ [1, CELLS])) / CELLS**2)
        agreement, pairs = self._agreement(points, poses)
        return Fit(float(np.mean(shown)), float(within.mean()), path, on_mesh, watched, agreement, pairs)

    def _agreement(self, points: np.ndarray, poses: np.ndarray) -> tuple[float, int]:
        """Median correlation of photographs in the points that two of them see, and how many pairs there are.

        Args:
            points: (N, 3).
            poses: (V, 4, 4).
        """
        known = [index for index, sight in enumerate(self.sights) if sight.radiance is not None]
        known = known[:: max(1, -(-len(known) // COMPARED))]
        values = np.zeros((3, len(known), len(points)))
        sees = np.zeros((len(known), len(points)), bool)
        for row, index in enumerate(known):
            radiance = self.sights[index].radiance
            assert radiance is not None, "only these are known"
            inside, place, depth = self.sights[index].shows(points, poses[index])
            cell = np.floor(place * DEPTH_CELLS).astype(np.int64) @ [1, DEPTH_CELLS]
            nearest = np.full(DEPTH_CELLS**2, np.inf)
            np.minimum.at(nearest, cell, depth)
            column, line = (place * radiance.shape[1::-1]).astype(np.int64).T
            color = radiance[line, column]
            good = (depth <= REACH * nearest[cell]) & np.isfinite(color[:, 0])
            sees[row, inside[good]] = True
            values[:, row, inside[good]] = np.log(np.maximum(color[good], 0.0) + FLOOR).T
        share = sees.astype(np.float64)
        shared = share @ share.T
        common, covariance, variance = np.maximum(shared, 1.0), np.zeros(shared.shape), np.zeros(shared.shape)
        for value in values:
            sums = value @ share.T
            covariance += value @ value.T / common - sums * sums.T / common**2
            variance += value**2 @ share.T / common - (sums / common) ** 2
        compared = (shared >= LEAST_SHARED) & (np.minimum(variance, variance.T) > 3.0 * LEAST_SPREAD**2)
        first, second = np.nonzero(np.triu(compared, 1))
        if not len(first):
            return 0.0, 0
        spread = np.sqrt(np.maximum(variance * variance.T, 1e-12))
        return float(np.median((covariance / spread)[first, second])), len(first)

    def is_same(self, one: Correction, other: Correction) -> bool:
        """Whether two corrections put the mesh into the same places, as turns of a symmetric room do."""
        if one.mesh is None or other.mesh is None:
            return False
        first, second = (transform_points(place, self.points) for place in (one.mesh, other.mesh))
        near = NEAR * float(np.linalg.norm(np.ptp(first, axis=0)))
        return float((cKDTree(first).query(second)[0] < near).mean()) > SAME

    def is_elsewhere(self, fit: Fit) -> bool:
        """Whether cameras and mesh clearly do not belong together, whatever photographs show."""
        return fit.on_mesh < ON_MESH if self.solved is not None and self.has_mesh else fit.seen < LEAST_SEEN

    def is_doubtful(self, fit: Fit) -> bool:
        """Whether something may be wrong. Photographs of smooth walls agree in wrong places, too."""
        odd = self.solved is None and (fit.path < SMALL_PATH or fit.inside < INSIDE)
        if self.is_elsewhere(fit) or odd or fit.watched < WATCHED:
            return True
        return self.is_telling and fit.pairs > 0 and (fit.pairs < LEAST_PAIRS or fit.agreement < DISAGREE)

    def explains(self, fit: Fit, given: Fit) -> bool:
        """Whether mesh and points fit, which do not as they are given."""
        if self.solved is not None:
            least = WATCHED if given.on_mesh >= CURED else min(WATCHED, given.watched)
            return fit.on_mesh >= CURED and fit.watched >= least
        room = fit.inside >= FITTING_INSIDE and fit.path >= USUAL_PATH
        return fit.seen >= FITTING_SEEN and room


@dataclass(frozen=True, eq=False)
class Finding:
    """What was found of a scene."""

    given: Fit  # how it fits as it is
    elsewhere: bool = False  # whether cameras and mesh clearly do not belong together
    explained: Sequence[Correction] = ()  # the corrections that explain all
    best: Fit | None = None  # how it fits with the first of them
    is_sure: bool = False  # whether photographs confirm them
    contradicted: bool = False  # whether the photographs hardly agree on the mesh

    def error(self, at_import: bool) -> FiptError:
        """The error where photographs confirm what explains it."""
        assert self.best is not None, "something explains it"
        best, says, which = self.best.agreement, self._says, self._which
        given = f"the photographs agree by {self.given.agreement:.2f} on it"
        if self.given.pairs < LEAST_PAIRS:
            given = "hardly two photographs would show the same of it"
        if at_import:
            said = problem("convention", given=given, best=best, says=says, which=which)
        else:
            said = problem("mesh-misplaced", given=given, best=best, says=says, which=which)
        return FiptError.of(said.code, said.text, said.remedy, self._fix if at_import else "")

    def note(self, scene: Scene, mesh: Path | None) -> Problem:
        """The warning where mesh and points alone tell, or nothing explains it."""
        places, given = np.array([sight.pose[:3, 3] for sight in scene.sights]), self.given
        low, high = scene.points.min(axis=0), scene.points.max(axis=0)
        middle, what = places.mean(axis=0), mesh or "the solve's points"
        if scene.is_normalized and not self.explained:
            return problem("mesh-elsewhere.normalized", mesh=what, agreement=given.agreement)
        if self.contradicted and not self.elsewhere:
            return problem("mesh-elsewhere.photographs", mesh=what, agreement=given.agreement)
        evidence = f"the photographs would show {what} in {100.0 * given.seen:.0f} % of their pixels"
        if scene.solved is not None:
            evidence += f", {100.0 * given.on_mesh:.0f} % of the solve's points lie on it"
            evidence += f", {100.0 * given.watched:.0f} % of them are before two cameras"
        evidence += f", {100.0 * given.inside:.0f} % of the cameras are within its box"
        evidence += f" of {np.linalg.norm(high - low):.3g} units, and their middle is"
        evidence += f" {np.linalg.norm(middle - 0.5 * (low + high)):.3g} units from its middle"
        if not self.explained:
            return problem("mesh-elsewhere.unknown", evidence=evidence)
        said = problem("mesh-elsewhere.explained", evidence=evidence, says=self._says, which=self._which)
        return replace(said, fix=self._fix)

    @property
    def _says(self) -> str:
        return ", or ".join(each.says for each in self.explained)

    @property
    def _fix(self) -> str:
        """The name of the only correction; "" of several."""
        return self.explained[0].name if len(self.explained) == 1 else ""

    @property
    def _which(self) -> str:
        names = " or ".join(each.name for each in self.explained)
        return self._fix or f"one of {names}, whichever your program's mistake is"


def examine(scene: Scene, source: str, poses: bool = True, doubt: bool = False) -> Finding | None:
    """Which usual mistakes explain that a scene does not belong together; None where it does.

    Rooms are alike in front of and behind a camera, so that photographs may agree well with wrong poses:
    corrections of cameras are also tried where nothing is doubtful.

    Args:
        source: name of the capture's format.
        poses: whether corrections of poses are tried that depend on the source's coordinates.
        doubt: whether the mesh is doubted for other reasons.
    """
    given = scene.fit()
    doubtful = doubt or scene.is_doubtful(given)
    if not doubtful and not scene.is_telling:
        return None
    elsewhere = scene.is_elsewhere(given) and not given.agrees
    for table in (corrections(source), both(source)):
        tried = [
            (each, scene.fit(each))
            for each in table
            if (each.poses is not None or (doubtful and scene.has_mesh))
            and (poses or each.poses is None or each.name.startswith("axes-"))
        ]
        found = _explaining(scene, given, tried)
        if found:
            sure = scene.is_telling and found[0][1].pairs >= LEAST_PAIRS
            return Finding(given, elsewhere, [each for each, _ in found], found[0][1], sure)
    least = WELL if scene.is_normalized else DISAGREE
    contradicted = scene.has_mesh and given.pairs >= 2 * LEAST_PAIRS and given.agreement < least
    return Finding(given, elsewhere, contradicted=contradicted) if elsewhere or contradicted else None


def _explaining(
    scene: Scene, given: Fit, tried: Sequence[tuple[Correction, Fit]]
) -> list[tuple[Correction, Fit]]:
    """The corrections that explain all, of those that do the same the simplest."""
    if not scene.is_telling:
        fitting = [] if scene.explains(given, given) else tried
        found = [(each, fit) for each, fit in fitting if scene.explains(fit, given)]
    else:
        least = max(LEAST_PAIRS, max((fit.pairs for _, fit in tried), default=0) / 3)
        left = LACK * (1.0 - (given.agreement if given.pairs >= LEAST_PAIRS else 0.0))
        if given.agrees:  # what is right is seen by no fewer pairs
            least, left = max(least, given.pairs), 0.5 * left
        found = [
            (each, fit)
            for each, fit in tried
            if fit.pairs >= least
            and fit.agreement > EXPLAINED
            and 1.0 - fit.agreement < left
            and fit.on_mesh >= min(CURED, given.on_mesh)
        ]
        best = max((fit.agreement for _, fit in found), default=0.0)
        found = [pair for pair in found if 1.0 - pair[1].agreement <= ALIKE * (1.0 - best)]
    kept: list[tuple[Correction, Fit]] = []
    for pair in found:  # the simplest first
        if not any(scene.is_same(pair[0], other) for other, _ in kept):
            kept.append(pair)
    return kept
