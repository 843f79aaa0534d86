"""Figures of a finished run for the scoreboard, in its own process: score_run.py RUN JSON [--truth DIR]."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import accuracy
from fipt_blender.core.run.runfolder import RunFolder, write_json

LIKELY, CERTAIN = 0.5, 0.95  # probabilities from which fixtures count
SPP = 32  # of renders, denoised
METRICS = ("kd_psnr", "a_prime_psnr", "sigma_psnr", "metallic_psnr")


def score(folder: Path, truth: Path | None) -> dict[str, float]:
    """Figures of a finished run."""
    from fipt_blender.core.device.variant import set_variant
    from fipt_blender.core.run.documents import read_document
    from fipt_blender.core.run.result_contents import Emitters

    run, figures = RunFolder(folder), {}
    set_variant(run.read().device)  # before Mitsuba is imported
    from benchmarks import lamps

    if run.quality_json.exists():  # where photographs were held back
        quality = read_document(run.quality_json, dict)
        figures |= {"judged_db": quality["held_back_db"], "projection_db": quality["projection_db"]}
    fixtures = read_document(run.emitters_json, Emitters)
    figures["inferred"] = sum(lamp.inferred for lamp in fixtures.missing)
    for level, suffix in ((LIKELY, "50"), (CERTAIN, "95")):
        if truth is not None:
            count = lamps.lamps_of_run(run, truth, level)
            figures |= {
                f"true_{suffix}": count.true,
                f"false_{suffix}": count.false,
                f"missed_{suffix}": count.lost,
            }
    figures |= against_photographs(run)
    if run.quality_json.exists() and quality["projection_on_mesh_db"] is not None:
        figures["gap_db"] = quality["projection_on_mesh_db"] - figures["cycles_on_mesh_db"]
    if truth is not None:
        figures |= against_truth(run, truth)
    return figures


def against_photographs(run: RunFolder) -> dict[str, float]:
    """PSNR of held-back photographs against Cycles renders of the .blend, in display values.

    Those of the judge, with one factor of exposure, and those that Blender displays.
    """
    from fipt_blender.core.capture.encoded import srgb_decoded
    from fipt_blender.core.capture.images import read_radiance
    from fipt_blender.core.capture.views import load_capture
    from fipt_blender.core.checks.quality import GAMMA, Display, judged_photograph, judged_views
    from fipt_blender.core.pixels.store import trace_view
    from fipt_blender.core.run.documents import read_document
    from fipt_blender.core.surface.room import load_room

    capture, room = load_capture(run), load_room(run)
    statistics = read_document(run.statistics_json, dict)
    facts = statistics.get("photometry") or {}
    scale = float(statistics["radiance_scale"])
    chosen = judged_views(capture.held_back)
    area = float(np.median([view.width * view.height for view in capture.train]))
    judged = [judged_photograph(view, area, scale) for view in chosen]
    if not judged:
        return {}
    widths = {view.name: sized.width for view, (sized, _, _) in zip(chosen, judged, strict=True)}
    images = accuracy.cycles_renders(run, {"rerender": widths, "relight": None}, SPP)
    errors: dict[str, list[np.ndarray]] = {"cycles_db": [], "cycles_on_mesh_db": [], "displayed_db": []}
    hits, pixels = 0, 0
    for full, (view, photograph, used) in zip(chosen, judged, strict=True):
        path = images["rerender", full.name]
        image = read_radiance(path) / scale
        display = Display.of(view, facts)
        shown = display.shown(image, view, display.factor(photograph, image, view))
        squared = (shown - photograph) ** 2
        hit = (np.asarray(trace_view(room, view).triangle) >= 0).reshape(used.shape) & used
        errors["cycles_db"].append(squared[used])
        errors["cycles_on_mesh_db"].append(squared[hit])
        with Image.open(path.with_suffix(".png")) as picture:
            displayed = np.asarray(picture.convert("RGB")) / 255.0
        if not view.encoded:  # in the judge's display values
            displayed = srgb_decoded(displayed) ** GAMMA
        errors["displayed_db"].append(((displayed - photograph) ** 2)[used])
        hits, pixels = hits + int(hit.sum()), pixels + int(used.sum())
    figures = {
        name: float(-10.0 * np.log10(max(float(np.concatenate(each).mean()), 1e-10)))
        for name, each in errors.items()
    }
    return {**figures, "on_mesh_share": hits / max(pixels, 1)}


def against_truth(run: RunFolder, capture: Path) -> dict[str, float | None]:
    """kd, a', sigma, metallic and relit PSNR of the held-back views that have true maps.

    Args:
        capture: with them, at their own size; the run's photographs may be smaller ones of some of them
            (then nothing is relit), or those of another camera.
    """
    from benchmarks import metrics, predict, truth
    from benchmarks.tracer.forward import RenderSettings, render_view
    from fipt_blender.core.capture.images import read_radiance
    from fipt_blender.core.capture.views import load_capture

    loaded = load_capture(run)
    views = []
    for view in loaded.held_back:
        image = (capture / "val" / "Image" / view.image.name).with_suffix(".exr")
        height, width = read_radiance(image).shape[:2]
        views.append(replace(view.resized(width, height), image=image))
    true = [truth.read_maps(view) for view in views]
    lit, table = predict.load_result(run)
    filtered = truth.maps_are_filtered(true)
    predicted = [predict.predict_maps(lit, view, filtered) for view in views]
    found = dict(metrics.map_metrics(predicted, true, strict=False))
    figures = {name: found[name] for name in METRICS}
    whole = len(views) == len(list((capture / "val" / "Image").iterdir()))
    relight = truth.read_relight(capture, loaded) if whole else None
    if relight is not None:
        dark = predict.relit(lit, table, relight)
        settings = RenderSettings(spp=SPP)
        images = [render_view(dark, view, settings, stream) for stream, view in enumerate(relight.views)]
        truths = [read_radiance(view.image) for view in relight.views]
        figures["relight_psnr"] = metrics.mean_image_psnr(images, truths)
    return figures


def main() -> None:
    """Write the figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("run", type=Path, metavar="RUN")
    parser.add_argument("json", type=Path, metavar="JSON")
    parser.add_argument("--truth", type=Path, metavar="CAPTURE", help="with the truth of its held-back views")
    arguments = parser.parse_args()
    write_json(arguments.json, score(arguments.run, arguments.truth))


if __name__ == "__main__":
    main()
