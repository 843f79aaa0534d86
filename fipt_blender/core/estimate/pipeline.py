"""The paper's algorithm (Sec. 4) as a list of stages.

Each stage is a pure function; its signature says what it takes and makes (:mod:`..run.chain`). Stages without
a text are quick, and made again where they are needed. What comes before, the room and the views, is
in :mod:`.input`; what comes after in :mod:`.results`.
"""

from __future__ import annotations

from collections.abc import Iterator

from ..run.chain import Stage
from .judge_stages import find_room_fields, judge_result
from .light_stages import (
    bake_shadings,
    find_presumed_lamps,
    infer_outside,
    light_outside,
    observe_pixels,
    refine_shadings,
)
from .material_stages import (
    estimate,
    find_emitter_units,
    find_fixtures,
    find_reflection,
    fit_closed_form,
    honour_hints,
)
from .pixel_stages import check_poses, divide_mixed_pixels, find_photometry, refit_photometry, trace_pixels
from .training_stages import open_fields, train_networks


def pipeline(
    rounds: int, encoded: bool, rerun: bool = False, light: bool = False, judged: bool = False
) -> list[Stage]:
    """The stages of an estimation in order; costs are relative to stage 1, as measured in drafts.

    Args:
        rounds: number of times that stage 3 and the closed form are repeated.
        encoded: whether some photographs are not HDR.
        rerun: whether closed form and training are repeated with hints that were given since.
        light: whether the shadings are refined with them, too.
        judged: whether photographs are held back.
    """
    first = [*_pixels(encoded), *_light(), *_rounds(rounds), *_training()]
    return [*first, *_hinted(rounds, rerun, light), *_judgement(judged)]


def _pixels(encoded: bool) -> Iterator[Stage]:
    """First hits, radiance and its check (supplementary)."""
    yield Stage("pixels", trace_pixels, "Tracing the photographs' pixels", 0.1)
    if encoded:
        yield Stage("photometry", find_photometry, "Finding the radiance of the photographs", 0.3)
    yield Stage("checks", check_poses, "Checking the photographs' poses and exposures", 0.4)
    yield Stage("unmixing", divide_mixed_pixels, "Dividing mixed pixels", 0.3, "pixels")
    if encoded:
        yield Stage("refit", refit_photometry, "Finding the radiance with the room's light", 0.8)


def _light() -> Iterator[Stage]:
    """Stage 1: shadings from the radiance cache (Sec. 4.2, Eq. 9)."""
    yield Stage("observed", observe_pixels, gives="observed")
    yield Stage("presumed", find_presumed_lamps, gives="lamps")
    yield Stage("outside", infer_outside, "Inferring the light from outside", 0.4, "environment")
    yield Stage("lit", light_outside, gives="observed")
    yield Stage("hints", honour_hints)
    yield Stage("shadings", bake_shadings, "Baking shadings from the photographs", 1.0, "shadings")


def _rounds(rounds: int) -> Iterator[Stage]:
    """Closed form (Eq. 5) and emitters (Sec. 4.4), then stage 3 (Sec. 4.3, Eq. 10 and 11), and again."""
    yield Stage("emitter-units", find_emitter_units, gives="emitter_units")
    for index in range(rounds + 1):
        text = f" (round {index} of {rounds})" if index else ""
        yield Stage(f"closed-form-{index}", fit_closed_form)
        yield Stage(f"estimate-{index}", estimate, f"Estimating materials and lamps{text}", 0.35)
        yield Stage(f"fixtures-{index}", find_fixtures)
        if index < rounds:
            number = index + 1
            before = f"refinement-{index}" if index else "shadings"
            text = f" (round {number} of {rounds})"
            yield from _refinement(f"-{number}", number, text, replaces=before)


def _refinement(suffix: str, number: int, text: str, prefix: str = "", replaces: str = "") -> Iterator[Stage]:
    """Stage 3 with the last estimate; of the shadings that it replaces the files are not kept."""
    yield Stage(f"{prefix}reflection{suffix}", find_reflection, f"Preparing light paths{text}", 0.2)
    name, takes = f"{prefix}refinement{suffix}", {"index": f"round_{number}"}
    yield Stage(name, refine_shadings, f"Refining shadings{text}", 2.9, "shadings", takes, replaces)


def _training() -> Iterator[Stage]:
    """Stage 2: BRDF and emission mask, once (Sec. 4.5, Eq. 12 to 20)."""
    yield Stage("training", train_networks, "Training materials", 1.6)
    yield Stage("fields", open_fields, gives="fields")


def _hinted(rounds: int, rerun: bool, light: bool) -> Iterator[Stage]:
    """What is repeated with hints that were given since; pixels stay as they are, and shadings may."""
    if not rerun:
        return
    before = {"units_before": "trained_units"}
    yield Stage("hinted-hints", honour_hints, takes={"hints": "hints_rerun"})
    if light:
        yield Stage("hinted-lamps-closed-form", fit_closed_form)
        yield Stage("hinted-lamps", estimate, "Finding lamps with the hints", 0.4, takes=before)
        yield Stage("hinted-fixtures", find_fixtures)
        yield from _refinement("", max(rounds, 1), " with the hints", prefix="hinted-")
    yield Stage("hinted-closed-form", fit_closed_form)
    text = "Estimating materials with the hints"
    yield Stage("hinted-estimate", estimate, text, 0.4, takes=before | {"lamps_before": "emitting"})
    yield Stage("hinted-lamps-found", find_fixtures)
    yield Stage("hinted-training", train_networks, "Training materials with the hints", 0.4)
    yield Stage("hinted-fields", open_fields, gives="fields")


def _judgement(judged: bool) -> Iterator[Stage]:
    """The estimate on all surfaces, and how good it is."""
    yield Stage("room-fields", find_room_fields, gives="room_fields")
    if judged:
        text = "Judging the result by photographs that were held back"
        yield Stage("quality", judge_result, text, 0.7, "quality")


def round_numbers(rounds: int) -> dict[str, int]:
    """The values that tell the stages of a round its number."""
    return {f"round_{index}": index for index in range(max(rounds, 1) + 1)}
