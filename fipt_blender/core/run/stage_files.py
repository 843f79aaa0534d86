# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The outputs of stages as files: dataclasses of arrays, numbers, texts and further dataclasses.

Arrays are .npy files, which are opened as read-only memory maps; everything else is one JSON document. An
array that a stage made in a file of a stage's folder, or passes on from an earlier stage, is not copied: the
document names its file. What the chain was given, such as the room, is named, not written.
"""

from __future__ import annotations

import mmap
import types
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from .arrays import DAMAGE, refuse_infinite
from .paths import leads_outside


class UnreadableArray(ValueError):
    """An array's file can't be read.

    Attributes:
        stage: whose folder it is in.
    """

    def __init__(self, text: str, stage: str) -> None:
        super().__init__(text)
        self.stage = stage


_ARRAY, _GIVEN = {"array", "shape", "type"}, {"given"}
UNKNOWN = {"unknown": True}  # metadata of a field of arrays in which NaN stands for unknown values


def saved(value: Any, folder: Path, root: Path, given: Mapping[str, Any], unknown: bool = False) -> Any:
    """Write the arrays of a value to files, and return the document that describes it.

    Args:
        value: dataclasses, arrays, numbers, texts, None, and sequences and mappings (by texts) of these.
        folder: for new files; they are named by the path to them in the value.
        root: folder of all stages, which contains `folder`; resolved.
        given: values by name that are referred to instead of written.
        unknown: whether NaN stands for unknown values of arrays; of a field of a dataclass: `UNKNOWN`.

    Raises:
        TypeError: for values of other types.
        FiptError: ``not-finite``.
    """
    for name, each in given.items():
        if value is each and not isinstance(value, (int, float, str, type(None))):
            return {"given": name}
    if isinstance(value, np.ndarray):
        path = _file_of(value, root)
        stage = folder.relative_to(root).parts[0]
        if path is None or path.relative_to(root).parts[0] == stage:  # else an earlier one has stored it
            refuse_infinite(folder.relative_to(root).as_posix(), value, unknown)
        if path is None:
            path = folder.with_name(f"{folder.name}.npy")
            path.parent.mkdir(parents=True, exist_ok=True)
            np.save(path, value, allow_pickle=False)
        place = path.relative_to(root).as_posix()
        return {"array": place, "shape": list(value.shape), "type": value.dtype.str}
    if is_dataclass(value):
        return {
            item.name: saved(
                getattr(value, item.name), folder / item.name, root, given, bool(item.metadata.get("unknown"))
            )
            for item in fields(value)
            if item.init
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
        ValueError: the document or a file does not fit the type.
    """
    if isinstance(document, dict) and document.keys() == _GIVEN and document["given"] in given:
        return given[document["given"]]
    origin, arguments = get_origin(kind), get_args(kind)
    if kind is Any:
        return document
    if origin in (Union, types.UnionType):
        return _loaded_union(document, arguments, root, given)
    if kind is np.ndarray or origin is np.ndarray:
        return _loaded_array(document, root)
    if isinstance(kind, type) and is_dataclass(kind) and isinstance(document, dict):
        hints = get_type_hints(kind)
        names = [item.name for item in fields(kind) if item.init]
        if document.keys() != set(names):
            raise ValueError(f"it lacks values of {kind.__name__}, or has others")
        return kind(**{name: loaded(document[name], hints[name], root, given) for name in names})
    if isinstance(document, dict) and origin is not None and issubclass(origin, Mapping):
        return {key: loaded(each, arguments[1], root, given) for key, each in document.items()}
    if isinstance(document, list) and origin is not None and issubclass(origin, Sequence):
        kinds = arguments if origin is tuple and arguments[-1] is not ... else arguments[:1] * len(document)
        values = [loaded(each, of, root, given) for each, of in zip(document, kinds, strict=True)]
        return tuple(values) if origin is tuple else values
    if kind is float and type(document) is int:
        return float(document)
    if isinstance(kind, type) and type(document) is kind and kind in (bool, int, float, str, dict, list):
        return document
    if kind in (None, type(None)) and document is None:
        return None
    raise ValueError(f"{str(document)[:40]} is not of type {kind}")


def stages_of(document: Any) -> set[str]:
    """The stages whose folders hold the arrays of a document by :func:`saved`."""
    if isinstance(document, dict) and document.keys() == _ARRAY:
        return {str(document["array"]).partition("/")[0]}
    each = document.values() if isinstance(document, dict) else document
    return set().union(*map(stages_of, each)) if isinstance(document, (dict, list)) else set()


def _loaded_union(document: Any, kinds: Sequence[Any], root: Path, given: Mapping[str, Any]) -> Any:
    for kind in kinds:
        try:
            return loaded(document, kind, root, given)
        except UnreadableArray:
            raise
        except ValueError as error:
            last = error
    raise last


def _loaded_array(document: Any, root: Path) -> np.ndarray:
    if not isinstance(document, dict) or document.keys() != _ARRAY:
        raise ValueError(f"{str(document)[:40]} names no array")
    path, stage = root / str(document["array"]), str(document["array"]).partition("/")[0]
    if leads_outside(root, str(document["array"])):
        raise ValueError(f"{path} is outside of the stages")
    try:
        empty = 0 in document["shape"]  # cannot be mapped
        array = np.load(path, mmap_mode=None if empty else "r", allow_pickle=False)
    except DAMAGE as error:
        raise UnreadableArray(f"{path} can't be read ({error})", stage) from None
    if list(array.shape) != document["shape"] or array.dtype.str != document["type"]:
        raise UnreadableArray(f"{path} holds another array", stage)
    return array


def _file_of(array: np.ndarray, root: Path) -> Path | None:
    """The file of a stage that holds exactly this array; None where there is none."""
    if not isinstance(array, np.memmap) or not isinstance(array.base, mmap.mmap):
        return None  # no map, or a part of one
    path = Path(str(array.filename))
    return path if path.is_relative_to(root) else None
