"""A truncated signed distance field in blocks of voxels, which exist only near measured surfaces.

Source: Curless and Levoy 1996 (weighted mean of projective distances); Niessner et al. 2013 (blocks).
"""

from __future__ import annotations

import numpy as np

from .range_image import RangeImage

SIDE = 8  # voxels of a block along each axis
CELLS = SIDE**3
# Distances are cut off at this many voxels: wide enough for the noise of depth cameras, and for the cells
# that hold the surface to have all their corners.
TRUNCATION_VOXELS = 4.0
_AXIS_BITS = 20
_AXIS_OFFSET = 1 << (_AXIS_BITS - 1)
_CHUNK = 2048  # blocks that are updated at a time; bounds the memory


def pack(coordinates: np.ndarray) -> np.ndarray:
    """One int64 key for each integer position (..., 3) between -2^19 and 2^19; keys sort by x, y, z."""
    shifted = coordinates.astype(np.int64) + _AXIS_OFFSET
    return (shifted[..., 0] << 2 * _AXIS_BITS) | (shifted[..., 1] << _AXIS_BITS) | shifted[..., 2]


def unpack(keys: np.ndarray) -> np.ndarray:
    """The integer positions (..., 3) int64 of keys."""
    mask = (1 << _AXIS_BITS) - 1
    parts = [keys >> 2 * _AXIS_BITS, (keys >> _AXIS_BITS) & mask, keys & mask]
    return np.stack(parts, axis=-1) - _AXIS_OFFSET


class BlockVolume:
    """The field. Voxel (i, j, k) stands for the point (i, j, k) * voxel of the world.

    Args:
        voxel: metres.
        with_color: whether the range images have colors, whose means are kept.

    Attributes:
        keys: (B,) int64 packed block positions, in the order in which blocks were added.
        distance: (B, 512) float32 mean signed distance in units of the truncation, positive in front of
            surfaces; voxels of a block are in the order x, y, z.
        weight: (B, 512) float32 sum of the measurements' weights; those far behind a surface count less.
        color: (B, 512, 3) float32 mean color near surfaces, or None.
    """

    def __init__(self, voxel: float, with_color: bool = False) -> None:
        self.voxel = float(voxel)
        self.truncation = TRUNCATION_VOXELS * self.voxel
        self._count = 0
        self._keys = np.zeros(0, np.int64)
        self._distance = np.zeros((0, CELLS), np.float32)
        self._weight = np.zeros((0, CELLS), np.float32)
        self._color = np.zeros((0, CELLS, 3), np.float32) if with_color else None
        self._sorted = np.zeros(0, np.int64)
        self._order = np.zeros(0, np.int64)
        grid = np.mgrid[:SIDE, :SIDE, :SIDE].reshape(3, -1).T
        self._offsets = grid.astype(np.float64) * self.voxel

    @property
    def keys(self) -> np.ndarray:
        return self._keys[: self._count]

    @property
    def distance(self) -> np.ndarray:
        return self._distance[: self._count]

    @property
    def weight(self) -> np.ndarray:
        return self._weight[: self._count]

    @property
    def color(self) -> np.ndarray | None:
        return None if self._color is None else self._color[: self._count]

    def find(self, keys: np.ndarray) -> np.ndarray:
        """Indices of blocks, -1 for those that do not exist."""
        if not self._count:
            return np.full(keys.shape, -1, np.int64)
        place = np.minimum(np.searchsorted(self._sorted, keys), self._count - 1)
        return np.where(self._sorted[place] == keys, self._order[place], -1)

    def integrate(self, image: RangeImage) -> None:
        """Add the measurements of one range image."""
        self.allocate(self._touched(image))
        seen = self._in_frustum(image)
        for start in range(0, len(seen), _CHUNK):
            self._update(image, seen[start : start + _CHUNK])

    def _touched(self, image: RangeImage) -> np.ndarray:
        """Keys of the blocks within the truncation of the measured points."""
        size = SIDE * self.voxel
        farthest = float(image.depth.max(initial=0.0))
        if farthest <= 0.0:
            return np.zeros(0, np.int64)
        step = max(1, int(0.25 * size * min(image.fx, image.fy) / farthest))
        points, direction = image.points(step)
        shifts = (-self.truncation, 0.0, self.truncation)
        blocks = [np.floor((points + shift * direction) / size).astype(np.int64) for shift in shifts]
        found = np.concatenate(blocks)
        # Poses that are kilometres away are wrong; keys have no room for them.
        return np.unique(pack(found[(np.abs(found) < _AXIS_OFFSET // SIDE - 1).all(axis=1)]))

    def allocate(self, keys: np.ndarray) -> None:
        """Add the blocks of packed positions that do not exist yet; nothing is known of their voxels."""
        new = keys[self.find(keys) < 0]
        if not len(new):
            return
        total = self._count + len(new)
        if total > len(self._keys):
            capacity = max(total, len(self._keys) * 3 // 2, 1024)
            for name in ("_keys", "_distance", "_weight", "_color"):
                values = getattr(self, name)
                if values is not None:
                    grown = np.zeros((capacity, *values.shape[1:]), values.dtype)
                    grown[: self._count] = values[: self._count]
                    setattr(self, name, grown)
        self._keys[self._count : total] = new
        self._count = total
        self._order = np.argsort(self.keys)
        self._sorted = self.keys[self._order]

    def adopt(self, other: BlockVolume) -> None:
        """Take over the voxels of which this volume knows nothing; blocks that both have."""
        blocks = self.find(other.keys)
        taken = self._weight[blocks] <= 0.0
        for mine, others in ((self._distance, other.distance), (self._weight, other.weight)):
            mine[blocks] = np.where(taken, others, mine[blocks])
        if self._color is not None and other.color is not None:
            self._color[blocks] = np.where(taken[..., None], other.color, self._color[blocks])

    def _in_frustum(self, image: RangeImage) -> np.ndarray:
        """Blocks of which the camera may see a part in front of its farthest measurement."""
        size = SIDE * self.voxel
        radius = 0.5 * np.sqrt(3.0) * size
        pose = image.camera_to_world
        centre = (unpack(self.keys) + 0.5) * size - 0.5 * self.voxel
        local = (centre - pose[:3, 3]) @ pose[:3, :3]
        height, width = image.depth.shape
        left, right = -image.cx / image.fx, (width - image.cx) / image.fx
        top, bottom = -image.cy / image.fy, (height - image.cy) / image.fy
        inward = np.array([[1.0, 0.0, -left], [-1.0, 0.0, right], [0.0, 1.0, -top], [0.0, -1.0, bottom]])
        inward /= np.linalg.norm(inward, axis=1, keepdims=True)
        farthest = float(image.depth.max(initial=0.0)) + self.truncation
        reach = (local @ inward.T > -radius).all(axis=1) & (local[:, 2] - radius < farthest)
        return np.flatnonzero(reach)

    def _update(self, image: RangeImage, blocks: np.ndarray) -> None:
        """Add one range image to some blocks."""
        pose = image.camera_to_world
        origin = unpack(self._keys[blocks]) * (SIDE * self.voxel)
        base = ((origin - pose[:3, 3]) @ pose[:3, :3]).astype(np.float32)
        offset = (self._offsets @ pose[:3, :3]).astype(np.float32)
        x, y, z = (base[:, axis, None] + offset[None, :, axis] for axis in range(3))
        in_front = z > 1e-3
        inverse = 1.0 / np.where(in_front, z, 1.0)
        height, width = image.depth.shape
        column = np.floor(x * inverse * np.float32(image.fx) + np.float32(image.cx))
        row = np.floor(y * inverse * np.float32(image.fy) + np.float32(image.cy))
        inside = in_front & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        block, cell = np.nonzero(inside)
        pixel = row[inside].astype(np.int64) * width + column[inside].astype(np.int64)
        measured = image.depth.reshape(-1)[pixel]
        distance = measured - z[inside]
        known = (measured > 0.0) & (distance > -self.truncation)
        index = blocks[block[known]] * CELLS + cell[known]
        value = np.minimum(distance[known] * np.float32(1.0 / self.truncation), np.float32(1.0))
        weights, distances = self._weight.reshape(-1), self._distance.reshape(-1)
        # What is far behind a surface is rather hidden by it than inside it (Bylow et al. 2013).
        counts = np.clip((value + 1.0) * np.float32(1.0 / (1.0 - 1.0 / TRUNCATION_VOXELS)), 0.0, 1.0)
        if image.weight is not None:
            counts *= image.weight.reshape(-1)[pixel[known]]
        weight = weights[index] + counts
        share = counts / np.maximum(weight, np.float32(1e-9))
        distances[index] += (value - distances[index]) * share
        weights[index] = weight
        if self._color is not None and image.color is not None:
            near = value < 1.0
            found = image.color.reshape(-1, 3)[pixel[known][near]]
            colors, index = self._color.reshape(-1, 3), index[near]
            colors[index] += (found - colors[index]) * share[near][:, None]
