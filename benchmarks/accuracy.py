"""python3 dev.py accuracy CAPTURE: run the main job on a capture with ground truth and score the result.

The capture has the FIPT authors' synthetic layout (benchmarks/truth.py). Prints one table, the paper's
protocol and the stricter one (benchmarks/metrics.py), for training and for held-back views.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import cycles_views, disturb, ldr, metrics, picture_page, results, truth
from fipt_blender.core.capture.images import read_radiance, write_exr
from fipt_blender.core.capture.views import View, load_capture
from fipt_blender.core.device.variant import set_variant
from fipt_blender.core.run.documents import read_document
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.messages import parse_message
from fipt_blender.core.run.runfolder import PRODUCT_VERSION, RunFolder, write_json

ROOT = Path(__file__).resolve().parent.parent
SPLITS = ("training", "held_back")
COLUMNS = ("paper", "strict", "edge", "inside")
IMAGE_METRICS = ("view_synthesis_psnr", "relight_psnr")
METRICS = (
    "kd_psnr",
    "a_prime_psnr",
    "sigma_psnr",
    "metallic_psnr",
    "emission_iou",
    "emission_log_l2",
    *IMAGE_METRICS,
    "view_synthesis_cycles_psnr",
    "relight_cycles_psnr",
)


def make_parser() -> argparse.ArgumentParser:
    """The command's options."""
    parser = argparse.ArgumentParser(prog="dev.py accuracy", description=(__doc__ or "").partition("\n")[0])
    add = parser.add_argument
    add("capture", type=Path, metavar="CAPTURE", help="capture with ground truth")
    add("--preset", default="medium", help="draft, medium or high (default: medium)")
    add("--set", action="append", default=[], metavar="NAME=VALUE", help="change one setting of the run")
    add(
        "--parts",
        default="auto",
        help="what tells materials apart: masks, semantics, none, ... (as estimate)",
    )
    add("--mesh-scan", type=float, metavar="VOXEL", help="replace the mesh by a scan of it, voxels in meters")
    add("--scan", action="append", default=[], metavar="OPTION", help="more options of benchmarks/scan.py")
    add("--mesh-noise", type=float, default=0.0, metavar="SIGMA", help="disturb the mesh, in its own units")
    add("--resume", action="store_true", help="keep what an earlier run in the same folder finished")
    add("--output", type=Path, metavar="RUN", help="run folder to make (default: below out/accuracy)")
    add("--reuse", type=Path, metavar="RUN", help="score this finished run instead of making one")
    add("--json", type=Path, metavar="FILE", help="write all figures there")
    add("--maps", type=Path, metavar="DIR", help="write predicted maps and images in the capture's layout")
    add("--page", type=Path, metavar="DIR", help="write the picture page there (default: RUN/accuracy)")
    add("--bounds", type=Path, metavar="FILE", help="fail where a figure leaves the bounds in this file")
    add("--skip-cycles", action="store_true", help="leave out the renders in Cycles")
    add("--spp", type=int, default=128, help="paths a pixel of the renders, denoised (default: 128)")
    add("--train-views", type=int, default=16, help="training views whose maps count (default: 16)")
    add("--train-renders", type=int, default=4, help="training views that are rendered (default: 4)")
    return parser


def main(argv: Sequence[str]) -> int:
    """Run the command; 0, 1 for a failure or a figure out of bounds."""
    arguments = make_parser().parse_args(list(argv))
    try:
        default = ROOT / "out" / "accuracy" / f"{arguments.capture.absolute().name}-{arguments.preset}"
        return evaluate(arguments, arguments.reuse or arguments.output or default)
    except FiptError as error:
        print(f"error: {error.text} {error.remedy}", file=sys.stderr)
        return 1


def evaluate(arguments: argparse.Namespace, folder: Path) -> int:
    """Make the run where asked to, score it and write what is wanted."""
    figures: dict[str, Any] = {}
    if not arguments.reuse:
        figures = run_main_job(
            arguments.capture, folder, arguments.preset, main_job_options(arguments, folder)
        )
    run = RunFolder(folder)
    figures = {**recorded_costs(run), **figures}
    page = picture_page.PicturePage(arguments.page or run.root / "accuracy")
    scope = Scope(
        arguments.capture, arguments.spp, arguments.train_views, arguments.train_renders, arguments.maps
    )
    scored = score(run, scope, page)
    result = scored.figures
    if not arguments.skip_cycles:
        score_cycles(run, arguments.spp, scored)
    page.write(result)
    result |= figures
    result["camera"] = ldr.camera_errors(run, arguments.capture)
    import mitsuba  # its variant is set by now

    settings = run.read()
    result |= {"version": PRODUCT_VERSION, "settings": asdict(settings), "spp": arguments.spp}
    command = ["python3", "dev.py", "accuracy", *sys.argv[1:]]
    result["measured"] = results.provenance(arguments.capture.name, settings.seed, mitsuba.variant(), command)
    print(format_table(result))
    print(f"pictures: {(arguments.page or run.root / 'accuracy') / 'index.html'}")
    if arguments.json:
        write_json(arguments.json.absolute(), result)
    broken = out_of_bounds(result, read_document(arguments.bounds, dict)) if arguments.bounds else []
    for line in broken:
        print(f"out of bounds: {line}", file=sys.stderr)
    return 1 if broken else 0


def main_job_options(arguments: argparse.Namespace, output: Path) -> list[str]:
    """Options of the product's command line beside capture, output and preset; makes a disturbed mesh.

    Raises:
        FiptError: ``truth-missing`` where there is no mesh to disturb.
    """
    options = ["--parts", arguments.parts]
    for change in arguments.set:
        options += ["--set", change]
    if arguments.resume:
        options.append("--resume")
    if arguments.mesh_scan is not None:
        mesh = output.absolute().with_name(f"{output.name}-scan.ply")
        scan_capture(arguments.capture, mesh, ["--voxel", str(arguments.mesh_scan), *arguments.scan])
        options += ["--mesh", str(mesh)]
    if arguments.mesh_noise > 0.0:
        source = arguments.capture / "scene.obj"
        if not source.is_file():
            raise FiptError.of("truth-missing", f"{source} does not exist.", "Only an OBJ can be disturbed.")
        mesh = output.with_name(f"{output.name}-mesh.obj")
        mesh.parent.mkdir(parents=True, exist_ok=True)
        disturb.disturb_obj(source, mesh, arguments.mesh_noise)
        options += ["--mesh", str(mesh)]
    return options


def scan_capture(capture: Path, mesh: Path, options: Sequence[str]) -> None:
    """Write the mesh that a scan of a capture's room gives; in a process of its own, as it needs Mitsuba.

    Raises:
        FiptError: ``run-failed``.
    """
    mesh.parent.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, str(ROOT / "benchmarks" / "scan.py"), str(capture), "--output", str(mesh)]
    if subprocess.run([*command, *options], check=False).returncode:
        raise FiptError.of("run-failed", "The room could not be scanned.", "Mend what is reported above.")


def run_main_job(capture: Path, output: Path, preset: str, options: Sequence[str]) -> dict[str, Any]:
    """Run the product's own command line.

    Returns:
        Wall seconds, those that it announced first, and peak memory of its engine.

    Args:
        options: more of them.

    Raises:
        FiptError: ``run-failed``; the reason is on stderr.
    """
    command = [sys.executable, str(ROOT / "fipt_blender" / "__main__.py"), "estimate", str(capture)]
    command += ["--output", str(output), "--preset", preset, "--no-renders", "--json", *options]
    started, memory, shown, announced = time.monotonic(), 0.0, -1, None
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        for line in process.stdout or ():
            message = parse_message(line)
            if message is None:
                continue
            if message["type"] == "stage":
                print(f"{time.monotonic() - started:6.0f} s  {message['text']}", file=sys.stderr, flush=True)
            if message["type"] == "progress":
                memory = max(memory, float(message["memory_gb"]))
                if announced is None and message.get("remaining_seconds") is not None:
                    announced = time.monotonic() - started + float(message["remaining_seconds"])
                if int(message["fraction"] * 20) > shown:
                    shown = int(message["fraction"] * 20)
                    print(f"{100 * message['fraction']:3.0f} %", file=sys.stderr, flush=True)
    if process.returncode:
        raise FiptError.of("run-failed", "The main job failed.", "Mend what it reports above.")
    seconds = round(time.monotonic() - started, 1)
    return {"seconds": seconds, "announced": announced, "peak_memory_gb": memory}


def recorded_costs(run: RunFolder) -> dict[str, Any]:
    """Seconds by step, and what the engine counted, from a run's own records."""
    costs: dict[str, Any] = {"seconds": None, "peak_memory_gb": None}
    if run.job_json.exists():
        seconds = read_document(run.job_json, dict)["seconds"]
        costs |= {"seconds": round(sum(seconds.values()), 1), "step_seconds": seconds}
    if run.statistics_json.exists():
        costs["statistics"] = read_document(run.statistics_json, dict)
        costs["peak_memory_gb"] = costs["statistics"].get("peak_memory_gb")
    return costs


@dataclass(frozen=True)
class Scope:
    """What of a run is scored.

    Attributes:
        capture: with ground truth.
        spp: paths a pixel of the renders.
        train_views: training views whose maps count.
        train_renders: training views that are rendered.
        maps: folder for predicted maps and images in the capture's layout, or None.
    """

    capture: Path
    spp: int = 128
    train_views: int = 16
    train_renders: int = 4
    maps: Path | None = None


@dataclass(frozen=True)
class Scored:
    """Figures by split, and the views that were rendered for them."""

    figures: dict[str, Any]
    rendered: dict[str, list[View]]
    relight: truth.Relight | None


def score(run: RunFolder, scope: Scope, page: picture_page.PicturePage) -> Scored:
    """All figures of an estimate but those of Cycles; adds pictures to the page and writes maps on the way.

    Args:
        run: needs nothing but its input and `results/`.

    Raises:
        FiptError: ``truth-missing``, ``results-missing``.
    """
    # Mitsuba, torch: not before the main job's own processes are gone, and the variant is chosen.
    set_variant(run.read().device)
    from benchmarks import predict
    from benchmarks.tracer.forward import RenderSettings, render_view

    capture = load_capture(run)
    relight = truth.read_relight(scope.capture, capture)
    chosen = {"training": spread(capture.train, scope.train_views), "held_back": capture.held_back}
    rendered = {"training": spread(capture.train, scope.train_renders), "held_back": capture.held_back}
    lit, table = predict.load_result(run)
    shining = predict.with_inferred_lamps(lit, table, run)
    settings = RenderSettings(spp=scope.spp)
    result: dict[str, Any] = {}
    for split in SPLITS:
        true = [truth.read_maps(view) for view in chosen[split]]
        filtered = truth.maps_are_filtered(true)
        predicted = [predict.predict_maps(lit, view, filtered) for view in chosen[split]]
        predicted = ldr.in_true_units(predicted, run, scope.capture)
        figures: dict[str, Any] = dict.fromkeys(METRICS)
        strict: dict[str, Any] = dict.fromkeys(METRICS)
        borders: dict[str, Any] = {"edge": {}, "inside": {}, "edge_share": None}
        if true:
            figures |= metrics.map_metrics(predicted, true, strict=False)
            strict |= metrics.map_metrics(predicted, true, strict=True)
            borders = metrics.border_metrics(predicted, true)
        images = [render_view(shining, view, settings, stream) for stream, view in enumerate(rendered[split])]
        images = ldr.as_photographed(images, run, rendered[split])
        truths = [view.radiance() for view in rendered[split]]
        enter(figures, strict, "view_synthesis_psnr", images, truths)
        result[split] = {**figures, "strict": strict, **borders, "maps_are_filtered": filtered}
        result[split] |= {"views": len(true), "rendered_views": len(images)}
        if split == "held_back":
            result[split]["confidence"] = predict.confidence_table(run, chosen[split], true) if true else []
            for view, one, other in zip(chosen[split], predicted, true, strict=True):
                page.add_maps(view.name, one, other)
                if scope.maps:
                    truth.write_maps(scope.maps, view, one)
            for view, image, other in zip(rendered[split], images, truths, strict=True):
                page.add_images(view.name, "Photograph, re-render", image, other)
                if scope.maps:
                    folder = scope.maps / truth.split_folder(view).name / "Image"
                    write_exr(folder / truth.file_names(view)[0], image)
    if relight is not None:
        dark = predict.relit(lit, table, relight)
        images = [render_view(dark, view, settings, stream) for stream, view in enumerate(relight.views)]
        truths = [read_radiance(view.image) for view in relight.views]
        enter(result["held_back"], result["held_back"]["strict"], "relight_psnr", images, truths)
        for view, image, other in zip(relight.views, images, truths, strict=True):
            page.add_images(view.name, "Relit", image, other)
            if scope.maps:
                write_exr(scope.maps / "relight" / view.image.name, image)
    return Scored(result, rendered, relight)


def enter(
    figures: dict[str, Any], strict: dict[str, Any], name: str, images: Sequence[Any], truths: Sequence[Any]
) -> None:
    """Put the mean PSNR of rendered images into both protocols' figures."""
    figures[name] = metrics.mean_image_psnr(images, truths)
    strict[name] = metrics.mean_image_psnr(images, truths, strict=True)


def spread(views: Sequence[View], count: int) -> list[View]:
    """At most `count` views, evenly spread over the list."""
    if count >= len(views):
        return list(views)
    return [views[i * len(views) // count] for i in range(count)]


def score_cycles(run: RunFolder, spp: int, scored: Scored) -> None:
    """Render the same views in Cycles in a process of its own and enter their PSNRs.

    Raises:
        FiptError: ``run-failed`` where Blender fails.
    """
    result, rendered, relight = scored.figures, scored.rendered, scored.relight
    names = [view.name for split in SPLITS for view in rendered[split]]
    wanted: dict[str, Any] = {"rerender": dict.fromkeys(names), "relight": None}
    if relight is not None and len(relight.vertices) == 4:
        wanted["relight"] = {
            "views": [view.name for view in relight.views],
            "vertices": relight.vertices.tolist(),
            "radiance": relight.radiance.tolist(),
        }
    images = cycles_renders(run, wanted, spp)
    for split in SPLITS:
        found = [read_radiance(images["rerender", view.name]) for view in rendered[split]]
        truths = [view.radiance() for view in rendered[split]]
        enter(result[split], result[split]["strict"], "view_synthesis_cycles_psnr", found, truths)
    if wanted["relight"] is not None and relight is not None:
        found = [read_radiance(images["relight", view.name]) for view in relight.views]
        truths = [read_radiance(view.image) for view in relight.views]
        figures = result["held_back"]
        enter(figures, figures["strict"], "relight_cycles_psnr", found, truths)


def cycles_renders(run: RunFolder, wanted: dict[str, Any], spp: int) -> dict[tuple[str, str], Path]:
    """Render views of a run's .blend in Cycles, in a process of its own; the images by kind and view.

    Args:
        wanted: what `cycles_views` reads.

    Raises:
        FiptError: ``run-failed`` where Blender fails.
    """
    command = [sys.executable, str(ROOT / "benchmarks" / "cycles_views.py"), str(run.root), str(spp)]
    print("rendering in Cycles", file=sys.stderr, flush=True)
    with open(run.log, "ab") as log:  # Blender tells a lot
        text = json.dumps(wanted).encode()
        ended = subprocess.run(command, input=text, stdout=log, stderr=log, check=False)
    if ended.returncode:
        raise FiptError.of("run-failed", "The renders in Cycles failed.", f"Mend what {run.log} reports.")
    listed = read_document(cycles_views.apart(RunFolder(run.root)).renders_json, dict)["renders"]
    return {(entry["kind"], entry["view"]): run.resolve(entry["image"]) for entry in listed}


def format_table(result: dict[str, Any]) -> str:
    """The figures as text: for each split both protocols, and pixels near borders and away from them."""
    cells = [["", *(f"{split.replace('_', ' ')} {column}" for split in SPLITS for column in COLUMNS)]]
    for name in METRICS:
        digits = ".2e" if name.endswith("log_l2") else ".3f" if name.endswith("iou") else ".2f"
        groups = [
            result[split] if key == "paper" else result[split][key] for split in SPLITS for key in COLUMNS
        ]
        values = [group.get(name) for group in groups]
        cells.append([name, *("-" if value is None else f"{value:{digits}}" for value in values)])
    for split in SPLITS:
        share = result[split]["edge_share"]
        cells.append([f"pixels near borders, {split}", "-" if share is None else f"{share:.3f}"])
    cells += [[name, str(result.get(name))] for name in ("seconds", "peak_memory_gb", "version", "spp")]
    return "\n".join(f"{row[0]:30s}" + "".join(f"{cell:>18s}" for cell in row[1:]) for row in cells)


def out_of_bounds(result: dict[str, Any], bounds: dict[str, Any]) -> list[str]:
    """What violates bounds of the form {"held_back": {"kd_psnr": [lowest or null, highest or null]}}.

    A figure that is missing violates its bounds; bounds on "seconds" stand at the top level.
    """
    broken = []
    for group, entries in bounds.items():
        named = entries.items() if isinstance(entries, dict) else [("", entries)]
        for name, (low, high) in named:
            value = result.get(group, {}).get(name) if name else result.get(group)
            label = f"{group} {name}".strip()
            if value is None:
                broken.append(f"{label} is missing")
            elif (low is not None and value < low) or (high is not None and value > high):
                broken.append(f"{label} is {value:.4g}, allowed is {low} to {high}")
    return broken


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
