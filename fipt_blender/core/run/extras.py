"""Packages that only some photographs or steps need; because of their size, set-up does not install them."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

from .errors import FiptError

# Extra of pyproject.toml: the module that is imported, and the package.
EXTRAS = {
    "heif": ("pillow_heif", "pillow-heif"),
    "markers": ("cv2", "opencv-python-headless"),
    "cluster": ("distributed", "distributed"),
}


def install_list(extra: str) -> Path:
    """The packages of an extra with their versions and hashes, for pip; `dev.py lock` writes it."""
    return Path(__file__).with_name(f"extra_{extra}.txt")


def optional(extra: str, purpose: str) -> ModuleType:
    """Import an optional package.

    Args:
        extra: a key of `EXTRAS`.
        purpose: what needs it, as the subject of a sentence, e.g. "A photograph in HEIC".
    """
    module, package = EXTRAS[extra]
    try:
        return importlib.import_module(module)
    except ImportError:
        command = f'"{sys.executable}" -m pip install --require-hashes --no-deps -r "{install_list(extra)}"'
        raise FiptError(
            "package-optional", purpose=purpose, package=package, extra=extra, command=command
        ) from None
