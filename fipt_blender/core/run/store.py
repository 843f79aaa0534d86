"""Dataclasses of arrays, numbers and texts as files: array files of a run (.npz), and the outputs of stages.

What is written is finite, but for NaN in fields that are `Gaps`. These are files of our own, complete or not
there at all, whose keys or digests say what they were made of: what is in them is not checked when they are
read. One that can't be read is an error that says so, or is made again. JSON alone is in :mod:`.documents`.
Needs numpy alone.
"""

from __future__ import annotations

import mmap
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, get_args, get_type_hints

import numpy as np

from .errors import FiptError
from .kinds import T, as_kind
from .paths import leads_outside
from .runfolder import atomic_path

# What numpy and zipfile raise for damaged files.
DAMAGE = (
    *(OSError, ValueError, KeyError, EOFError, IndexError, TypeError, SyntaxError, NotImplementedError),
    *(zipfile.BadZipFile, zlib.error, struct.error, tokenize.TokenError, OverflowError, MemoryError),
    RuntimeError,  # an archive that says that it is encrypted
)
_BLOCK = 1 << 22  # values that are checked at a time
_UNKNOWN = "NaN stands for unknown"  # what `Gaps` says of an array
Gaps = Annotated[np.ndarray, _UNKNOWN]


class DamagedStage(Exception):
    """The outputs of a stage can't be read; the text says why.

    Attributes:
        stage: its name.
    """

    def __init__(self, stage: str, text: str) -> None:
        super().__init__(text)
        self.stage = stage


# ---- Array files -------------------------------------------------------------------------------------------


def read_arrays(path: Path, kind: type[T], remedy: str = "Repeat the step that writes it.") -> T:
    """The dataclass that an .npz file holds; a field that is a mapping has the arrays FIELD/NAME.

    Args:
        path: of the file.
        kind: of dataclass; fields with a default may be missing.
        remedy: what the user can do where the file is damaged.
    """
    values: dict[str, Any] = {}
    try:
        with np.load(path, allow_pickle=False) as archive:
            for name in archive.files:
                field, inside, key = name.partition("/")
                if inside:
                    values.setdefault(field, {})[key] = archive[name]
                else:
                    values[name] = archive[name]
        return kind(**{name: values[name] for name in get_type_hints(kind) if name in values})
    except FileNotFoundError:
        raise FiptError("file-missing.read-arrays", path=path, remedy=remedy) from None
    except DAMAGE as error:
        raise FiptError("file-damaged.read-arrays", path=path, error=error, remedy=remedy) from None


def optional_arrays(path: Path, kind: type[T]) -> T | None:
    """The dataclass that an .npz file holds, None where it is missing or damaged; see `read_arrays`."""
    try:
        return read_arrays(path, kind)
    except FiptError:
        return None


def write_arrays(path: Path, value: Any) -> None:
    """Write a dataclass of arrays as an .npz file, completely or not at all; see `read_arrays`."""
    arrays, gaps = {}, _with_gaps(type(value))
    for item in fields(value):
        found = getattr(value, item.name)
        named = found.items() if isinstance(found, Mapping) else [("", found)] * (found is not None)
        for key, array in named:
            name = f"{item.name}/{key}" if key else item.name
            arrays[name] = np.asarray(array)
            refuse_infinite(f"{path.name}/{name}", arrays[name], item.name in gaps)
    with atomic_path(path) as temporary:
        np.savez(temporary, **arrays)


def _with_gaps(kind: Any) -> set[str]:
    """The fields of a dataclass whose arrays may hold NaN: `Gaps`, or `Gaps` or None."""
    hints = get_type_hints(kind, include_extras=True).items()
    return {name for name, hint in hints if Gaps in (hint, *get_args(hint))}


def refuse_infinite(name: str, array: np.ndarray, unknown: bool = False) -> None:
    """Check values before they are stored: those after them would be spoilt without a word.

    Args:
        name: of the array, for the message.
        array: of any shape and type.
        unknown: whether NaN stands for unknown values.
    """
    if array.dtype.kind not in "fc":
        return
    flat = array.reshape(-1)  # no copy of a file's array
    blocks = (flat[first : first + _BLOCK] for first in range(0, len(flat), _BLOCK))
    bad = sum(int(np.count_nonzero(np.isinf(one) if unknown else ~np.isfinite(one))) for one in blocks)
    if bad:
        raise FiptError("not-finite", bad=bad, size=array.size, name=name)


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
        gaps, names = _with_gaps(type(value)), [item.name for item in fields(value) if item.init]
        return {name: saved(getattr(value, name), folder / name, root, given, name in gaps) for name in names}
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
