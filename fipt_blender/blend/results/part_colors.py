"""A colour for a part: its base colour is moved so that its mean is that colour, and its pattern stays.

The contrast of the pattern follows the brightness: a wall that is half as bright has half the differences, of
all channels alike, so that a white wall takes any colour, and a coloured one keeps nothing of its own.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import bpy
import numpy as np

from ...core.run.errors import FiptError
from ..color_spaces import to_scene_linear
from ..png16 import decode_srgb
from .part_list import adjustment, set_adjustment

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear Rec.709 (ITU-R BT.709)
_MOST_GAIN = 4.0  # more would show the noise of dark estimates as a pattern
# sRGB of paints that are common indoors, by their RAL numbers: approximations for screens, of which others
# give values that differ by some per cent. A fan of colours on paper decides.
_RAL = """
1001 d0b084  1013 e3d9c6  1015 e6d2b5  1019 a48f7a  1023 f7b500  2004 e25303  3000 a72920  3005 5e2028
3009 6d342d  3020 bb1e10  5002 00387b  5003 1f3855  5010 004f7c  5014 637d96  5015 007cb0  5024 6093ac
6005 114232  6011 6c7c59  6018 48a43f  6019 b9ceac  6021 8a9977  7001 8f999f  7004 9b9b9b  7012 575d5e
7015 51565c  7016 383e42  7021 2f3234  7022 4c4a44  7024 474a50  7030 939388  7032 b5b0a1  7035 c5c7c4
7036 979392  7037 7a7b7a  7038 b4b8b0  7039 6b695f  7040 9da3a6  7042 8f9695  7044 bdbdb2  7047 c8c8c7
8003 7e4b26  8011 5a3826  8014 4a3526  8017 442f29  8019 3d3635  8028 4e3b2b  9001 e9e0d2  9002 d7d5cb
9003 ecece7  9005 0e0e10  9010 f1ece1  9011 292c2f  9016 f1f0ea  9018 cfd3cd
"""


def named_color(text: str) -> tuple[float, ...]:
    """The scene-linear colour of a RAL number ("RAL 7035") or of sRGB: "#fff", "rgb(255, 255, 255)"."""
    words = _RAL.split()
    known = dict(zip(words[::2], words[1::2], strict=True))
    name = re.sub(r"[\s#]|^\s*ral", "", text.lower())
    code = known.get(name, name)
    if values := re.fullmatch(r"\s*rgb\(\s*(\d+)[\s,]+(\d+)[\s,]+(\d+)\s*\)\s*", text.lower()):
        code = bytes(min(int(value), 255) for value in values.groups()).hex()
    if re.fullmatch("[0-9a-f]{3}", code):
        code = "".join(2 * digit for digit in code)
    if not re.fullmatch("[0-9a-f]{6}", code):
        raise FiptError("color-unknown", text=text, known=", ".join(known))
    encoded = np.array([int(code[place : place + 2], 16) / 255.0 for place in (0, 2, 4)])
    return tuple(to_scene_linear(decode_srgb(encoded)).tolist())


def color_of(part: bpy.types.PropertyGroup) -> tuple[float, ...]:
    """The mean base colour of a row of parts, scene-linear, with its gain and shift."""
    values = adjustment(part.id_data, part.key)
    shift = np.array([values.red, values.green, values.blue])
    return tuple(np.clip(np.array(part.base_color) * values.gain + shift, 0.0, 1.0).tolist())


def set_color(part: bpy.types.PropertyGroup, color: Sequence[float]) -> None:
    """Move a part's base colour so that its mean is a scene-linear colour; the estimate has gain 1."""
    mean, wanted = np.array(part.base_color), np.array(color)
    if np.allclose(mean, wanted, atol=1e-6):
        gain = 1.0
    else:
        gain = min(float(wanted @ _LUMINANCE) / max(float(mean @ _LUMINANCE), 1e-3), _MOST_GAIN)
    shift = wanted - gain * mean
    set_adjustment(
        part.id_data, part.key, gain=gain, **dict(zip(("red", "green", "blue"), shift.tolist(), strict=True))
    )
