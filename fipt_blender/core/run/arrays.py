# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Array files of a run (.npz): read without pickles, within limits, and with one error for all that can fail.

A file may have been cut off by a full disk or come from somebody else. What is written is finite. Needs numpy
alone.
"""

from __future__ import annotations

import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from .errors import FiptError
from .runfolder import atomic_path
from .shapes import Layout

# Unpacked bytes of an archive: more than any room needs, and compressed at most this much.
MOST_BYTES = 32_000_000_000
# What numpy and zipfile raise for damaged files.
DAMAGE = (
    *(OSError, ValueError, KeyError, EOFError, IndexError, TypeError, SyntaxError, NotImplementedError),
    *(zipfile.BadZipFile, zlib.error, struct.error, tokenize.TokenError, OverflowError, MemoryError),
    RuntimeError,  # an archive that says that it is encrypted
)


# numpy's kinds of numbers by those of layouts.
_KINDS = {"f": "f", "u": "f", "i": "iu", "b": "b"}
_KIND_TEXTS = {"f": "numbers", "u": "numbers", "i": "whole numbers", "b": "truth values"}
_BLOCK = 1 << 22  # values that are checked at a time


def read_arrays(
    path: Path,
    layouts: Mapping[str, Layout],
    code: str = "file-damaged",
    remedy: str = "Repeat the step that writes it.",
) -> dict[str, np.ndarray]:
    """All arrays of an .npz file by name.

    Args:
        path: of the file.
        layouts: of the arrays that must be there.
        code: of the error for a damaged file.
        remedy: what the user can do then.

    Raises:
        FiptError: ``file-missing``, or `code`.
    """
    try:
        _check_sizes(path)
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        check_layouts(arrays, layouts)
    except FileNotFoundError:
        raise FiptError("file-missing", f"{path} does not exist.", remedy) from None
    except DAMAGE as error:
        raise FiptError(code, f"{path} can't be read ({error}).", remedy) from None
    return arrays


def write_arrays(path: Path, layouts: Mapping[str, Layout], **arrays: ArrayLike) -> None:
    """Write an .npz file, completely or not at all.

    Args:
        path: of the file.
        layouts: of its arrays; those that have none are finite, like those of kind "f".
        arrays: by their names.

    Raises:
        FiptError: ``not-finite``, ``disk-full`` or ``run-unwritable``.
    """
    for name, array in arrays.items():
        refuse_infinite(f"{path.name}/{name}", np.asarray(array), name in layouts and layouts[name][0] == "u")
    with atomic_path(path) as temporary:
        np.savez(temporary, **arrays)


def refuse_infinite(name: str, array: np.ndarray, unknown: bool = False) -> None:
    """Check values before they are stored: those after them would be spoilt without a word.

    Args:
        name: of the array, for the message.
        array: of any shape and type.
        unknown: whether NaN stands for unknown values.

    Raises:
        FiptError: ``not-finite``.
    """
    if array.dtype.kind not in "fc":
        return
    flat = array.reshape(-1)  # no copy of a file's array
    blocks = (flat[first : first + _BLOCK] for first in range(0, len(flat), _BLOCK))
    bad = sum(int(np.count_nonzero(np.isinf(one) if unknown else ~np.isfinite(one))) for one in blocks)
    if bad:
        raise FiptError(
            "not-finite",
            f"{bad:,} of {array.size:,} values of {name} are infinite or not a number. They were not stored.",
            "Please report this with the file log.txt of the run folder.",
        )


def check_layouts(arrays: Mapping[str, np.ndarray], layouts: Mapping[str, Layout]) -> None:
    """Check kinds and sizes of arrays.

    Raises:
        ValueError: names the array, what is needed and what is there.
    """
    sizes: dict[str, int] = {}
    for name, (kind, needed) in layouts.items():
        if name not in arrays:
            raise ValueError(f"it lacks the array '{name}'")
        array = arrays[name]
        if array.dtype.kind not in _KINDS[kind]:
            raise ValueError(f"the array '{name}' should hold {_KIND_TEXTS[kind]}, not {array.dtype}")
        fits = len(array.shape) == len(needed) and all(
            size == (sizes.setdefault(wanted, size) if isinstance(wanted, str) else wanted)
            for size, wanted in zip(array.shape, needed, strict=True)
        )
        if not fits:
            shape = tuple(sizes.get(size, size) if isinstance(size, str) else size for size in needed)
            raise ValueError(f"the array '{name}' should have the sizes {shape}, not {array.shape}")


def _check_sizes(path: Path) -> None:
    """Refuse an archive that unpacks to far more than it holds."""
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
    total, packed = sum(member.file_size for member in members), path.stat().st_size
    # A high ratio of a small archive does no harm.
    if total > MOST_BYTES or (total > 64_000_000 and total > 2000 * packed):
        raise ValueError(f"it unpacks to {total / 1e9:.1f} GB")
