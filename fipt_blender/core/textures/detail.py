"""Detail of the photographs on the texels: what they show above the resolution at which light was solved.

Each view that has more pixels than its pixels of light gives a base colour of the texels that it sees
(:mod:`.texel_views`). Its low frequencies are replaced by those of the estimate, so that errors of light,
exposure and vignetting don't matter and views need no seams; the weighted mean of the views is detail as far
as they agree (a Wiener filter). Photographs are decoded one at a time, each once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import mitsuba as mi
import numpy as np

from ..capture.averaging import means
from ..capture.encoded import is_clipped, srgb_decoded
from ..capture.views import View, load_capture
from ..light.baking import ShadingStore
from ..light.observations import median_footprint
from ..optics.lights import LUMINANCE
from ..parts.labels import NO_PART
from ..pixels.store import PixelStore
from ..run.documents import read_document
from ..run.errors import FiptError
from ..run.kinds import Pixels
from ..run.messages import Reporter
from ..run.result_contents import Stages
from ..run.run_files import Resolution
from ..run.runfolder import RunFolder, write_json
from ..run.store import DamagedStage, loaded, saved, stages_of, write_arrays
from ..surface.room import Room
from ..surface.smoothing import SmoothingGrid
from .texel_views import LightPixels, Seen, see_texels
from .texels import Texels

# Width of the cells of the low-pass filter in median widths of a pixel of light: what is wider than about two
# cells is the estimate's.
CELL = 2.5
# By which factor the low frequencies of a view are corrected at most.
MAX_GAIN = 4.0
# Texels in a block that is culled as a whole.
BLOCK = 1 << 12
# Least number of texels of a part that two views saw, from which its noise is known.
FEW_TEXELS = 500
_LUMINANCE = LUMINANCE.astype(np.float32)


@dataclass(frozen=True)
class DetailInput:
    """What the detail of texels is made from; see :func:`load_input`.

    Attributes:
        photographs: the training views at full size, in the order of `pixels`.
        pixels, shadings: at light resolution.
        response: (256,) logarithm of the light of each code, for photographs that are not HDR; None without
            such.
    """

    photographs: list[View]
    pixels: PixelStore
    shadings: ShadingStore
    response: np.ndarray | None = None

    def larger(self) -> list[int]:
        """Indices of the views whose photographs have more pixels than light has."""
        return [
            index
            for index, (view, light) in enumerate(zip(self.photographs, self.pixels.views, strict=True))
            if view.width * view.height > light.width * light.height
        ]


@dataclass(frozen=True)
class _UsedView:
    """A view at light resolution."""

    name: str
    width: Pixels
    height: Pixels


@dataclass(frozen=True)
class _UsedViews:
    """stage/views.json: the views, and what :func:`.store.saved` says of their pixels and shadings."""

    views: tuple[_UsedView, ...]
    light: dict[str, Any]


@dataclass(frozen=True)
class SolvedLight:
    """What an estimation has solved light with: pixels and the last shadings."""

    pixels: PixelStore
    shadings: ShadingStore


def remember_light(run: RunFolder, light: SolvedLight) -> None:
    """Write where the pixels and shadings of an estimation are, and to which views they belong."""
    views, root = light.pixels.views, run.stage.resolve()
    listed = tuple(_UsedView(view.name, view.width, view.height) for view in views)
    document = saved(light, run.stage / "light", root, {"views": views})
    write_json(run.stage / "views.json", _UsedViews(listed, document))


def solved_light(run: RunFolder, views: list[View]) -> SolvedLight:
    """What :func:`remember_light` wrote; `views`: the same, at light resolution."""
    path = run.stage / "views.json"
    try:
        light = read_document(path, _UsedViews).light
        return cast(SolvedLight, loaded(light, SolvedLight, run.stage.resolve(), {"views": views}))
    except (ValueError, DamagedStage) as error:
        raise FiptError("file-damaged.solved-light", path=path, error=error) from None


def load_input(run: RunFolder, reporter: Reporter | None = None) -> DetailInput | None:
    """The views of a finished estimation; None where detail is off, or no photograph has more than light has.

    Args:
        reporter: is warned where the files that detail needs are gone.
    """
    settings = run.read()
    path = run.stage / "views.json"
    if not settings.detail or not path.exists():
        return None
    document = read_document(path, _UsedViews)
    by_name = {view.name: view for view in load_capture(run).train}
    lost = "another estimation was begun" if not _is_kept(run, document.light) else ""
    if any(view.name not in by_name for view in document.views):
        lost = "the capture has changed"
    if lost:
        if reporter is not None:
            reporter.warning("detail-lost", lost=lost)
        return None
    photographs = [by_name[view.name] for view in document.views]
    lights = [by_name[view.name].resized(view.width, view.height) for view in document.views]
    pairs = zip(photographs, lights, strict=True)
    if all(view.width * view.height <= light.width * light.height for view, light in pairs):
        return None
    light = solved_light(run, lights)
    photometry = run.statistics().get("photometry")
    response = np.array(photometry["log_curve"]) if photometry else None
    return DetailInput(photographs, light.pixels, light.shadings, response)


def _is_kept(run: RunFolder, light: dict[str, Any]) -> bool:
    """Whether the stages that hold pixels and shadings are still those that the results were made of.

    A later estimation removes what it makes anew when it begins, whether it ends or not.

    Args:
        light: what :func:`.store.saved` says of them.
    """
    kept = run.results / run.stages_json.name
    if not kept.exists():
        return True  # the results are being written
    before, now = (read_document(path, Stages) for path in (kept, run.stages_json))
    present = now.stages.keys() - set(now.dropped)
    return all(name in present and before.keys.get(name) == now.keys[name] for name in stages_of(light))


def write_resolution(run: RunFolder, triangles: int) -> None:
    """Write results/resolution.npz: the texels a metre that photographs resolve on the room's triangles.

    It is the median over the pixels of light that see a triangle of the density of the photograph's pixels.
    There is no such file where the photographs have no more pixels than light.
    """
    run.resolution_npz.unlink(missing_ok=True)
    given = load_input(run)
    if given is None:
        return
    pixels, seen, density = given.pixels, [], []
    for index in given.larger():
        rows, view = pixels.rows(index), given.photographs[index]
        triangle = np.asarray(pixels.triangle[rows])
        hit = np.flatnonzero(triangle >= 0)
        away = np.asarray(pixels.position[rows])[hit] - view.camera_to_world[:3, 3]
        seen.append(triangle[hit])
        density.append(np.sqrt(view.fx * view.fy) / np.maximum(away @ view.camera_to_world[:3, 2], 1e-3))
    triangle, values = np.concatenate(seen), np.concatenate(density)
    order = np.lexsort((values, triangle))
    found, start, number = np.unique(triangle[order], return_index=True, return_counts=True)
    result = np.full(triangles, np.nan, np.float32)
    result[found] = values[order][start + number // 2]
    write_arrays(run.resolution_npz, Resolution(result))


def add_detail(
    given: DetailInput,
    room: Room,
    part: np.ndarray,
    texels: Texels,
    progress: Callable[[float], None] = lambda fraction: None,
) -> np.ndarray:
    """(N, 3) float32 base colour of texels with the photographs' detail.

    Args:
        part: (T,) int part of each triangle, -1 without one.
    """
    count = len(texels)
    normals = room.normals.astype(np.float32)
    width = CELL * median_footprint(given.pixels)
    cells = SmoothingGrid.around(texels.position, part, texels.triangle, width)
    starts = np.arange(0, len(texels.position), BLOCK)
    low, high = (reduce.reduceat(texels.position, starts) for reduce in (np.minimum, np.maximum))
    total = Totals.of(count)
    larger = given.larger()
    for done, index in enumerate(larger, 1):
        view = given.photographs[index]
        rows = _candidates(view, low, high, count)
        light = light_pixels(given, index, part)
        if len(rows) and light is not None:
            radiance = photograph(given, index)
            seen = see_texels(texels, rows, room, part, normals, light, view, radiance, given.shadings.levels)
            total.add(seen, with_low_frequencies(seen, texels, cells), texels.base_color)
        progress(done / (len(larger) + 1))
    return total.result(texels, cells, part)


def light_pixels(given: DetailInput, index: int, part: np.ndarray) -> LightPixels | None:
    """The pixels of light of one view; those that see nothing have a part below `NO_PART`. None if all do."""
    pixels = given.pixels
    rows = pixels.rows(index)
    triangle = np.asarray(pixels.triangle[rows])
    if (triangle < 0).all():
        return None
    own = np.where(triangle >= 0, part[np.maximum(triangle, 0)], NO_PART - 1)
    arrays = pixels.position, pixels.normal, given.shadings.diffuse, given.shadings.specular
    position, normal, diffuse, specular = (
        mi.Float(np.array(array[rows], np.float32).reshape(-1)) for array in arrays
    )
    pure = mi.Bool(np.array(pixels.pure[rows]))
    return LightPixels(
        pixels.views[index], position, normal, mi.Int32(own.astype(np.int32)), pure, diffuse, specular
    )


def photograph(given: DetailInput, index: int) -> np.ndarray:
    """(H, W, 3) float32 radiance of a photograph in the unit of the pixels; NaN where clipped or masked.

    The pixels' radiance has one scale and corrections of exposure: here their median ratio, a channel each.
    """
    view, pixels = given.photographs[index], given.pixels
    image = view.radiance()
    light = pixels.views[index]
    known = np.asarray(pixels.radiance[pixels.rows(index)]).reshape(light.height, light.width, 3)
    useless = np.zeros(image.shape[:2], bool)
    if view.encoded:
        useless |= is_clipped(image).any(axis=2)
        if given.response is not None:
            codes = srgb_decoded(np.arange(256) / 255.0)
            image = np.interp(image, codes, np.exp(given.response)).astype(np.float32)
    if (masked := view.masked()) is not None:
        useless |= masked
    mean = means(image, light.width, light.height)
    both = (mean > 0.0) & (known > 0.0)
    ratio = [
        np.median(known[..., c][both[..., c]] / mean[..., c][both[..., c]]) if both[..., c].any() else 1.0
        for c in range(3)
    ]
    image = image * np.array(ratio, np.float32)
    image[useless] = np.nan
    return image


def with_low_frequencies(seen: Seen, texels: Texels, cells: SmoothingGrid) -> np.ndarray:
    """(n, 3) the colours of one view with the low frequencies of the estimate."""
    position = texels.position[seen.texel]
    estimate = texels.base_color[seen.texel]
    smooth = cells.smooth(seen.texel, position, seen.weight, np.concatenate([seen.color, estimate], axis=1))
    ratio = smooth[:, 3:] / np.maximum(smooth[:, :3], 1e-4)
    return seen.color * np.clip(ratio, 1.0 / MAX_GAIN, MAX_GAIN)


@dataclass
class Totals:
    """Sums over the views, N texels; float32.

    Attributes:
        weight: (N,) of the weights w. squares: (N,) of w^2.
        change: (N, 3) of w e, where e is the view's base colour less the estimate's.
        power: (N,) of w y^2, where y is the luminance of e.
        light: (N,) of w s^2, where s is the error of y by the view's light.
    """

    weight: np.ndarray
    squares: np.ndarray
    change: np.ndarray
    power: np.ndarray
    light: np.ndarray

    @classmethod
    def of(cls, count: int) -> Totals:
        """Zero."""
        weight, squares, power, light = (np.zeros(count, np.float32) for _ in range(4))
        return cls(weight, squares, np.zeros((count, 3), np.float32), power, light)

    def add(self, seen: Seen, color: np.ndarray, estimate: np.ndarray) -> None:
        """Add a view: its corrected colours (n, 3); `estimate` (N, 3) of all texels."""
        rows, weight = seen.texel, seen.weight
        known = estimate[rows]
        change = color - known
        luminance = change @ _LUMINANCE
        self.weight[rows] += weight
        self.squares[rows] += weight * weight
        self.change[rows] += weight[:, None] * change
        self.power[rows] += weight * luminance * luminance
        self.light[rows] += weight * (seen.error * (known @ _LUMINANCE)) ** 2

    def result(self, texels: Texels, cells: SmoothingGrid, part: np.ndarray) -> np.ndarray:
        """(N, 3) the estimate with as much of the mean change as the views agree on."""
        result = np.array(texels.base_color)
        rows = np.flatnonzero(self.squares > np.finfo(np.float32).tiny)  # else no number of views follows
        if not len(rows):
            return result
        weight = self.weight[rows]
        change = self.change[rows] / weight[:, None]
        luminance = change @ _LUMINANCE
        # Effective number of views, and the variance of one view about their mean
        effective = weight * weight / self.squares[rows]
        variance = np.maximum(self.power[rows] / weight - luminance * luminance, 0.0)
        several = effective > 1.3
        if not several.any():
            return result  # no two views show the same texel: nothing tells detail from noise
        variance[several] *= effective[several] / (effective[several] - 1.0)
        owner = part[texels.triangle[rows]] + 1
        alone = _noise_of_parts(variance, several, owner)
        # Views share the light's error: their number does not lower it.
        noise = np.where(several, variance, alone[owner]) / effective + self.light[rows] / weight
        position = texels.position[rows]
        values = np.stack([luminance * luminance, noise], axis=1)
        smooth = cells.smooth(rows, position, np.ones(len(rows), np.float32), values)
        share = np.clip(1.0 - smooth[:, 1] / np.maximum(smooth[:, 0], 1e-12), 0.0, 1.0)
        result[rows] = np.clip(result[rows] + share[:, None] * change, 0.0, 1.0)
        return result


def _noise_of_parts(variance: np.ndarray, known: np.ndarray, part: np.ndarray) -> np.ndarray:
    """(parts,) variance of one view where only one saw a texel: the mean of its part, or of all.

    Args:
        variance: (n,) of one view at each texel.
        known: (n,) bool, whether several views saw it; of one at least.
        part: (n,) int part of each, from 0.
    """
    count = int(part.max(initial=0)) + 1
    number = np.bincount(part[known], minlength=count)
    sums = np.bincount(part[known], variance[known], count)
    everywhere = sums.sum() / number.sum()
    return np.where(number >= FEW_TEXELS, sums / np.maximum(number, 1), everywhere)


def _candidates(view: View, low: np.ndarray, high: np.ndarray, count: int) -> np.ndarray:
    """(n,) int64 texels of the blocks that are not wholly outside the view."""
    corners = np.stack(
        [np.where(pick, high, low) for pick in np.array(np.meshgrid(*[[False, True]] * 3)).reshape(3, 8).T],
        axis=1,
    )
    local = (corners - view.camera_to_world[:3, 3]) @ view.camera_to_world[:3, :3]
    x, y, z = local[..., 0] * view.fx, local[..., 1] * view.fy, local[..., 2]
    outside = (z <= 0).all(axis=1)
    outside |= (x + view.cx * z < 0).all(axis=1) | (x - (view.width - view.cx) * z > 0).all(axis=1)
    outside |= (y + view.cy * z < 0).all(axis=1) | (y - (view.height - view.cy) * z > 0).all(axis=1)
    blocks = np.flatnonzero(~outside)
    rows = (blocks[:, None] * BLOCK + np.arange(BLOCK)).reshape(-1)
    return rows[rows < count]
