# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How well a run of a real room, of which no ground truth exists, re-renders the photographs held back.

    python benchmarks/held_back.py RUN [--spp 48] [--pictures DIR]

Each render is compared after one factor for each channel, as the exposure of a photograph that the estimation
did not see is unknown; photographs that are not HDR in the camera's values.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import ldr, metrics
from fipt_blender.core.capture.encoded import srgb_encoded
from fipt_blender.core.capture.views import load_capture
from fipt_blender.core.device.variant import set_variant
from fipt_blender.core.run.runfolder import RunFolder


def exposed(image: np.ndarray, photograph: np.ndarray) -> np.ndarray:
    """A render (H, W, 3) with the factor of each channel that brings its median to the photograph's."""
    good = (image > 0.0).all(axis=-1) & (photograph > 0.0).all(axis=-1)
    if not good.any():
        return image
    return image * np.exp(np.median(np.log(photograph[good] / image[good]), axis=0))


def main(argv: Sequence[str]) -> int:
    """Print the PSNR of each view, over all pixels and over those that see the mesh."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("run", type=Path, metavar="RUN", help="finished run with held-back views")
    parser.add_argument("--spp", type=int, default=48, help="paths a pixel, denoised (default: 48)")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="write photograph and render there")
    arguments = parser.parse_args(list(argv))
    run = RunFolder(arguments.run)
    set_variant(run.read().device)
    from benchmarks import predict
    from benchmarks.tracer.forward import RenderSettings, render_view
    from fipt_blender.core.pixels.camera_rays import trace_pixels

    views = load_capture(run).held_back
    lit, _ = predict.load_result(run)
    found: list[tuple[float, float, float]] = []
    for stream, view in enumerate(views):
        photograph = view.radiance()
        image = render_view(lit, view, RenderSettings(spp=arguments.spp), stream)
        image = ldr.as_photographed([image], run, [view])[0] if view.encoded else exposed(image, photograph)
        squared = (metrics.tone_mapped(image) - metrics.tone_mapped(photograph)) ** 2
        hit = np.array(trace_pixels(lit.room, view).valid).reshape(squared.shape[:2])
        both = [metrics.psnr(float(part.mean())) for part in (squared, squared[hit])]
        found.append((*both, float(hit.mean())))
        print(f"{view.name}: {both[0]:.2f} dB, {both[1]:.2f} where the mesh is ({100 * hit.mean():.0f} %)")
        if arguments.pictures:
            arguments.pictures.mkdir(parents=True, exist_ok=True)
            beside = np.clip(np.concatenate([photograph, image], axis=1), 0.0, 1.0)
            name = view.name.replace("/", "_")
            Image.fromarray(np.round(255.0 * srgb_encoded(beside)).astype(np.uint8)).save(
                arguments.pictures / f"{name}.png"
            )
    means = np.mean(found, axis=0)
    print(f"mean of {len(found)} views: {means[0]:.2f} dB, {means[1]:.2f} where the mesh is")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
