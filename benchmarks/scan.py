"""A capture whose mesh is replaced by a scan: `scan.py CAPTURE --voxel 0.02 --output DIR`.

Range images are rendered of the capture's mesh from positions around its training cameras, disturbed as a
scanner's are, fused into a truncated signed distance field and extracted as one welded mesh. All other files
of the new capture are links to the original's.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.disturb import read_obj
from fipt_blender.core.capture.distortion import lens_pinhole
from fipt_blender.core.capture.formats.registry import read_rig
from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.capture.views import View
from fipt_blender.core.depth.extraction import FusedMesh, extract
from fipt_blender.core.depth.ply import write_ply
from fipt_blender.core.depth.range_image import RangeImage
from fipt_blender.core.depth.volume import BlockVolume
from fipt_blender.core.device.variant import set_variant
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.errors import FiptError

MESH = "scene.ply"
BULGE_WIDTH = 1.5  # metres
REPLACED = ("scene.obj", "scene.npz")  # the second describes the triangles of the first


@dataclass(frozen=True)
class Scanner:
    """What a scanner measures and what it gets wrong.

    Attributes:
        width, height: pixels of a range image.
        shots: range images for each training camera: one at the camera, the others around it.
        wander: metres between a shot and its camera, standard deviation along each axis.
        turn: degrees by which a shot is turned, standard deviation about each axis.
        noise: metres of range noise.
        relative_noise: more of it, as a share of the range.
        grazing: cosine at the surface below which nothing returns.
        dark: diffuse reflectance below which nothing returns.
        shiny: roughness below which only what is seen nearly head-on returns.
        head_on: cosine of that.
        flying: share of pixels at depth edges whose range is between both sides.
        edge: metres of range between neighbouring pixels that make a depth edge.
        drift, tilt: metres and degrees by which the poses are wrong, standard deviations.
        bulge: metres by which surfaces without texture are wrong, smoothly, as in photogrammetry.
    """

    width: int = 640
    height: int = 320
    shots: int = 5
    wander: float = 0.15
    turn: float = 12.0
    noise: float = 0.004
    relative_noise: float = 0.002
    grazing: float = 0.17
    dark: float = 0.03
    shiny: float = 0.2
    head_on: float = 0.94
    flying: float = 0.5
    edge: float = 0.05
    drift: float = 0.0
    tilt: float = 0.0
    bulge: float = 0.0


@dataclass(frozen=True, eq=False)
class Truth:
    """The exact mesh, in the capture's own coordinates (metres).

    Attributes:
        vertices: (V, 3).
        triangles: (T, 3).
        reflectance: (T,) highest channel of the base color.
        roughness: (T,).
        blank: (T,) whether the material has no texture.
        emits: (T,) whether a triangle is a lamp, which returns well.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    reflectance: np.ndarray
    roughness: np.ndarray
    blank: np.ndarray
    emits: np.ndarray


def read_truth(capture: Path) -> Truth:
    """The exact mesh of a capture with its materials.

    Raises:
        FiptError: ``truth-missing`` where the capture has no scene.obj, scene.npz or materials.json.
    """
    missing = [name for name in (*REPLACED, "materials.json") if not (capture / name).is_file()]
    if missing:
        raise FiptError.of(
            "truth-missing",
            f"{capture / missing[0]} does not exist.",
            "Only captures with truth are scanned.",
        )
    vertices, triangles = read_obj(capture / "scene.obj")
    with np.load(capture / "scene.npz", allow_pickle=False) as table:
        material, emits = table["material"], table["is_emitter"]
    entries = read_document(capture / "materials.json", dict)["materials"]
    # Ids begin at 1; where 0 is among them, they are places in the list.
    row = material if material.min() == 0 else np.argsort([entry["id"] for entry in entries])[material - 1]
    reflectance = np.array([1.0 if entry.get("texture") else max(entry["base_color"]) for entry in entries])
    roughness = np.array([entry["roughness"] for entry in entries])
    blank = np.array([not entry.get("texture") for entry in entries])
    return Truth(vertices, triangles, reflectance[row], roughness[row], blank[row], emits)


def cameras(capture: Path, scanner: Scanner, rng: np.random.Generator) -> list[View]:
    """The scanner's cameras around the training cameras of a capture, with their field of view."""
    rig = read_rig(capture, "auto", CaptureOptions())
    shots = []
    for view in (view for view in rig.views if view.split != "held_back"):
        pinhole = lens_pinhole(view.lens, view.width, view.height)
        scale = scanner.width / pinhole.width
        for shot in range(scanner.shots):
            pose = view.camera_to_world.copy()
            if shot:
                pose[:3, 3] += scanner.wander * rng.normal(size=3)
                pose[:3, :3] = pose[:3, :3] @ turned(np.radians(scanner.turn) * rng.normal(size=3))
            size = {"width": scanner.width, "height": scanner.height}
            middle = {"cx": 0.5 * scanner.width, "cy": 0.5 * scanner.height}
            focal = {"fx": pinhole.fx * scale, "fy": pinhole.fy * scale}
            name = f"{view.name}/{shot}"
            shots.append(View(name, "train", view.image, **size, **focal, **middle, camera_to_world=pose))
    return shots


def turned(vector: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) about a vector by its length in radians."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector / max(angle, 1e-12)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def range_images(
    truth: Truth, views: Sequence[View], scanner: Scanner, rng: np.random.Generator
) -> Iterator[RangeImage]:
    """What the scanner measures from each camera; needs Mitsuba's variant."""
    from fipt_blender.core.pixels.camera_rays import trace_pixels
    from fipt_blender.core.surface.room import Room

    normals = np.zeros((len(truth.triangles), 3, 3), np.float32)
    none = np.zeros(len(truth.triangles), np.int32)
    room = Room(truth.vertices.astype(np.float32), truth.triangles.astype(np.int32), normals, none, none)
    for view in views:
        surface = trace_pixels(room, view)
        shape = (view.height, view.width)
        valid = np.array(surface.valid).reshape(shape)
        distance = np.where(valid, np.array(surface.distance).reshape(shape), 0.0).astype(np.float64)
        local = axis_directions(view)
        direction = local @ view.camera_to_world[:3, :3].T
        normal = np.array(surface.geometric_normal).T.reshape(*shape, 3)
        cosine = np.abs((direction * normal).sum(axis=2)) / np.linalg.norm(direction, axis=2)
        triangle = np.where(valid, np.array(surface.triangle).reshape(shape), 0)
        returns = valid & (cosine > scanner.grazing)
        returns &= truth.emits[triangle] | (truth.reflectance[triangle] >= scanner.dark)
        returns &= (truth.roughness[triangle] >= scanner.shiny) | (cosine > scanner.head_on)
        if scanner.bulge:
            position = np.array(surface.position).T.reshape(*shape, 3)
            distance = distance + scanner.bulge * truth.blank[triangle] * bulges(position) * valid
        measured = disturbed(distance, returns, scanner, rng) / np.linalg.norm(local, axis=2)
        pinhole = (view.fx, view.fy, view.cx, view.cy)
        yield RangeImage(measured.astype(np.float32), *pinhole, believed_pose(view, scanner, rng))


def believed_pose(view: View, scanner: Scanner, rng: np.random.Generator) -> np.ndarray:
    """The pose (4, 4) that the scanner takes for its own."""
    pose = view.camera_to_world.copy()
    if scanner.drift or scanner.tilt:
        pose[:3, 3] += scanner.drift * rng.normal(size=3)
        pose[:3, :3] = pose[:3, :3] @ turned(np.radians(scanner.tilt) * rng.normal(size=3))
    return pose


def bulges(position: np.ndarray) -> np.ndarray:
    """A smooth random field of the place (..., 3), standard deviation 1; its waves are about a metre long."""
    rng = np.random.default_rng(0)
    waves, phases = rng.normal(0.0, 2.0 * np.pi / BULGE_WIDTH, (3, 32)), rng.uniform(0.0, 2.0 * np.pi, 32)
    return np.asarray(np.sqrt(2.0 / 32) * np.cos(np.nan_to_num(position) @ waves + phases).sum(axis=-1))


def axis_directions(view: View) -> np.ndarray:
    """(H, W, 3) directions of one metre of depth through the pixels, in the camera's axes."""
    y, x = np.mgrid[: view.height, : view.width] + 0.5
    return np.stack([(x - view.cx) / view.fx, (y - view.cy) / view.fy, np.ones_like(x)], axis=2)


def disturbed(
    distance: np.ndarray, returns: np.ndarray, scanner: Scanner, rng: np.random.Generator
) -> np.ndarray:
    """Measured ranges (H, W): noise of about two pixels' width, flying pixels at depth edges, 0 where lost.

    Args:
        distance: (H, W) true ranges in metres, 0 where no surface is.
        returns: (H, W) whether the surface returns anything.
    """
    noise = rng.normal(size=distance.shape)
    around = sum(np.roll(noise, (y, x), (0, 1)) for y in (0, 1) for x in (0, 1)) * 0.5
    result = distance + (scanner.noise + scanner.relative_noise * distance) * around
    for axis in (0, 1):
        other = np.roll(distance, 1, axis)
        jump = (np.abs(other - distance) > scanner.edge) & (other > 0.0)
        flies = jump & (rng.random(distance.shape) < scanner.flying)
        share = rng.random(distance.shape)
        result = np.where(flies, share * distance + (1.0 - share) * other, result)
    return np.where(returns, result, 0.0)


def scanned(capture: Path, voxel: float, scanner: Scanner, seed: int) -> FusedMesh:
    """The mesh that a scan of a capture's room gives, in the capture's coordinates."""
    rng = np.random.default_rng(seed)
    views = cameras(capture, scanner, rng)
    volume = BlockVolume(voxel)
    for image in range_images(read_truth(capture), views, scanner, rng):
        volume.integrate(image)
    return extract(volume, least_weight=2.0)


def smoothed(mesh: FusedMesh, steps: int) -> FusedMesh:
    """The mesh with each vertex halfway to the mean of its neighbours, some times, as scanning apps do."""
    vertices = mesh.vertices.astype(np.float64)
    start, end = mesh.triangles.reshape(-1), np.roll(mesh.triangles, -1, axis=1).reshape(-1)
    start, end = np.concatenate([start, end]), np.concatenate([end, start])
    count = np.maximum(np.bincount(start, minlength=len(vertices)), 1)[:, None]
    for _ in range(steps):
        total = np.stack(
            [np.bincount(start, vertices[end, axis], len(vertices)) for axis in range(3)], axis=1
        )
        vertices = 0.5 * (vertices + total / count)
    return FusedMesh(vertices.astype(np.float32), mesh.triangles, mesh.colors)


def link_capture(capture: Path, target: Path) -> None:
    """Make a folder with links to everything in a capture but its mesh."""
    target.mkdir(parents=True, exist_ok=True)
    for source in capture.absolute().iterdir():
        if source.name not in REPLACED and not (target / source.name).exists():
            os.symlink(source, target / source.name)


def main(argv: Sequence[str]) -> int:
    """Run the command; 0, 1 for a failure."""
    parser = argparse.ArgumentParser(description="Replace a capture's mesh by a scan.")
    parser.add_argument("capture", type=Path, help="in the FIPT authors' synthetic layout, with scene.npz")
    parser.add_argument("--voxel", type=float, default=0.02, help="metres (default: 0.02)")
    parser.add_argument(
        "--output", type=Path, required=True, help="folder of the new capture, or a .ply for the mesh alone"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--shots", type=int, default=Scanner.shots, help="range images a camera; few leave pinholes"
    )
    parser.add_argument("--pose-error", action="store_true", help="poses wrong by 2 mm and 0.1 degrees")
    parser.add_argument("--bulge", type=float, default=0.0, help="metres of photogrammetry's bulging walls")
    parser.add_argument("--smooth", type=int, default=0, metavar="STEPS", help="smooth the mesh, as apps do")
    arguments = parser.parse_args(list(argv))
    wrong = {"drift": 0.002, "tilt": 0.1} if arguments.pose_error else {}
    try:
        set_variant("llvm")
        scanner = Scanner(shots=arguments.shots, bulge=arguments.bulge, **wrong)
        mesh = scanned(arguments.capture, arguments.voxel, scanner, arguments.seed)
    except FiptError as error:
        print(f"error: {error.text} {error.remedy}", file=sys.stderr)
        return 1
    mesh = smoothed(mesh, arguments.smooth)
    if arguments.output.suffix == ".ply":
        write_ply(arguments.output, mesh)
    else:
        link_capture(arguments.capture, arguments.output)
        write_ply(arguments.output / MESH, mesh)
    print(f"{len(mesh.vertices)} vertices, {len(mesh.triangles)} triangles")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
