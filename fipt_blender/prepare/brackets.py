"""Which photographs belong together: exposures of one view, by EXIF, time, content or folders.

Where time and exposure data do not tell, small pictures of the photographs are aligned and compared.
"""

from __future__ import annotations

import io
import itertools
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path, PurePath

import numpy as np
import rawpy
from PIL import Image

from ..core.capture.encoded import CLIPPED_CODE
from ..core.capture.images import open_picture
from ..core.run.contents import Problem
from ..core.run.errors import FiptError, problem
from ..core.run.names import free_name
from .exif import DAMAGE
from .frames import linear_frame, load
from .motion import LEAST_OVERLAP, grey, log_values, measure, warped
from .preparation import Group, Photograph
from .response import srgb_curve

# Seconds from the end of a photograph to the next one. Cameras take a bracket in one go, within the first. By
# hand it takes up to the last, but so do photographs of different views: their content decides.
CERTAIN_SECONDS, GAP_SECONDS, LONGEST_SECONDS = 2.0, 5.0, 60.0
CERTAIN_STOPS = 0.6  # between exposures of a bracket; automatic exposure changes by less from view to view
# EXIF rounds shutter times (1/60 stands for 1/64); brackets differ by a third of a stop or more.
SAME_STOPS = 0.2
MOST_NAMES = 5  # of files or groups in a warning
SIDE = 96  # pixels of the small pictures' longer side
# Correlation of the logarithms once they are aligned. Exposures of real brackets, up to 3 EV apart, had
# 0.92 and more; neighbouring views of a walk around a building had 0.87 and less.
LEAST_LIKENESS = 0.9
# Measured over nominal stops: cameras' curves are steeper than sRGB's (up to 1.5). A camera that exposes
# automatically makes different views equally bright instead.
LEAST_GAIN, MOST_GAIN = 0.5, 2.0
_FORBIDDEN = re.compile(r'[\\/:*?"<>|\x00-\x1f]')


# Whether two photographs show one view; None if that can't be decided.
SameView = Callable[[Photograph, Photograph], bool | None]


def find_groups(
    photographs: Sequence[Photograph], grouping: str, same_view: SameView = lambda first, second: None
) -> list[Group]:
    """Group photographs.

    Args:
        photographs: any order.
        grouping: ``auto``: consecutive photographs of one camera and one view with different exposures
            (by folders where headers have no exposures, and the folders hold several photographs each);
            ``folders``: each folder is a group; ``single``: each photograph is one.
        same_view: whether two photographs show one view, by their content; asked only where time and
            exposures are not enough.

    Returns:
        Groups in the order of time and name, photographs in theirs.
    """
    ordered = in_order(photographs)
    if grouping == "single":
        return _named([[photograph] for photograph in ordered])
    if grouping == "folders" or _folders_speak(ordered):
        folders: dict[PurePath, list[Photograph]] = {}
        for photograph in ordered:
            folders.setdefault(PurePath(photograph.path).parent, []).append(photograph)
        return _named(folders.values(), by_folder=True)
    lists = _equal_bursts(ordered)
    if not lists:
        for photograph in ordered:
            if lists and continues(lists[-1], photograph, same_view):
                lists[-1].append(photograph)
            else:
                lists.append([photograph])
    return _named(lists)


def _equal_bursts(ordered: Sequence[Photograph]) -> list[list[Photograph]]:
    """The bursts of a camera that repeats one series in which an exposure occurs twice; none otherwise."""
    bursts: list[list[Photograph]] = []
    for item in ordered:
        last = bursts[-1][-1] if bursts else item
        apart = (item.time or 0.0) - (last.time or 0.0)
        if last.time and item.time and _same_camera(last, item) and 0.0 < apart <= GAP_SECONDS:
            bursts[-1].append(item)
        else:
            bursts.append([item])
    series = {tuple(round(math.log2(item.exposure or 1.0), 1) for item in burst) for burst in bursts}
    first = next(iter(series), ())
    if len(bursts) > 1 and len(series) == 1 and len(first) - 1 == len(set(first)) > 1:
        return bursts
    return []


def in_order(photographs: Iterable[Photograph]) -> list[Photograph]:
    """By folder, then time (where all of a folder have one), then name with numbers by their value."""
    photographs = list(photographs)
    timeless = {PurePath(item.path).parent for item in photographs if item.time is None}

    def rank(item: Photograph) -> tuple[object, ...]:
        folder = PurePath(item.path).parent
        time = 0.0 if folder in timeless or item.time is None else item.time
        return _natural(str(folder)), time, _natural(PurePath(item.path).name)

    return sorted(photographs, key=rank)


def continues(group: Sequence[Photograph], photograph: Photograph, same_view: SameView) -> bool:
    """Whether a photograph is a further exposure of the bracket that a group has begun."""
    last = group[-1]
    if PurePath(last.path).parent != PurePath(photograph.path).parent or not _same_camera(last, photograph):
        return False
    if photograph.exposure is None or any(item.exposure is None for item in group):
        return False
    steps = [stops_between(item, photograph) for item in group]
    if min(map(abs, steps)) < SAME_STOPS:
        return False
    pause = None
    if last.time is not None and photograph.time is not None:
        # Clocks without fractions of seconds are up to one second off.
        pause = photograph.time - last.time - (last.shutter or 0.0)
        if not -1.0 <= pause <= LONGEST_SECONDS:
            return False
        if pause <= CERTAIN_SECONDS and min(map(abs, steps)) >= CERTAIN_STOPS:
            return True
    # Exposures that are near each other have most in common.
    nearest = min(range(len(group)), key=lambda index: abs(steps[index]))
    verdict = same_view(group[nearest], photograph)
    if verdict is not None:
        return verdict
    return pause is None or pause <= GAP_SECONDS or _goes_on(group, steps[-1])


def _goes_on(group: Sequence[Photograph], step: float) -> bool:
    """Whether a step of exposure goes the way of those before, as the ends of a long bracket do."""
    steps = [stops_between(first, second) for first, second in itertools.pairwise(group)]
    return bool(steps) and all(before * step > 0.0 for before in steps)


def stops_between(first: Photograph, second: Photograph) -> float:
    """How many stops more light the second photograph got; both exposures must be known."""
    assert first.exposure and second.exposure
    return math.log2(second.exposure / first.exposure)


def likeness(source: Path) -> SameView:
    """Compares photographs of one folder, whose exposures must be known.

    What it returns says None where too little of two photographs is well exposed in both, or readable.

    Args:
        source: folder to which the photographs' paths refer.
    """

    @lru_cache(maxsize=32)  # small pictures in memory: a bracket's
    def picture(photograph: Photograph) -> np.ndarray | None:
        try:
            return small_picture(source / photograph.path, photograph)
        except (FiptError, *DAMAGE):
            return None  # the merge reports what is wrong with it

    def same_view(one: Photograph, other: Photograph) -> bool | None:
        first, second = picture(one), picture(other)
        if first is None or second is None:
            return None
        if first.shape != second.shape:
            return False
        motion = measure(first, second)
        logs = log_values(first), log_values(warped(second[..., None], motion, 0, len(second))[..., 0])
        both = np.isfinite(logs[0]) & np.isfinite(logs[1])
        if motion.similarity == -1.0 or both.mean() < LEAST_OVERLAP:
            return None
        gain = float(np.median((logs[1] - logs[0])[both])) / (math.log(2.0) * stops_between(one, other))
        return motion.similarity >= LEAST_LIKENESS and LEAST_GAIN <= gain <= MOST_GAIN

    return same_view


def small_picture(path: Path, photograph: Photograph) -> np.ndarray:
    """(height, width) linear values, about `SIDE` long; NaN where clipped.

    Of RAW photographs, the preview that the camera has stored is enough.
    """
    codes = _codes(path, photograph)
    if codes is not None:
        linear = srgb_curve()[codes, np.arange(3)].astype(np.float32)
        return grey(linear, codes >= CLIPPED_CODE, SIDE)
    stored = load(path, photograph)
    factor = -(-max(photograph.width, photograph.height) // SIDE)
    frame = linear_frame(stored, srgb_curve() if photograph.kind == "ldr" else None, factor)
    return grey(frame.values, frame.clipped, SIDE)


def _codes(path: Path, photograph: Photograph) -> np.ndarray | None:
    """(height, width, 3) uint8 of a JPEG or of a preview, reduced while decoding; None without one."""
    source: Path | io.BytesIO = path
    if photograph.kind == "raw":
        with rawpy.imread(str(path)) as raw:
            try:
                preview = raw.extract_thumb()
            except (rawpy.LibRawNoThumbnailError, rawpy.LibRawUnsupportedThumbnailError):
                return None
        if not isinstance(preview.data, bytes):  # a bitmap
            return None
        source = io.BytesIO(preview.data)
    elif open_picture(path).kind != "jpeg":
        return None
    with Image.open(source, formats=["JPEG"]) as image:
        image.draft("RGB", (4 * SIDE, 4 * SIDE))
        return np.asarray(image.convert("RGB"))


def remarks(photographs: Sequence[Photograph], groups: Sequence[Group]) -> Iterator[Problem]:
    """What looks wrong with photographs and groups."""
    by_path = {photograph.path: photograph for photograph in photographs}
    members = {group.name: [by_path[path] for path in group.photographs] for group in groups if group.used}
    firsts = {name: items[0] for name, items in members.items()}
    unknown = [item.path for items in members.values() for item in items if item.exposure is None]
    if unknown:
        yield problem("exposure-unknown.remarks", unknown=listed(unknown))
    apertures = [name for name, items in members.items() if len({item.aperture for item in items}) > 1]
    if apertures:
        yield problem("aperture-varies", apertures=listed(apertures))
    cameras = Counter(f"{item.make} {item.model}".strip() or "an unknown camera" for item in firsts.values())
    if len(cameras) > 1:
        texts = ", ".join(f"{name} ({count})" for name, count in cameras.most_common())
        yield problem("cameras-mixed", texts=texts)
    edges = {name: frozenset((item.width, item.height)) for name, item in firsts.items()}
    if len(set(edges.values())) > 1:
        usual_edges = Counter(edges.values()).most_common(1)[0][0]
        others = [name for name, each in edges.items() if each != usual_edges]
        yield problem("sizes-mixed", others=listed(others))
    sizes = Counter(len(items) for items in members.values())
    usual = max(sizes, key=lambda size: (sizes[size], size), default=1)
    odd = [name for name, items in members.items() if len(items) < usual]
    if odd:
        yield problem("bracket-incomplete", usual=usual, odd=listed(odd))
    if members and usual == 1 and not any(item.kind == "linear" for item in firsts.values()):
        yield problem("no-brackets")


def listed(names: Sequence[str]) -> str:
    """The first names, and the number of the others."""
    text = ", ".join(f"'{name}'" for name in names[:MOST_NAMES])
    return text if len(names) <= MOST_NAMES else f"{text} and {len(names) - MOST_NAMES} more"


def _folders_speak(photographs: Sequence[Photograph]) -> bool:
    """Whether folders alone decide the groups: no exposures, and several folders of several photographs."""
    if any(photograph.exposure is not None for photograph in photographs):
        return False
    counts = Counter(PurePath(photograph.path).parent for photograph in photographs)
    return len(counts) > 1 and all(1 < count <= 20 for count in counts.values())


def _same_camera(first: Photograph, second: Photograph) -> bool:
    names = ("kind", "width", "height", "make", "model", "lens", "focal_length")
    return all(getattr(first, name) == getattr(second, name) for name in names)


def _natural(text: str) -> list[tuple[int, str]]:
    """A sort key in which img_9 comes before img_10."""
    parts = re.split(r"(\d+)", text.casefold())
    return [(int(part[:18]), part) if part.isdecimal() else (-1, part) for part in parts]


def _named(lists: Iterable[Sequence[Photograph]], by_folder: bool = False) -> list[Group]:
    """Groups named after their folder or first photograph; names are unique and fit every file system."""
    taken: set[str] = set()
    groups = []
    for items in lists:
        path = PurePath(items[0].path)
        has_folder = by_folder and path.parent != PurePath(".")
        stem = "_".join(path.parent.parts) if has_folder else path.stem
        plain = _FORBIDDEN.sub("_", stem).strip(" .")[:80] or "view"
        name = free_name(plain, taken, "_", str.casefold)
        taken.add(name.casefold())
        groups.append(Group(name, tuple(item.path for item in items)))
    return groups
