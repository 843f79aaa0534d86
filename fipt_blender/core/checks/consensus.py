"""Whether photographs, poses and mesh belong together, before anything is estimated.

Two photographs of the same surface points correlate, whatever their exposures and responses are, if both
poses and the mesh are right. The correlations of all pairs determine which views most others confirm (up to
half of the poses may be wrong). :mod:`..capture.mistakes` tries what usually is wrong with all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..capture.mistakes import Scene, examine, is_clear
from ..capture.mistakes import small as small_image
from ..capture.relation import sight
from ..capture.rig import Pinhole
from ..capture.views import View
from ..run.errors import FiptError
from ..run.stage_settings import Forced
from ..surface.room import Room
from .consistency import FLOOR, ConsistencyTable, SmallPhotographs, footprint

WIDTH = 96  # about, of the photographs that are compared, pixels
LEAST_CELLS = 30  # that a pair of views must share
# Standard deviation of log radiance in the shared cells, below which a pair is not compared.
LEAST_SPREAD = 0.1
JUDGED_VIEWS = 4  # that must be judged before anything is said of poses or mesh
# Below this correlation, a pose of the pair may be wrong. Median: 0.9 of right poses, 0.15 of wrong ones.
AGREE = 0.5
SOFTNESS = 0.1  # width of the transition to credible views, in mean correlation
ROUNDS = 20  # at most, of weighing views by each other
# Where more than this share of the views is contradicted and the rest agrees less than this in the median, it
# is the mesh that is wrong: right poses agree by 0.9.
MANY, MEND_LEFT = 0.1, 0.85
CLOSE = 0.2  # share of the pairs, those of the closest cameras, to whose agreement the mesh hardly matters
LEAST_SEEN = 0.05  # share of the pixels that see the mesh, of a view or of all, below which they see nothing
SAME = 0.02  # standard deviation of log radiance in all photographs, below which they show nothing
_ALIGN = "align the cameras to the mesh by pairs of points in Blender (Capture > Alignment > Cameras to Mesh)"


@dataclass(frozen=True, eq=False)
class PairAgreement:
    """How well the photographs of V views agree in pairs."""

    # (V, V) of log radiance in the cells that both see; 0 where they are not compared
    correlation: np.ndarray
    weight: np.ndarray  # (V, V) root of the number of these cells, 0 where they are not compared
    seen: np.ndarray  # (V,) share of each view's pixels that see the mesh

    @property
    def median(self) -> float:
        """Of the correlations of all pairs that are compared; 0 without any."""
        known = np.triu(self.weight) > 0.0
        return float(np.median(self.correlation[known])) if known.any() else 0.0

    def among(self, chosen: np.ndarray) -> PairAgreement:
        """Of the views marked in `chosen`, (V,) bool."""
        both = np.ix_(chosen, chosen)
        return PairAgreement(self.correlation[both], self.weight[both], self.seen[chosen])

    def credible(self) -> tuple[np.ndarray, np.ndarray]:
        """(V,) bool, views that the credible others confirm; (V,) bool, views that are judged at all.

        In a view's mean correlation, the others are weighted by their own credibility, iteratively. The first
        value is the upper quartile of the view's correlations, so that half of the others may be wrong.
        """
        judged = (self.weight > 0.0).sum(axis=1) >= 2
        values = np.where(self.weight > 0.0, self.correlation, np.nan)
        score = np.zeros(len(values))
        score[judged] = np.nanquantile(values[judged], 0.75, axis=1)
        for _ in range(ROUNDS):
            trust = 1.0 / (1.0 + np.exp(-np.clip((score - AGREE) / SOFTNESS, -30.0, 30.0)))
            total = self.weight @ trust
            score = (self.weight * self.correlation) @ trust / np.maximum(total, 1e-9)
        return ~judged | (score > AGREE), judged


def small_photographs(views: Sequence[View]) -> SmallPhotographs:
    """The photographs on coarse pixels, each in units of its median."""
    small = SmallPhotographs.of(views, [max(1, view.width // WIDTH) for view in views])
    positive = [np.maximum(each, 0.0) for each in small.radiance]
    return replace(small, radiance=[each / max(float(np.median(each)), 1e-12) for each in positive])


def pair_agreement(room: Room, small: SmallPhotographs) -> PairAgreement:
    """How the photographs agree on the mesh."""
    pixels = small.traced(room)
    table = ConsistencyTable.of(pixels, room, footprint(pixels), colored=True)
    correlation, shared, variance = table.pair_correlation()
    clear = np.array([is_clear(np.log(image + FLOOR).mean(axis=2)) for image in small.images()], bool)
    compared = (shared >= LEAST_CELLS) & (np.minimum(variance, variance.T) > 3.0 * LEAST_SPREAD**2)
    compared &= np.outer(clear, clear) & ~np.eye(len(clear), dtype=bool)
    seen = np.array([np.mean(pixels.triangle[pixels.rows(index)] >= 0) for index in range(len(clear))])
    return PairAgreement(np.where(compared, correlation, 0.0), np.where(compared, np.sqrt(shared), 0.0), seen)


def check_input(
    room: Room, views: Sequence[View], settings: Forced, own_mesh: bool = False, source: str = ""
) -> dict[int, float]:
    """Refuse input from which nothing can be estimated; find the views whose poses are far off.

    Args:
        own_mesh: whether the mesh was made of depth images of these cameras: it lies where they are.
        source: name of the capture's format.

    Returns:
        index of each view that the others contradict, and its mean correlation with the credible ones.
    """
    small = small_photographs(views)
    found = pair_agreement(room, small)
    if not settings.force:
        _check_photographs(small)
    credible, judged = found.credible()
    few = judged.sum() < JUDGED_VIEWS
    blind = int((found.seen < LEAST_SEEN).sum())
    elsewhere = 2 * blind >= len(views) or found.seen.mean() < LEAST_SEEN
    if not settings.force and not own_mesh and (elsewhere or not few):
        _check_mesh(room, small, source)
    if not settings.force and 2 * blind >= len(views) > blind:  # where all are blind, see fill_pixels
        raise _insufficient(
            f"{blind} of {len(views)} cameras see nothing of the mesh",
            f"Leave these views out, correct their poses, or {_ALIGN}.",
        )
    if not settings.force and 0.0 < found.seen.mean() < LEAST_SEEN:  # where nothing is seen, see fill_pixels
        raise _insufficient(
            f"the cameras see the mesh in only {100.0 * found.seen.mean():.0f} % of their pixels",
            f"Use a mesh of the whole room, in the cameras' coordinates and unit, or {_ALIGN}.",
        )
    if few:
        return {}
    wrong = np.flatnonzero(~credible)
    left = found.among(credible)
    unsettled = len(wrong) > MANY * judged.sum() and left.median < MEND_LEFT
    most = 2 * len(wrong) > judged.sum()
    near = _near_agreement(found, small.views)
    # A mesh fused of the cameras' own depth images lies where they are. If photographs from nearly one place
    # agree, the poses are right: windows, glass, holes and changing exposure make the others disagree.
    if (settings.force and (unsettled or most)) or (own_mesh and unsettled and near >= AGREE):
        return {}
    if most or (unsettled and not own_mesh):
        raise disagreement(len(wrong), int(judged.sum()), _evidence(found, near), own_mesh)
    weight = found.weight * credible
    score = (weight * found.correlation).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-9)
    return {int(index): round(float(score[index]), 2) for index in wrong}


def disagreement(wrong: int, judged: int, evidence: str = "", own_mesh: bool = False) -> FiptError:
    """The error where too many photographs contradict each other.

    Args:
        evidence: sentence on which of both, poses or mesh, is wrong.
        own_mesh: as of `check_input`.
    """
    align = "" if own_mesh else f", or {_ALIGN}"
    mesh = "fuse the depth images with smaller voxels" if own_mesh else "use another mesh of the room"
    return FiptError("views-disagree", wrong=wrong, judged=judged, evidence=evidence, align=align, mesh=mesh)


def _near_agreement(found: PairAgreement, views: Sequence[View]) -> float:
    """Median correlation of pairs of close cameras, to which a wrong mesh matters little; 0 without any."""
    place = np.array([view.camera_to_world[:3, 3] for view in views])
    apart = np.linalg.norm(place[:, None] - place[None], axis=2)
    pairs = np.triu(found.weight) > 0.0
    if not pairs.any():
        return 0.0
    return float(np.median(found.correlation[pairs & (apart <= np.quantile(apart[pairs], CLOSE))]))


def _evidence(found: PairAgreement, near: float) -> str:
    """Whether poses or mesh are wrong; near: as of `_near_agreement`."""
    if not found.weight.any():
        return ""
    if near < AGREE:
        return (
            f" Photographs from nearly the same place do not agree either ({near:.2f}): the poses are wrong."
        )
    return (
        f" Photographs from nearly the same place agree by {near:.2f}, all by {found.median:.2f}: the mesh is"
        " wrong."
    )


def _insufficient(text: str, remedy: str) -> FiptError:
    return FiptError("input-insufficient", text=text, remedy=remedy)


def _check_photographs(small: SmallPhotographs) -> None:
    """Refuse one view, and photographs without content."""
    if len(small.views) < 2:
        raise _insufficient(
            "there is one photograph, but gloss and light follow from several",
            "Add photographs from other places, or hold fewer back.",
        )
    black = np.log(FLOOR) + 1e-6  # black photographs are refused when they are read
    colors = [np.log(radiance + FLOOR) for radiance in small.radiance]
    spread = [float(color.std(axis=0).max()) for color in colors if color.max() > black]
    if spread and max(spread) < SAME:
        raise _insufficient(
            "the photographs show nothing, all pixels are alike",
            "Check the export of the photographs: they may be over-exposed or empty.",
        )


def _check_mesh(room: Room, small: SmallPhotographs, source: str) -> None:
    """Find out whether the photographs agree far better with a usual mistake of mesh or cameras undone."""
    sights = []
    for view, image, masked in zip(small.views, small.images(), small.masked, strict=True):
        shown = small_image(image, masked.reshape(view.height, view.width))
        pinhole = Pinhole(view.width, view.height, view.fx, view.fy, view.cx, view.cy)
        sights.append(sight(view.camera_to_world, pinhole, shown))
    scene = Scene.of(sights, (room.vertices, room.triangles), np.zeros((0, 3)))
    finding = None if scene is None else examine(scene, source, poses=False)
    if finding is not None and finding.is_sure:
        raise finding.error(at_import=False)
