"""results/doubts.json: the parts of which a hint would help most, each with a question and a picture.

The posterior of the closed form says how uncertain roughness and metallic of a part are; the number of its
pixels, how much that matters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..material.closed_form import CellEstimate, TrainingData
from ..material.pixel_samples import rows_with_donor
from ..report.comparison import to_display
from ..report.pictures import write_png
from ..run.kinds import Row
from ..run.result_contents import Doubt, Doubts
from ..run.runfolder import RunFolder, write_json

MAX_DOUBTS = 20  # of a run
# Standard deviation of roughness or metallic, or of whether a part emits, from which a part is doubtful.
MIN_DOUBT = 0.1
# Parts with a smaller share of all pixels are not worth a question.
MIN_SHARE = 2e-4
DARK = 0.2  # base color of dark surfaces
# A picture shows the part's box and so much around it, as a share of the box; at least so many pixels.
MARGIN, MIN_PIXELS = 0.5, 24
PICTURE_SIZE = 192  # about, by repeating pixels
EXPOSURE = 0.4  # the capture's median is mid-gray then
DIMMED = 0.35  # brightness of what does not belong to the part


@dataclass(frozen=True)
class GroupDoubts:
    """What is uncertain in each of G groups.

    Attributes:
        material: (G,) standard deviation of roughness and metallic, root of the sum of squares.
        lamp: (G,) standard deviation of whether it emits.
        share: (G,) of all pixels.
    """

    material: np.ndarray
    lamp: np.ndarray
    share: np.ndarray

    @property
    def score(self) -> np.ndarray:
        """(G,) what a hint is worth; 0 where nothing is in doubt."""
        spread = np.maximum(self.material, self.lamp)
        return np.where((spread >= MIN_DOUBT) & (self.share >= MIN_SHARE), spread * self.share, 0.0)


def group_doubts(errors: np.ndarray, pixels: np.ndarray, emits: np.ndarray, doubt: np.ndarray) -> GroupDoubts:
    """The doubts of G groups.

    Args:
        errors: (G, 2) standard deviation of roughness and metallic.
        pixels: (G,) number of pixels.
        emits: (G,) probability that they emit, and doubt: (G,) its variance, both means of the pixels.
    """
    material = np.sqrt((errors**2).sum(axis=1))
    # Of a lamp roughness and metallic do not matter.
    material = np.where(emits >= 0.5, 0.0, material)
    return GroupDoubts(material, np.sqrt(doubt), pixels / max(pixels.sum(), 1))


def question(metallic: float, errors: np.ndarray, color: float, lamp: bool) -> tuple[str, str]:
    """What to ask about a part, as a word for programs and as words for the artist.

    Args:
        metallic: of the part. errors: (2,) of roughness and metallic. color: mean base color.
    """
    if lamp:
        return "lamp", "Lamp or white surface?"
    unclear = 0.0 < metallic < 1.0 or errors[0] == 0.0  # where a hint says how rough it is
    if errors[1] >= MIN_DOUBT and errors[1] >= 0.5 * errors[0] and unclear:
        return "metal", "Dark metal or plastic?" if color < DARK else "Metal or paint?"
    return "gloss", "Glossy or matt?"


def write_doubts(
    folder: RunFolder,
    data: TrainingData,
    cells: CellEstimate,
    probability: np.ndarray,
    decided: np.ndarray,
    names: np.ndarray,
) -> None:
    """Write doubts.json and its pictures into new results, the most doubtful part first.

    What a hint says is not asked again, however wide the range that it leaves.

    Args:
        data, cells: the last closed-form estimate.
        probability: (T,) of each triangle to emit.
        decided: (T, 3) bool, triangles of which hints say how rough they are, whether they are metal, and
            whether they emit.
        names: (T,) name of each triangle's part, "" without one.
    """
    pixels, materials = data.observations.pixels, data.materials
    counts, emits, doubt, decided_of = _counts(data, probability, decided)
    total = counts.sum(axis=0)
    open_errors = np.where(decided_of[:, :2], 0.0, materials.error)
    doubts = group_doubts(open_errors, total, emits, np.where(decided_of[:, 2], 0.0, doubt))
    order = np.argsort(-doubts.score, kind="stable")[:MAX_DOUBTS]
    entries = []
    for number, group in enumerate(order[doubts.score[order] > 0.0].tolist(), start=1):
        lamp = bool(doubts.lamp[group] >= doubts.material[group])
        errors, (roughness, metallic) = open_errors[group], materials.mean[group].tolist()
        own = cells.group == group
        color = float(np.average(cells.color[own].mean(axis=1), weights=cells.pixels[own]))
        word, text = question(metallic, errors, color, lamp)
        view = int(counts[:, group].argmax())
        place, box, picture = _picture(data, view, group)
        path = folder.doubts / f"{number:02d}.png"
        write_png(path, picture)
        entries.append(
            Doubt(
                name=names[int(pixels.triangle[place])] or f"Part {group}",
                question=word,
                text=text,
                point=pixels.position[place].astype(np.float64).round(5).tolist(),
                pixels=int(total[group]),
                share=round(float(doubts.share[group]), 5),
                roughness=round(roughness, 4),
                metallic=round(metallic, 4),
                roughness_error=round(float(errors[0]), 4),
                metallic_error=round(float(errors[1]), 4),
                view=pixels.views[view].name,
                box=box,
                picture=path.name,
            )
        )
    write_json(folder.doubts_json, Doubts(tuple(entries)))


def _counts(
    data: TrainingData, probability: np.ndarray, decided: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(V, G) pixels of each view and group; (G,) means of their probability to emit and of its variance;
    (G, 3) bool, most are decided."""
    pixels, groups = data.observations.pixels, len(data.materials.mean)
    views = len(pixels.views)
    counts = np.zeros((views, groups), np.int64)
    values = np.column_stack([probability, probability * (1.0 - probability), decided])  # (T, 5)
    sums = np.zeros((values.shape[1], groups))
    for view in range(views):
        rows = _rows(data, view)
        group, triangle = np.asarray(data.group[rows]), np.asarray(pixels.triangle[rows])
        counts[view] = np.bincount(group, minlength=groups)
        for total, of_triangle in zip(sums, values.T, strict=True):
            total += np.bincount(group, of_triangle[triangle], minlength=groups)
    share = sums / np.maximum(counts.sum(axis=0), 1)
    return counts, share[0], share[1], share[2:].T > 0.5


def _rows(data: TrainingData, view: int) -> np.ndarray:
    """(n,) pixels of a view that have a donor and a group."""
    rows = rows_with_donor(data.observations, view)
    return rows[data.group[rows] >= 0]


def _picture(data: TrainingData, view: int, group: int) -> tuple[int, Row, np.ndarray]:
    """A pixel of a group in a view, near the middle of its pixels; their box; and a picture of it.

    The box is left, top, right, bottom in pixels, the last two not included; the picture (h, w, 3) in [0, 1].
    """
    pixels = data.observations.pixels
    bounds = pixels.rows(view)
    width, height = pixels.views[view].width, pixels.views[view].height
    rows = _rows(data, view)
    rows = rows[np.asarray(data.group[rows]) == group]
    y, x = np.divmod(rows - bounds.start, width)
    low, high = np.quantile([x, y], [0.02, 0.98], axis=1)
    middle = np.argmin((x - np.median(x)) ** 2 + (y - np.median(y)) ** 2)
    size = np.maximum((1.0 + MARGIN) * (high - low + 1.0), MIN_PIXELS)
    center = 0.5 * (low + high + 1.0)
    left, top = (int(max(value, 0)) for value in center - 0.5 * size)
    right, bottom = (
        int(min(value, most)) for value, most in zip(center + 0.5 * size, (width, height), strict=True)
    )
    radiance = np.asarray(pixels.radiance[bounds], np.float32).reshape(height, width, 3)
    shown = np.full(height * width, DIMMED, np.float32)
    shown[rows - bounds.start] = 1.0
    crop = radiance[top:bottom, left:right] * shown.reshape(height, width, 1)[top:bottom, left:right]
    repeat = max(PICTURE_SIZE // max(crop.shape[:2]), 1)
    picture = to_display(crop, EXPOSURE).repeat(repeat, axis=0).repeat(repeat, axis=1)
    box = (float(low[0]), float(low[1]), float(high[0]) + 1.0, float(high[1]) + 1.0)
    return int(rows[middle]), box, picture
