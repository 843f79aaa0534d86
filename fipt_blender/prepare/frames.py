"""The pixels of one photograph: sensor values or codes as stored, and linear values at the working size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import rawpy
from scipy import ndimage

from ..core.capture.encoded import CLIPPED_CODE
from ..core.capture.images import read_codes, read_radiance
from ..core.capture.primaries import REC709, xyz_from_rgb
from .exif import DAMAGE, unreadable
from .preparation import Photograph, PrepareSettings

BAND_ROWS = 128  # rows of a photograph at a time; bounds the memory
# A sensor's own ceiling below the nominal one: this share of its pixels holds the highest value.
_CEILING_SHARE = 1e-4
CEILING_WIDTH = 0.002
# Share of the nominal ceiling from which on a sensor's pixels count as clipped.
NEAR_TOP = 0.998
LARGE_PIXELS = 8_000_000  # above this, linear values are kept as half floats


@dataclass(frozen=True, eq=False)
class Stored:
    """A photograph's values as stored."""

    # RAW: (height, width) sensor values above black, 0 to 1 at the nominal ceiling, float32, or
    # (height, width, 3) where the file holds no mosaic. LDR: (height, width, 3) uint8 or uint16 codes.
    # Linear: (height, width, 3) float32.
    values: np.ndarray
    # RAW: the channel (0 to 2) of each place of the mosaic's pattern, (n, m); None elsewhere
    colors: np.ndarray | None = None
    ceiling: float = 1.0  # value at which pixels count as clipped, in units of `values`
    top: float = 1.0  # RAW: the highest value
    # RAW: factors of the three channels for the camera's own white balance; ones elsewhere
    balance: np.ndarray = field(default_factory=lambda: np.ones(3))
    # (3, 3) to linear Rec.709 from the balanced camera's channels, or from the file's primaries
    matrix: np.ndarray = field(default_factory=lambda: np.eye(3))


@dataclass(frozen=True, eq=False)
class Frame:
    """Linear values of one exposure at the working size."""

    # (height, width, 3) float16 or float32, radiance times exposure; 1 at the nominal ceiling
    values: np.ndarray
    clipped: np.ndarray  # (height, width, 3) bool, places to which a clipped value contributes


def load(path: Path, photograph: Photograph, settings: PrepareSettings | None = None) -> Stored:
    """The stored values of a photograph, in the orientation of the file.

    Codes are those of sRGB's curve, where the file has another one, unless the settings say that they are
    linear.
    """
    settings = settings or PrepareSettings()
    try:
        if photograph.kind == "raw":
            stored = _load_raw(path)
        elif photograph.kind == "ldr":
            codes, matrix = read_codes(path, as_stored=settings.response == "linear")
            stored = Stored(codes, matrix=np.eye(3) if matrix is None else matrix)
        else:
            stored = Stored(read_radiance(path, settings.layer), ceiling=np.inf)
            if not np.isfinite(stored.values).all():
                raise ValueError("it holds values that are no numbers")
    except DAMAGE as error:
        raise unreadable(path, error) from None
    size = stored.values.shape[1], stored.values.shape[0]
    if size != (photograph.width, photograph.height):
        raise unreadable(path, f"it has {size[0]} x {size[1]} pixels; it had {photograph.width} x"
                         f" {photograph.height} when its header was read")  # fmt: skip
    return stored


def linear_frame(stored: Stored, curve: np.ndarray | None, factor: int) -> Frame:
    """Linear values, averaged over squares of pixels.

    Args:
        stored: as loaded.
        curve: (256, 3) linear value of each code, 1 at the highest; None for RAW and linear photographs.
        factor: edge of the squares; rows and columns that fill no square are cut off.
    """
    height, width = (size // factor for size in stored.values.shape[:2])
    is_large = width * height > LARGE_PIXELS and np.isfinite(stored.ceiling)
    kind = np.float16 if is_large else np.float32
    frame = Frame(np.empty((height, width, 3), kind), np.empty((height, width, 3), bool))
    rows = max(BAND_ROWS // factor, 1)
    for start in range(0, height, rows):
        stop = min(start + rows, height)
        if stored.colors is not None and factor > max(stored.colors.shape):
            band = stored.values[start * factor : stop * factor, : width * factor]
            values, clipped = binned_rows(band, stored.colors, stored.ceiling, start * factor, factor)
        else:
            values, clipped = linear_rows(stored, curve, start * factor, stop * factor)
            if factor > 1:
                values, clipped = block_mean(values, factor), blocks(clipped, factor).any(axis=(1, 3))
        frame.values[start:stop], frame.clipped[start:stop] = values, clipped
    return frame


def linear_rows(
    stored: Stored, curve: np.ndarray | None, start: int, stop: int
) -> tuple[np.ndarray, np.ndarray]:
    """Linear values and clipped places, both (rows, width, 3), of the rows from `start` to before `stop`."""
    if stored.colors is not None:
        return demosaiced_rows(stored.values, stored.colors, stored.ceiling, start, stop)
    values, ceiling = stored.values[start:stop], stored.ceiling
    if curve is not None:
        codes, top = values, np.iinfo(values.dtype).max
        ceiling = CLIPPED_CODE / 255.0 * top
        if top == 255:
            values = curve.astype(np.float32)[codes, np.arange(3)]
        else:
            scaled, levels = codes * (255.0 / top), np.arange(256)
            channels = [np.interp(scaled[..., c], levels, curve[:, c]) for c in range(3)]
            values = np.stack(channels, -1).astype(np.float32)
    # Cameras mix channels after they clip: where one is at its end, the others are wrong, too.
    clipped = (stored.values[start:stop] >= ceiling).any(axis=-1, keepdims=True)
    return values, np.repeat(clipped, 3, -1)


def demosaiced_rows(
    mosaic: np.ndarray, colors: np.ndarray, ceiling: float, start: int, stop: int
) -> tuple[np.ndarray, np.ndarray]:
    """Bilinear interpolation of a mosaic of any pattern: means over the nearest places of each channel.

    Returns:
        Values (rows, width, 3) float32, and bool (rows, width, 3): a clipped place contributes.
    """
    radius = 1 if max(colors.shape) == 2 else 2
    first, last = max(start - radius, 0), min(stop + radius, len(mosaic))
    rows = mosaic[first:last].astype(np.float32)
    places = np.arange(first, last) % colors.shape[0]
    pattern = colors[places][:, np.arange(mosaic.shape[1]) % colors.shape[1]]
    ramp = np.array([1.0, 2.0, 1.0] if radius == 1 else [1.0, 2.0, 3.0, 2.0, 1.0], np.float32)
    values = np.empty((*rows.shape, 3), np.float32)
    clipped = np.empty((*rows.shape, 3), bool)
    for channel in range(3):
        own = pattern == channel
        total = _smoothed(np.where(own, rows, 0.0), ramp)
        values[..., channel] = np.where(own, rows, total / _smoothed(own.astype(np.float32), ramp))
        high = own & (rows >= ceiling)
        clipped[..., channel] = ndimage.maximum_filter(high, 2 * radius + 1) if high.any() else False
    return values[start - first : stop - first], clipped[start - first : stop - first]


def binned_rows(
    mosaic: np.ndarray, colors: np.ndarray, ceiling: float, start: int, factor: int
) -> tuple[np.ndarray, np.ndarray]:
    """Means of a mosaic over squares larger than its pattern, of each channel's own places in the square.

    Interpolating first would mix in what lies beside the square, and blur borders. Weights put the mean's
    place into the square's middle, so that channels agree on slopes.

    Args:
        mosaic: (rows, width) values, whole squares.
        colors: the channel of each place of the pattern.
        ceiling: value at which pixels count as clipped.
        start: number of the first row, for the pattern.
        factor: edge of the squares.

    Returns:
        Values (rows, width, 3) float32, and bool (rows, width, 3): a clipped place contributes; of squares.
    """
    rows, columns = np.arange(start, start + len(mosaic)), np.arange(mosaic.shape[1])
    pattern = colors[rows % colors.shape[0]][:, columns % colors.shape[1]]
    down = _centering_weights(len(mosaic), start, colors.shape[0], factor)
    across = _centering_weights(mosaic.shape[1], 0, colors.shape[1], factor)
    weighted = mosaic * down[:, None] * across[None, :]
    high = mosaic >= ceiling
    values = np.empty((len(mosaic) // factor, mosaic.shape[1] // factor, 3), np.float32)
    clipped = np.empty(values.shape, bool)
    for channel in range(3):
        own = pattern == channel
        total = blocks(np.where(own, weighted, np.float32(0.0)), factor).sum(axis=(1, 3))
        values[..., channel] = total / np.float32((colors == channel).sum())
        clipped[..., channel] = blocks(own & high, factor).any(axis=(1, 3)) if high.any() else False
    return values, clipped


def _centering_weights(count: int, start: int, period: int, factor: int) -> np.ndarray:
    """(count,) float32 weights of rows; those of a square's rows at one place of the pattern add up to 1.

    Their weighted mean is the square's middle where two rows or more allow that.
    """
    places = np.arange(count)
    square = places // factor
    weights = np.empty(count)
    for phase in range(period):
        own = (start + places) % period == phase
        position = (places - square * factor - 0.5 * (factor - 1))[own]  # from the square's middle
        number = np.bincount(square[own])[square[own]]
        mean = np.bincount(square[own], position)[square[own]] / number
        spread = np.bincount(square[own], (position - mean) ** 2)[square[own]]
        tilt = np.divide(mean, spread, out=np.zeros_like(mean), where=spread > 0.0)
        weights[own] = 1.0 / number - tilt * (position - mean)
    return weights.astype(np.float32)


def blocks(values: np.ndarray, factor: int) -> np.ndarray:
    """Squares of (height, width, ...) as (rows, factor, columns, factor, ...), without what fills none."""
    rows, columns = values.shape[0] // factor, values.shape[1] // factor
    whole = values[: rows * factor, : columns * factor]
    return whole.reshape(rows, factor, columns, factor, *values.shape[2:])


def block_mean(values: np.ndarray, factor: int) -> np.ndarray:
    """Means over squares of (height, width, ...); see `blocks`."""
    return values if factor == 1 else blocks(values, factor).mean(axis=(1, 3), dtype=np.float32)


def upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Pixels (height, width, ...) turned and mirrored as EXIF's orientation says (1 to 8)."""
    pixels = pixels.swapaxes(0, 1) if orientation >= 5 else pixels
    pixels = pixels[::-1] if orientation in (3, 4, 7, 8) else pixels
    return np.ascontiguousarray(pixels[:, ::-1] if orientation in (2, 3, 6, 7) else pixels)


def rec709_from_camera(xyz_to_camera: np.ndarray) -> np.ndarray:
    """(3, 3) from the camera's channels, white balanced, to linear Rec.709: white stays white.

    Args:
        xyz_to_camera: (3, 3) of the camera; the unit matrix is returned where it is singular or zero.
    """
    camera = xyz_to_camera @ xyz_from_rgb(REC709)
    sums = camera.sum(axis=1, keepdims=True)
    if not np.isfinite(camera).all() or np.abs(sums).min() < 1e-6:
        return np.eye(3)
    balanced = camera / sums
    return np.eye(3) if np.linalg.cond(balanced) > 1e3 else np.linalg.inv(balanced)


def _smoothed(plane: np.ndarray, ramp: np.ndarray) -> np.ndarray:
    across = ndimage.convolve1d(plane, ramp, axis=1, mode="constant")
    return ndimage.convolve1d(across, ramp, axis=0, mode="constant")


def _load_raw(path: Path) -> Stored:
    with rawpy.imread(str(path)) as raw:
        matrix = rec709_from_camera(np.array(raw.rgb_xyz_matrix, np.float64)[:3])
        balance = _balance(raw)
        if raw.raw_type != rawpy.RawType.Flat or raw.raw_pattern is None:
            return Stored(_developed(raw), ceiling=NEAR_TOP, balance=balance, matrix=matrix)
        values, colors = raw.raw_image_visible.astype(np.float32), np.array(raw.raw_pattern)
        black = np.array(raw.black_level_per_channel, np.float32)
        values -= black[raw.raw_colors_visible]
        values /= np.float32(raw.white_level - black[colors].mean())
    channels = np.where(colors == 3, 1, colors)  # the second green
    return Stored(values, channels, find_ceiling(values), float(values.max()), balance, matrix)


def find_ceiling(values: np.ndarray) -> float:
    """Where a sensor seems to clip, below 1 if its pixels pile up there; a little lower, for its noise."""
    top = float(values.max(initial=0.0))
    if 0.5 < top < NEAR_TOP and np.mean(values >= top - CEILING_WIDTH) > _CEILING_SHARE:
        return top - CEILING_WIDTH
    return NEAR_TOP


def common_ceiling(ceilings: Sequence[float], tops: Sequence[float]) -> float:
    """Where a camera clips, from all its photographs: a bright flat area alone looks like a ceiling, too.

    Args:
        ceilings: of each photograph; see `find_ceiling`.
        tops: the highest value of each.
    """
    highest = max(tops, default=1.0)
    return min((value for value in ceilings if highest <= value + 2.0 * CEILING_WIDTH), default=NEAR_TOP)


def _balance(raw: rawpy.RawPy) -> np.ndarray:
    """The camera's white balance relative to green, ones where the file has none."""
    for factors in (raw.camera_whitebalance, raw.daylight_whitebalance):
        values = np.array(factors[:3], np.float64)
        if np.isfinite(values).all() and values.min() > 0.0:
            return values / values[1]
    return np.ones(3)


def _developed(raw: rawpy.RawPy) -> np.ndarray:
    """(height, width, 3) of files without a mosaic, linear and without any brightening."""
    pixels = raw.postprocess(
        gamma=(1, 1),
        no_auto_bright=True,
        adjust_maximum_thr=0.0,  # otherwise LibRaw scales each photograph by its own maximum
        output_bps=16,
        user_wb=[1, 1, 1, 1],
        output_color=rawpy.ColorSpace.raw,
        user_flip=0,
    )
    return pixels.astype(np.float32) / np.float32(65535.0)
