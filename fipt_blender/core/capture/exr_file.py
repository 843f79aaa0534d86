"""Reading OpenEXR files: which layer is the picture, its channels on the display window, its primaries.

Sizes are checked before the library allocates memory for pixels.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from ..run.errors import FiptError
from .encoded import check_pixels, unreadable
from .primaries import REC709, spaces, to_rec709, xyz_from_rgb

# What programs call the picture itself, and what they call other passes; without blanks, "_" and "-".
_BEAUTY = re.compile("|combined|beauty|rgba?|c|ci|color|colour|image|finalimage|main")
_OTHERS = re.compile(
    r"n[gs]?|p|z|uv|st|id|ao|.*(normals?|position|depth|mist|occlusion|albedo|basecolou?r|crypto.*|matte|mask)"
    r"|(diff|diffuse|gloss|glossy|trans|transmission|spec|specular|subsurface|volume)(col|dir|ind|color|direct"
    r"|indirect)?|emit|emission|env|environment|shadow|shadowcatcher|vector|velocity|motion.*|index.*"
    r"|(noisy|denoising|debug|variance).*|(in)?direct.*|roughness|reflection|refraction|background|alpha"
)
_VIEWS = ("left", "right", "center", "main")  # of stereo files; the last part of a layer's name
_COLOR_NAMES = {"RED": "R", "GREEN": "G", "BLUE": "B"}
_LUMA_CHROMA = ("Y", "RY", "BY")
NOTE = "fiptNote"  # attribute of a header
_WINDOWS = ("displayWindow", "dataWindow")  # attributes of a header


@dataclass(frozen=True)
class Layer:
    """Channels of one part that belong together."""

    part: int  # its index
    name: str  # of part and layer, "" where both have none
    channels: dict[str, str]  # names in the file by what they mean (R, G, B, Y, RY, BY, X, Z, ...)

    @property
    def color(self) -> Sequence[str]:
        """What its colors consist of: R, G and B, or luminance with chroma; nothing where it has none."""
        return next((names for names in ("RGB", _LUMA_CHROMA) if set(names) <= self.channels.keys()), ())


class ExrFile:
    """An OpenEXR file by the headers of its parts, and by the color space that is named for it."""

    def __init__(self, path: Path, space: str = "") -> None:
        self.path = path
        file = self._open(header_only=True)
        self._headers = [file.header(index) for index in range(len(file.parts))]
        try:
            sizes = [[_window_size(header[name]) for name in _WINDOWS] for header in self._headers]
        except (RuntimeError, ValueError, TypeError) as error:
            raise unreadable(path, error) from None
        for (width, height), stored in sizes:
            check_pixels(path, width, height)
            check_pixels(path, *stored)
            if width * height > 16_000_000 and stored[0] * stored[1] < width * height / 16:
                reason = f"{width} x {height} pixels, of which {stored[0]} x {stored[1]} are stored"
                raise unreadable(path, reason)
        self.size = sizes[0][0]
        tag = str(self._headers[0].get("colorInteropID", ""))
        self.space = space or (tag if tag.lower() in spaces() else "")  # color space, "" without

    @property
    def note(self) -> str:
        """The text that `images.write_exr` has put into the header, "" without."""
        return str(self._headers[0].get(NOTE, ""))

    def is_plain(self, layer: str) -> bool:
        """Whether programs that know nothing of layers and primaries read the same picture."""
        with suppress(FiptError):  # of no or several pictures, or impossible primaries
            found = chosen_layer(self.path, self._layers(), layer)
            names = [found.channels[name] for name in found.color or "Y"]
            if len(self._headers) == 1 and names in (["R", "G", "B"], ["Y"]):
                return _primaries(self.path, self._headers[found.part])[0] is None
        return False

    def picture(self, layer: str = "") -> tuple[np.ndarray, np.ndarray | None]:
        """Linear Rec.709 of the picture, or values of its `space`, (height, width, 3) float32 on the display
        window, and its alpha (height, width), None without: 0 also where the file holds no pixels.

        Args:
            layer: name of the part or layer; "" for the one that is named like a picture.
        """
        found = chosen_layer(self.path, self._layers(), layer)
        file = self._open()
        planes = [_plane(file, found, name) for name in found.color or "Y"]
        alpha = _plane(file, found, "A") if "A" in found.channels else self._stored_part(found)
        matrix, weights = _primaries(self.path, self._headers[found.part])
        if found.color == _LUMA_CHROMA:  # Y, RY = (R - Y) / Y, BY = (B - Y) / Y
            red, blue = ((plane + np.float32(1.0)) * planes[0] for plane in planes[1:])
            green = (planes[0] - weights[0] * red - weights[2] * blue) / weights[1]
            planes = [red, green.astype(np.float32), blue]
        pixels = np.stack(planes * (3 // len(planes)), axis=-1)
        if matrix is not None and len(planes) == 3 and not self.space:
            pixels = pixels @ matrix.T.astype(np.float32)
        return pixels, alpha

    def _stored_part(self, layer: Layer) -> np.ndarray | None:
        """(height, width) 1 where the file holds pixels, 0 beside; None where it holds all."""
        (low, high), (stored_low, stored_high) = (self._headers[layer.part][name] for name in _WINDOWS)
        if (np.asarray(stored_low) <= low).all() and (np.asarray(stored_high) >= high).all():
            return None
        alpha = np.zeros((int(high[1] - low[1]) + 1, int(high[0] - low[0]) + 1), np.float32)
        x0, y0 = (int(value) for value in np.maximum(np.subtract(stored_low, low), 0))
        x1, y1 = (int(value) for value in np.maximum(np.subtract(stored_high, low) + 1, 0))
        alpha[y0:y1, x0:x1] = 1.0
        return alpha

    def values(self) -> np.ndarray:
        """Values (height, width, 1 or 3) of an image that is no picture, as stored: ids, depths.

        They are the file's only channel, or R, G and B, Y or R of the layer that would be its picture.
        """
        layers = self._layers()
        layer = layers[0] if len(layers) == 1 else chosen_layer(self.path, layers, "", others=True)
        file = self._open()
        if set("RGB") <= layer.channels.keys():
            return np.stack([_plane(file, layer, name) for name in "RGB"], axis=-1)
        names = sorted(layer.channels, key=lambda name: (name != "R", name != "Y", name == "A", name))
        return _plane(file, layer, names[0])[..., None]

    def _open(self, header_only: bool = False) -> OpenEXR.File:
        """The file with its pixels, or without; the sizes that its header announces are known before."""
        try:
            file = OpenEXR.File(str(self.path), separate_channels=True, header_only=header_only)
        except (RuntimeError, ValueError, TypeError) as error:
            raise unreadable(self.path, error) from None
        # OpenEXR only prints a warning where pixels are missing.
        if not file.parts or (not header_only and len(file.parts) != len(self._headers)):
            raise unreadable(self.path, "the file is truncated or damaged")
        return file

    def _layers(self) -> list[Layer]:
        """The layers of all parts; those of several parts have the part's name first."""
        found = []
        for index, header in enumerate(self._headers):
            part = str(header.get("name") or "")
            if len(self._headers) == 1 and not _OTHERS.fullmatch(_last(part)):
                part = ""
            by_layer: dict[str, dict[str, str]] = {}
            for channel in header["channels"]:
                layer, _, name = channel.name.rpartition(".")
                by_layer.setdefault(layer, {})[_COLOR_NAMES.get(name.upper(), name.upper())] = channel.name
            for layer, channels in by_layer.items():
                found.append(Layer(index, ".".join(word for word in (part, layer) if word), channels))
        return found


def chosen_layer(path: Path, layers: Sequence[Layer], wanted: str, others: bool = False) -> Layer:
    """The layer that is the picture: the unnamed one, else the one with a picture's name, else the only one.

    Colors come before luminance. Normals, depths and other passes are never taken unless they are asked for.

    Args:
        path: for the error.
        layers: of all parts.
        wanted: a layer's name, whole or its last word; "" for none.
        others: whether other passes are as good as pictures.
    """
    colored = [layer for layer in layers if layer.color]
    grey = [layer for layer in layers if "Y" in layer.channels and not {"X", "Z"} & layer.channels.keys()]
    if wanted:
        known = [layer for layer in layers if layer in (*colored, *grey)]
        found = [layer for layer in known if layer.name.lower() == wanted.lower()]
        found = found or [layer for layer in known if _last(layer.name) == _last(wanted)]
    else:
        usable = [layer for layer in layers if others or not _OTHERS.fullmatch(_last(layer.name))]
        found = [layer for layer in colored if layer in usable] or [
            layer for layer in grey if layer in usable
        ]
        named = [layer for layer in found if _BEAUTY.fullmatch(_last(layer.name))]
        found = [layer for layer in named if not layer.name] or named or found
    if len(found) == 1:
        return found[0]
    listed = ", ".join(layer.name or "unnamed" for layer in found or layers)
    if found:
        code, text = "image-layers", f"{path} has several layers that may be the photograph: {listed}."
    else:
        which = f"layer '{wanted}'" if wanted else "layer of a picture"
        code, text = "image-channels", f"{path} has no {which} with R, G, B or Y; it has: {listed}."
    raise FiptError.of(
        code, text, "Name the layer to use (Layer in the settings, --layer NAME), or export only that."
    )


def _last(name: str) -> str:
    """The last word of a layer's name, of stereo files the one before the view; plain small letters."""
    words = [re.sub(r"[\s_-]", "", word).lower() for word in name.split(".")]
    return words[-2] if len(words) > 1 and words[-1] in _VIEWS else words[-1]


def _window_size(window: Any) -> tuple[int, int]:
    """Width and height of a data or display window."""
    low, high = window
    return int(high[0]) - int(low[0]) + 1, int(high[1]) - int(low[1]) + 1


def _primaries(path: Path, header: dict[str, Any]) -> tuple[np.ndarray | None, np.ndarray]:
    """(3, 3) from a part's primaries to Rec.709, None where they are that or not declared, and (3,) the
    weights of R, G and B in its luminance."""
    try:
        values = np.asarray(header.get("chromaticities", REC709), np.float64).reshape(8)
        is_rec709 = np.abs(values - REC709).max() < 1e-3  # programs round them differently
        return None if is_rec709 else to_rec709(values), xyz_from_rgb(values)[1]
    except (TypeError, ValueError, np.linalg.LinAlgError) as error:
        raise unreadable(path, f"its chromaticities are invalid: {error}") from None


def _plane(file: OpenEXR.File, layer: Layer, name: str) -> np.ndarray:
    """One channel (height, width) float32 on the display window; ids of 32 bits stay float64."""
    channel = file.channels(layer.part)[layer.channels[name]]
    header = file.header(layer.part)
    pixels = np.asarray(channel.pixels)
    pixels = pixels.astype(np.float64 if pixels.dtype == np.uint32 else np.float32)
    data_low, data_high = header["dataWindow"]
    for axis, step in ((0, channel.ySampling), (1, channel.xSampling)):
        if step != 1:
            pixels = _upsampled(pixels, int(data_high[1 - axis] - data_low[1 - axis]) + 1, step, axis)
    low, high = header["displayWindow"]
    if np.array_equal(data_low, low) and np.array_equal(data_high, high):
        return pixels
    plane = np.zeros((int(high[1] - low[1]) + 1, int(high[0] - low[0]) + 1), pixels.dtype)
    x0, y0 = (int(v) for v in np.maximum(data_low, low))
    x1, y1 = (int(v) for v in np.minimum(data_high, high) + 1)
    if x1 > x0 and y1 > y0:
        plane[y0 - low[1] : y1 - low[1], x0 - low[0] : x1 - low[0]] = pixels[
            y0 - data_low[1] : y1 - data_low[1], x0 - data_low[0] : x1 - data_low[0]
        ]
    return plane


def _upsampled(pixels: np.ndarray, count: int, step: int, axis: int) -> np.ndarray:
    """Values at all places by linear interpolation of those at every `step`-th, from the first on."""
    places = np.arange(count) / step
    below = np.minimum(places.astype(np.intp), pixels.shape[axis] - 1)
    above = np.minimum(below + 1, pixels.shape[axis] - 1)
    share = np.expand_dims((places - below).astype(np.float32), 1 - axis)
    return pixels.take(below, axis) * (1 - share) + pixels.take(above, axis) * share
