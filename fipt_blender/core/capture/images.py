"""Reading and writing image files: radiance and codes of photographs, id images. The first row is the top.

A file's content decides what it is, not its suffix. OpenEXR files are read by :mod:`.exr_file`, HEIC by
pillow-heif, all others by OpenImageIO; :mod:`.primaries` says what values mean. Pixels are as the file stores
them: EXIF's orientation is not applied, since cameras are those of the stored pixels.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import OpenImageIO as oiio
from PIL import Image, PngImagePlugin, WebPImagePlugin

from ..run.errors import FiptError
from ..run.extras import optional
from ..run.runfolder import atomic_path
from ..run.store import refuse_infinite
from ..run.threads import cached_property
from . import primaries
from .encoded import (
    DAMAGE,
    check_pixels,
    exif_number,
    exif_tags,
    missing,
    relative_exposure,
    srgb_decoded,
    srgb_encoded,
    unreadable,
)
from .exr_file import NOTE, ExrFile
from .files import stand_in
from .primaries import Colors
from .suffixes import IMAGE_SUFFIXES, RAW_SUFFIXES

EXR_SUFFIX = ".exr"
HALF_MAX = float(np.finfo(np.float16).max)
JPEG_QUALITY = 95  # an error of about one of 255 steps, in places of seven
MAX_PNG_ID = 2**16 - 1  # 16 bits
MAX_ID = 2**24 - 1  # highest id of a colour mask; 32-bit floats represent all of them exactly
FORMATS = "OpenEXR, JPEG, PNG, TIFF, WebP, HEIC and Radiance (.hdr)"
# How the files of each format begin; all but the first two are OpenImageIO's names.
_STARTS = re.compile(
    rb"(?P<exr>v/1\x01)|....ftyp(?P<heif>hei|hev|mif1|msf1)|(?P<jpeg>\xff\xd8\xff)|(?P<png>\x89PNG\r\n)"
    rb"|(?P<tiff>II[*+]\0|MM\0[*+])|(?P<webp>RIFF....WEBP)|(?P<hdr>#\?)|(?P<jpegxl>\xff\x0a|....JXL )",
    re.DOTALL,
)
# How files begin that are not read, and what they are.
_NOT_READ = (
    (rb"....ftypavi[fs]", "AVIF"),
    (rb"\0\0\0\x0cjP  |\xff\x4f\xff\x51", "JPEG 2000"),
    (rb"8BPS", "Photoshop"),
    (rb"BM", "BMP"),
    (rb"GIF8", "GIF"),
    (rb"SDPX|XPDS", "DPX"),
    (rb"%PDF", "PDF"),
    (rb"....ftyp(crx )", "RAW"),
    (rb"FUJIFILM|IIU\0|IIRO|FOVb|\0MRM", "RAW"),
    (rb"....ftyp|\x1a\x45\xdf\xa3|RIFF....AVI ", "video"),
)
# What a TIFF's values are that are no RGB: Lab, a sensor's mosaic, LogL and LogLuv, linear RAW. OpenImageIO
# reads these as RGB, or a preview of 8 bits.
_NO_RGB = {
    8: "Lab",
    9: "Lab",
    10: "Lab",
    32803: "a sensor's",
    32844: "LogL",
    32845: "LogLuv",
    34892: "a sensor's",
}
MOST_CHUNK = 64  # bytes of a PNG's chunk that are read
_TYPES = {"uint8": "uint8", "uint16": "uint16", **dict.fromkeys(("half", "float", "double"), "float32")}


@dataclass(frozen=True, eq=False)
class Picture:
    """An image file: its header, which is read once, and its pixels, which are decoded when they are asked
    for.
    """

    path: Path  # of the file
    kind: str  # "exr", "heif" or OpenImageIO's name of the format
    size: tuple[int, int]  # width and height in pixels, as stored
    type: str  # what its values mean: "uint8" or "uint16" codes, "float32" radiance, also by log codes
    colors: Colors  # what the values mean
    is_plain: bool  # whether programs that know nothing of layers, primaries and curves show the same
    # Makes the pixels (height, width, channels), and alpha (height, width), None without
    decode: Callable[[], tuple[Any, np.ndarray | None]]
    exif: Path | bytes = b""  # where its EXIF is
    # Makes the values (height, width, channels) of an EXR that is no picture
    numbers: Callable[[], np.ndarray] | None = None

    @property
    def is_encoded(self) -> bool:
        """Whether it holds codes instead of radiance."""
        return self.type != "float32"

    @cached_property
    def tags(self) -> dict[str, Any]:
        """EXIF tags that are about the pixels as they are read; see `exif_tags`."""
        tags = exif_tags(self.exif)
        if self.kind in ("heif", "jpegxl"):  # turned by the decoder, as their containers say
            tags.pop("Image Orientation", None)
        return tags

    @property
    def exposure(self) -> float | None:
        """The relative exposure by the EXIF of an image that is not HDR; None without."""
        return relative_exposure(self.tags) if self.is_encoded else None

    def stored(self) -> tuple[np.ndarray, np.ndarray | None]:
        """Values (height, width, 1 or 3) as stored, and alpha (height, width), or None without."""
        try:
            decoded, alpha = self.decode()
        except DAMAGE as error:
            raise unreadable(self.path, error) from None
        pixels = np.atleast_3d(np.asarray(decoded))
        return pixels[..., : 3 if pixels.shape[-1] > 2 else 1], alpha

    def data(self) -> np.ndarray:
        """Values (height, width, 1 or 3) as stored of an image that is no picture: ids, depths."""
        return self.stored()[0] if self.numbers is None else self.numbers()

    def shown(self) -> tuple[np.ndarray, np.ndarray | None]:
        """Radiance as of `read_radiance`, and (height, width) bool, whose alpha is 0, so that they show
        nothing; None where none or all are."""
        values, alpha = self.stored()
        pixels, matrix, curve = _three(values), self.colors.matrix, self.colors.curve
        if pixels.dtype.kind == "u":
            # By a table, since powers of all pixels would take seconds.
            table = _curve_table(self.colors, pixels.dtype).astype(np.float32)
            # No code is clipped; to check that would take longer.
            pixels = np.take(table[:, 0], pixels, mode="clip") if curve is None else _mapped(table, pixels)
        elif curve is not None:
            pixels = curve(pixels.ravel())[:, 0].reshape(pixels.shape)
        if matrix is not None:
            pixels = pixels @ matrix.T.astype(np.float32)
            pixels = np.clip(pixels, 0.0, 1.0) if self.is_encoded else pixels
        clear = None if alpha is None else alpha <= 0.0
        return pixels, clear if clear is not None and clear.any() and not clear.all() else None

    def ids(self) -> np.ndarray:
        """Its ids; see `read_ids`."""
        if self.kind == "exr":
            values = self.data()
            if not np.isfinite(values).all() or np.abs(values - np.round(values)).max(initial=0.0) > 1e-3:
                fault = "contains fractions"
                raise _no_ids(self.path, fault, "without anti-aliasing, with one integer per part")
            ids = _red(self.path, np.round(values).astype(np.int64))
        elif self.kind == "png":
            ids = _png_ids(self)
        else:
            raise _no_ids(self.path, "is not a PNG or EXR file (lossy formats change ids)", "as PNG or EXR")
        if np.abs(ids).max(initial=0) > MAX_ID:
            raise _no_ids(self.path, f"contains ids above {MAX_ID}", "with smaller ids")
        return ids.astype(np.int32)


def open_picture(path: Path, layer: str = "", space: str = "") -> Picture:
    """An image file by its header; no pixel is decoded. The same object while the file does not change.

    Args:
        path: of the file.
        layer: of an EXR; see `ExrFile.picture`.
        space: its color space, a name of `primaries.space_colors`; "" for what the file says.
    """
    try:
        status = path.stat()
    except FileNotFoundError:
        raise missing(path) from None
    except DAMAGE as error:
        raise unreadable(path, error) from None
    return _opened(path, layer, space, status.st_ino, status.st_size, status.st_mtime_ns)


@lru_cache(maxsize=10_000)
def _opened(path: Path, layer: str, space: str, *state: int) -> Picture:
    """`open_picture` of a file in a state."""
    try:
        with path.open("rb") as file:
            start = file.read(16)
            found = _STARTS.match(start)
        kind, suffix = str(found and found.lastgroup), path.suffix.lower()
        if found is None or (suffix in RAW_SUFFIXES and kind == "tiff"):
            if (error := stand_in(path)) is not None:
                raise error
            what = next((name for begins, name in _NOT_READ if re.match(begins, start, re.DOTALL)), "")
            if what and suffix not in RAW_SUFFIXES:
                raise FiptError("image-format.known", path=path, what=what, formats=FORMATS)
            if suffix in IMAGE_SUFFIXES:
                raise ValueError(f"its content is none of {FORMATS}")
            raise FiptError("image-format", path=path)
        picture = _OPEN.get(kind, _open_by_oiio)(path, kind, layer, space)
    except DAMAGE as error:
        raise unreadable(path, error) from None
    check_pixels(path, *picture.size)
    return picture


def is_picture(path: Path) -> bool:
    """Whether a file is a picture by its content, whatever its name says; RAW files may begin like TIFFs."""
    try:
        with path.open("rb") as file:
            found = _STARTS.match(file.read(16))
    except OSError:
        return False
    return found is not None and found.lastgroup != "tiff"


def read_size(path: Path) -> tuple[int, int]:
    """Width and height in pixels of an image as it is stored, from its header; raises as `open_picture`."""
    return open_picture(path).size


def read_radiance(path: Path, layer: str = "") -> np.ndarray:
    """Scene-linear radiance in Rec.709; of images that are not HDR, the values by sRGB's curve.

    Returns:
        (height, width, 3) float32, units as stored; from 0 to 1 where the image is not HDR.
    """
    return open_picture(path, layer).shown()[0]


def read_codes(path: Path, as_stored: bool = False) -> tuple[np.ndarray, np.ndarray | None]:
    """The codes of an image that is not HDR, with all their bits, by sRGB's curve.

    Args:
        path: of the file.
        as_stored: by the file's own curve instead.

    Returns:
        (height, width, 3) uint8, or uint16 where 8 bits are too few, and (3, 3) from the linear values to
        Rec.709; None where they are that.
    """
    picture = open_picture(path)
    codes = _three(picture.stored()[0])
    if picture.colors.curve is not None and not as_stored:
        table = srgb_encoded(_curve_table(picture.colors, codes.dtype))
        codes = _mapped(np.round(65535.0 * table).astype(np.uint16), codes)
    return codes, picture.colors.matrix


def read_ids(path: Path) -> np.ndarray:
    """Ids of an id image.

    EXR: integer values of the only channel, or of R, else Y. PNG: palette indices or grey values of 1 to 16
    bits; in colour masks, each colour has the id ``red * 65536 + green * 256 + blue``. Colours of 16 bits
    have that of the same colour with 8 bits, and where there is none, the value of red.

    Returns:
        (height, width) int32.
    """
    return open_picture(path).ids()


def write_exr(path: Path, array: np.ndarray, half: bool = False, lossy: bool = False, note: str = "") -> None:
    """Write an image as EXR, completely or not at all.

    Args:
        path: the file; its folder is created if missing.
        array: (height, width, 3) as R, G, B, or (height, width) as Y; converted to float.
        half: 16-bit values, clamped to ±65504, instead of 32-bit.
        lossy: compressed to a quarter, for pictures that are only looked at.
        note: a text in the header, as of `ExrFile`.
    """
    values = np.asarray(array)
    refuse_infinite(path.name, values)
    if half:
        values = np.clip(values, -HALF_MAX, HALF_MAX).astype(np.float16)
    else:
        values = values.astype(np.float32)
    planes = {"Y": values} if values.ndim == 2 else dict(zip("RGB", np.moveaxis(values, -1, 0), strict=True))
    compression = OpenEXR.DWAA_COMPRESSION if lossy else OpenEXR.ZIP_COMPRESSION
    header = {"compression": compression, "type": OpenEXR.scanlineimage, **({NOTE: note} if note else {})}
    # Written through memory, because OpenEXR does not report the system's reason for a failure.
    buffer = io.BytesIO()
    OpenEXR.File(header, {name: np.ascontiguousarray(plane) for name, plane in planes.items()}).write(buffer)
    with atomic_path(path) as temporary:
        temporary.write_bytes(buffer.getbuffer())


def write_codes(path: Path, values: np.ndarray) -> None:
    """Write values (height, width, 3) from 0 to 1 with 8 bits, completely or not at all.

    Args:
        path: .png, with an error of half of a code; or .jpg, for pictures that are only looked at.
        values: by the curve of the codes.
    """
    codes = np.clip(values * 255.0 + 0.5, 0.0, 255.0).astype(np.uint8)
    buffer = io.BytesIO()
    if path.suffix == ".jpg":
        Image.fromarray(codes).save(buffer, "JPEG", quality=JPEG_QUALITY, subsampling=0)
    else:  # the fastest compression: higher ones take four times as long and save a sixth
        Image.fromarray(codes).save(buffer, "PNG", compress_level=1)
    with atomic_path(path) as temporary:
        temporary.write_bytes(buffer.getbuffer())


def threads_for(pixels: Iterable[int]) -> int:
    """How many threads may hold a decoded photograph each, of views with these numbers of pixels."""
    # One of 12 megapixels takes up to 0.5 GB.
    return max(1, 50_000_000 // max(pixels, default=1))


def write_ids(path: Path, ids: np.ndarray) -> None:
    """Write an id image as PNG with 16 bits, completely or not at all.

    Args:
        path: the file; its folder is created if missing.
        ids: (height, width) int from 0 to `MAX_PNG_ID`.
    """
    buffer = io.BytesIO()
    Image.fromarray(ids.astype(np.uint16)).save(buffer, "PNG")
    with atomic_path(path) as temporary:
        temporary.write_bytes(buffer.getbuffer())


def _open_exr(path: Path, kind: str, layer: str, space: str) -> Picture:
    file = ExrFile(path, space)
    colors = primaries.space_colors(file.space, "float32") if file.space else Colors()
    decode, plain = partial(file.picture, layer), file.is_plain(layer)
    plain = plain and colors.curve is None and colors.matrix is None
    return Picture(path, kind, file.size, "float32", colors, plain, decode, numbers=file.values)


def _open_heif(path: Path, kind: str, _: str, space: str) -> Picture:
    open_file = partial(optional(kind, "A photograph in HEIC").open_heif, path, convert_hdr_to_8bit=False)
    file = open_file()
    icc, nclx = file.info.get("icc_profile"), file.info.get("nclx_profile")
    colors = primaries.space_colors(space) if space else Colors()
    if icc and not space:
        colors = primaries.icc_colors(icc)
    elif nclx and not space:
        if nclx["transfer_characteristics"] in (16, 18):
            primaries.cicp_colors(1, nclx["transfer_characteristics"])
        corners = ("red", "green", "blue", "white")
        values = [nclx[f"color_primary_{corner}_{axis}"] for corner in corners for axis in "xy"]
        colors = Colors(None, primaries.to_rec709(np.array(values)))
    values_type = "float32" if colors.is_log else "uint16" if file.mode.endswith("16") else "uint8"
    exif = file.info.get("exif") or b""
    return Picture(
        path, kind, tuple(file.size), values_type, colors, False, lambda: (open_file(), None), exif
    )


def _open_by_oiio(path: Path, kind: str, _: str, space: str) -> Picture:
    colors = _radiance_colors(path, space) if kind == "hdr" else Colors()
    if kind == "jpegxl" and not oiio.is_imageio_format_name(kind):
        raise FiptError("image-format.known", path=path, what="JPEG XL", formats=FORMATS)
    if kind == "tiff":
        _refuse_previews(path)
    spec = _oiio_input(path, kind).spec()
    name = _TYPES.get(str(spec.format))
    if name is None:
        raise ValueError(f"its values are {spec.format}, not of 8 or 16 bits or floats")
    if space and kind != "hdr":
        colors = primaries.space_colors(space, name)
    elif kind == "png" and (coded := _png_chunk(path, b"cICP")) is not None:  # it counts before all others
        colors = primaries.cicp_colors(coded[0], coded[1])
    elif (icc := spec.getattribute("ICCProfile")) is not None:
        colors = primaries.icc_colors(bytes(icc))
    elif kind == "png":
        with PngImagePlugin.PngImageFile(path) as image:
            colors = primaries.png_colors(image.info)
    elif kind == "jpeg" and str(exif_tags(path).get("Interoperability InteroperabilityIndex")) == "R03":
        colors = primaries.space_colors("adobergb")  # for which cameras embed no profile
    exif: Path | bytes = path
    if kind == "webp":  # where ExifRead finds none
        with WebPImagePlugin.WebPImageFile(path) as webp:
            exif = webp.info.get("exif") or b""
    count, alpha = spec.nchannels, spec.alpha_channel

    def decode() -> tuple[Any, np.ndarray | None]:
        file = _oiio_input(path, kind)
        pixels = file.read_image(0, 0, 0, min(count, max(3, alpha + 1)), name)
        if pixels is None or file.has_error:
            raise ValueError(file.geterror() or "it is damaged")
        return (pixels, None) if alpha < 0 else (pixels[..., :3], np.asarray(pixels)[..., alpha])

    is_plain, size = colors.curve is None and colors.matrix is None, (spec.width, spec.height)
    return Picture(path, kind, size, "float32" if colors.is_log else name, colors, is_plain, decode, exif)


def _refuse_previews(path: Path) -> None:
    """Refuse a TIFF of whose values OpenImageIO would give others."""
    tags = exif_tags(path)
    names = "PhotometricInterpretation", "SubfileType"
    colors, kind = (exif_number(tags, f"Image {name}") for name in names)
    if colors in _NO_RGB:
        what = f"its values are {_NO_RGB[int(colors)]} values, not RGB"
    elif kind is not None and int(kind) % 2 == 1:
        what = "its first image is a preview, as in RAW files"
    else:
        return
    raise FiptError("image-format.preview", path=path, what=what)


def _oiio_input(path: Path, kind: str) -> Any:
    hints = oiio.ImageSpec()
    hints.attribute("oiio:UnassociatedAlpha", 1)  # colours are not multiplied by alpha
    file = oiio.ImageInput.open(str(path), hints)
    if file is None or file.format_name() != kind:
        raise ValueError(oiio.geterror() or f"it is no valid {kind}; {FORMATS} can be read")
    return file


_OPEN = {"exr": _open_exr, "heif": _open_heif}  # of other formats, OpenImageIO


def _png_chunk(path: Path, name: bytes) -> bytes | None:
    """The content of a PNG's chunk before its pixels; None without it."""
    with path.open("rb") as file:
        file.seek(8)
        while len(head := file.read(8)) == 8 and head[4:] != b"IDAT":
            length = int.from_bytes(head[:4], "big")
            if head[4:] == name:
                return file.read(min(length, MOST_CHUNK))
            file.seek(length + 4, io.SEEK_CUR)
    return None


def _radiance_colors(path: Path, space: str) -> Colors:
    """What a Radiance file's header says of its values, or a space's name; OpenImageIO applies none of it."""
    with path.open("rb") as file:
        head, _, rest = file.read(65_536).partition(b"\n\n")
    if not rest.startswith(b"-Y"):
        raise ValueError("its rows are in an unusual order")
    named = primaries.space_colors(space, "float32") if space else Colors()
    scale, matrix = np.ones(3), named.matrix
    for line in head.split(b"\n"):
        name, _, value = line.partition(b"=")
        if name == b"FORMAT" and value.strip() != b"32-bit_rle_rgbe":
            raise ValueError("its colors are CIE XYZ, not RGB")
        if name == b"PRIMARIES" and not space:
            matrix = primaries.to_rec709(np.array(value.split(), np.float64))
        elif name in (b"EXPOSURE", b"COLORCORR"):
            scale = scale / np.array(value.split(), np.float64)
    if scale.shape != (3,) or not ((scale > 1e-12) & (scale < 1e12)).all():
        raise ValueError("its exposure makes no sense")
    plain = matrix is None and (scale == 1.0).all()
    return Colors(named.curve, None if plain else (np.eye(3) if matrix is None else matrix) * scale)


def _three(values: np.ndarray) -> np.ndarray:
    """Values (height, width, 3) of 1 or 3 channels; grey ones are repeated."""
    return np.repeat(values, 3, axis=-1) if values.shape[-1] < 3 else values


@lru_cache(maxsize=4)
def _curve_table(colors: Colors, stored: np.dtype[Any]) -> np.ndarray:
    """(levels, 3) linear value of each code of a type."""
    codes = np.linspace(0.0, 1.0, np.iinfo(stored).max + 1)
    curve = colors.curve or (lambda values: np.repeat(srgb_decoded(values)[:, None], 3, axis=1))
    return curve(codes) if colors.is_log else np.clip(curve(codes), 0.0, 1.0)


def _mapped(table: np.ndarray, codes: np.ndarray) -> np.ndarray:
    """Codes (..., 3) by a table (levels, 3)."""
    return np.stack([table[codes[..., channel], channel] for channel in range(3)], axis=-1)


def _png_ids(picture: Picture) -> np.ndarray:
    """Ids (height, width) int64 of an id image in PNG."""
    path = picture.path
    try:
        with PngImagePlugin.PngImageFile(path) as image:  # of palettes, OpenImageIO gives only the colours
            if image.mode == "P":
                return np.asarray(image).astype(np.int64)
            bits = {"1": 1, "L;2": 2, "L;4": 4}.get(str(image.tile[0].args), 8)
    except DAMAGE as error:
        raise unreadable(path, error) from None
    colors = picture.stored()[0].astype(np.int64)
    if colors.shape[-1] < 3:
        return colors[..., 0] // (255 // (2**bits - 1))  # fewer bits than 8 are scaled
    if picture.type == "uint16":
        same = (colors % 257 == 0).all(axis=-1)
        red = colors[..., 0] if same.all() else _red(path, colors)
        return np.where(same, _packed(colors // 257), red)
    return _packed(colors)


def _packed(colors: np.ndarray) -> np.ndarray:
    return np.asarray((colors[..., 0] << 16) + (colors[..., 1] << 8) + colors[..., 2])


def _red(path: Path, colors: np.ndarray) -> np.ndarray:
    """The first channel of (height, width, channels), to which the others must have nothing to add."""
    red, others = colors[..., :1], colors[..., 1:]
    if others.any() and (others != red).any():
        remedy = "with one channel, or as PNG with colors of 8 bits"
        raise _no_ids(path, "has several values in each pixel, which are too many for an id", remedy)
    return np.asarray(red[..., 0])


def _no_ids(path: Path, fault: str, remedy: str) -> FiptError:
    return FiptError("mask-not-ids", path=path, fault=fault, remedy=remedy)
