"""The plain projection of the training photographs onto the mesh, seen from another camera.

It knows neither materials nor light: for each pixel's surface point, the radiance of the training pixels that
see it, weighted by how alike their directions are and how near they are (after C. Buehler et al.,
Unstructured Lumigraph Rendering, SIGGRAPH 2001). Where the mesh is missed, points are infinitely far.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates

from ..capture.views import View
from ..conventions import project
from ..pixels.store import NO_TRIANGLE, PixelStore, TracedView

# A point is seen where the surface of a pixel is at most so many pixel widths nearer or farther.
REACH = 2.0
# Weight of a photograph: 1 / (1 - cosine of the angle between the directions + this).
ANGLE = 0.01
LEAST_COSINE = 0.1  # between a surface and a direction, for the tolerance of depth
# Most photographs that are projected into a view, those that show most of it.
MOST_VIEWS = 24
SAMPLE = 97  # every so many pixels of a view decide which photographs show most of it
FAR = 1.0e4  # metres, of what lies outside of the mesh
FLOOR = 1e-3  # radiance in units of the capture's median, below which logarithms do not fall


def projected(pixels: PixelStore, place: float, view: View, traced: TracedView) -> np.ndarray:
    """The training photographs as they are seen from a camera, (H, W, 3) float32.

    A pixel whose point no photograph shows has the radiance of the nearest one that has.

    Args:
        pixels: of the training views; those that are left out show nothing.
        place: standard deviation of the place of surfaces, metres.
        view: the camera; it must not be one of the training views.
        traced: the first surfaces of its pixels.
    """
    outside = traced.triangle == NO_TRIANGLE
    origin, direction = view.rays()
    position = np.where(outside[:, None], origin + FAR * direction, traced.position)
    points, camera = (position, traced.normal, outside), np.asarray(view.camera_to_world)[:3, 3]
    few = [each[::SAMPLE] for each in points]
    views = range(len(pixels.views))
    shown = [int(np.count_nonzero(_seen(pixels, index, few, camera, place)[0])) for index in views]
    order = [index for index in np.argsort(shown, kind="stable")[::-1][:MOST_VIEWS] if shown[index]]
    total, sums = np.zeros(len(position)), np.zeros((len(position), 3))
    for index in order:
        rows, weight, where = _seen(pixels, int(index), points, camera, place)
        # Of logarithms, as of display values, the mean is not that of a single highlight.
        radiance = np.log(np.maximum(_sampled(pixels, int(index), where), FLOOR))
        total[rows] += weight
        sums[rows] += weight[:, None] * radiance
    shape = (view.height, view.width)
    image = np.exp(sums / np.maximum(total, 1e-30)[:, None]).astype(np.float32).reshape(*shape, 3)
    unseen = total.reshape(shape) == 0.0
    if unseen.all():
        return image
    nearest = distance_transform_edt(unseen, return_distances=False, return_indices=True)
    return np.asarray(image[tuple(nearest)])


def _seen(
    pixels: PixelStore, index: int, points: Sequence[np.ndarray], camera: np.ndarray, place: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(M,) int64 points that a training view shows, (M,) their weights, and (M, 2) x and y there, pixels.

    Args:
        points: position (N, 3) metres, normal (N, 3) and whether it is outside (N,), of what a camera sees.
        camera: (3,) its place, metres.
    """
    position, normal, outside = points
    view = pixels.views[index]
    pose = np.asarray(view.camera_to_world, np.float64)
    where, depth = project(position, view)
    chosen = np.flatnonzero(
        ((where >= 0.5) & (where <= np.array([view.width, view.height]) - 0.5)).all(axis=1)
    )
    where, depth = where[chosen], depth[chosen]
    column, row = np.rint(where - 0.5).astype(np.int64).T
    pixel = pixels.rows(index).start + row * view.width + column
    triangle = np.asarray(pixels.triangle[pixel])
    toward = pose[:3, 3] - position[chosen]
    toward /= np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-12)
    cosine = np.abs((toward * normal[chosen]).sum(axis=1))
    met = (np.asarray(pixels.position[pixel]) - pose[:3, 3]) @ pose[:3, 2]
    reach = REACH * depth / view.fx / np.maximum(cosine, LEAST_COSINE) + REACH * place
    outside = outside[chosen]
    on_mesh = (triangle >= 0) & (np.abs(met - depth) < reach)
    visible = np.where(outside, triangle == NO_TRIANGLE, on_mesh)
    chosen, toward = chosen[visible], toward[visible]
    back = camera - position[chosen]
    distance = np.linalg.norm(back, axis=1)
    alike = (toward * back).sum(axis=1) / np.maximum(distance, 1e-12)
    nearer = np.minimum(distance / depth[visible], 1.0) ** 2
    facing = np.where(outside[visible], 1.0, np.maximum(cosine[visible], LEAST_COSINE))
    return chosen, facing * nearer / (1.0 - np.minimum(alike, 1.0) + ANGLE), where[visible]


def _sampled(pixels: PixelStore, index: int, where: np.ndarray) -> np.ndarray:
    """(M, 3) radiance of a training view at x and y (M, 2), bilinear."""
    view, image = pixels.views[index], np.asarray(pixels.radiance[pixels.rows(index)])
    planes = np.moveaxis(image.reshape(view.height, view.width, 3), 2, 0)
    place = where[:, ::-1].T - 0.5
    return np.stack([map_coordinates(plane, place, order=1, mode="nearest") for plane in planes], axis=1)
