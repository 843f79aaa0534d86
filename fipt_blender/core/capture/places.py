"""Where the photographs, id images and mesh of a camera file lie, and which files lie unused beside them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from ..run.errors import FiptError, Problem, problem
from ..run.paths import leads_outside
from .files import (
    DEPTHS_FIRST,
    IDS_FIRST,
    Folders,
    Found,
    is_plain,
    key,
    name_parts,
    role,
    stem_of,
    suffix_of,
    view_name,
)
from .images import read_ids, read_size
from .options import CaptureOptions
from .rig import PARTS_FOLDER, SEMANTICS_FOLDER, DepthView, Lens, Rig, RigView, find_mesh

IMAGE_FOLDERS = ("hdr", "exr", "images", "input", "Image", ".")
MASK_FOLDER = "masks"
# Where programs write masks: COLMAP, nerfstudio and Metashape into a folder, the last one and RealityScan
# also beside the photographs; and what they put behind a photograph's name, or its stem, besides the suffix.
MASK_FOLDERS, MASK_ENDS = (MASK_FOLDER, "mask"), (".mask", "_mask", "-mask")
WHITE = 255, 2**16 - 1, 2**24 - 1  # ids of white pixels
BLACK_OR_WHITE = 0.9  # share of a mask's pixels whose edges are smooth; others are images of parts or classes
MESH_STEMS = ("scene", "mesh", "model", "texturedMesh", "scene_dense_mesh")
ID_FOLDERS = {PARTS_FOLDER: PARTS_FOLDER, SEMANTICS_FOLDER: SEMANTICS_FOLDER}


@dataclass(frozen=True)
class Places:
    """Where the photographs, id images and mesh of a camera file are searched."""

    file: Path  # the camera file, for messages
    roots: tuple[Path, ...]  # folders, the first ones first
    images: Path | None = None  # the folder in which photographs are searched before all others, or None
    image_folders: tuple[str, ...] = IMAGE_FOLDERS  # folders below each root that may hold photographs
    # Folders below each root that may hold masks of pixels to leave out
    mask_folders: tuple[str, ...] = (".", MASK_FOLDER)
    inside: Path | None = None  # folder whose subfolders may hold photographs, too, or None
    own_paths: bool = False  # whether paths from the file may lead anywhere
    relative: bool = False  # whether paths start at the file's folder: such a path must not lead elsewhere
    # Folder below a root of each kind of id images
    id_folders: dict[str, str] = field(default_factory=lambda: ID_FOLDERS)
    finds_masks: bool = True  # whether masks are searched that the camera file does not name
    folders: Folders = field(default_factory=Folders, compare=False, repr=False)
    # What was found of each name, since camera files may repeat names without end.
    _found: dict[tuple, Any] = field(default_factory=dict, compare=False, repr=False)

    @classmethod
    def around(
        cls,
        file: Path,
        options: CaptureOptions,
        image_folders: tuple[str, ...] = IMAGE_FOLDERS,
        folders: Sequence[str] = (),
    ) -> Places:
        """The places around a camera file: its folder, the one above, and the capture's subfolders.

        Args:
            file, options, image_folders: see `Places`.
            folders: of a capture in which its program writes the camera file.
        """
        roots = (file.parent, file.absolute().parent.parent)
        inside = roots[file.absolute().parent.name in folders]
        return cls(file, roots, options.images, image_folders, inside=inside)

    def find(self, name: str, size: tuple[int, int] | None = None) -> Found | None:
        """The photograph of a name or path; None without one.

        Args:
            name: as the camera file has it.
            size: width and height in pixels; of several files, one of this size is the photograph.
        """
        found: Found | None = self._once(("image", name, size), lambda: self._find(name, size))
        return found

    def _find(self, name: str, size: tuple[int, int] | None) -> Found | None:
        if self.own_paths and (self.file.parent / name).is_file():
            return Found(self.file.parent / name, name_parts(name))
        fits = None if size is None else lambda path: _has_size(path, size)
        for each in dict.fromkeys((name, unquote(name))):  # some programs write names as web addresses
            found = self.images and self.folders.find(each, [self.images], self.images, fits=fits)
            found = found or self.folders.find(each, self._below(self.image_folders), self.inside, fits=fits)
            if found:
                return found
        return None

    def _once(self, of: tuple, find: Callable[[], Any]) -> Any:
        if of not in self._found:
            self._found[of] = find()
        return self._found[of]

    def _below(self, folders: Iterable[str]) -> list[Path]:
        return [root / folder for root, folder in product(self.roots, folders)]

    def size(self, name: str) -> tuple[int, int]:
        """Width and height in pixels of the photograph of a name."""
        found = self.find(name)
        if found is None:
            raise FiptError("image-missing.check-files", text=self._missing(name))
        size: tuple[int, int] = self._once(("size", name), lambda: read_size(found.path))
        return size

    def view(
        self,
        name: str,
        size: tuple[int, int],
        lens: Lens,
        camera_to_world: np.ndarray,
        *,
        called: str = "",
        split: str | None = None,
        mask: str | None = None,
    ) -> RigView:
        """The view of a photograph, with the id images that exist.

        Args:
            name: of the photograph, as the camera file has it.
            size: width and height in pixels that the lens is calibrated for.
            lens, camera_to_world: see `RigView`.
            called: the view's name; "" for that of its photograph.
            split: see `RigView`.
            mask: name of the image whose black pixels are left out, or None.
        """
        found = self.find(name, size)
        missing = "" if found else self._missing(name)
        masking = None
        if mask:
            places = self._below(self.mask_folders)
            masking = self._once(("mask", mask), lambda: self.folders.find(mask, places, first=IDS_FIRST))
            if masking is None or masking == found:
                missing = missing or self._missing(mask, places)
        elif found and self.finds_masks:
            masking = self._once(("mask", found.path), lambda: self._mask(found))
        ends = name_parts(name) if is_plain(name) else found.end if found else name_parts(name)[-1:]
        own = view_name(called or "/".join(ends))
        names = (own, "/".join(ends), *([found.path.name] if found else []))
        ids = {kind: self._once((kind, names), partial(self._ids, kind, names)) for kind in self.id_folders}
        return RigView(
            name=own,
            split=split,
            image=found.path if found else self.file.parent / "/".join(ends),
            width=size[0],
            height=size[1],
            lens=lens,
            camera_to_world=camera_to_world,
            mask=masking.path if masking else None,
            missing=missing,
            **ids,
        )

    def _mask(self, photograph: Found) -> Found | None:
        """The mask of a photograph where programs write it; None without."""
        path, end = photograph.path, "/".join(photograph.end)
        names = [each for name in dict.fromkeys((end, path.name)) for each in (name, stem_of(name))]
        ends = [name + end for name in names for end in MASK_ENDS]
        folders = [*self.roots, path.parent, path.parent.parent]
        for root, folder in product(dict.fromkeys(folders), MASK_FOLDERS):
            if root / folder != path.parent and (file := self.folders.ids(root / folder, [*names, *ends])):
                return Found(file, ())
        beside = self._once(
            ("beside", path.parent),
            lambda: {key(stem_of(file.name)): file for file in self.folders.images(path.parent)},
        )
        file = next(filter(None, (beside.get(key(name.rpartition("/")[2])) for name in ends)), None)
        return None if file is None else Found(file, ())

    def _checked_masks(self, views: Sequence[RigView]) -> tuple[list[RigView], list[Problem]]:
        """The views without found masks that are none, and a note of these."""
        for view in (view for view in views if view.mask is not None and self._masked(view)):
            assert view.mask is not None, "only these are looked at"
            try:
                fault, ids = "", read_ids(view.mask)
                ends = (ids == 0) | ((ids == ids.max()) & np.isin(ids, WHITE))
                if len(np.unique(ids)) > 2 and ends.mean() < BLACK_OR_WHITE:
                    fault = "it has several values, as images of parts or classes have"
                elif read_size(view.mask) != (view.width, view.height):
                    fault = "it has another size than its photograph"
            except FiptError as error:
                fault = error.text
            if not fault:
                break
            views = [replace(each, mask=None) if self._masked(each) else each for each in views]
            return list(views), [
                problem("masks-unused.kind", folder=view.mask.parent, mask=view.mask, fault=fault)
            ]
        return list(views), []

    def _masked(self, view: RigView) -> bool:
        """Whether the mask of a view was found, not named."""
        return ("mask", view.image) in self._found and view.mask is not None

    def _ids(self, kind: str, names: Sequence[str]) -> Path | None:
        """The id image with one of a view's names in the folder of its kind, or None."""
        found = (self.folders.ids(folder, names) for folder in self._below([self.id_folders[kind]]))
        return next(filter(None, found), None)

    def depth(self, folder: Path, name: str) -> Path | None:
        """The depth image of a name in a folder, or None."""
        found = self._once(
            ("depth", folder, name), lambda: self.folders.find(name, [folder], first=DEPTHS_FIRST)
        )
        return found.path if found else None

    def mesh(self, stems: Sequence[str] = MESH_STEMS, folders: Sequence[str] = (".",)) -> Path | None:
        """The first mesh with one of these names, or None."""
        return find_mesh([root / folder for root in self.roots for folder in folders], stems)

    def rig(
        self,
        source: str,
        views: Sequence[RigView],
        up_axis: str | None,
        mesh: Path | None,
        notes: Sequence[Problem] = (),
        depths: tuple[DepthView, ...] = (),
        one_camera: bool = False,
    ) -> Rig:
        """The rig of these views, with warnings of files that lie unused beside used ones.

        Args:
            source, views, up_axis, mesh, notes, depths, one_camera: see `Rig`.
        """
        self._refuse_other_folders()
        views, unread = self._checked_masks(views)
        masks = {view.mask for view in views if view.mask is not None and self._masked(view)}
        if masks:
            place = min(masks).parent
            unread.append(problem("masks-found", count=len(masks), views=len(views), folder=place))
        for kind in ("image", *self.id_folders):
            self._refuse_shared(kind, [view for view in views if not view.missing])
        found = [one.path for one in self._found.values() if isinstance(one, Found)]
        used = [path for path in found if path not in masks]
        suffixes, folders = {suffix_of(path.name) for path in used}, {path.parent for path in used}
        beside = [path for folder in sorted(folders) for path in self.folders.images(folder)]
        beside = [path for path in beside if suffix_of(path.name) in suffixes and not self.own_paths]
        beside = [path for path in beside if not role(str(path))]  # maps and masks of photographs
        unused = [_unused("images-unused", "image files", "camera", beside, used)]
        for kind, folder in self.id_folders.items():
            roots = [root for root in self.roots if root in (self.roots[0], self.inside)]
            beside = [path for root in roots for path in self.folders.images(root / folder, True)]
            used = [path for view in views if (path := getattr(view, kind)) is not None]
            unused.append(_unused("masks-unused", "id images", "photograph", beside, used))
        folders = {path.parent for path in masks if path.parent.name.lower() in MASK_FOLDERS}
        beside = [path for each in sorted(folders) for path in self.folders.images(each, True)]
        unused.append(_unused("masks-unused", "masks", "photograph", beside, masks))
        notes = (*notes, *filter(None, unused), *unread)
        return Rig(source, tuple(views), up_axis, mesh, notes, depths, one_camera)

    def _refuse_other_folders(self) -> None:
        """Refuse a photograph that lies in a folder of other cameras than the one that it was found for."""
        found = {of[1]: one for of, one in self._found.items() if of[0] == "image" and one}
        claimed = {one.path.parent for one in found.values() if len(one.end) > 1}
        for name, one in found.items():
            if len(one.end) == 1 < len(name_parts(name)) and one.path.parent in claimed:
                text = f"{self.file} names the file {name[:200]!r}; the only one of this name, {one.path},"
                raise FiptError("image-missing.refuse-other-folders", text=text)

    def _refuse_shared(self, kind: str, views: Sequence[RigView]) -> None:
        """Refuse one file for several cameras: the name was not enough to tell which one it belongs to."""
        first: dict[Path, RigView] = {}
        for view in views:
            path = getattr(view, kind)
            other = first.setdefault(path, view) if path is not None else view
            if other is not view and not np.allclose(
                other.camera_to_world, view.camera_to_world, equal_nan=True
            ):
                raise FiptError(
                    "file-ambiguous.refuse-shared",
                    file=self.file,
                    name=other.name,
                    name_2=view.name,
                    path=path,
                )

    def _missing(self, name: str, folders: Sequence[Path] = ()) -> str:
        """What was looked for in vain, and where; of the first file also similar names.

        Args:
            name: as the camera file has it.
            folders: where it was looked for; () stands for those of photographs.
        """
        inside = None if folders else self.inside
        stub = self.folders.stub(name, folders or self._below(self.image_folders))
        if stub is not None:
            raise stub
        folders = folders or [*([self.images] if self.images else []), *self._below(self.image_folders)]
        last = (name_parts(name) or ("",))[-1]
        text = (
            f"{self.file} names the file {name[:200]!r}, but {stem_of(last)[:200]!r} is neither in"
            f" {', '.join(str(folder) for folder in folders if folder.is_dir())}"
            f"{f' nor below {inside}' if inside else ''}."
        )
        if self._once(("missing",), lambda: name) == name:
            files = [path for folder in folders for path in self.folders.images(folder)]
            files += self.folders.images(inside, True) if inside else []
            near = {key(path.name): str(path) for path in files}
            similar = [near[each] for each in get_close_matches(key(last), near)]
            text += f" Similar names: {', '.join(similar)}." if similar else ""
        if self.relative and not self.own_paths and leads_outside(self.file.parent, name):
            text += " The path itself leads outside of the capture's folder, and is not followed."
            raise FiptError("path-outside.missing", text=text)
        return text


def _has_size(path: Path, size: tuple[int, int]) -> bool:
    try:
        return read_size(path) == size
    except FiptError:
        return False


def _unused(code: str, what: str, whose: str, paths: Iterable[Path], used: Iterable[Path]) -> Problem | None:
    """A warning of files that nothing uses; copies of used ones in another format do not count."""
    stems = {path.parent / key(stem_of(path.name)) for path in used}
    unused = [path for path in paths if path.parent / key(stem_of(path.name)) not in stems]
    if not unused:
        return None
    folders = ", ".join(dict.fromkeys(str(path.parent) for path in unused))
    shown = ", ".join(path.name for path in unused[:3]) + (", and others" if len(unused) > 3 else "")
    text = f"{len(unused)} {what} in {folders} belong to no {whose} that is used ({shown})."
    return Problem(code, text, "Check their names if you miss them; otherwise nothing needs to be done.")
