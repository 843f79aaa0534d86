"""What image files mean: layers and parts, primaries and curves, orientation, bits, whatever their suffix."""

from __future__ import annotations

import struct

import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pytest
from PIL import Image

from fipt_blender.core.capture.encoded import srgb_decoded, srgb_encoded
from fipt_blender.core.capture.images import open_picture, read_codes, read_ids, read_radiance, read_size, write_exr
from fipt_blender.core.capture.primaries import space_colors
from fipt_blender.core.capture.views import load_capture
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.prepare.exif import describe
from fipt_blender.prepare.frames import load, upright
from samples.capture_files import make_samples, write_transforms
from samples.combinations import pairs
from samples.image_files import (
    CURVES,
    PRIMARIES,
    XYZ_FROM_REC709,
    icc_profile,
    in_primaries,
    write_exr_layers,
    write_plain_exr,
    write_png,
    write_tiff,
    xyz_of,
)
from samples.ingesting import edited_json, run_ingest
from samples.photographs import exif
from samples.refusals import error_of

HEIGHT, WIDTH = 6, 8


BEAUTIES = ("Combined", "beauty", "RGBA", "rgba", "rgb", "C", "Ci", "Image", "color", "ViewLayer.Combined")
PASSES = (
    *("N", "Normal", "AO", "albedo", "DiffCol", "Denoising Normal", "P", "cryptomatte00", "uv", "mist"),
    *("Scene.Emit", "ViewLayer.AO", "GlossDir", "Depth", "world_position", "IndexOB", "foo.Shadow"),
)
CHANNELS = ("RGB", "RGBA", ("red", "green", "blue"), ("r", "g", "b"))
OTHER_CHANNELS = ("RGB", "XYZ", "Y", "Z", "UV", ("x", "y", "z"))


def layer(rng: np.random.Generator, channels: object) -> dict[str, np.ndarray]:
    return {name: rng.random((HEIGHT, WIDTH), np.float32) for name in channels}


def stacked(planes: dict[str, np.ndarray]) -> np.ndarray:
    return np.stack(list(planes.values())[:3], axis=-1)


def some_layers(seed: int, beauties: int) -> tuple[dict[str, dict[str, np.ndarray]], list[str], bool]:
    """Layers in any order, the names of those that may be the picture, and whether each is a part."""
    rng = np.random.default_rng(seed)
    parts = bool(rng.integers(2))
    names = {name.rpartition(".")[2].lower(): name for name in rng.permutation(BEAUTIES).tolist()}
    chosen = list(names.values())[:beauties]
    layers = {name: layer(rng, CHANNELS[rng.integers(len(CHANNELS))]) for name in chosen}
    for name in rng.choice(PASSES, rng.integers(1, 5), replace=False).tolist():
        layers[name] = layer(rng, OTHER_CHANNELS[rng.integers(len(OTHER_CHANNELS))])
    return {name: layers[name] for name in rng.permutation(list(layers)).tolist()}, chosen, parts


@pytest.mark.parametrize("seed", range(16))
def test_the_picture_of_an_exr_is_found_by_its_name(tmp_path, seed):
    layers, (name,), parts = some_layers(seed, 1)
    path = write_exr_layers(tmp_path / "a.exr", layers, parts)
    np.testing.assert_array_equal(read_radiance(path), stacked(layers[name]))
    assert not open_picture(path).is_plain
    layers = {"other" if key == name else key: planes for key, planes in layers.items()}
    path = write_exr_layers(tmp_path / "b.exr", layers, parts)  # what is no known pass is left
    np.testing.assert_array_equal(read_radiance(path), stacked(layers["other"]))


@pytest.mark.parametrize("seed", range(8))
def test_several_pictures_in_an_exr_are_listed_and_one_can_be_named(tmp_path, seed):
    layers, names, parts = some_layers(seed, 2)
    path = write_exr_layers(tmp_path / "a.exr", layers, parts)
    error = error_of(read_radiance, path)
    assert error.code == "image-layers" and "--layer" in error.remedy
    assert all(name in error.text for name in names)
    for name in (*names, names[0].upper(), *(key for key, planes in layers.items() if set("RGB") <= set(planes))):
        wanted = next(key for key in layers if key.lower() == name.lower())
        np.testing.assert_array_equal(read_radiance(path, name), stacked(layers[wanted]))
    assert error_of(read_radiance, path, "absent").code == "image-channels"
    assert read_size(path) == (WIDTH, HEIGHT)
    path.write_bytes(path.read_bytes()[:-30])
    assert error_of(read_radiance, path, names[0]).code == "image-unreadable"


@pytest.mark.parametrize(("name", "channels"), pairs(("N", "ao", "Layer.DiffCol"), ("RGB", "XYZ", "Y")))
def test_a_pass_alone_is_no_picture_unless_it_is_asked_for(tmp_path, name, channels):
    planes = layer(np.random.default_rng(0), channels)
    path = write_exr_layers(tmp_path / "a.exr", {name: planes}, parts=False)
    assert error_of(read_radiance, path).code == "image-channels"
    if channels == "RGB":
        np.testing.assert_array_equal(read_radiance(path, name), stacked(planes))


def test_colors_come_before_luminance_and_the_unnamed_layer_before_all(tmp_path):
    rng = np.random.default_rng(0)
    layers = {"": layer(rng, "Y"), "foo": layer(rng, "RGB")}
    path = write_exr_layers(tmp_path / "a.exr", layers, parts=False)
    np.testing.assert_array_equal(read_radiance(path), stacked(layers["foo"]))
    layers = {"": layer(rng, "RGB"), "Combined": layer(rng, "RGB"), "foo": layer(rng, "RGB")}
    path = write_exr_layers(tmp_path / "b.exr", layers, parts=False)
    np.testing.assert_array_equal(read_radiance(path), stacked(layers[""]))


@pytest.mark.parametrize(("step", "primaries"), pairs((1, 2), ("Rec.709", "P3")))
def test_luminance_with_chroma(tmp_path, step, primaries):
    """Luminance is CIE Y of the file's primaries; chroma lies on the first pixel of each square."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH] / 10.0
    pixels = np.array([0.8, 0.3, 0.1]) * (1.0 + rows + columns)[..., None]
    luminance = pixels @ xyz_of(PRIMARIES[primaries])[1]
    chroma = pixels[..., [0, 2]] / luminance[..., None] - 1.0
    planes = {"BY": chroma[::step, ::step, 1], "RY": chroma[::step, ::step, 0], "Y": luminance}
    path = write_plain_exr(tmp_path / "a.exr", planes, PRIMARIES[primaries])
    found = in_primaries(read_radiance(path).astype(np.float64), primaries)
    np.testing.assert_allclose(found, pixels, rtol=1e-4)
    assert not open_picture(path).is_plain


RADIANCE = np.array([[[0.6, 0.15, 0.08], [0.1, 0.4, 0.2], [0.3, 0.3, 0.3], [0.2, 0.25, 0.7]]] * 4)


def write_hdr(path, pixels, header=b"", form=b"rgbe"):
    exponent = np.frexp(pixels.max(axis=-1))[1]
    codes = np.floor(pixels * 256.0 / 2.0 ** exponent[..., None])
    rgbe = np.concatenate([codes, exponent[..., None] + 128.0], axis=-1).astype(np.uint8)
    size = b"-Y %d +X %d\n" % pixels.shape[:2]
    path.write_bytes(b"#?RADIANCE\n" + header + b"FORMAT=32-bit_rle_" + form + b"\n\n" + size + rgbe.tobytes())
    return path


@pytest.mark.parametrize("white", [(0.3127, 0.3290), (1 / 3, 1 / 3)])
def test_exr_files_of_cie_xyz(tmp_path, white):
    xyz = RADIANCE @ XYZ_FROM_REC709.T
    xyz = xyz if white[0] > 0.32 else xyz / [0.95047, 1.0, 1.08883]  # relative to the white
    planes = {name: np.ascontiguousarray(xyz[..., i].astype(np.float32)) for i, name in enumerate("RGB")}
    chromaticities = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, *white)
    path = write_exr_layers(tmp_path / "a.exr", {"": planes}, parts=False, chromaticities=chromaticities)
    np.testing.assert_allclose(read_radiance(path), RADIANCE, atol=1e-3)
    assert not open_picture(path).is_plain


EXPOSURES = (b"", b"EXPOSURE=2\nEXPOSURE=.25\n", b"COLORCORR= 2 1 .5\n")


@pytest.mark.parametrize(("primaries", "exposure"), pairs(PRIMARIES, EXPOSURES))
def test_radiance_files_with_primaries_and_exposures(tmp_path, primaries, exposure):
    header, pixels = exposure, RADIANCE
    if primaries != "Rec.709":
        pixels = in_primaries(pixels, primaries)
        header += b"PRIMARIES=" + b" ".join(b"%.4f" % value for value in PRIMARIES[primaries]) + b"\n"
    factor = np.array([2.0, 1.0, 0.5]) if b"COLOR" in exposure else 0.5 if exposure else 1.0
    path = write_hdr(tmp_path / "a.hdr", pixels * factor, header)
    assert not open_picture(path).is_encoded and read_size(path) == (4, 4)
    assert open_picture(path).is_plain == (primaries == "Rec.709" and not exposure)
    np.testing.assert_allclose(read_radiance(path), RADIANCE, atol=0.012)  # of 8 bits, before the matrix
    assert describe(path, "a.hdr").exposure == 1.0
    whole = path.read_bytes()
    for length in (len(whole) - 4 * pixels[..., 0].size + 3, len(whole) - 1):
        path.write_bytes(whole[:length])
        assert error_of(read_radiance, path).code == "image-unreadable"
    assert "XYZ" in error_of(read_radiance, write_hdr(path, pixels, form=b"xyze")).text


def write_codes(path, codes, profile):
    """Codes (height, width, 3) from 0 to 1 with 8 bits, of TIFF with 16, and an ICC profile."""
    if path.suffix == ".tif":
        return write_tiff(path, np.round(codes * 65535).astype(np.uint16), profile=profile)
    options = {"lossless": True} if path.suffix == ".webp" else {"quality": 100, "subsampling": 0}
    if path.suffix == ".heic":
        pillow_heif = pytest.importorskip("pillow_heif")
        pillow_heif.register_heif_opener()
        options = {"quality": -1, "chroma": 444, "matrix_coefficients": 0}
    Image.fromarray(np.round(codes * 255).astype(np.uint8)).save(path, icc_profile=profile, **options)
    return path


@pytest.mark.parametrize(
    ("suffix", "primaries", "curve"),
    pairs((".jpg", ".png", ".tif", ".webp", ".heic"), ("P3", "Adobe RGB", "Rec.709"), CURVES),
)
def test_icc_profiles_say_primaries_and_curve(tmp_path, suffix, primaries, curve):
    colors = np.kron(0.2 + 0.6 * RADIANCE, np.ones((16, 16, 1)))  # within all curves and primaries
    encode = CURVES[curve][1]
    path = write_codes(tmp_path / f"a{suffix}", encode(in_primaries(colors, primaries)), icc_profile(primaries, curve))
    tolerance = 2e-3 if suffix == ".tif" else 0.02
    np.testing.assert_allclose(read_radiance(path)[8::16, 8::16], colors[8::16, 8::16], atol=tolerance)
    assert open_picture(path).is_encoded and open_picture(path).is_plain == (
        primaries == "Rec.709" and curve == "sRGB" and suffix != ".heic"
    )
    codes, matrix = read_codes(path)  # for `prepare`: by sRGB's curve, with the matrix to follow
    linear = srgb_decoded(codes / float(np.iinfo(codes.dtype).max))
    linear = linear if matrix is None else linear @ matrix.T
    np.testing.assert_allclose(linear[8::16, 8::16], colors[8::16, 8::16], atol=tolerance)
    assert codes.dtype == (np.uint8 if curve == "sRGB" and suffix != ".tif" else np.uint16)


@pytest.mark.parametrize(("gamma", "primaries"), pairs((0.45455, 1.0, 1 / 1.8), PRIMARIES))
def test_png_chunks_say_primaries_and_gamma(tmp_path, gamma, primaries):
    values = np.round(np.roll(PRIMARIES[primaries], 2) * 1e5).astype(">u4").tobytes()
    chunks = [(b"gAMA", int(gamma * 1e5).to_bytes(4, "big")), (b"cHRM", values)]
    linear = in_primaries(0.2 + 0.6 * RADIANCE, primaries)
    codes = srgb_encoded(linear) if gamma == 0.45455 else linear**gamma
    samples = np.round(codes * 65535)
    path = write_png(tmp_path / "a.png", samples, 16, 2, *chunks)
    np.testing.assert_allclose(read_radiance(path), 0.2 + 0.6 * RADIANCE, atol=2e-3)
    if primaries == "Rec.709" and gamma == 0.45455:
        assert np.array_equal(read_codes(path)[0], samples)  # all sixteen bits


@pytest.mark.parametrize(("number", "primaries"), [(1, "Rec.709"), (12, "P3")])
@pytest.mark.parametrize("transfer", [1, 8, 13])
def test_png_chunks_say_colors_by_numbers(tmp_path, number, primaries, transfer):
    linear = in_primaries(0.2 + 0.6 * RADIANCE, primaries)
    codes = {1: 1.099 * linear**0.45 - 0.099, 8: linear, 13: srgb_encoded(linear)}[transfer]
    chunks = [(b"gAMA", (45455).to_bytes(4, "big")), (b"cICP", bytes([number, transfer, 0, 1]))]
    path = write_png(tmp_path / "a.png", np.round(codes * 65535), 16, 2, *chunks)
    np.testing.assert_allclose(read_radiance(path), 0.2 + 0.6 * RADIANCE, atol=3e-3)


@pytest.mark.parametrize(("number", "transfer", "word"), [(9, 16, "HDR"), (9, 18, "HDR"), (22, 13, "H.273")])
def test_png_chunks_of_video_are_refused(tmp_path, number, transfer, word):
    chunk = (b"cICP", bytes([number, transfer, 0, 1]))
    path = write_png(tmp_path / "a.png", np.full((8, 8, 3), 999), 16, 2, chunk)
    error = error_of(read_radiance, path)
    assert error.code == "image-unreadable" and word in error.text


@pytest.mark.parametrize(
    "damage", [lambda p: b"", lambda p: p[:140], lambda p: p[:-150], lambda p: p.replace(b"RGB ", b"CMYK")]
)
def test_a_profile_that_says_nothing_is_refused_or_left(tmp_path, damage):
    path = tmp_path / "a.jpg"
    profile = damage(icc_profile("P3", "table"))
    Image.fromarray(np.full((8, 8, 3), 99, np.uint8)).save(path, icc_profile=profile)
    if profile:
        error = error_of(read_radiance, path)
        assert error.code == "image-unreadable" and "profile" in error.text
    else:
        assert read_radiance(path).shape == (8, 8, 3)


@pytest.mark.parametrize(("tag", "value", "word"), [(262, 32845, "LogLuv"), (262, 8, "Lab"), (254, 1, "preview")])
def test_tiffs_of_which_other_values_would_be_read_are_refused(tmp_path, tag, value, word):
    path = tmp_path / "a.tif"
    Image.fromarray(np.full((8, 8, 3), 99, np.uint8)).save(path, tiffinfo={254: 0})
    data = bytearray(path.read_bytes())
    place = data.index(struct.pack("<HH", tag, 4 if tag == 254 else 3) + struct.pack("<I", 1))
    data[place + 8 : place + 12] = struct.pack("<I", value)
    path.write_bytes(data)
    error = error_of(read_radiance, path)
    assert error.code == "image-format" and word in error.text and "OpenEXR" in error.remedy


@pytest.mark.parametrize(
    ("content", "word"),
    [(b"\0\0\0\x20ftypavif", "AVIF"), (b"\0\0\0\x0cjP  \r\n", "JPEG 2000"), (b"8BPS\0\1", "Photoshop"), (b"BM", "BMP")],
)
def test_pictures_that_are_not_read_are_named_whatever_their_suffix(tmp_path, content, word):
    path = tmp_path / "a.heic"
    path.write_bytes(content + bytes(64))
    error = error_of(read_radiance, path)
    assert error.code == "image-format" and word in error.text and "PNG" in error.remedy


CODES = np.random.default_rng(3).integers(0, 256, (HEIGHT, WIDTH, 3)).astype(np.uint8)
WRITERS = {
    "png": lambda path: Image.fromarray(np.dstack([CODES, CODES[..., 0]])).save(path, "PNG"),  # alpha says nothing
    "grey": lambda path: Image.fromarray(CODES[..., 0]).save(path, "PNG"),
    "palette": lambda path: Image.fromarray(CODES).quantize(48, dither=Image.Dither.NONE).save(path, "PNG"),
    "tiff": lambda path: Image.fromarray(CODES).save(path, "TIFF"),
    "webp": lambda path: Image.fromarray(CODES).save(path, "WEBP", lossless=True),
    "exr": lambda path: write_exr(path, srgb_decoded(CODES / 255.0)),
}


@pytest.mark.parametrize(("kind", "suffix"), pairs(WRITERS, (".jpg", ".png", ".tif", ".exr", ".webp", ".hdr", ".bin")))
def test_the_content_of_a_file_decides_not_its_suffix(tmp_path, kind, suffix):
    path = tmp_path / f"a{suffix}"
    WRITERS[kind](path)
    wanted = CODES[..., :1] if kind == "grey" else CODES
    assert np.abs(np.round(srgb_encoded(read_radiance(path)) * 255.0) - wanted).max() <= (9 if kind == "palette" else 0)
    assert read_size(path) == (WIDTH, HEIGHT) and open_picture(path).is_encoded == (kind != "exr")


@pytest.mark.parametrize(
    ("planar", "channels", "kind"), pairs((False, True), (1, 2, 3, 4), ("uint8", "uint16", "float32"))
)
def test_tiff_of_any_depth_planes_apart_or_not(tmp_path, planar, channels, kind):
    values = np.random.default_rng(channels).random((HEIGHT, WIDTH, channels), np.float32)
    most = 1 if kind == "float32" else np.iinfo(kind).max
    stored = (values * most).astype(kind)
    path = write_tiff(tmp_path / "a.tif", stored, planar)
    wanted = stored[..., :3] if channels > 2 else np.repeat(stored[..., :1], 3, axis=-1)
    assert open_picture(path).is_encoded == (kind != "float32") == (describe(path, "a").kind == "ldr")
    found = read_radiance(path)
    if kind != "float32":
        assert np.array_equal(read_codes(path)[0], wanted)
    np.testing.assert_allclose(found if most == 1 else srgb_encoded(found) * most, wanted, rtol=1e-4, atol=most * 1e-6)


@pytest.mark.parametrize(("suffix", "orientation"), pairs((".jpg", ".png", ".tif", ".webp"), range(1, 9)))
def test_pixels_are_as_stored_and_upright_once(tmp_path, suffix, orientation):
    """A camera's pose belongs to the stored pixels; `prepare` turns them."""
    tall = np.kron(CODES, np.ones((8, 8, 1))).astype(np.uint8)
    path = tmp_path / f"a{suffix}"
    options = {"lossless": True} if suffix == ".webp" else {"quality": 100, "subsampling": 0}
    Image.fromarray(tall).save(path, exif=exif(0.01, orientation=orientation), **options)
    assert np.abs(srgb_encoded(read_radiance(path)) * 255.0 - tall).max() < 8.0
    photograph = describe(path, path.name)
    assert photograph.orientation == orientation
    assert suffix == ".tif" or photograph.shutter == pytest.approx(0.01)  # Pillow writes none there
    turned = upright(load(path, photograph).values, photograph.orientation)
    assert turned.shape[1::-1] == photograph.upright_size
    assert np.abs(turned.astype(int) - upright(tall, orientation)).max() < 8


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_heic_is_turned_once(tmp_path, orientation):
    """By its container, which the decoder does; its EXIF, which cameras write as well, is left out."""
    pillow_heif = pytest.importorskip("pillow_heif")
    pillow_heif.register_heif_opener()
    tall = np.kron(CODES, np.ones((16, 16, 1))).astype(np.uint8)
    tags = exif(0.01, orientation=orientation).tobytes()
    Image.fromarray(tall).save(tmp_path / "a.heic", exif=tags, quality=100)
    assert (b"irot" in (tmp_path / "a.heic").read_bytes()) == (orientation > 1)
    photograph = describe(tmp_path / "a.heic", "a.heic")
    turned = upright(load(tmp_path / "a.heic", photograph).values, photograph.orientation)
    assert photograph.shutter == pytest.approx(0.01)
    wanted = upright(tall, orientation)
    assert turned.shape == wanted.shape and turned.shape[1::-1] == read_size(tmp_path / "a.heic")
    assert np.abs(turned.astype(int) - wanted)[8::16, 8::16].max() < 40  # chroma has half the pixels


# PNG's numbers of the kinds of colour, with their channels and depths.
PNG_KINDS = {0: (1, (1, 2, 4, 8, 16)), 2: (3, (8, 16)), 3: (1, (1, 2, 4, 8)), 4: (2, (8, 16)), 6: (4, (8, 16))}


@pytest.mark.parametrize(
    ("color", "depth"), [(color, depth) for color, (_, depths) in PNG_KINDS.items() for depth in depths]
)
def test_id_images_keep_all_ids(tmp_path, color, depth):
    channels = PNG_KINDS[color][0]
    rng = np.random.default_rng(10 * color + depth)
    ids = rng.integers(0, 2**depth, (HEIGHT, WIDTH))
    samples = np.repeat(ids[..., None], channels, axis=-1)
    samples[..., 1:3] = 0 if channels > 2 else rng.integers(0, 2**depth, samples[..., 1:3].shape)
    path = write_png(tmp_path / "a.png", samples, depth, color)
    found = read_ids(path)
    assert found.dtype == np.int32 and len(np.unique(found)) == len(np.unique(ids))
    if channels < 3 or depth == 16:
        np.testing.assert_array_equal(found, np.where(ids % 257, ids, ids // 257 << 16) if channels > 2 else ids)
    else:
        np.testing.assert_array_equal(found, ids << 16)


def test_colors_of_16_bits_are_those_of_8_or_refused(tmp_path):
    colors = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3))
    plain = read_ids(write_png(tmp_path / "a.png", colors, 8, 2))
    np.testing.assert_array_equal(read_ids(write_png(tmp_path / "b.png", colors * 257, 16, 2)), plain)
    assert error_of(read_ids, write_png(tmp_path / "c.png", colors * 250, 16, 2)).code == "mask-not-ids"
    write_exr(tmp_path / "d.exr", colors)
    assert error_of(read_ids, tmp_path / "d.exr").code == "mask-not-ids"


def test_an_imported_photograph_is_what_other_programs_read(tmp_path):
    """Blender knows neither profiles nor layers: such photographs are written anew, the others stay."""
    write_transforms(tmp_path / "in", make_samples(2))
    first, second = (tmp_path / "in" / "images" / f"00{index}_0001.exr" for index in range(2))
    colors = np.zeros_like(read_radiance(first)) + [0.6, 0.15, 0.08]
    write_codes(first.with_suffix(".jpg"), srgb_encoded(in_primaries(colors, "P3")), icc_profile("P3", "sRGB"))
    first.unlink()
    with edited_json(tmp_path / "in" / "transforms.json") as data:
        data["frames"][0]["file_path"] = f"images/{first.stem}.jpg"
    black = np.zeros_like(read_radiance(second)[..., 0])
    layers = {"rgba": dict.fromkeys("RGB", black), "beauty": dict.fromkeys("RGB", black + np.float32(0.7))}
    write_exr_layers(second, layers, parts=True)
    run = RunFolder(tmp_path / "run")
    assert error_of(run_ingest, tmp_path / "in", run).code == "image-layers"
    run_ingest(tmp_path / "in", run, layer="beauty", hold_back=0)
    views = load_capture(run).views
    np.testing.assert_allclose(views[0].radiance(), colors, atol=0.02)
    np.testing.assert_array_equal(views[1].radiance(), np.float32(0.7))
    assert [view.encoded for view in views] == [True, False]
    assert all(view.image.is_relative_to(run.root) and open_picture(view.image).is_plain for view in views)


@pytest.mark.parametrize(
    ("name", "code", "linear"),
    [  # published codes of 18 % grey; of Apple's and Blackmagic's, of white and twelve times that
        ("ARRI LogC3 (EI800)", 0.391, 0.18),
        ("ARRI LogC4", 0.27840, 0.18),
        ("S-Log3 S-Gamut3.Cine", 420.0 / 1023.0, 0.18),
        ("vlog_vgamut", 0.42331, 0.18),
        ("Log3G10 REDWideGamutRGB", 1.0 / 3.0, 0.18),
        ("ACEScct", 0.41359, 0.18),
        ("davinci intermediate widegamut", 0.336043, 0.18),
        ("Apple Log", 1.0, 12.0),
    ],
)
def test_named_log_curves(tmp_path, name, code, linear):
    """Codes of 16 bits and floats are radiance, also above white; alike by any name of the space."""
    for path in (tmp_path / "a.tif", tmp_path / "a.exr"):
        values = np.full((4, 4, 3), code, np.float32)
        if path.suffix == ".exr":
            write_exr(path, values)
        else:
            write_tiff(path, np.round(values * 65535.0).astype(np.uint16))
        picture = open_picture(path, space=name)
        assert not picture.is_encoded and not picture.is_plain
        np.testing.assert_allclose(picture.shown()[0], linear, atol=1e-4, rtol=2e-4)


def test_named_color_spaces(tmp_path):
    """Curve and matrix of every space give what OpenColorIO makes of any color; published matrices."""
    published = [[1.70505, -0.62179, -0.08326], [-0.13026, 1.14080, -0.01055], [-0.02400, -0.12897, 1.15297]]
    np.testing.assert_allclose(space_colors("ACEScg").matrix, published, atol=1e-4)
    colors = np.random.default_rng(0).uniform(0.05, 0.9, (50, 1, 3)).astype(np.float32)
    path = tmp_path / "a.exr"
    write_exr(path, colors)
    for name in ("sRGB - Display", "ACEScc", "ADX10", "Raw"):  # of no scene, or no curve with a matrix
        assert error_of(space_colors, name).code == "colorspace-unknown"
    config = "ocio://studio-config-v2.2.0_aces-v1.3_ocio-v2.4"
    for name in ("ACES2065-1", "BMDFilm WideGamut Gen5", "CanonLog3 CinemaGamut D55", "Gamma 1.8 Encoded Rec.709"):
        wanted = oiio.ImageBufAlgo.colorconvert(oiio.ImageBuf(colors), name, "lin_rec709", colorconfig=config)
        wanted = np.asarray(wanted.get_pixels(oiio.FLOAT))
        np.testing.assert_allclose(open_picture(path, space=name).shown()[0], wanted, atol=1e-4 * np.abs(wanted).max())


def test_a_named_color_space_goes_before_what_the_file_says(tmp_path):
    linear = 0.2 + 0.6 * RADIANCE
    other = in_primaries(linear, "P3").astype(np.float32)
    planes = {name: np.ascontiguousarray(other[..., i]) for i, name in enumerate("RGB")}
    path = write_plain_exr(tmp_path / "a.exr", planes, PRIMARIES["Rec.2020"])
    np.testing.assert_allclose(open_picture(path, space="Linear P3-D65").shown()[0], linear, atol=1e-4)
    write_exr(tmp_path / "b.exr", other)
    assert open_picture(tmp_path / "b.exr", space="lin_rec709").is_plain
    path = write_codes(tmp_path / "a.png", srgb_encoded(other), icc_profile("Adobe RGB", "sRGB"))
    picture = open_picture(path, space="sRGB Encoded P3-D65")
    assert picture.is_encoded
    np.testing.assert_allclose(picture.shown()[0], linear, atol=4e-3)
    header = b"EXPOSURE=2\nPRIMARIES=" + b" ".join(b"%.4f" % value for value in PRIMARIES["Rec.2020"]) + b"\n"
    path = write_hdr(tmp_path / "a.hdr", other, header)
    np.testing.assert_allclose(open_picture(path, space="lin_p3d65").shown()[0], linear / 2.0, atol=0.012)


def test_the_color_space_that_an_exr_is_tagged_with(tmp_path):
    """The attribute colorInteropID counts before chromaticities; one that says nothing changes nothing."""
    planes = {name: np.full((2, 2), value, np.float32) for name, value in zip("RGB", (0.4, 0.2, 0.1), strict=True)}
    for tag, wanted in (("lin_ap1_scene", space_colors("ACEScg").matrix @ [0.4, 0.2, 0.1]), ("data", [0.4, 0.2, 0.1])):
        header = {"type": OpenEXR.scanlineimage, "colorInteropID": tag}
        OpenEXR.File(header, planes).write(str(tmp_path / f"{tag}.exr"))
        np.testing.assert_allclose(read_radiance(tmp_path / f"{tag}.exr")[0, 0], wanted, atol=1e-5)


def test_unknown_color_spaces_are_refused_with_near_ones():
    for name, near in (("slog3", "S-Log3 S-Gamut3.Cine"), ("LogC", "ARRI LogC4"), ("ACESgc", "ACEScg")):
        error = error_of(space_colors, name)
        assert error.code == "colorspace-unknown" and near in error.text and "--colorspace" in error.remedy
