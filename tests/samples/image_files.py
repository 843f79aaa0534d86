"""Image files as other programs write them: PNG of any depth, EXR of parts and layers, TIFF, ICC profiles."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import OpenEXR
import OpenImageIO as oiio

# x, y of red, green, blue and white.
PRIMARIES = {
    "P3": (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.3290),
    "Rec.2020": (0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.3290),
    "Adobe RGB": (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.3290),
    "Rec.709": (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290),
}
XYZ_FROM_REC709 = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
_D50 = np.array([0.9642, 1.0, 0.8249])


def _fixed(numbers: object) -> bytes:
    """Numbers as ICC profiles have them."""
    return np.round(np.array(numbers) * 65536).astype(">i4").tobytes()


def xyz_of(chromaticities: tuple[float, ...]) -> np.ndarray:
    """(3, 3) from linear values to CIE XYZ."""
    x, y = np.array(chromaticities).reshape(4, 2).T
    columns = np.stack([x / y, np.ones(4), (1.0 - x - y) / y])
    return columns[:, :3] * np.linalg.solve(columns[:, :3], columns[:, 3])


def in_primaries(rec709: np.ndarray, name: str) -> np.ndarray:
    """Linear values in other primaries with the same white."""
    return rec709 @ np.linalg.solve(xyz_of(PRIMARIES[name]), xyz_of(PRIMARIES["Rec.709"])).T


def _parameters(kind: int, *numbers: float) -> bytes:
    return (
        b"para" + bytes(4) + struct.pack(">HH", kind, 0) + np.round(np.array(numbers) * 65536).astype(">i4").tobytes()
    )


def _table(values: np.ndarray) -> bytes:
    return b"curv" + bytes(4) + struct.pack(">I", len(values)) + np.round(values).astype(">u2").tobytes()


def _srgb(linear: np.ndarray) -> np.ndarray:
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)


def _raised(linear: np.ndarray) -> np.ndarray:
    return np.sqrt(linear - 0.0975) / 0.95


# Of ICC profiles: the tag, and codes of linear values from 0 to 1.
CURVES = {
    "sRGB": (_parameters(3, 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045), _srgb),
    "linear": (_table(np.zeros(0)), lambda linear: linear),
    "gamma 1.8": (_table(np.array([1.8 * 256.0])), lambda linear: linear ** (1.0 / 1.8)),
    "gamma 2.2": (_parameters(0, 2.2), lambda linear: linear ** (1.0 / 2.2)),
    "table": (_table(65535.0 * np.linspace(0.0, 1.0, 1025) ** 2.0), np.sqrt),
    "shifted": (_parameters(1, 2.0, 0.9, 0.1), lambda linear: (np.sqrt(linear) - 0.1) / 0.9),
    "raised": (_parameters(4, 2.0, 0.95, 0.0, 0.5, 0.0, 0.0975, 0.0975), _raised),
}


def icc_profile(primaries: str, curve: str) -> bytes:
    """A profile of a display, version 4."""
    matrix = xyz_of(PRIMARIES[primaries])
    adapted = (_BRADFORD @ _D50) / (_BRADFORD @ matrix.sum(axis=1))
    matrix = np.linalg.solve(_BRADFORD, adapted[:, None] * _BRADFORD) @ matrix
    text = "test".encode("utf-16-be")
    description = b"mluc" + bytes(4) + struct.pack(">II2s2sII", 1, 12, b"en", b"US", len(text), 28) + text

    def place(values: np.ndarray) -> bytes:
        return b"XYZ " + bytes(4) + _fixed(values)

    tags = {b"desc": description, b"cprt": description, b"wtpt": place(_D50)}
    tags |= {name: place(matrix[:, index]) for index, name in enumerate((b"rXYZ", b"gXYZ", b"bXYZ"))}
    tags |= dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), CURVES[curve][0])
    table, body, start = b"", b"", 132 + 12 * len(tags)
    for name, data in tags.items():
        table += struct.pack(">4sII", name, start + len(body), len(data))
        body += data + bytes(-len(data) % 4)
    head = struct.pack(">I4sI4s4s4s12s4s", start + len(body), bytes(4), 0x04200000, b"mntr", b"RGB ", b"XYZ ",
                       struct.pack(">6H", 2026, 1, 1, 0, 0, 0), b"acsp")  # fmt: skip
    head += bytes(28) + _fixed(_D50) + bytes(48)
    return head + struct.pack(">I", len(tags)) + table + body


def write_png(path: Path, samples: np.ndarray, depth: int, color: int, *chunks: tuple[bytes, bytes]) -> Path:
    """Write samples (height, width, channels) with 1 to 16 bits; `color` is PNG's number of their kind."""
    height, width = samples.shape[:2]
    if depth == 16:
        rows = samples.astype(">u2").view(np.uint8).reshape(height, -1)
    else:
        bits = np.unpackbits(samples.reshape(height, -1, 1).astype(np.uint8), axis=2)[..., 8 - depth :]
        rows = np.packbits(bits.reshape(height, -1), axis=1)
    filtered = np.pad(rows, ((0, 0), (1, 0)))
    if color == 3:
        chunks = (*chunks, (b"PLTE", np.random.default_rng(0).bytes(3 * 2**depth)))
    header = struct.pack(">IIBBBBB", width, height, depth, color, 0, 0, 0)
    data = [(b"IHDR", header), *chunks, (b"IDAT", zlib.compress(filtered.tobytes())), (b"IEND", b"")]
    blocks = [struct.pack(">I", len(b)) + k + b + struct.pack(">I", zlib.crc32(k + b)) for k, b in data]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(blocks))
    return path


def write_tiff(path: Path, pixels: np.ndarray, planar: bool = False, profile: bytes | None = None) -> Path:
    """Write pixels (height, width, channels) of 8 or 16 bits or floats, planes apart or not."""
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, oiio.TypeDesc(str(pixels.dtype).replace("float32", "float")))
    spec.attribute("planarconfig", "separate" if planar else "contig")
    if profile is not None:
        spec.attribute("ICCProfile", oiio.TypeDesc(f"uint8[{len(profile)}]"), np.frombuffer(profile, np.uint8))
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec), output.geterror()
    output.write_image(np.ascontiguousarray(pixels))
    output.close()
    return path


def write_exr_layers(path: Path, layers: dict[str, dict[str, np.ndarray]], parts: bool, **header: object) -> Path:
    """Write channels by layer ("" for none), each layer in a part of its own or all in one part."""
    header = {"type": OpenEXR.scanlineimage, **header}
    if parts:
        found = [OpenEXR.Part({**header, "name": name}, dict(planes)) for name, planes in layers.items()]
        OpenEXR.File(found).write(str(path))
    else:
        named = [(name, key, plane) for name, planes in layers.items() for key, plane in planes.items()]
        channels = {f"{name}.{key}" if name else key: plane for name, key, plane in named}
        OpenEXR.File(header, channels).write(str(path))
    return path


def write_plain_exr(path: Path, planes: dict[str, np.ndarray], chromaticities: tuple[float, ...]) -> Path:
    """Write float channels without compression, smaller ones as every n-th pixel of every n-th row.

    The bindings of OpenEXR do not write such channels.
    """
    height, width = max(plane.shape for plane in planes.values())
    steps = {name: height // len(plane) for name, plane in planes.items()}

    def attribute(name: bytes, kind: bytes, data: bytes) -> bytes:
        return name + b"\0" + kind + b"\0" + struct.pack("<I", len(data)) + data

    channels = b"".join(
        name.encode() + struct.pack("<BI4xII", 0, 2, steps[name], steps[name]) for name in sorted(planes)
    )
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    head = b"\x76\x2f\x31\x01" + struct.pack("<I", 2)
    head += attribute(b"channels", b"chlist", channels + b"\0")
    head += attribute(b"chromaticities", b"chromaticities", struct.pack("<8f", *chromaticities))
    head += attribute(b"compression", b"compression", b"\0") + attribute(b"dataWindow", b"box2i", window)
    head += attribute(b"displayWindow", b"box2i", window) + attribute(b"lineOrder", b"lineOrder", b"\0")
    head += attribute(b"pixelAspectRatio", b"float", struct.pack("<f", 1.0))
    head += attribute(b"screenWindowCenter", b"v2f", bytes(8))
    head += attribute(b"screenWindowWidth", b"float", struct.pack("<f", 1.0)) + b"\0"
    rows, offsets, start = b"", [], len(head) + 8 * height
    for y in range(height):
        data = b"".join(
            planes[name][y // steps[name]].astype("<f4").tobytes() for name in sorted(planes) if y % steps[name] == 0
        )
        offsets.append(start + len(rows))
        rows += struct.pack("<ii", y, len(data)) + data
    path.write_bytes(head + struct.pack(f"<{height}Q", *offsets) + rows)
    return path
