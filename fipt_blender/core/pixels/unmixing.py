"""The radiance of each surface in a mixed pixel: the photographed one is the sum of coverage times radiance.

The expected radiance of a fragment is that of pure pixels of its surface nearby. Where there are none, it is
that of all such fragments of the surface in the view, whose mean and variance expectation maximisation finds.
The difference between the photograph and the sum of expectations is distributed by their variances (the
posterior mean of a linear Gaussian model).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import mitsuba as mi
import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import spsolve

from ..capture.views import View
from ..radiometry.inversion import MODEL_ERROR
from ..run.per_view import LocalWorkers, Workers
from ..surface.room import Room
from .fragments import OUTSIDE, Fragments, trace_fragments
from .grouped import grouped_sums
from .store import LEFT_OUT, NO_TRIANGLE, PixelStore, ViewFunction

# The expected radiance of a fragment is that of pure pixels of its surface within this distance in pixels, at
# most this many of them.
REACH = 4
NEIGHBOURS = 4
# Relative standard deviation of the radiance of a surface within that distance, besides their own spread.
VARIATION = 0.1
# Standard deviation of an unknown radiance before anything is known, as a multiple of the photographed one.
UNKNOWN = 3.0
# Iterations by which mean and variance of unknown radiances are found; more change little.
ITERATIONS = 6
# Prior of the relative standard deviation of the radiance of one surface in one view, and the number of
# fragments to which this prior is equivalent.
SPREAD, SPREAD_FRAGMENTS = 0.5, 0.2
# Relative standard deviation of a photographed radiance.
NOISE = 0.02
# Standard deviation of a coverage by 16 samples: 0.035 at edges of any slope, 0.048 for strips.
COVERAGE_ERROR = 0.04
# Radiance (in units of the capture's median) that is added to a radiance before it is multiplied by
# MODEL_ERROR, the relative error of the model at a pure pixel.
FLOOR = 0.05
# Pixels per chunk; each needs 16 rays.
CHUNK = 1 << 15


@dataclass(frozen=True)
class ViewPhotograph:
    """One view's pixels, arrays of H * W rows as in :class:`PixelStore`."""

    view: View
    radiance: np.ndarray
    position: np.ndarray
    triangle: np.ndarray
    pure: np.ndarray


def unmix_pixels(
    store: PixelStore,
    room: Room,
    labels: np.ndarray,
    progress: Callable[[float], None],
    workers: Workers | None = None,
) -> None:
    """Fill `store.own` and `store.weight`; needs the photographs and the pure pixels.

    Args:
        labels: (T,) int surface of each triangle: its part, or its piece of the mesh where parts are unknown.
        progress: called with the share (0..1) that is done.
        workers: unmix the views; this process where None.
    """

    def views() -> Iterator[ViewPhotograph]:
        for index, view in enumerate(store.views):
            rows = store.rows(index)
            arrays = store.radiance, store.position, store.triangle, store.pure
            yield ViewPhotograph(view, *(np.array(array[rows]) for array in arrays))

    unmixed = (workers or LocalWorkers()).map(ViewFunction(_unmix_view, (room, labels)), views())
    for done, (index, (own, weight)) in enumerate(unmixed, 1):
        rows = store.rows(index)
        store.own[rows], store.weight[rows] = own, weight
        progress(done / len(store.views))


def keep_pure(store: PixelStore) -> None:
    """Fill `store.own` and `store.weight` without unmixing: mixed pixels have no weight."""
    for index in range(len(store.views)):
        rows = store.rows(index)
        store.own[rows], store.weight[rows] = store.radiance[rows], store.pure[rows]


def standard_error(own: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(n,) standard error of the mean over the channels of unmixed radiances (n, 3) of weights (n,)."""
    model = MODEL_ERROR * (own.mean(axis=1) + FLOOR)
    return model * np.sqrt(np.maximum(1.0 / np.maximum(weight, 1e-12) - 1.0, 0.0))


def _unmix_view(room: Room, labels: np.ndarray, photograph: ViewPhotograph) -> tuple[np.ndarray, np.ndarray]:
    """(H * W, 3) float32 radiance of the surface at each pixel's centre, and (H * W,) float32 weights."""
    triangle, device_labels = photograph.triangle, mi.Int32(labels.astype(np.int32))
    label = np.where(triangle >= 0, labels[np.maximum(triangle, 0)], OUTSIDE)
    own = photograph.radiance.copy()
    weight = photograph.pure.astype(np.float32)
    mixed = np.flatnonzero(~photograph.pure & (triangle != LEFT_OUT))
    for start in range(0, len(mixed), CHUNK):
        pixels = mixed[start : start + CHUNK]
        fragments = trace_fragments(room, device_labels, photograph.view, pixels)
        fragments, mean, variance, known = expected(fragments, photograph, label, pixels)
        radiance = photograph.radiance[pixels].astype(np.float64)
        mean, variance = posterior(
            fragments, radiance, *fit_unknown(fragments, radiance, mean, variance, known)
        )
        chosen = at_centres(fragments, label[pixels], photograph.position[pixels])
        found = np.flatnonzero(chosen >= 0)
        chosen = chosen[found]
        own[pixels[found]] = mean[chosen]
        weight[pixels[found]] = weights(mean[chosen], variance[chosen])
    return own, weight


def expected(
    fragments: Fragments, photograph: ViewPhotograph, label: np.ndarray, pixels: np.ndarray
) -> tuple[Fragments, np.ndarray, np.ndarray, np.ndarray]:
    """Expected radiance of fragments before the pixel itself is considered.

    Args:
        fragments: of the M pixels `pixels` of the view.
        label: (H * W,) label of what each pixel's centre sees.

    Returns:
        the fragments (those of one pixel and label without pure pixels nearby are merged), their (F, 3)
        mean and (F, 3) variance, and (F,) bool, whether there are pure pixels nearby.
    """
    usable = photograph.pure & (photograph.triangle >= NO_TRIANGLE)
    size = photograph.view.height, photograph.view.width
    place = pixels[fragments.pixel]
    sums = _nearby(usable, label, size, place, fragments.label, photograph.radiance)
    known = sums[0] > 0.0
    fragments, index = fragments.merged(np.where(known, np.arange(len(known)), -1))
    photographed = photograph.radiance[place[index]].astype(np.float64)
    known = known[index]
    total, weighted, squares = (values[index] for values in sums)
    total = np.maximum(total, 1e-12)[:, None]
    mean = np.where(known[:, None], weighted / total, photographed)
    spread = np.maximum(squares / total - mean**2, 0.0)
    grey = mean.mean(axis=1, keepdims=True)
    variance = np.where(known[:, None], spread + (VARIATION * grey) ** 2, (UNKNOWN * grey) ** 2)
    return fragments, mean, variance, known


def _nearby(
    usable: np.ndarray,
    label: np.ndarray,
    size: tuple[int, int],
    place: np.ndarray,
    wanted: np.ndarray,
    radiance: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sums over the nearest usable pixels of the label `wanted` (F,) around the pixels `place` (F,).

    Args:
        usable: (H * W,) bool. label: (H * W,). size: (H, W).
        radiance: (H * W, 3).

    Returns:
        (F,) sum of weights (inverse squared distance) and (F, 3) weighted sums of radiance and its square.
    """
    height, width = size
    row, column = np.divmod(place, width)
    total, count = np.zeros(len(place)), np.zeros(len(place), np.int64)
    sums, squares = np.zeros((2, len(place), 3))
    open_ones = np.arange(len(place))
    for down, right in _offsets(REACH):
        y, x = row[open_ones] + down, column[open_ones] + right
        inside = (y >= 0) & (y < height) & (x >= 0) & (x < width)
        near = np.where(inside, y * width + x, 0)
        alike = inside & usable[near] & (label[near] == wanted[open_ones])
        chosen, weight = open_ones[alike], 1.0 / (down**2 + right**2)
        total[chosen] += weight
        count[chosen] += 1
        values = radiance[near[alike]].astype(np.float64)
        sums[chosen] += weight * values
        squares[chosen] += weight * values**2
        open_ones = open_ones[count[open_ones] < NEIGHBOURS]
    return total, sums, squares


def _offsets(reach: int) -> list[tuple[int, int]]:
    """(down, right) of all pixels at most `reach` rows and columns away, by their distance."""
    steps = range(-reach, reach + 1)
    offsets = [(down, right) for down in steps for right in steps if down or right]
    return sorted(offsets, key=lambda step: (step[0] ** 2 + step[1] ** 2, step))


def posterior(
    fragments: Fragments, radiance: np.ndarray, mean: np.ndarray, variance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and variance of each fragment's radiance, given the photographed radiance of its pixel.

    Args:
        radiance: (M, 3) photographed.
        mean, variance: (F, 3) expected.

    Returns:
        (F, 3) each; means are not negative, variances include the error of the coverage.
    """
    coverage, pixel = fragments.coverage[:, None], fragments.pixel
    added = partial(grouped_sums, group=pixel, count=len(radiance))
    residual = radiance - added(coverage * mean)
    noise = (NOISE * radiance) ** 2 + COVERAGE_ERROR**2 * added((mean - radiance[pixel]) ** 2) + 1e-12
    gain = coverage * variance / (added(coverage**2 * variance) + noise)[pixel]
    result = np.maximum(mean + gain * residual[pixel], 0.0)
    # An error of the coverage shifts radiance between the fragment and the rest of its pixel. It is part of
    # the noise only where the expectations determine the contrast between them.
    contrast = np.abs(result - radiance[pixel]) / np.maximum(1.0 - coverage, 1e-12)
    shifted = np.where(coverage < 1.0, (gain * COVERAGE_ERROR * contrast) ** 2, 0.0)
    return result, variance * (1.0 - gain * coverage) + shifted


def fit_unknown(
    fragments: Fragments, radiance: np.ndarray, mean: np.ndarray, variance: np.ndarray, known: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Expected radiance, with that of unknown fragments replaced by mean and variance of their label.

    Args:
        radiance: (M, 3) photographed.
        mean, variance: (F, 3) as :func:`expected` gives them.
        known: (F,) bool; where not, the values of all fragments of a label have one distribution.

    Returns:
        (F, 3) mean and (F, 3) variance.
    """
    mean, variance = mean.copy(), variance.copy()
    pixels = np.unique(fragments.pixel[~known])
    involved = np.flatnonzero(np.isin(fragments.pixel, pixels))
    if not len(involved):
        return mean, variance
    place = np.searchsorted(pixels, fragments.pixel[involved])
    some = Fragments(
        place, fragments.label[involved], fragments.coverage[involved], fragments.position[involved]
    )
    unknown = np.flatnonzero(~known[involved])
    group = np.unique(some.label[unknown], return_inverse=True)[1].ravel()
    count = np.bincount(group)[:, None]
    chosen, photographed = involved[unknown], radiance[pixels]
    first = grouped_sums(photographed[place[unknown]], group) / count
    spread = (SPREAD * first) ** 2
    for _ in range(ITERATIONS):
        mean[chosen], variance[chosen] = 0.0, spread[group]
        centre = _least_squares(some, photographed, mean[involved], variance[involved], unknown, group, first)
        mean[chosen] = centre[group]
        found, errors = (
            values[unknown] for values in posterior(some, photographed, mean[involved], variance[involved])
        )
        squares = (
            grouped_sums(errors + (found - centre[group]) ** 2, group)
            + SPREAD_FRAGMENTS * (SPREAD * centre) ** 2
        )
        spread = squares / (count + SPREAD_FRAGMENTS)
    variance[chosen] = spread[group]
    return mean, variance


def _least_squares(
    fragments: Fragments,
    radiance: np.ndarray,
    mean: np.ndarray,
    variance: np.ndarray,
    unknown: np.ndarray,
    group: np.ndarray,
    first: np.ndarray,
) -> np.ndarray:
    """(L, 3) mean radiance of L labels that explains pixels (M, 3) best, not negative.

    Args:
        mean, variance: (F, 3) of the fragments; the mean of unknown ones is 0.
        unknown: (U,) unknown fragments. group: (U,) label of each, from 0.
        first: (L, 3) guess, whose standard deviation is UNKNOWN times its mean.
    """
    coverage, pixel = fragments.coverage[:, None], fragments.pixel
    shape = len(radiance), len(first)
    shares = csr_matrix((fragments.coverage[unknown], (pixel[unknown], group)), shape)
    explained, spread = (
        grouped_sums(values, pixel, len(radiance)) for values in (coverage * mean, coverage**2 * variance)
    )
    weight = 1.0 / (spread + (NOISE * radiance) ** 2 + 1e-12)
    prior = 1.0 / ((UNKNOWN * first.mean(axis=1)) ** 2 + 1e-12)
    result = np.empty_like(first)
    for channel in range(3):
        weighted = shares.multiply(weight[:, channel, None]).T.tocsr()
        right = weighted @ (radiance - explained)[:, channel] + prior * first[:, channel]
        result[:, channel] = spsolve((weighted @ shares + diags(prior)).tocsc(), right)
    return np.maximum(result, 0.0)


def at_centres(fragments: Fragments, label: np.ndarray, position: np.ndarray) -> np.ndarray:
    """(M,) int64 fragment at the centre of each pixel, -1 where no sample met its surface.

    Args:
        label: (M,) of what the centre sees. position: (M, 3) world metres.
    """
    alike = np.flatnonzero(fragments.label == label[fragments.pixel])
    pixel = fragments.pixel[alike]
    distance = np.linalg.norm(fragments.position[alike] - position[pixel], axis=1)
    order = np.lexsort((distance, pixel))
    pixels, first = np.unique(pixel[order], return_index=True)
    result = np.full(len(label), -1, np.int64)
    result[pixels] = alike[order][first]
    return result


def weights(mean: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """(n,) information of radiances (n, 3) of these variances, relative to that of exact ones.

    Either has the error of the model as well, see MODEL_ERROR.
    """
    model = (MODEL_ERROR * (mean.mean(axis=1) + FLOOR)) ** 2
    return model / (model + variance.mean(axis=1))
