"""Camera poses from eight-bit copies of the photographs: SIFT, matching and incremental mapping by pycolmap.

Features and matches are kept in a database, so that a stopped solve goes on where it stood.
"""

from __future__ import annotations

import os
import sqlite3
import tempfile
from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
import pycolmap

from ..core.run.errors import FiptError
from ..core.run.messages import Progress, within
from .facts import LeftOut

FEW_FEATURES = 150  # below, a photograph shows too little to be placed
LEAST_MODEL = 3  # photographs; smaller models say nothing
MOST_EXHAUSTIVE = 100  # photographs: 4,950 pairs, half an hour on one core
_PAIRS_PER_CALL = 64  # between two messages of progress
SQLITE_FULL = "database or disk is full"  # text of SQLite's code 13
_FEATURES, _MATCHES = 0.2, 0.8  # share of the time after which features and matches are found


@dataclass(frozen=True)
class SolveView:
    """A photograph to be placed.

    Attributes:
        name: of the view; see `copy_name`.
        width, height: in pixels of the merged photograph; copies have the same size.
        camera: what photographs of one camera and lens setting share.
        focal: focal length in pixels, None where EXIF does not give it.
        distortion: first and second radial coefficient to start from.
        files: paths of files by which an existing solve may call it.
    """

    name: str
    width: int
    height: int
    camera: str = ""
    focal: float | None = None
    distortion: tuple[float, float] = (0.0, 0.0)
    files: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Solve:
    """What a solve gives.

    Attributes:
        model: the largest connected set of photographs, in an arbitrary frame; images are named like views.
        left_out: photographs that it lacks, in the order of the views.
        sizes: number of photographs of each model that no larger one has, the largest first.
    """

    model: pycolmap.Reconstruction
    left_out: tuple[LeftOut, ...]
    sizes: tuple[int, ...]


def camera_groups(views: Sequence[SolveView]) -> list[list[int]]:
    """Indices of the views that share intrinsics: one camera, focal length and size of image.

    Portrait and landscape of one camera are two groups, because COLMAP's intrinsics have one orientation.
    """
    groups: dict[tuple[str, int, int, float | None], list[int]] = {}
    for index, view in enumerate(views):
        focal = None if view.focal is None else round(view.focal, 1)
        groups.setdefault((view.camera, view.width, view.height, focal), []).append(index)
    return list(groups.values())


def start_camera(view: SolveView, views: int) -> pycolmap.Camera:
    """The camera from which the solve starts, for a number of views that share it."""
    known = view.focal is not None
    # Without EXIF, the longer side: between a phone's and a wide lens's.
    focal = view.focal if view.focal is not None else float(max(view.width, view.height))
    center = [0.5 * view.width, 0.5 * view.height]
    two = views >= 8  # fewer do not determine a second coefficient of the lens
    return pycolmap.Camera(
        model="RADIAL" if two else "SIMPLE_RADIAL",
        width=view.width,
        height=view.height,
        params=[focal, *center, *view.distortion[: 2 if two else 1]],
        has_prior_focal_length=known,
    )


def solve(folder: Path, views: Sequence[SolveView], seed: int, progress: Progress) -> Solve:
    """Poses of the photographs whose copies are in ``folder/copies``.

    Args:
        folder: for the database, which is gone on with if it is there.
        views: in the order in which they were taken; all sizes as of the copies.
        seed: of all random choices.
        progress: takes the share that is done, 0 to 1.

    Raises:
        FiptError: ``solve-failed`` where no two photographs could be connected, ``solve-few`` for less than
            two photographs, ``solve-database`` or ``disk-full`` where the database can't be used.
    """
    if len(views) < 2:
        raise FiptError("solve-few", number_of_views=len(views))
    pycolmap.logging.minloglevel = 2  # errors only; the log of a room has 10,000 lines
    pycolmap.set_random_seed(seed)
    database = folder / "database.db"
    try:
        _extract(database, folder / "copies", views, within(progress, 0.0, _FEATURES))
        _match(database, views, seed, within(progress, _FEATURES, _MATCHES))
        models = _map(database, folder, len(views), seed, within(progress, _MATCHES, 1.0))
    except RuntimeError as error:
        raise database_error(database, error) from error
    connections = _connections(database, [copy_name(view.name) for view in views])
    if not models:
        raise _nothing_solved(connections)
    names = {copy_name(view.name): view.name for view in views}
    for model in models:
        for image in model.images.values():
            image.name = names[image.name]
    placed = [registered_names(model) for model in models]
    return Solve(models[0], left_out(views, placed, connections), own_sizes(placed))


def own_sizes(models: Sequence[set[str]]) -> tuple[int, ...]:
    """Number of photographs of each model that no larger one has, of models that have any.

    The mapper begins several models and may end with smaller ones whose photographs are in the largest, too.

    Args:
        models: names of the views of each, the largest first.
    """
    seen: set[str] = set()
    sizes = []
    for names in models:
        sizes.append(len(names - seen))
        seen |= names
    return tuple(size for size in sizes if size)


def image_pairs(count: int) -> list[tuple[int, int]]:
    """Which of some photographs in the order in which they were taken are compared with each other.

    Up to `MOST_EXHAUSTIVE` photographs, these are all pairs. Beyond, each photograph is compared with the
    next ones, with those at distances of powers of two, and a coarse net with itself, so that a walk around
    a room that ends where it began is closed.

    Returns:
        Sorted pairs (first, second) with first < second, without repetition.
    """
    if count <= MOST_EXHAUSTIVE:
        return list(combinations(range(count), 2))
    steps = set(range(1, 11))  # each is compared with the next ten
    steps |= {2**power for power in range(count.bit_length()) if 2**power < count // 2}
    near = {(first, first + step) for step in steps for first in range(count - step)}
    # Every eighth is compared with all others of that net, which closes loops.
    return sorted(near | set(combinations(range(0, count, 8), 2)))


@dataclass(frozen=True)
class Connections:
    """What the database knows of one photograph: its features, and partners with verified matches."""

    features: int
    partners: int


def copy_name(view: str) -> str:
    """The name of a view's copy; COLMAP's lists of pairs separate names by spaces."""
    return view.replace("%", "%25").replace(" ", "%20") + ".jpg"


def registered_names(model: pycolmap.Reconstruction) -> set[str]:
    """Names of the images that a model has placed."""
    return {model.images[index].name for index in model.reg_image_ids()}


def left_out(
    views: Sequence[SolveView], models: Sequence[set[str]], connections: Sequence[Connections]
) -> tuple[LeftOut, ...]:
    """The views that the first model lacks, each with the most likely reason.

    Args:
        views: all of them.
        models: names of the views of each model, the largest first.
        connections: of each view.
    """
    return tuple(
        LeftOut(view.name, *_reason(view.name, models[1:], found))
        for view, found in zip(views, connections, strict=True)
        if view.name not in models[0]
    )


def _reason(name: str, others: Sequence[set[str]], found: Connections) -> tuple[str, str]:
    """Why a view has no camera, and what to do about it."""
    other = next((names for names in others if name in names), None)
    if other is not None:
        return (
            f"it is connected to {len(other) - 1} photographs, but these are not connected to the others",
            "Take photographs that lead from one set to the other, or prepare the sets separately.",
        )
    if found.features < FEW_FEATURES:
        return (
            f"only {found.features} features were found: it is blurred, dark, or shows plain surfaces",
            "Leave it out, or take it again sharper and with objects in the frame.",
        )
    if found.partners == 0:
        return (
            "it shows nothing that another photograph shows",
            "Leave it out, or take photographs between it and the others.",
        )
    return (
        f"it has too little in common with the {found.partners} photographs that show the same",
        "Take more photographs from near its position.",
    )


def _nothing_solved(connections: Sequence[Connections]) -> FiptError:
    poor = sum(found.features < FEW_FEATURES for found in connections)
    alone = sum(found.partners == 0 for found in connections)
    text = f"No camera could be solved: of {len(connections)} photographs, {alone} match no other one"
    text += f", and {poor} are blurred, dark or show only plain surfaces." if poor else "."
    return FiptError("solve-failed", text=text)


def database_error(database: Path, error: RuntimeError) -> FiptError:
    """pycolmap's error as one for the user: it stops at what SQLite says, often with paths."""
    if SQLITE_FULL in str(error):
        return FiptError("disk-full.explained", database=database)
    reason = str(error).strip().splitlines()
    return FiptError("solve-database", database=database, reason=reason[-1] if reason else "no reason given")


def _extract(database: Path, copies: Path, views: Sequence[SolveView], progress: Progress) -> None:
    """Find the features of all views; views that have them already are left as they are."""
    groups = camera_groups(views)
    done = 0
    for indices in groups:
        identifier = _camera_id(database, views[indices[0]], len(indices))
        options = pycolmap.FeatureExtractionOptions()
        options.max_image_size = 2400
        options.use_gpu = False
        options.sift.max_num_features = 8192
        options.sift.peak_threshold = 0.004  # of 0.0067: walls and ceilings have little contrast
        reader = pycolmap.ImageReaderOptions(existing_camera_id=identifier)
        step = max(1, os.cpu_count() or 1)  # one call works on the images of a batch in parallel
        for start in range(0, len(indices), step):
            names = [copy_name(views[index].name) for index in indices[start : start + step]]
            pycolmap.extract_features(
                database,
                copies,
                image_names=names,
                reader_options=reader,
                extraction_options=options,
                device=pycolmap.Device.cpu,
            )
            done += len(names)
            progress(done / len(views))


def _camera_id(database: Path, view: SolveView, views: int) -> int:
    """The number in the database of a group's camera, which is written if it is new."""
    wanted = start_camera(view, views)
    with pycolmap.Database.open(str(database)) as opened:
        for camera in opened.read_all_cameras():
            same = camera.model == wanted.model and (camera.width, camera.height) == (view.width, view.height)
            if same and np.allclose(camera.params, wanted.params):
                return int(camera.camera_id)
        identifier = int(opened.write_camera(wanted))
        wanted.camera_id = identifier
        rig = pycolmap.Rig()
        rig.add_ref_sensor(wanted.sensor_id)
        opened.write_rig(rig)
    return identifier


def _match(database: Path, views: Sequence[SolveView], seed: int, progress: Progress) -> None:
    """Match and verify the pairs of views that the database does not have yet."""
    pairs = image_pairs(len(views))
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = seed
    options = pycolmap.FeatureMatchingOptions()
    options.use_gpu = False
    with tempfile.TemporaryDirectory(dir=database.parent, prefix=".pairs") as folder:
        listed = Path(folder) / "pairs.txt"
        for start in range(0, len(pairs), _PAIRS_PER_CALL):
            chosen = pairs[start : start + _PAIRS_PER_CALL]
            names = [(copy_name(views[a].name), copy_name(views[b].name)) for a, b in chosen]
            listed.write_text("".join(f"{a} {b}\n" for a, b in names), encoding="utf-8")
            pycolmap.match_image_pairs(
                database,
                matching_options=options,
                pairing_options=pycolmap.ImportedPairingOptions(match_list_path=listed),
                verification_options=verification,
                device=pycolmap.Device.cpu,
            )
            progress(min(1.0, (start + len(chosen)) / len(pairs)))


def _map(
    database: Path, folder: Path, count: int, seed: int, progress: Progress
) -> list[pycolmap.Reconstruction]:
    """All models with at least `LEAST_MODEL` photographs (two where there are no more), the largest first."""
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = seed
    options.mapper.random_seed = seed
    options.triangulation.random_seed = seed
    options.min_model_size = min(LEAST_MODEL, count)
    options.extract_colors = False
    placed = 0

    def one_more() -> None:
        nonlocal placed
        placed += 1
        progress(min(placed / count, 0.95))

    with tempfile.TemporaryDirectory(dir=folder, prefix=".models") as output:
        models = pycolmap.incremental_mapping(
            database, folder / "copies", output, options, next_image_callback=one_more
        )
    found = [model for model in models.values() if model.num_reg_images() >= 2]
    return sorted(found, key=lambda model: (-model.num_reg_images(), -model.num_points3D()))


def _connections(database: Path, names: Sequence[str]) -> list[Connections]:
    """Features and verified partners of each photograph in the database."""
    with closing(sqlite3.connect(database)) as opened:
        features = dict(opened.execute("select name, rows from images join keypoints using (image_id)"))
        identifiers = dict(opened.execute("select image_id, name from images"))
        pairs = opened.execute("select pair_id from two_view_geometries where rows > 0").fetchall()
    partners = Counter(
        identifiers.get(identifier)
        for (pair,) in pairs
        for identifier in pycolmap.pair_id_to_image_pair(pair)
    )
    return [Connections(int(features.get(name, 0)), partners[name]) for name in names]
