"""The base colour of texels from one photograph, by the factorised rendering (paper Eq. 5).

A texel that a view sees has base colour (I - offset) / slope (`optics.factorised.color_line`): I is the
photograph at full size; slope and offset consist of the shadings of the pixels of light around it that see
the same surface and part. So shadings go along surfaces, never across a border.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..capture.views import View
from ..light.emitters import CHUNK
from ..material.projection import lower_levels
from ..optics.factorised import color_line
from ..pixels.camera_rays import opaque_vector
from ..surface.room import Room
from .texels import Texels

MIN_COSINE = 0.17  # of the angle between normal and view, below which texels are stretched too much
MARGIN = 1.0  # pixels around a texel in which its surface must be seen: blur mixes neighbours
PLANE = 0.4  # distance from a texel's plane that still is its surface, in widths of a pixel of light
MIN_NORMAL = 0.8  # least cosine between a texel's normal and that of a pixel of light beside it
MIN_MATCH = 0.3  # least share of the weight of the 3 x 3 pixels of light that sees the texel's surface
# Error of L_d where it slopes evenly, as a share of its change in a pixel of light: an edge within a pixel is
# an even slope, too.
SLOPE_ERROR = 0.4
VIEW_ERROR = 0.05  # relative error of L_d with which a view has half the weight of one without
GLOSS = 0.5  # share of gloss in a photograph's radiance from which it does not count for base colour


@dataclass(frozen=True)
class LightPixels:
    """The M pixels of light of one view, with what is known of the surfaces they see; flat Dr.Jit arrays.

    Attributes:
        view: at light resolution.
        position, normal: (M, 3).
        part: (M,), negative where a pixel does not count.
        pure: (M,), whether the whole pixel sees one smooth surface.
        diffuse: (M, 3) L_d in the unit of the photographs' radiance.
        specular: (M, K, 2, 3) L_s0 and L_s1 at each roughness level.
    """

    view: View
    position: mi.Float
    normal: mi.Float
    part: mi.Int32
    pure: mi.Bool
    diffuse: mi.Float
    specular: mi.Float


@dataclass(frozen=True)
class Seen:
    """The n texels that one view sees, and their base colours.

    Attributes:
        texel: (n,) int64.
        color: (n, 3) float32 base colour.
        weight: (n,) float32 by density, gloss and error, relative to other views.
        error: (n,) float32 relative error of L_d, as far as pixels of light do not resolve it.
    """

    texel: np.ndarray
    color: np.ndarray
    weight: np.ndarray
    error: np.ndarray


def see_texels(
    texels: Texels,
    candidates: np.ndarray,
    room: Room,
    part: np.ndarray,
    normals: np.ndarray,
    light: LightPixels,
    view: View,
    radiance: np.ndarray,
    levels: np.ndarray,
) -> Seen:
    """The base colours of one view.

    Args:
        candidates: (n,) int64 texels that the view may see, one at least.
        part: (T,) int32 part of each triangle.
        normals: (T, 3) float32 unit normals of the triangles.
        light: shadings of the view at light resolution.
        view: the same view at full size.
        radiance: (H, W, 3) float32 of the photograph, in the unit of the shadings; NaN where it is clipped.
        levels: (K,) roughness of the baked shadings.
    """
    pyramid, parts = _Pyramid.of(radiance), mi.Int32(part.astype(np.int32))
    found = []
    for first in range(0, len(candidates), CHUNK):
        rows = candidates[first : first + CHUNK]
        triangle = texels.triangle[rows]
        level, share = lower_levels(levels, texels.roughness[rows])
        points = _Points(
            mi.Point3f(np.ascontiguousarray(texels.position[rows].T)),
            mi.Vector3f(np.ascontiguousarray(normals[triangle].T.astype(np.float32))),
            mi.Int32(part[triangle].astype(np.int32)),
            mi.UInt32(level.astype(np.uint32)),
            mi.Float(share),
            mi.Float(np.asarray(texels.metallic[rows], np.float32)),
            mi.Float(np.asarray(texels.size[rows], np.float32)),
        )
        color, weight, error, seen = _see(points, light, pyramid, room, parts, view, len(levels))
        dr.eval(color, weight, error, seen)
        kept = np.flatnonzero(np.array(seen))
        found.append(Seen(rows[kept], np.array(color).T[kept], np.array(weight)[kept], np.array(error)[kept]))
    return Seen(*(np.concatenate(column) for column in zip(*map(astuple, found), strict=True)))


@dataclass
class _Points:
    position: mi.Point3f
    normal: mi.Vector3f
    part: mi.Int32
    level: mi.UInt32
    share: mi.Float
    metallic: mi.Float
    size: mi.Float


@dataclass
class _Pyramid:
    """All levels of a photograph behind each other, where each begins, and (L, 2) widths and heights."""

    image: mi.Float
    starts: mi.UInt32
    sizes: mi.UInt32

    @classmethod
    def of(cls, radiance: np.ndarray) -> _Pyramid:
        """That of a photograph (H, W, 3)."""
        levels = [np.asarray(radiance, np.float32)]
        while len(levels) < 5 and min(levels[-1].shape[:2]) >= 4:
            last = levels[-1]
            height, width = last.shape[0] // 2, last.shape[1] // 2
            levels.append(last[: 2 * height, : 2 * width].reshape(height, 2, width, 2, 3).mean(axis=(1, 3)))
        starts = np.cumsum([0, *(level.shape[0] * level.shape[1] for level in levels[:-1])])
        sizes = np.array([(level.shape[1], level.shape[0]) for level in levels], np.uint32)
        flat = np.concatenate([level.reshape(-1) for level in levels])
        return cls(mi.Float(flat), mi.UInt32(starts.astype(np.uint32)), mi.UInt32(sizes.reshape(-1)))


def _see(
    points: _Points,
    light: LightPixels,
    pyramid: _Pyramid,
    room: Room,
    parts: mi.Int32,
    view: View,
    levels: int,
) -> tuple[mi.Color3f, mi.Float, mi.Float, mi.Bool]:
    """Base colour, weight, error and whether the texel is seen."""
    pose = np.asarray(view.camera_to_world, np.float64)
    axes = [opaque_vector(mi.Vector3f, pose[:3, axis]) for axis in range(3)]
    eye = opaque_vector(mi.Point3f, pose[:3, 3])

    def opaque(value: float) -> mi.Float:
        return dr.opaque(mi.Float, float(value))

    # Where the view sees the texel
    along = points.position - eye
    local = mi.Vector3f(*(dr.dot(along, axis) for axis in axes))
    seen = local.z > 1e-3
    depth = dr.select(seen, local.z, 1.0)
    fx, fy, cx, cy = opaque(view.fx), opaque(view.fy), opaque(view.cx), opaque(view.cy)
    x, y = fx * local.x / depth + cx, fy * local.y / depth + cy
    width, height = opaque(view.width), opaque(view.height)
    seen &= (x >= MARGIN) & (y >= MARGIN) & (x <= width - MARGIN) & (y <= height - MARGIN)
    cosine = -dr.dot(points.normal, along) / dr.norm(along)
    normal = dr.select(cosine < 0.0, -points.normal, points.normal)
    cosine = dr.abs(cosine)
    seen &= cosine > MIN_COSINE

    # Shadings of the 3 x 3 pixels of light around it that see its surface, by quadratic B-splines
    light_width, light_height = opaque(light.view.width), opaque(light.view.height)
    columns, rows = mi.Int32(light_width), mi.Int32(light_height)
    lx, ly = x * (light_width / width), y * (light_height / height)
    column = dr.clip(mi.Int32(dr.floor(lx)), 1, columns - 2)
    row = dr.clip(mi.Int32(dr.floor(ly)), 1, rows - 2)
    reach = PLANE * depth * (width / light_width) / fx + 2.0 * room.noise
    matched, total = mi.Float(0.0), mi.Float(0.0)
    diffuse, s0, s1 = mi.Color3f(0.0), mi.Color3f(0.0), mi.Color3f(0.0)
    shades: list[tuple[mi.Float, mi.Bool]] = []
    alone = mi.Bool(True)  # whether all nine see this surface and nothing else
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            pixel = mi.UInt32((row + dy) * columns + column + dx)
            place = dr.gather(mi.Point3f, light.position, pixel, seen)
            facing = dr.gather(mi.Vector3f, light.normal, pixel, seen)
            same = seen & (dr.gather(mi.Int32, light.part, pixel, seen) == points.part)
            same &= dr.abs(dr.dot(place - points.position, normal)) < reach
            same &= dr.dot(facing, normal) > MIN_NORMAL
            weight = _spline(lx - (mi.Float(column + dx) + 0.5)) * _spline(ly - (mi.Float(row + dy) + 0.5))
            total += weight
            weight = dr.select(same, weight, 0.0)
            alone &= same & dr.gather(mi.Bool, light.pure, pixel, seen)
            light_here = dr.gather(mi.Color3f, light.diffuse, pixel, same)
            matched += weight
            diffuse += weight * light_here
            shades.append((dr.mean(light_here), same))
            at = (pixel * levels + points.level) * 2
            for number, step in ((0, at), (1, at + 2)):
                lobe = weight * (points.share if number else 1.0 - points.share)
                s0 += lobe * dr.gather(mi.Color3f, light.specular, step, same)
                s1 += lobe * dr.gather(mi.Color3f, light.specular, step + 1, same)
    seen &= matched > MIN_MATCH * total
    scale = dr.select(seen, 1.0 / matched, 0.0)
    slope, offset = color_line(diffuse * scale, s0 * scale, s1 * scale, points.metallic)
    error = _unresolved(shades, dr.mean(diffuse) * scale)

    # Whether the surface is seen, and nothing else, around the texel
    for dx, dy in ((-1, -1), (1, -1), (-1, 1), (1, 1)):
        active = seen & ~alone
        toward = axes[0] * ((x + dx * MARGIN - cx) / fx) + axes[1] * ((y + dy * MARGIN - cy) / fy) + axes[2]
        hit = room.intersect(mi.Ray3f(eye, dr.normalize(toward)), active)
        fits = hit.valid & (dr.abs(dr.dot(hit.position - points.position, normal)) < reach)
        fits &= dr.gather(mi.Int32, parts, hit.triangle, hit.valid) == points.part
        seen &= fits | ~active

    # The photograph, from the coarsest level of its pyramid whose pixels are not larger than the texel
    span = dr.maximum(points.size * fx / depth, 1.0)
    level = mi.UInt32(dr.clip(dr.floor(dr.log2(span)), 0, dr.width(pyramid.starts) - 1))
    start = dr.gather(mi.UInt32, pyramid.starts, level, seen)
    level_width = dr.gather(mi.UInt32, pyramid.sizes, 2 * level, seen)
    level_height = dr.gather(mi.UInt32, pyramid.sizes, 2 * level + 1, seen)
    shrunk = dr.power(0.5, mi.Float(level))
    u, v = x * shrunk - 0.5, y * shrunk - 0.5
    left = dr.clip(dr.floor(u), 0, mi.Float(level_width) - 2)
    top = dr.clip(dr.floor(v), 0, mi.Float(level_height) - 2)
    across, down = dr.clip(u - left, 0, 1), dr.clip(v - top, 0, 1)
    photograph = mi.Color3f(0.0)
    for dy in (0, 1):
        for dx in (0, 1):
            pixel = start + (mi.UInt32(top) + dy) * level_width + mi.UInt32(left) + dx
            share = (across if dx else 1.0 - across) * (down if dy else 1.0 - down)
            photograph += share * dr.gather(mi.Color3f, pyramid.image, pixel, seen)
    seen &= dr.all(dr.isfinite(photograph))

    color = (photograph - offset) / dr.maximum(slope, 1e-6)
    bright = dr.maximum(dr.mean(photograph), 1e-6)
    gloss = dr.mean(offset + color * points.metallic * s0 * scale) / bright
    seen &= (gloss < GLOSS) & (dr.mean(slope) > 1e-4)
    density = fx * fy * cosine / (depth * depth)
    weight = dr.power(density * 1e-4, 2.0) * (1.0 - gloss / GLOSS)
    weight /= 1.0 + (error / VIEW_ERROR) ** 2
    color = dr.clip(color, -0.5, 2.0)
    return color, weight, error, seen


def _unresolved(shades: list[tuple[mi.Float, mi.Bool]], mean: mi.Float) -> mi.Float:
    """Relative error of L_d in the middle of 3 x 3 pixels of light: how much it bends or slopes.

    It bends by its deviation from the mean of the neighbours on both sides, such as at a shadow's edge.
    Where only one of two sees the surface, half of its difference counts.

    Args:
        shades: L_d of each pixel, row by row, and whether it sees the same surface.
        mean: of those that do; stands for the middle where that does not.
    """
    middle = dr.select(shades[4][1], shades[4][0], mean)
    largest = mi.Float(0.0)
    for number in range(4):
        (one, first), (other, second) = shades[number], shades[8 - number]
        before, after = dr.select(first, one - middle, 0.0), dr.select(second, other - middle, 0.0)
        largest = dr.maximum(largest, dr.abs(before + after) * 0.5)
        largest = dr.maximum(largest, dr.abs(before - after) * (0.5 * SLOPE_ERROR))
    return largest / dr.maximum(middle, 1e-6)


def _spline(distance: mi.Float) -> mi.Float:
    """Quadratic B-spline of a distance in pixels."""
    far = dr.maximum(1.5 - dr.abs(distance), 0.0)
    return dr.select(dr.abs(distance) < 0.5, 0.75 - distance * distance, 0.5 * far * far)
