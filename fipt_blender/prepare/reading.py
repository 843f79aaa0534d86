"""Step `read`: finds the photographs of a folder, reads their headers and groups them; fills prepare.json."""

from __future__ import annotations

import filecmp
import hashlib
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path, PurePath
from typing import Any

from ..core.capture.files import copied_from, is_hidden, original_of, role
from ..core.capture.panorama import says_panorama
from ..core.capture.suffixes import SUFFIXES
from ..core.run.errors import FiptError
from ..core.run.made import file_state
from ..core.run.messages import Reporter
from .brackets import find_groups, in_order, likeness, listed, remarks
from .exif import describe
from .facts import LeftOut, ReadFacts
from .preparation import Group, Photograph, Preparation, PreparationFolder, write_preparation

ENDS = 1 << 18  # bytes at both ends of files that are compared before all of them


def key(folder: PreparationFolder, preparation: Preparation) -> Any:
    """The files with their sizes and times, the way of grouping, and whether panoramas are used."""
    source, settings = preparation.source, preparation.settings
    files = [file_state(source / name) for name in list_photographs(source)]
    return [str(source), settings.grouping, bool(settings.cameras), files]


def run(folder: PreparationFolder, preparation: Preparation, reporter: Reporter) -> ReadFacts:
    """Read all headers and write prepare.json.

    Exposures that the user entered are kept, and so are the groups if they have the same photographs.
    """
    photographs: list[Photograph] = []
    damaged: list[LeftOut] = []
    panoramas: list[LeftOut] = []
    maps: list[LeftOut] = []
    source = preparation.source
    names = list_photographs(source)
    copied = second_copies(source, [name for name in names if not role(name)])
    for index, name in enumerate(names):
        if name in copied:
            continue
        try:
            photograph = describe(source / name, name)
            size = photograph.width, photograph.height
            # Cameras and phones write what a photograph was taken with, programs that make maps do not.
            what = "" if photograph.model or photograph.shutter else role(name)
            if name.lower().endswith(".insp"):
                fisheyes = (
                    "it is a pair of fisheye images: stitch it to a panorama first, which prepare leaves out"
                )
                panoramas.append(LeftOut(name, fisheyes))
            elif what:
                maps.append(LeftOut(name, f"it is one of the {what}"))
            elif not preparation.settings.cameras and says_panorama(source / name, size):
                panoramas.append(LeftOut(name, "it is an equirectangular panorama, which is not solved here"))
            else:
                photographs.append(photograph)
        except FiptError as error:
            remedy = error.remedy if error.code == "package-optional" else ""
            damaged.append(LeftOut(name, error.text, remedy))
        reporter.progress(0.7 * (index + 1) / len(names))  # of the time; the rest compares photographs
    photographs, doubles = without_doubles(in_order(photographs))
    copies = [LeftOut(item.path, "the photograph that it was made of is used") for item in doubles]
    again = [LeftOut(name, f"it is a second copy of {original}") for name, original in copied.items()]
    skipped = (*damaged, *copies, *again, *maps, *panoramas)
    if not photographs:
        raise FiptError(
            "no-photographs.run", number_of_skipped=len(skipped), source=source, reason=skipped[0].reason
        )
    # Exposures that the header lacks may be in prepare.json.
    entered = {item.path: item.exposure for item in preparation.photographs}
    photographs = [replace(item, exposure=item.exposure or entered.get(item.path)) for item in photographs]
    groups: Sequence[Group] = preparation.groups
    if {path for group in groups for path in group.photographs} != {item.path for item in photographs}:
        groups = find_groups(photographs, preparation.settings.grouping, likeness(source))
    if panoramas:
        reporter.warning("panoramas-left-out", panoramas=listed([item.name for item in panoramas]))
    if copies or maps or again:
        kinds = Counter(item.reason.removeprefix("it is one of the ") for item in maps)
        said = [f"{count} {kind}" for kind, count in kinds.items()]
        said += [f"{len(copies)} JPEGs of RAW photographs or edited copies"] if copies else []
        said += [f"{len(again)} second copies"] if again else []
        remedy = "To use them instead, move the others out of the folder."
        reporter.warning("images-left-out", said=" and ".join(said), remedy=remedy)
    if damaged:
        reporter.warning(
            "photographs-skipped",
            value=f"{listed([item.name for item in damaged])} can't be used: {damaged[0].reason}"
            f" {damaged[0].remedy}".strip(),
        )
    for remark in remarks(photographs, groups):
        reporter.warn(remark)
    write_preparation(folder, replace(preparation, photographs=tuple(photographs), groups=tuple(groups)))
    return ReadFacts(skipped, len(photographs), len(groups))


def list_photographs(source: Path) -> list[str]:
    """Relative paths of all photographs below a folder, with forward slashes; hidden ones are left out."""
    if not source.is_dir():
        raise FiptError("photographs-missing.list-photographs", source=source)
    names = []
    for top, folders, files in os.walk(source):
        folders[:] = sorted(name for name in folders if not is_hidden(name))
        for name in sorted(files):
            if not is_hidden(name) and name.lower().endswith(SUFFIXES):
                names.append(Path(top, name).relative_to(source).as_posix())
        if len(names) > 20_000:
            raise FiptError("too-many-photographs", source=source)
    if not names:
        raise FiptError("no-photographs.list-photographs", source=source)
    return names


def second_copies(source: Path, names: Sequence[str]) -> dict[str, str]:
    """The files with the content of another one, by name, and the name of that, the plainest one."""
    by_size: dict[int, list[str]] = {}
    for name in names:
        by_size.setdefault((source / name).stat().st_size, []).append(name)
    copies = {}
    for size, alike in by_size.items():
        first: dict[str, str] = {}
        plain = sorted(
            alike, key=lambda name: (copied_from(PurePath(name).stem) != PurePath(name).stem, len(name))
        )
        for name in plain if len(alike) > 1 and size else ():
            # Photographs of one size differ in their ends, where times and the last rows are.
            with (source / name).open("rb") as file:
                ends = file.read(ENDS)
                file.seek(max(size - ENDS, 0))
                ends += file.read(ENDS)
            original = first.setdefault(hashlib.sha256(ends).hexdigest(), name)
            if original != name and filecmp.cmp(source / original, source / name, shallow=False):
                copies[name] = original
    return copies


def without_doubles(photographs: Sequence[Photograph]) -> tuple[list[Photograph], list[Photograph]]:
    """Photographs without copies of others, and these copies.

    They are the JPEGs that a camera saves beside its RAW files, in their folder or with their names and times
    in another one, and edited copies beside the photographs that a phone has made them of.
    """
    raws, all_of = [item for item in photographs if item.kind == "raw"], {_stem(item) for item in photographs}
    of_raws: set[object] = {_stem(item) for item in raws}
    of_raws |= {(_stem(item).rpartition("/")[2], item.time) for item in raws if item.time is not None}

    def is_copy(item: Photograph) -> bool:
        folder, _, stem = _stem(item).rpartition("/")
        original = original_of(stem)
        edited = bool(original) and f"{folder}/{original}".lstrip("/") in all_of
        return item.kind == "ldr" and (edited or _stem(item) in of_raws or (stem, item.time) in of_raws)

    copies = [item for item in photographs if is_copy(item)]
    return [item for item in photographs if item not in copies], copies


def _stem(photograph: Photograph) -> str:
    return PurePath(photograph.path).with_suffix("").as_posix().casefold()
