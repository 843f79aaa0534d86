# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""prepare.json: what `prepare` knows of the photographs, their groups and its settings; the folder's paths.

The add-on and the user edit the file between steps; therefore it is read and checked again by each step.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ..run.documents import read_json
from ..run.errors import FiptError
from ..run.runfolder import write_json
from ..run.shapes import MOST_SIDE, PREPARE, PREPARE_FORMAT, PREPARE_VERSION

GROUPINGS = ("auto", "folders", "single")
RESPONSES = ("auto", "srgb", "linear")
_REMEDY = "Correct the file, or delete it and find the brackets again."


@dataclass(frozen=True)
class Photograph:
    """One file as its header describes it; None where the header does not say.

    Attributes:
        path: absolute, or relative to the folder of the photographs.
        kind: ``raw`` (a sensor's values), ``ldr`` (values after a camera's response), ``linear`` (EXR, HDR).
        width, height: pixels as stored, before `orientation`.
        orientation: of EXIF, 1 to 8.
        shutter: seconds.
        aperture: f-number.
        iso: sensitivity.
        focal_length: mm.
        focal_35mm: mm of a 35 mm camera with the same angle of view.
        make, model, lens: of the camera and its lens; "" where unknown.
        time: seconds, only for differences between photographs.
        exposure: the light that reaches the values, relative: shutter * iso / (100 * aperture²). The user may
            set it where the header does not.
    """

    path: str
    kind: str
    width: int
    height: int
    orientation: int = 1
    shutter: float | None = None
    aperture: float | None = None
    iso: float | None = None
    focal_length: float | None = None
    focal_35mm: float | None = None
    make: str = ""
    model: str = ""
    lens: str = ""
    time: float | None = None
    exposure: float | None = None

    @property
    def upright_size(self) -> tuple[int, int]:
        """Width and height after `orientation`."""
        return (self.height, self.width) if self.orientation >= 5 else (self.width, self.height)


@dataclass(frozen=True)
class Group:
    """Photographs that become one view.

    Attributes:
        name: of the view and of its files.
        photographs: paths as in `Photograph.path`.
        used: whether it becomes a view.
    """

    name: str
    photographs: tuple[str, ...]
    used: bool = True


def _setting(default: Any, text: str) -> Any:
    return field(default=default, metadata={"help": text})


@dataclass(frozen=True)
class PrepareSettings:
    """What the user chooses; the metadata of each field holds its `help`."""

    grouping: str = _setting("auto", "how brackets are found: auto (EXIF and time), folders, or single")
    working_width: int = _setting(
        2048, "longer side of the merged images in pixels; 0 keeps the photographs' size"
    )
    response: str = _setting(
        "auto", "response of JPEG, PNG and TIFF: auto (recovered from the brackets), srgb or linear"
    )
    align: bool = _setting(True, "align hand-held brackets, and take what moved from one exposure")


@dataclass(frozen=True)
class Preparation:
    """Content of prepare.json.

    Attributes:
        source: absolute folder of the photographs.
        photographs: in the order of time and name.
        groups: in the order of their views.
        settings: see `PrepareSettings`.
    """

    source: Path
    photographs: tuple[Photograph, ...]
    groups: tuple[Group, ...]
    settings: PrepareSettings = PrepareSettings()

    @property
    def used_groups(self) -> list[Group]:
        """The groups that become views."""
        return [group for group in self.groups if group.used]

    def of(self, group: Group) -> list[Photograph]:
        """A group's photographs, shortest exposure first; those without a known exposure come last."""
        by_path = {photograph.path: photograph for photograph in self.photographs}
        members = [by_path[path] for path in group.photographs]
        return sorted(members, key=lambda item: item.exposure if item.exposure else float("inf"))

    def file(self, photograph: Photograph) -> Path:
        """The absolute path of a photograph."""
        return self.source / photograph.path


class PreparationFolder:
    """Paths of the files that `prepare` writes; docs/architecture.md lists them."""

    def __init__(self, root: str | Path) -> None:
        self.root = Path(root).absolute()
        self.prepare_json = self.root / "prepare.json"
        self.images = self.root / "images"
        self.clipped = self.root / "clipped"
        self.sparse = self.root / "sparse" / "0"
        self.report = self.root / "report"
        self.stage = self.root / "stage"

    def image(self, group: Group) -> Path:
        """The merged image of a group: scene-linear radiance, upright, with the lens's distortion."""
        return self.images / f"{group.name}.exr"

    def clipped_mask(self, group: Group) -> Path:
        """255 where a group's darkest photograph is clipped; the file is missing where none is."""
        return self.clipped / f"{group.name}.png"

    def facts(self, step: str) -> Path:
        """What a finished step has found out, for the report and for later steps (JSON)."""
        return self.stage / f"{step}.json"


def make_prepare_settings(changes: Mapping[str, Any]) -> PrepareSettings:
    """Settings with some values changed; texts are converted to the field's type.

    Raises:
        FiptError: ``setting-unknown`` or ``setting-invalid``.
    """
    defaults = {item.name: item.default for item in dataclasses.fields(PrepareSettings)}
    values = {}
    for name, value in changes.items():
        if name not in defaults:
            raise FiptError(
                "setting-unknown", f"There is no setting '{name}'.", f"Use one of: {', '.join(defaults)}."
            )
        values[name] = _converted(name, value, defaults[name])
    return PrepareSettings(**values)


def write_preparation(folder: PreparationFolder, preparation: Preparation) -> None:
    """Write prepare.json, completely or not at all.

    Raises:
        FiptError: ``disk-full`` or ``run-unwritable``.
    """
    data = {
        "format": PREPARE_FORMAT,
        "version": PREPARE_VERSION,
        "source": str(preparation.source),
        "settings": asdict(preparation.settings),
        "photographs": [asdict(photograph) for photograph in preparation.photographs],
        "groups": [asdict(group) for group in preparation.groups],
    }
    write_json(folder.prepare_json, data)


def read_preparation(folder: PreparationFolder) -> Preparation:
    """Read prepare.json and check that its groups agree with its photographs.

    Raises:
        FiptError: ``file-missing``, ``file-damaged``, ``setting-unknown`` or ``setting-invalid``.
    """
    data = read_json(folder.prepare_json, PREPARE, _REMEDY)
    known = {item.name for item in dataclasses.fields(Photograph)}
    photographs = tuple(
        Photograph(**{key: value for key, value in entry.items() if key in known})
        for entry in data["photographs"]
    )
    groups = tuple(
        Group(entry["name"], tuple(entry["photographs"]), entry.get("used", True)) for entry in data["groups"]
    )
    fault = _fault(photographs, groups)
    if fault:
        raise FiptError("file-damaged", f"{folder.prepare_json} can't be used: {fault}.", _REMEDY)
    return Preparation(Path(data["source"]), photographs, groups, make_prepare_settings(data["settings"]))


def _fault(photographs: tuple[Photograph, ...], groups: tuple[Group, ...]) -> str:
    """What contradicts itself in the lists, "" where nothing does."""
    paths = {photograph.path for photograph in photographs}
    outside = next((path for path in paths if ".." in Path(path).parts), None)
    if outside is not None:
        return f"the path '{outside}' leads out of the photographs' folder"
    taken: set[str] = set()
    names: set[str] = set()
    for group in groups:
        if group.name.casefold() in names:
            return f"two groups have the name '{group.name}'"
        names.add(group.name.casefold())
        for path in group.photographs:
            if path not in paths:
                return f"the group '{group.name}' lists '{path}', which is not among the photographs"
            if path in taken:
                return f"'{path}' is in two groups"
            taken.add(path)
    return ""


def _converted(name: str, value: Any, default: Any) -> Any:
    """A setting's value in the type of its default."""
    choices = {"grouping": GROUPINGS, "response": RESPONSES}.get(name)
    if choices is not None:
        if value in choices:
            return value
        wanted = f"one of: {', '.join(choices)}"
    elif isinstance(default, bool):
        truths: dict[str, bool] = {"true": True, "1": True, "false": False, "0": False}
        if str(value).lower() in truths:
            return truths[str(value).lower()]
        wanted = "true or false"
    else:
        try:
            number = int(str(value))
        except ValueError:
            number = -1
        if number == 0 or 64 <= number <= MOST_SIDE:
            return number
        wanted = f"0, or a whole number from 64 to {MOST_SIDE}"
    raise FiptError(
        "setting-invalid", f"'{value}' is not a valid value of the setting '{name}'.", f"Give {wanted}."
    )
