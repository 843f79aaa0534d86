"""prepare.json: what `prepare` knows of the photographs, their groups and its settings; the folder's paths.

The add-on and the user edit the file between steps; therefore it is read and checked again by each step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path, PurePath
from typing import Annotated, Any, ClassVar

from ..core.capture.options import LAYER_TEXT
from ..core.run.declared import Option, converted
from ..core.run.documents import read_document
from ..core.run.errors import FiptError
from ..core.run.kinds import SOME, FileName, Number, Pixels, choice
from ..core.run.names import free_name
from ..core.run.paths import is_network, leads_outside
from ..core.run.runfolder import write_json
from ..core.run.shapes import MOST_SIDE

GROUPINGS = (  # identifier, label, tooltip
    ("auto", "Automatic", "Find brackets by exposure, time and camera, as written in the files"),
    ("folders", "Folders", "Each folder with photographs is one bracket"),
    ("single", "Single", "Each photograph is a view of its own"),
)
RESPONSES = (
    ("auto", "Recover", "Recover the response of JPEG, PNG and TIFF from the brackets"),
    ("srgb", "sRGB", "The pixel values follow the sRGB curve"),
    ("linear", "Linear", "The pixel values are proportional to light"),
)
WHITE_BALANCES = (
    ("camera", "Camera", "The white balance that the camera has chosen for the first photograph, for all"),
    ("daylight", "Daylight", "The white balance of daylight"),
)
VIGNETTINGS = (
    ("auto", "Automatic", "From the lens database, otherwise from what overlapping views have in common"),
    ("none", "None", "Vignetting is not corrected"),
)
SCALES = (
    ("none", "Unknown", "The capture is scaled later, under Alignment in the section Capture"),
    ("points", "Two Points", "Two points that are marked in photographs, and their distance"),
    ("marker", "Printed Marker", "A printed ArUco marker that is seen in photographs"),
    ("mesh", "Mesh", "The transform to a mesh (scale_matrix)"),
)
_Positive = Annotated[float, Number(1e-12, 1e12)]
_REMEDY = "Correct the file, or delete it and find the brackets again."


@dataclass(frozen=True)
class Photograph:
    """One file as its header describes it; None where the header does not say."""

    path: str  # within the folder of the photographs, relative to it
    # ``raw`` (a sensor's values), ``ldr`` (codes after a camera's response), ``linear`` (radiance)
    kind: Annotated[str, choice("raw", "ldr", "linear")]
    # width, height: pixels as stored, before `orientation`
    width: Pixels
    height: Pixels
    orientation: Annotated[int, Number(1, 8)] = 1  # of EXIF, 1 to 8
    shutter: _Positive | None = None  # seconds
    aperture: _Positive | None = None  # f-number
    iso: _Positive | None = None  # sensitivity
    focal_length: _Positive | None = None  # mm
    focal_35mm: _Positive | None = None  # mm of a 35 mm camera with the same angle of view
    # make, model, lens: of the camera and its lens; "" where unknown
    make: str = ""
    model: str = ""
    lens: str = ""
    # Whether the camera has corrected the lens's vignetting; None where it does not say
    corrected: bool | None = None
    time: float | None = None  # seconds, only for differences between photographs
    # The light that reaches the values, relative: shutter * iso / (100 * aperture²). The user may set
    # it where the header does not.
    exposure: _Positive | None = None

    @property
    def has_vignetting(self) -> bool:
        """Whether the lens's vignetting is in the values for certain; most cameras correct their JPEGs."""
        return self.kind == "raw" or (self.kind == "ldr" and self.corrected is False)

    @property
    def upright_size(self) -> tuple[int, int]:
        """Width and height after `orientation`."""
        return (self.height, self.width) if self.orientation >= 5 else (self.width, self.height)


@dataclass(frozen=True)
class Group:
    """Photographs that become one view."""

    name: FileName  # of the view and of its files
    photographs: Annotated[tuple[str, ...], SOME]  # paths as in `Photograph.path`
    used: bool = True  # whether it becomes a view


@dataclass(frozen=True)
class PrepareSettings:
    """What the user chooses."""

    grouping: Annotated[
        str, Option("How photographs of one view are recognized", "Brackets", choices=GROUPINGS)
    ] = "auto"
    working_width: Annotated[
        int,
        Option(
            "Longer side of the merged images in pixels. 0 keeps the size of the photographs",
            "Size",
            low=64,
            high=MOST_SIDE,
            zero=True,
            shown={"soft_max": 8192},
        ),
    ] = 2048
    response: Annotated[
        str, Option("Relation between light and the pixel values of JPEG, PNG and TIFF", choices=RESPONSES)
    ] = "auto"
    white_balance: Annotated[str, Option("White balance of RAW photographs", choices=WHITE_BALANCES)] = (
        "camera"
    )
    align: Annotated[bool, "Align photographs taken by hand, and take what moved from one of them"] = True
    vignetting: Annotated[str, Option("Correction of the lens's darker corners", choices=VIGNETTINGS)] = (
        "auto"
    )
    layer: Annotated[str, LAYER_TEXT] = ""
    cameras: Annotated[
        str,
        Option(
            "Folder of cameras that were solved elsewhere (COLMAP, transforms.json) for images of the same"
            " names. If empty, the cameras are solved here",
            "Existing Solve",
            shown={"subtype": "DIR_PATH"},
        ),
    ] = ""
    seed: Annotated[int, Option("Seed of the camera solve", zero=True, panel=False)] = 0
    scale: Annotated[str, Option("What the real size of the room is known from", choices=SCALES)] = "none"
    scale_length: Annotated[
        float,
        Option(
            "Distance of the two points, or the length of the marker's edge, in meters",
            "Length",
            zero=True,
            high=1e4,
            shown={"soft_max": 10.0, "precision": 4},
        ),
    ] = 0.0
    scale_picks: Annotated[
        str,
        Option(
            "Two points, each with a view and its pixel, or several with commas, e.g. IMG_4209 812 440,"
            " IMG_4214 790 431; IMG_4209 102 455",
            "Points",
        ),
    ] = ""
    scale_matrix: Annotated[
        str, Option("4 x 4 matrix, row by row, from the solved cameras to the mesh", panel=False)
    ] = ""
    marker_dictionary: Annotated[str, Option("Dictionary of the printed ArUco marker", panel=False)] = (
        "4X4_50"
    )


@dataclass(frozen=True)
class Preparation:
    """Content of prepare.json."""

    source: Path  # absolute folder of the photographs
    photographs: tuple[Photograph, ...]  # in the order of time and name
    groups: tuple[Group, ...]  # in the order of their views
    settings: PrepareSettings = PrepareSettings()  # see `PrepareSettings`

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


@dataclass(frozen=True)
class _Document:
    """prepare.json."""

    document: ClassVar[str] = "prepare"
    source: str
    settings: Mapping[str, Any]
    photographs: tuple[Photograph, ...]
    groups: tuple[Group, ...]


class PreparationFolder:
    """Paths of the files that `prepare` writes; docs/run_folder.md lists them."""

    def __init__(self, root: str | Path) -> None:
        self.root = Path(root).absolute()
        self.prepare_json = self.root / "prepare.json"
        self.images = self.root / "images"
        self.clipped = self.root / "clipped"
        self.sparse = self.root / "sparse" / "0"
        self.report = self.root / "report"
        self.stage = self.root / "stage"
        self.solve = self.stage / "solve"
        self.model = self.solve / "model"  # the cameras in the frame of the solve

    def image(self, group: Group) -> Path:
        """The merged image of a group: scene-linear radiance, upright, with the lens's distortion."""
        return self.images / f"{group.name}.exr"

    def clipped_mask(self, group: Group) -> Path:
        """255 where a group's darkest photograph is clipped; the file is missing where none is."""
        return self.clipped / f"{group.name}.png"

    def facts(self, step: str) -> Path:
        """What a finished step has found out, for the report and for later steps (JSON)."""
        return self.stage / f"{step}.json"


def split_group(groups: Sequence[Group], index: int, at: int) -> list[Group]:
    """The groups with one of them cut into its first `at` photographs and the others.

    The first part keeps its name; the second takes that of its first photograph.
    """
    group = groups[index]
    if not 0 < at < len(group.photographs):
        raise FiptError("group-not-split", name=group.name)
    taken = {other.name.casefold() for other in groups}
    name = free_name(PurePath(group.photographs[at]).stem, taken, "_", str.casefold)
    first = replace(group, photographs=group.photographs[:at])
    second = replace(group, name=name, photographs=group.photographs[at:])
    return [*groups[:index], first, second, *groups[index + 1 :]]


def merge_groups(groups: Sequence[Group], index: int) -> list[Group]:
    """The groups with one of them and the next one as one group, which has the name of the first."""
    if not 0 <= index < len(groups) - 1:
        raise FiptError("group-not-merged")
    first, second = groups[index], groups[index + 1]
    merged = replace(
        first, photographs=(*first.photographs, *second.photographs), used=first.used or second.used
    )
    return [*groups[:index], merged, *groups[index + 2 :]]


def make_prepare_settings(changes: Mapping[str, Any]) -> PrepareSettings:
    """Settings with some values changed; texts are converted to the field's type."""
    return PrepareSettings(**converted(PrepareSettings, changes))


def write_preparation(folder: PreparationFolder, preparation: Preparation) -> None:
    """Write prepare.json, completely or not at all."""
    settings = asdict(preparation.settings)
    data = _Document(str(preparation.source), settings, preparation.photographs, preparation.groups)
    write_json(folder.prepare_json, data)


def read_preparation(folder: PreparationFolder) -> Preparation:
    """Read prepare.json and check that its groups agree with its photographs."""
    data = read_document(folder.prepare_json, _Document, _REMEDY)
    fault = _fault(Path(data.source), data.photographs, data.groups)
    if fault:
        raise FiptError("file-damaged.read-preparation", prepare_json=folder.prepare_json, fault=fault)
    settings = make_prepare_settings(data.settings)
    for path in (data.source, settings.cameras):
        if is_network(path):
            raise FiptError(
                "path-network.read-preparation", prepare_json=folder.prepare_json, path=path[:200]
            )
    return Preparation(Path(data.source), data.photographs, data.groups, settings)


def _fault(source: Path, photographs: tuple[Photograph, ...], groups: tuple[Group, ...]) -> str:
    """What contradicts itself in the lists, "" where nothing does."""
    paths = {photograph.path for photograph in photographs}
    outside = next((path for path in paths if leads_outside(source, path)), None)
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


def refuse_foreign(folder: PreparationFolder, photographs: Path) -> None:
    """Refuse to write among the photographs or into a folder that holds something else."""
    if folder.prepare_json.exists():
        return
    own = {"messages", "log.txt", "engine.lock", "stage"}
    if folder.root.is_dir() and {path.name for path in folder.root.iterdir()} - own:
        raise FiptError("capture-foreign.refuse-foreign", root=folder.root)
    if folder.root.is_relative_to(photographs):
        raise FiptError("capture-foreign.refuse-foreign-2", root=folder.root)
