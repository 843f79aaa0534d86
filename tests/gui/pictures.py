#!/usr/bin/env python3
"""python tests/gui/pictures.py SHOTS [OUT]: the guide's pictures from the GUI test's, those that SHOTS has.

Run it after the story with the draft preset, in an interpreter with Pillow. OUT is docs/images.
"""

from __future__ import annotations

import sys
from pathlib import Path

from PIL import Image

IMAGES = Path(__file__).resolve().parents[2] / "docs" / "images"
_WIDTH, _GAP, _QUALITY = 1400, 12, 75  # pixels, pixels between pictures, percent
_VIEW = (0.0, 0.03, 0.826, 0.902)  # left, top, right, bottom: 3D viewport and sidebar, shares of the screen
_SIDEBAR = (0.649, 0.09, 0.826, 0.78)
_PREFERENCES = (0.075, 0.296, 0.506, 0.886)
# The shots of each picture, side by side, and the part of the screen.
PICTURES = {
    "guide_panel": (("03_start", "04_capture_closed", "12_materials", "16_lights"), _SIDEBAR),
    "guide_preferences": (("02_preferences_before", "03_preferences_after"), _PREFERENCES),
    "guide_photographs": (("03_photographs_found", "03_photographs_split", "03_photographs_prepared"), _SIDEBAR),
    "guide_capture": (("05_capture_view", "06_capture_coverage"), _VIEW),
    "guide_align": (("06_align_photograph", "06_align_pairs"), _VIEW),
    "guide_parts": (("07_parts",), _VIEW),
    "guide_estimate": (("08_estimate_running",), _VIEW),
    "guide_hints": (("33_hints_answered",), _VIEW),
    "guide_materials": (("12_materials", "13_show_base_color"), _VIEW),
    "guide_lights": (("40_one_lamp",), _VIEW),
}


def main(argv: list[str]) -> int:
    """Write the pictures whose shots there are."""
    shots, out = Path(argv[0]), Path(argv[1]) if len(argv) > 1 else IMAGES
    for name, (parts, box) in PICTURES.items():
        files = [shots / f"{part}.png" for part in parts]
        if all(file.is_file() for file in files):
            picture = beside([cut(Image.open(file).convert("RGB"), box) for file in files])
            picture.save(out / f"{name}.jpg", quality=_QUALITY, optimize=True)
            print(name)
    return 0


def cut(image: Image.Image, box: tuple[float, ...]) -> Image.Image:
    """A part of a picture by shares of its size."""
    sizes = (image.width, image.height) * 2
    return image.crop(tuple(round(share * size) for share, size in zip(box, sizes, strict=True)))


def beside(images: list[Image.Image]) -> Image.Image:
    """Pictures of one size side by side, `_WIDTH` wide at most."""
    row = Image.new("RGB", (sum(image.width + _GAP for image in images) - _GAP, images[0].height), "white")
    for index, image in enumerate(images):
        row.paste(image, (index * (image.width + _GAP), 0))
    row.thumbnail((_WIDTH, _WIDTH))
    return row


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
