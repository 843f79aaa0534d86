"""Measure Cycles' Principled BSDF, write the table of its correction to the fitted model, and evaluate it.

The evaluation sweeps materials, viewing angles and lights. Needs bpy; the model runs in a child process.

    python benchmarks/fit_write_back.py                # fit the table, then sweep
    python benchmarks/fit_write_back.py --check        # only sweep, with the existing table
    python benchmarks/fit_write_back.py --picture out.png --json out.json
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks import model_side, patches
from fipt_blender.blend.results.write_back_nodes import agree_with_model
from fipt_blender.core.optics.factorised import specular_reflectance
from fipt_blender.core.textures import write_back

MIN_ROUGHNESS = 0.02  # of the model
COLUMNS, ROWS = 32, 21  # n.v and sigma of the table
BASE_COLORS = (0.1, 0.3, 0.5, 0.7, 0.9)
METALLICS = (0.0, 0.25, 0.5, 0.75, 1.0)
ROUGHNESSES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
ANGLES = tuple(range(0, 81, 10))  # degrees between normal and view
AZIMUTHS = tuple(np.radians((15.0, 60.0, 120.0, 165.0)))  # degrees of the normal about the view
SUNS = tuple(np.radians((20.0, 50.0, 80.0)))  # between sun and view
LIGHTS = ("white", "sun")


def leave(material: Any) -> None:
    """Leave Blender's Principled BSDF unchanged."""


def fit(spp: int = 4096) -> dict[str, dict[str, np.ndarray]]:
    """The table's functions, each (ROWS, COLUMNS), of "principled" and of the model with each G."""
    # A patch that is seen exactly edge-on has no area; it is replaced by one that is seen almost edge-on.
    cosine = np.maximum(np.linspace(0.0, 1.0, COLUMNS), 0.25 / COLUMNS)
    roughness = np.linspace(0.0, 1.0, ROWS)
    both = patches.grid((0.0, 1.0), np.maximum(roughness, MIN_ROUGHNESS), (0.0, 1.0), cosine)
    rendered = patches.render(both, leave, spp=spp).mean(axis=1).reshape(2, ROWS, 2, COLUMNS)
    black, slope = rendered[0], rendered[1] - rendered[0]
    nv, sigma = (axis.ravel() for axis in np.meshgrid(cosine, roughness))
    functions = {"principled": {"e": black[:, 0], "t": slope[:, 0], "f1": black[:, 1], "f0": slope[:, 1]}}
    for masking in write_back.MASKINGS:
        lobes = model_side.ask(masking, cosine=nv, roughness=np.maximum(sigma, MIN_ROUGHNESS))
        functions[masking] = {name: lobes[name].reshape(ROWS, COLUMNS) for name in ("s0", "s1")}
    return functions


def write(functions: dict[str, dict[str, np.ndarray]]) -> None:
    """Write the table of the package, `write_back.TABLE`."""
    groups = []
    for group, members in functions.items():
        rows = []
        for name, values in members.items():
            lines = [json.dumps(row) for row in np.maximum(values, 0.0).round(5).tolist()]
            rows.append(f'  "{name}": [\n   ' + ",\n   ".join(lines) + "\n  ]")
        groups.append(f' "{group}": {{\n' + ",\n".join(rows) + "\n }")
    write_back.TABLE.write_text("{\n" + ",\n".join(groups) + "\n}\n", encoding="utf-8")
    write_back.table.cache_clear()


def model(materials: patches.Patches, sun: float | None, masking: str = write_back.MASKINGS[0]) -> np.ndarray:
    """(N,3) radiance that the fitted model reflects; lights as in `patches.render`."""
    common = {"roughness": materials.roughness, "metallic": materials.metallic}
    if sun is None:
        lobes = model_side.ask(masking, cosine=materials.cosine, roughness=materials.roughness)
        m = materials.metallic[:, None]
        specular = specular_reflectance(materials.base_color, m)
        return materials.base_color * (1.0 - m) + specular * lobes["s0"][:, None] + lobes["s1"][:, None]
    normal = materials.normals()
    side = np.column_stack([np.cos(materials.azimuth), np.sin(materials.azimuth), np.zeros(len(normal))])
    along = side * materials.cosine[:, None]
    along[:, 2] = -np.sqrt(1.0 - materials.cosine**2)
    across = np.cross(normal, along)
    frame = np.stack([along, across, normal], axis=1)
    light = frame @ np.array([np.sin(sun), 0.0, np.cos(sun)])
    view = frame @ np.array([0.0, 0.0, 1.0])
    return model_side.ask(masking, wi=light, wo=view, base_color=materials.base_color, **common)["value"]


def relative_errors(rendered: np.ndarray, modelled: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Mean absolute difference over the last axis (directions), relative to the mean of the model."""
    difference = np.abs(rendered - modelled).mean(axis=1).reshape(shape)
    return difference.mean(axis=-1) / modelled.mean(axis=1).reshape(shape).mean(axis=-1)


def sweep(finish: Any, masking: str, spp: int = 1024) -> dict[str, np.ndarray]:
    """Relative errors of Cycles against the model under each of LIGHTS, by (a, sigma, m, viewing angle).

    Under the sun, an entry is a mean over all directions of the sun, except those that do not reach the patch
    or only graze it (n.l < 0.05).

    Args:
        finish: changes the material of each patch; see `patches.render`.
        masking: G of the model.
        spp: samples per patch under the white world.
    """
    cosines = np.cos(np.radians(np.maximum(ANGLES, 0.5)))
    shape = (len(BASE_COLORS), len(ROUGHNESSES), len(METALLICS), len(ANGLES))
    flat = patches.grid(BASE_COLORS, ROUGHNESSES, METALLICS, cosines)
    white = relative_errors(patches.render(flat, finish, spp=spp), model(flat, None, masking), (*shape, 1))
    rotated = patches.grid(BASE_COLORS, ROUGHNESSES, METALLICS, cosines, AZIMUTHS)
    rendered, modelled = [], []
    for sun in SUNS:
        lit = rotated.normals() @ np.array([np.sin(sun), 0.0, np.cos(sun)]) > 0.05
        rendered.append(patches.render(rotated, finish, sun, spp=4) * lit[:, None])
        modelled.append(model(rotated, sun, masking) * lit[:, None])
    # suns x azimuths are the directions
    both = [np.stack(values, axis=1).reshape(-1, 3) for values in (rendered, modelled)]
    return {"white": white, "sun": relative_errors(*both, (*shape, len(AZIMUTHS) * len(SUNS)))}


def tables(errors: dict[str, np.ndarray]) -> str:
    """Text: mean errors in per cent by viewing angle, roughness, metallic and base colour."""
    lines = []
    for light in LIGHTS:
        all_of_them = 100 * errors[light]
        lines.append(f"{light}: mean {all_of_them.mean():.2f} %, largest {all_of_them.max():.1f} %")
        for axis, name, values in (
            (3, "angle", ANGLES), (1, "sigma", ROUGHNESSES), (2, "m", METALLICS), (0, "a", BASE_COLORS),
        ):  # fmt: skip
            others = tuple(each for each in range(4) if each != axis)
            means = all_of_them.mean(axis=others)
            lines.append(f"  {name:6s}" + "".join(f"{value!s:>7s}" for value in values))
            lines.append(f"  {'%':6s}" + "".join(f"{mean:7.2f}" for mean in means))
    return "\n".join(lines)


def main(argv: Sequence[str]) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("--check", action="store_true", help="only sweep, with the existing table")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the errors of the sweep as PNG")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the errors of the sweep as JSON")
    arguments = parser.parse_args(list(argv))
    if not arguments.check:
        write(fit())
    sweeps = {}
    for masking in write_back.MASKINGS:
        sweeps[f"{masking}, Principled alone"] = sweep(leave, masking)
        sweeps[f"{masking}, with write-back"] = sweep(partial(agree_with_model, masking=masking), masking)
    for name, errors in sweeps.items():
        print(f"--- {name}\n{tables(errors)}")
    if arguments.json:
        axes = {"a": BASE_COLORS, "sigma": ROUGHNESSES, "m": METALLICS, "angle": ANGLES}
        rounded = {
            name: {light: np.round(errors[light], 5).tolist() for light in LIGHTS}
            for name, errors in sweeps.items()
        }
        arguments.json.write_text(json.dumps({"axes": axes, "errors": rounded}), encoding="utf-8")
    if arguments.picture:
        draw(arguments.picture, sweeps)
    return 0


def draw(path: Path, sweeps: dict[str, dict[str, np.ndarray]]) -> None:
    """One row of squares per light and one square per metallic: sigma to the right, viewing angle upwards."""
    import bpy

    scale, gap = 10, 6
    strips = []
    for errors in sweeps.values():
        for light in LIGHTS:
            by = errors[light].mean(axis=0).transpose(1, 2, 0)  # m, angle, sigma
            squares = [np.kron(each[::-1], np.ones((scale, scale))) for each in by]
            padded = [np.pad(each, gap, constant_values=np.nan) for each in squares]
            strips.append(np.concatenate(padded, axis=1))
    image = np.concatenate(strips)
    # 0 % black, 1 % green, 10 % and more red
    shade = np.clip(np.nan_to_num(image, nan=0.0), 0.0, 0.1)
    rgba = np.ones((*image.shape, 4), np.float32)
    rgba[..., 0] = np.clip((shade - 0.01) / 0.09, 0.0, 1.0)
    rgba[..., 1] = np.where(shade < 0.01, 0.8 * shade / 0.01, 0.8 * (1.0 - rgba[..., 0]))
    rgba[..., 2] = 0.0
    rgba[np.isnan(image)] = (1.0, 1.0, 1.0, 1.0)
    picture = bpy.data.images.new("Sweep", image.shape[1], image.shape[0])
    picture.pixels.foreach_set(np.ascontiguousarray(rgba[::-1]).ravel())
    picture.filepath_raw, picture.file_format = str(path.absolute()), "PNG"
    picture.save()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
