"""Give a room of examples/make_room.py random materials and lamps; no constant was tuned on such a room.

python examples/make_room.py --seed 7 [--thin] --no-render --out DIR
python benchmarks/other_materials.py DIR --seed 7
python examples/render_room.py DIR
python3 dev.py accuracy DIR
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

# Shares of rough and of metallic materials; all others are glossy dielectrics.
DIFFUSE_SHARE, METALLIC_SHARE = 0.5, 0.2


def drawn_material(material: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """The material with random base colour, roughness (the paper's sigma) and metallic.

    Textured ones keep their texture, and are no metals.
    """
    kind, base = rng.random(), dict(material)
    metallic = not material["texture"] and kind > 1.0 - METALLIC_SHARE
    if kind < DIFFUSE_SHARE:
        roughness = 1.0
    else:
        roughness = rng.uniform(0.06, 0.5) if metallic else rng.uniform(0.12, 0.7)
    brightness = rng.uniform(0.45, 0.9) if metallic else np.exp(rng.uniform(np.log(0.1), np.log(0.8)))
    tint = rng.dirichlet(np.full(3, 15.0))
    base["roughness"], base["metallic"] = round(float(roughness), 2), float(metallic)
    if not material["texture"]:
        base["base_color"] = [round(float(value), 3) for value in brightness * tint / tint.max()]
    return base


def drawn_radiance(radiance: list[float], rng: np.random.Generator) -> list[float]:
    """(3,) radiance with a random brightness (half to twice) and colour temperature."""
    warmth = rng.uniform(-0.5, 0.5)
    factor = 2.0 ** rng.uniform(-1.0, 1.0) * 2.0 ** (warmth * np.array([1.0, 0.0, -1.0]))
    return [round(float(value), 3) for value in np.array(radiance) * factor]


def change(folder: Path, seed: int) -> None:
    """Rewrite materials.json, emitters.json and scene.npz of a capture that has not been rendered yet."""
    rng = np.random.default_rng(seed)
    table = json.loads((folder / "materials.json").read_text())
    emitters = json.loads((folder / "emitters.json").read_text())
    with np.load(folder / "scene.npz") as data:
        scene = {name: data[name] for name in data.files}
    emitting = set(np.unique(scene["material"][scene["is_emitter"].astype(bool)]).tolist())
    table["materials"] = [
        material if material["id"] in emitting else drawn_material(material, rng)
        for material in table["materials"]
    ]
    table["command"] += f"; other_materials.py --seed {seed}"
    for emitter in emitters:
        emitter["radiance"] = drawn_radiance(emitter["radiance"], rng)
        first, end = emitter["triangles"]
        scene["radiance"][first:end] = emitter["radiance"]
    (folder / "materials.json").write_text(json.dumps(table, indent=1) + "\n")
    (folder / "emitters.json").write_text(json.dumps(emitters, indent=1) + "\n")
    np.savez_compressed(folder / "scene.npz", **scene)


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, required=True)
    options = parser.parse_args()
    change(options.folder.resolve(), options.seed)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
