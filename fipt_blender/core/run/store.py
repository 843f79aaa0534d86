# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Dataclasses of arrays, numbers and texts as files: array files of a run (.npz), and the outputs of stages.

A field of arrays may say by an `Array` what these hold; what is written is finite, what is read fits. JSON
alone is in :mod:`.documents`. A file may have been cut off by a full disk or come from somebody else: there
is one error for all that can fail. Needs numpy alone.
"""

from __future__ import annotations

import mmap
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from types import EllipsisType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np

from .errors import FiptError
from .kinds import T, as_kind
from .paths import leads_outside
from .runfolder import atomic_path

# Unpacked bytes of an archive: more than any room needs, and compressed at most this much.
MOST_BYTES = 32_000_000_000
# What numpy and zipfile raise for damaged files.
DAMAGE = (
    *(OSError, ValueError, KeyError, EOFError, IndexError, TypeError, SyntaxError, NotImplementedError),
    *(zipfile.BadZipFile, zlib.error, struct.error, tokenize.TokenError, OverflowError, MemoryError),
    RuntimeError,  # an archive that says that it is encrypted
)
AGAIN = "Repeat the step that writes it."  # remedy for a damaged file
# Numpy's kinds of numbers by those of `Array`, and words for them.
_KINDS = {"f": "f", "u": "f", "i": "iu", "b": "b"}
_KIND_TEXTS = {"f": "numbers", "u": "numbers", "i": "whole numbers", "b": "truth values"}
_BLOCK = 1 << 22  # values that are checked at a time


@dataclass(frozen=True, init=False)
class Array:
    """What the arrays of a field hold.

    Attributes:
        kind: "f" float, "u" float or NaN for unknown, "i" whole numbers, "b" truth values.
        sizes: each a number, or a word for a size that all fields with this word have; ``...``: any.
        below: of indices: the word for the size that they are below. least: the lowest of them.
    """

    kind: str
    sizes: tuple[int | str | EllipsisType, ...]
    below: str
    least: int

    def __init__(self, kind: str, *sizes: int | str | EllipsisType, below: str = "", least: int = 0) -> None:
        vars(self).update(kind=kind, sizes=sizes, below=below, least=least)


Gaps = Annotated[np.ndarray, Array("u", ...)]  # in which NaN stands for unknown values


class DamagedStage(Exception):
    """The outputs of a stage can't be read; the text says why.

    Attributes:
        stage: its name.
    """

    def __init__(self, stage: str, text: str) -> None:
        super().__init__(text)
        self.stage = stage


# ---- Array files -------------------------------------------------------------------------------------------


def read_arrays(
    path: Path,
    kind: type[T],
    remedy: str = AGAIN,
    code: str = "file-damaged",
    sizes: Mapping[str, int] | None = None,
) -> T:
    """The dataclass that an .npz file holds; a field that is a mapping has the arrays FIELD/NAME.

    Args:
        path: of the file.
        kind: of dataclass; fields with a default may be missing.
        remedy: what the user can do where the file is damaged.
        code: of the error then.
        sizes: that are known, by the words of `Array`.

    Raises:
        FiptError: ``file-missing``, or `code`.
    """
    try:
        _check_sizes(path)
        with np.load(path, allow_pickle=False) as archive:
            found = {name: archive[name] for name in archive.files}
        values: dict[str, Any] = {}
        for name, hint in get_type_hints(kind).items():
            start = f"{name}/"
            if get_origin(hint) is Mapping:
                values[name] = {each[len(start) :]: found[each] for each in found if each.startswith(start)}
            elif name in found or hasattr(kind, name):  # a default
                values[name] = found.get(name, getattr(kind, name, None))
            else:
                raise ValueError(f"it lacks the array '{name}'")
        _check_layouts(values, _layouts(kind), dict(sizes or {}))
        return kind(**values)
    except FileNotFoundError:
        raise FiptError("file-missing", f"{path} does not exist.", remedy) from None
    except DAMAGE as error:
        raise FiptError(code, f"{path} can't be read ({error}).", remedy) from None


def optional_arrays(path: Path, kind: type[T], sizes: Mapping[str, int] | None = None) -> T | None:
    """The dataclass that an .npz file holds, None where it is missing or damaged; see `read_arrays`."""
    try:
        return read_arrays(path, kind, sizes=sizes)
    except FiptError:
        return None


def write_arrays(path: Path, value: Any) -> None:
    """Write a dataclass of arrays as an .npz file, completely or not at all; see `read_arrays`.

    Raises:
        FiptError: ``not-finite``, ``disk-full`` or ``run-unwritable``.
    """
    arrays, layouts = {}, _layouts(type(value))
    for item in fields(value):
        for name, array in _named(item.name, getattr(value, item.name)):
            arrays[name] = np.asarray(array)
            refuse_infinite(f"{path.name}/{name}", arrays[name], _may_have_gaps(layouts.get(item.name)))
    with atomic_path(path) as temporary:
        np.savez(temporary, **arrays)


def _named(name: str, value: Any) -> Iterable[tuple[str, Any]]:
    """The names and arrays of a field."""
    if isinstance(value, Mapping):
        return ((f"{name}/{key}", each) for key, each in value.items())
    return () if value is None else ((name, value),)


def _layouts(kind: Any) -> dict[str, Array]:
    """What the fields of a dataclass that say so hold, by their names."""
    found: dict[str, Array] = {}
    for name, hint in get_type_hints(kind, include_extras=True).items():
        for each in (hint, *get_args(hint)):  # X, or X | None
            for layout in getattr(each, "__metadata__", ()):
                if isinstance(layout, Array):
                    found[name] = layout
    return found


def _may_have_gaps(layout: Array | None) -> bool:
    return layout is not None and layout.kind == "u"


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


def _check_layouts(values: Mapping[str, Any], layouts: Mapping[str, Array], sizes: dict[str, int]) -> None:
    """Check kinds and sizes of arrays, and that indices are within their ranges.

    Raises:
        ValueError: names the array, what is needed and what is there.
    """
    named = [
        (name, array, layout)
        for field, layout in layouts.items()
        for name, array in _named(field, values[field])
    ]
    for name, array, layout in named:
        if array.dtype.kind not in _KINDS[layout.kind]:
            text = _KIND_TEXTS[layout.kind]
            raise ValueError(f"the array '{name}' should hold {text}, not {array.dtype}")
        needed = layout.sizes
        fits = len(array.shape) == len(needed) and all(
            size == (sizes.setdefault(wanted, size) if isinstance(wanted, str) else wanted)
            for size, wanted in zip(array.shape, needed, strict=True)
        )
        if not fits and needed != (...,):
            shape = tuple(sizes.get(size, size) if isinstance(size, str) else size for size in needed)
            raise ValueError(f"the array '{name}' should have the sizes {shape}, not {array.shape}")
    for name, array, layout in named:
        end = sizes.get(layout.below, np.iinfo(np.int32).max)
        if layout.below and array.size and not layout.least <= array.min() <= array.max() < end:
            raise ValueError(f"the array '{name}' refers to missing {layout.below}")


def _check_sizes(path: Path) -> None:
    """Refuse an archive that unpacks to far more than it holds."""
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
    total, packed = sum(member.file_size for member in members), path.stat().st_size
    # A high ratio of a small archive does no harm.
    if total > MOST_BYTES or (total > 64_000_000 and total > 2000 * packed):
        raise ValueError(f"it unpacks to {total / 1e9:.1f} GB")


# ---- Outputs of stages -------------------------------------------------------------------------------------
# An array is a .npy file, which is opened as a read-only memory map; everything else is one JSON document. An
# array that a stage made in a file of its folder, or passes on from an earlier stage, is not copied: the
# document names its file. What the chain was given, such as the room, is named, not written.


def saved(value: Any, folder: Path, root: Path, given: Mapping[str, Any], unknown: bool = False) -> Any:
    """Write the arrays of a value to files, and return the document that describes it.

    Args:
        value: dataclasses, arrays, numbers, texts, None, and sequences and mappings (by texts) of these.
        folder: for new files; they are named by the path to them in the value.
        root: folder of all stages, which contains `folder`; resolved.
        given: values by name that are referred to instead of written.
        unknown: whether NaN stands for unknown values of arrays; of a field of a dataclass: `Gaps`.

    Raises:
        TypeError: for values of other types.
        FiptError: ``not-finite``.
    """
    for name, each in given.items():
        if value is each and not isinstance(value, (int, float, str, type(None))):
            return {"stored": name}
    if isinstance(value, np.ndarray):
        path = _file_of(value, root)
        stage = folder.relative_to(root).parts[0]
        if path is None or path.relative_to(root).parts[0] == stage:  # else an earlier one has stored it
            refuse_infinite(folder.relative_to(root).as_posix(), value, unknown)
        if path is None:
            path = folder.with_name(f"{folder.name}.npy")
            path.parent.mkdir(parents=True, exist_ok=True)
            np.save(path, value, allow_pickle=False)
        return {"stored": path.relative_to(root).as_posix()}
    if is_dataclass(value):
        layouts, names = _layouts(type(value)), [item.name for item in fields(value) if item.init]
        return {
            name: saved(getattr(value, name), folder / name, root, given, _may_have_gaps(layouts.get(name)))
            for name in names
        }
    if isinstance(value, Mapping):
        return {str(key): saved(each, folder / str(key), root, given, unknown) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [saved(each, folder / str(index), root, given, unknown) for index, each in enumerate(value)]
    if isinstance(value, np.generic):
        return value.item()
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise TypeError(f"a {type(value).__name__} is no output of a stage")


def loaded(document: Any, kind: Any, root: Path, given: Mapping[str, Any]) -> Any:
    """The value that :func:`saved` has described.

    Args:
        kind: its type: a dataclass, or an annotation of one of the fields of such.

    Raises:
        ValueError: the document does not fit the type.
        DamagedStage: nor does a file.
    """

    def refer(name: str, kind: Any) -> Any:
        if name in given:
            return given[name]
        if leads_outside(root, name):
            raise ValueError(f"{name} is outside of the stages")
        try:
            try:
                return np.load(root / name, mmap_mode="r", allow_pickle=False)
            except ValueError:  # an array without values, which cannot be mapped, or a damaged one
                return np.load(root / name, allow_pickle=False)
        except DAMAGE as error:
            raise DamagedStage(name.partition("/")[0], f"{root / name} can't be read ({error}).") from None

    return as_kind(document, kind, refer)


def stages_of(document: Any) -> set[str]:
    """The stages whose folders hold the arrays of a document by :func:`saved`."""
    if isinstance(document, dict) and document.keys() == {"stored"}:
        stage, inside, _ = document["stored"].partition("/")
        return {stage} if inside else set()
    each = document.values() if isinstance(document, dict) else document
    return set().union(*map(stages_of, each)) if isinstance(document, (dict, list)) else set()


def _file_of(array: np.ndarray, root: Path) -> Path | None:
    """The file of a stage that holds exactly this array; None where there is none."""
    if not isinstance(array, np.memmap) or not isinstance(array.base, mmap.mmap):
        return None  # no map, or a part of one
    path = Path(str(array.filename))
    return path if path.is_relative_to(root) else None
