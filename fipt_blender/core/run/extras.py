# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Packages that only some photographs or steps need; because of their size, set-up does not install them."""

from __future__ import annotations

import importlib
import sys
from types import ModuleType

from .errors import FiptError

# Module: (extra, pin). pyproject.toml has the same pins.
EXTRAS = {
    "pillow_heif": ("heif", "pillow-heif==1.8.1"),
    "cv2": ("markers", "opencv-python-headless==4.11.0.86"),
}


def optional(module: str, purpose: str) -> ModuleType:
    """Import an optional package.

    Args:
        module: a key of `EXTRAS`.
        purpose: what needs it, as the subject of a sentence, e.g. "A photograph in HEIC".

    Raises:
        FiptError: ``package-optional``, with the command that installs it.
    """
    extra, pin = EXTRAS[module]
    try:
        return importlib.import_module(module)
    except ImportError:
        raise FiptError(
            "package-optional",
            f"{purpose} needs the package {pin.partition('==')[0]} (extra '{extra}'), which is missing.",
            f'Install it into the engine\'s Python: "{sys.executable}" -m pip install "{pin}"',
        ) from None
