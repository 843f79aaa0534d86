# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a mesh allows an estimate to reach: `surface_limits.py CAPTURE MESH ...`, without estimating anything.

The true maps of the training views are projected onto each mesh, and the held-back views read them there.
Their errors (paper's protocol) come from the geometry alone. Rays through the pixels of the held-back views
are compared with those on the exact mesh. MESH is a mesh file in the capture's coordinates, or a run folder,
whose room counts as the engine completes and cleans it. A mesh of a
million triangles takes a quarter of a minute of processor time.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import metrics, truth
from benchmarks.disturb import read_obj
from fipt_blender.core import conventions
from fipt_blender.core.alignment.mesh_file import read_mesh
from fipt_blender.core.capture.distortion import lens_pinhole
from fipt_blender.core.capture.formats.registry import read_rig
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.capture.views import View, load_capture
from fipt_blender.core.device.variant import set_variant
from fipt_blender.core.run.runfolder import RunFolder

if TYPE_CHECKING:
    from fipt_blender.core.surface.room import Room

NEAREST = 8  # true pixels of training views that a place on the mesh reads
# A place reads pixels within this many metres; a right angle between the normals counts as so many metres.
REACH, TURNED = 0.08, 0.06
OFFSETS = [(x, y) for x in (-0.25, 0.25) for y in (-0.25, 0.25)]  # of rays from a pixel's centre, in pixels
WITHIN = (0.01, 0.02, 0.05)  # metres along a ray
THIN = 0.01  # metres from a true place within which the mesh has it
SAMPLES = 100_000  # true places that are looked for
SPREAD = 4.0  # points on the mesh per square of THIN


@dataclass(frozen=True, eq=False)
class Seen:
    """What rays through pixels meet.

    Attributes:
        place: (N, 3) metres. normal: (N, 3) unit shading normal on the side of the camera.
        distance: (N,) metres, infinite where nothing is met.
    """

    place: np.ndarray
    normal: np.ndarray
    distance: np.ndarray

    @property
    def met(self) -> np.ndarray:
        """(N,) bool."""
        return np.isfinite(self.distance)


@dataclass(frozen=True)
class Limits:
    """Figures of a mesh.

    Attributes:
        within: shares of rays that are off by less than each of `WITHIN`.
        missing: share of the rays that should meet a surface and meet none. extra: the reverse.
        turned: median degrees between shading normals and the true faces, of rays off by less than 5 cm.
        kept: share of what training views see of the true surface that is closer than `THIN` to the mesh.
        maps: dB by map of the held-back views.
    """

    within: tuple[float, ...]
    missing: float
    extra: float
    turned: float
    kept: float
    maps: dict[str, float | None]


def bare_room(vertices: np.ndarray, triangles: np.ndarray) -> Room:
    """A room with flat shading."""
    from fipt_blender.core.surface.room import Room, triangle_normals

    normals = np.repeat(triangle_normals(vertices, triangles)[:, None], 3, axis=1).astype(np.float32)
    none = np.zeros(len(triangles), np.int32)
    return Room(vertices.astype(np.float32), triangles.astype(np.int32), normals, none, none - 1)


def rig_views(capture: Path) -> list[View]:
    """The views of a capture in its own coordinates."""
    rig = read_rig(capture, "auto", CaptureOptions())
    found = []
    for view in rig.views:
        pinhole = lens_pinhole(view.lens, view.width, view.height)
        size = {"width": pinhole.width, "height": pinhole.height}
        focal = {name: getattr(pinhole, name) for name in ("fx", "fy", "cx", "cy")}
        pose = view.camera_to_world
        found.append(View(view.name, view.split, view.image, **size, **focal, camera_to_world=pose))
    return found


def seen_through(room: Room, view: View, offsets: Sequence[tuple[float, float]]) -> Seen:
    """What rays through the pixels of a view meet, those of a pixel one after the other."""
    from fipt_blender.core.pixels.camera_rays import first_hits, trace_pixels

    surface = trace_pixels(room, view, offsets)
    distance = first_hits(surface)[1]
    return Seen(np.array(surface.position).T, np.array(surface.normal).T, distance)


def key(seen: Seen, rows: np.ndarray) -> np.ndarray:
    """(n, 6) place and side of a surface, by which pixels are looked up."""
    return np.concatenate([seen.place[rows], TURNED / np.sqrt(2.0) * seen.normal[rows]], axis=1)


def table_of(maps: metrics.Maps) -> np.ndarray:
    """(H * W, 8) kd, a', roughness and metallic."""
    columns = [maps.kd, maps.a_prime, maps.roughness[..., None], maps.metallic[..., None]]
    return np.concatenate(columns, axis=2).reshape(-1, 8)


def projected(
    room: Room, views: Sequence[View], maps: Sequence[metrics.Maps], held_back: Sequence[View]
) -> list[metrics.Maps]:
    """Maps of the held-back views, from those of training views on the mesh: means of the nearest pixels."""
    keys, values = [], []
    for view, one in zip(views, maps, strict=True):
        seen = seen_through(room, view, [(0.0, 0.0)])
        rows = np.flatnonzero(seen.met & metrics.surfaces(one).reshape(-1))
        keys.append(key(seen, rows))
        values.append(table_of(one)[rows])
    tree, table = cKDTree(np.concatenate(keys)), np.concatenate(values)
    found = []
    for view in held_back:
        seen = seen_through(room, view, OFFSETS)
        rows = np.flatnonzero(seen.met)
        away, nearest = tree.query(key(seen, rows), NEAREST, distance_upper_bound=REACH, workers=-1)
        width = np.maximum(seen.distance[rows] / view.fx, 1e-4)[:, None]
        near = np.isfinite(away)
        weight = near * (np.exp(-0.5 * (np.where(near, away, 0.0) / width) ** 2) + 1e-6)
        total = np.einsum("nk,nkc->nc", weight, table[np.where(near, nearest, 0)])
        mean = np.zeros((len(seen.met), 8))
        mean[rows] = total / np.maximum(weight.sum(axis=1), 1e-12)[:, None]
        shape = (view.height, view.width)
        image = mean.reshape(*shape, len(OFFSETS), 8).mean(axis=2)
        black = np.zeros((*shape, 3))
        hit = seen.met.reshape(*shape, -1).any(axis=2)
        split = image[..., :3], image[..., 3:6], black, image[..., 6], image[..., 7]
        found.append(metrics.Maps(*split, emission=black, hit=hit))
    return found


def points_over(room: Room) -> np.ndarray:
    """(N, 3) points on a mesh, evenly spread at random."""
    rng = np.random.default_rng(0)
    count = int(SPREAD * room.areas.sum() / THIN**2)
    chosen = rng.choice(len(room.triangles), count, p=room.areas / room.areas.sum())
    return room.points_on(chosen, *rng.random((2, count)))


@dataclass(frozen=True, eq=False)
class Reference:
    """The true surface of a capture and its views with their true maps. Mitsuba's variant must be set."""

    room: Room
    train: list[View]
    held_back: list[View]
    train_maps: list[metrics.Maps]
    held_back_maps: list[metrics.Maps]

    @classmethod
    def read(cls, capture: Path, views: Sequence[View], world_from_source: np.ndarray) -> Reference:
        """Those of a capture with ground truth.

        Args:
            world_from_source: (4, 4), coordinates in which meshes are compared.
        """
        vertices, triangles = read_obj(capture / "scene.obj")
        room = bare_room(conventions.transform_points(world_from_source, vertices), triangles)
        train = [view for view in views if view.split != "held_back"]
        held_back = [view for view in views if view.split == "held_back"]
        maps = ([truth.read_maps(view) for view in some] for some in (train, held_back))
        return cls(room, train, held_back, *maps)

    def limits(self, room: Room) -> Limits:
        """The figures of a mesh."""
        off, angles, counts = [], [], np.zeros(3, np.int64)
        for view in self.held_back:
            true, found = (seen_through(one, view, [(0.0, 0.0)]) for one in (self.room, room))
            both = true.met & found.met
            away = np.abs(true.distance[both] - found.distance[both])
            off.append(away)
            cosine = np.abs((true.normal[both] * found.normal[both]).sum(axis=1))
            angles.append(np.degrees(np.arccos(np.minimum(cosine, 1.0)))[away < WITHIN[-1]])
            counts += [true.met.sum(), (true.met & ~found.met).sum(), (~true.met & found.met).sum()]
        away = np.concatenate(off)
        within = tuple(float((away < limit).sum() / counts[0]) for limit in WITHIN)
        maps = projected(room, self.train, self.train_maps, self.held_back)
        everywhere = [np.ones(one.hit.shape, bool) for one in self.held_back_maps]
        scores = metrics.material_metrics(maps, self.held_back_maps, everywhere, strict=False)
        missing, extra = (float(count / counts[0]) for count in counts[1:])
        return Limits(
            within, missing, extra, float(np.median(np.concatenate(angles))), self.kept(room), scores
        )

    def kept(self, room: Room) -> float:
        """See `Limits`."""
        places = []
        for view in self.train:
            seen = seen_through(self.room, view, [(0.0, 0.0)])
            places.append(seen.place[seen.met])
        every = np.concatenate(places)
        some = every[np.random.default_rng(0).choice(len(every), min(SAMPLES, len(every)), replace=False)]
        return float(np.isfinite(cKDTree(points_over(room)).query(some, distance_upper_bound=THIN)[0]).mean())


HEADER = (
    "| mesh | triangles | within 1, 2, 5 cm | missing | extra | normals | kept | kd | a′ | σ | metallic |\n"
    "|---|---|---|---|---|---|---|---|---|---|---|"
)


def row(name: str, triangles: int, limits: Limits) -> str:
    """A line of the table."""
    within = " / ".join(f"{100.0 * share:.1f}" for share in limits.within)
    shares = f"{100.0 * limits.missing:.2f} % | {100.0 * limits.extra:.2f} % | {limits.turned:.1f}°"
    maps = " | ".join("-" if value is None else f"{value:.1f}" for value in limits.maps.values())
    return f"| {name} | {triangles} | {within} | {shares} | {100.0 * limits.kept:.2f} % | {maps} |"


def main(argv: Sequence[str]) -> int:
    """Run the command; 0."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("capture", type=Path, help="with ground truth")
    parser.add_argument("meshes", type=Path, nargs="+", metavar="MESH", help="mesh file or run folder")
    arguments = parser.parse_args(list(argv))
    set_variant("llvm")
    from fipt_blender.core.surface.room import load_room

    print(HEADER)
    for path in arguments.meshes:
        views, moved = rig_views(arguments.capture), np.eye(4)
        if path.is_dir():
            capture = load_capture(RunFolder(path))
            moved, room = capture.world_from_source, load_room(RunFolder(path))
            poses = {view.name: view.camera_to_world for view in (*capture.train, *capture.held_back)}
            views = [replace(view, camera_to_world=poses[view.name]) for view in views if view.name in poses]
        else:
            room = bare_room(*read_mesh(path))
        limits = Reference.read(arguments.capture, views, moved).limits(room)
        print(row(path.name, len(room.triangles), limits), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
