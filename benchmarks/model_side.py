"""The fitted model in comparisons with Cycles: a separate process, since Mitsuba and bpy can't share one.

python model_side.py MASKING < IN.npz > OUT.npz. IN holds cosine (N,) and roughness (N,); OUT then holds the
integrals s0 and s1 over all light directions. With wi (N,3), wo (N,3), base_color (N,3) and metallic (N,)
it holds `value`, the BRDF times cosine (N,3). Directions are in the shading frame.
"""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

SAMPLES = 1 << 14


def ask(masking: str, **arrays: np.ndarray) -> dict[str, np.ndarray]:
    """Run this file in a child process on arrays; see the module's docstring."""
    sent = io.BytesIO()
    np.savez(sent, **arrays)
    command = [sys.executable, __file__, masking]
    answer = subprocess.run(command, input=sent.getvalue(), capture_output=True, check=False)
    if answer.returncode:
        raise RuntimeError(answer.stderr.decode(errors="replace"))
    with np.load(io.BytesIO(answer.stdout), allow_pickle=False) as results:
        return {name: results[name] for name in results.files}


def lobe_integrals(cosine: np.ndarray, roughness: np.ndarray) -> dict[str, np.ndarray]:
    """s0 and s1 (N,) by importance sampling with a low-discrepancy sequence (R2)."""
    import drjit as dr
    import mitsuba as mi

    from fipt_blender.core.optics import brdf

    index = np.arange(SAMPLES) + 0.5
    u = mi.Point2f(mi.Float(index * 0.7548776662466927 % 1.0), mi.Float(index * 0.5698402909980532 % 1.0))
    results: dict[str, list[float]] = {"s0": [], "s1": []}
    for one, sigma in zip(cosine, roughness, strict=True):
        c, r = dr.opaque(mi.Float, float(one)), dr.opaque(mi.Float, float(sigma))
        wo = mi.Vector3f(dr.safe_sqrt(1.0 - c * c), 0.0, c) + dr.zeros(mi.Vector3f, SAMPLES)
        r = r + dr.zeros(mi.Float, SAMPLES)
        wi = brdf.sample_visible_normal(u, wo, r)
        density = brdf.visible_normal_pdf(wi, wo, r)
        lobes = brdf.specular_lobes(wi, wo, r)
        means = [dr.mean(dr.select(density > 0.0, lobe / density, 0.0)) for lobe in lobes]
        dr.eval(means)
        for name, mean in zip(results, means, strict=True):
            results[name].append(float(mean[0]))
    return {name: np.array(values) for name, values in results.items()}


def reflected(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The BRDF times the cosine of the light direction."""
    import mitsuba as mi

    from fipt_blender.core.optics import brdf

    def vector(name: str, kind: Any) -> Any:
        return kind(np.ascontiguousarray(arrays[name].T.astype(np.float32)))

    scalars = [mi.Float(arrays[name].astype(np.float32)) for name in ("roughness", "metallic")]
    value = brdf.evaluate(
        vector("wi", mi.Vector3f), vector("wo", mi.Vector3f), vector("base_color", mi.Color3f), *scalars
    )
    return {"value": np.array(value).T}


def main() -> None:
    """Compute what the arrays on stdin ask for."""
    from fipt_blender.core.device.variant import set_variant

    with np.load(io.BytesIO(sys.stdin.buffer.read()), allow_pickle=False) as given:
        arrays = {name: given[name] for name in given.files}
    set_variant("llvm")
    from fipt_blender.core.optics import brdf

    brdf.set_masking(sys.argv[1])
    results = reflected(arrays) if "wi" in arrays else lobe_integrals(arrays["cosine"], arrays["roughness"])
    answer = io.BytesIO()
    np.savez(answer, **results)
    sys.stdout.buffer.write(answer.getvalue())


if __name__ == "__main__":
    main()
