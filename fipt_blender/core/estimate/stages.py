# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's algorithm (Sec. 4) as a sequence of stages, each with a checkpoint.

    pixels          intersect the photographs' pixels with the mesh; check the views
    shadings        stage 1: bake the shadings from the radiance cache (Sec. 4.2, Eq. 9)
    estimate-0      closed-form estimate of the BRDF (Eq. 5); find the emitters (Sec. 4.4)
    refinement-i    stage 3: bake the shadings anew by path tracing (Sec. 4.3, Eq. 10 and 11)
    estimate-i      closed form and emitters with the refined shadings
    training        stage 2: fit BRDF and emission mask, once, and find the emitters (Sec. 4.5, Eq. 12 to 20)
    hinted-lamps, hinted-refinement
                    closed form, emitters and stage 3 again with hints that were given since, if wanted
    hinted-estimate, hinted-training
                    closed form and a short training again with these hints

Stage 3 and the closed form are repeated `rounds` times. A run that is resumed loads the stages that it has
finished. The computations are in `light/`, `checks/` and `material/`, the data that stages share in
:mod:`.state`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial

from ..run.checkpoints import (
    HINTED_ESTIMATE,
    HINTED_LAMPS,
    HINTED_REFINEMENT,
    HINTED_TRAINING,
    SHADINGS,
    DamagedStage,
    stage_names,
)
from ..run.errors import FiptError
from ..run.hints import Hint
from ..run.runfolder import explained_write_errors
from .light_stages import LightStages
from .material_stages import MaterialStages
from .previews import Preview
from .state import Facts

# Expected time of each kind of stage relative to stage 1, for the progress bar only.
_WEIGHTS = {
    "pixels": 0.5,
    "encoded-pixels": 1.2,
    "shadings": 1.0,
    "estimate": 0.3,
    "refinement": 1.6,
    "training": 1.2,
    "hinted": 0.4,
    HINTED_REFINEMENT: 1.2,
}


class Estimation(LightStages, MaterialStages):
    """One estimation on a run folder; arguments as of :class:`EstimationState`."""

    def run(self) -> None:
        """Do all stages that are not finished yet, and write the results.

        A finished stage whose files are damaged is discarded with a warning, and done again.
        """
        if self.checkpoints.problem:
            self._warn_of_damage(self.checkpoints.problem)
        finished = False
        while not finished:
            try:
                self._do_stages()
                finished = True
            except DamagedStage as damage:
                self._warn_of_damage(str(damage))
                self.checkpoints.discard(damage.stage)

    def _do_stages(self) -> None:
        rounds = self.settings.rounds
        self._shadings, self._units_before = SHADINGS, None  # after damage, all stages come by once more
        names = stage_names(rounds, self.told_again is not None, self.light_again)
        self.reporter.plan(_stage_weights(names, any(view.encoded for view in self.views)))
        with explained_write_errors(self.folder.stage):
            self._stage("pixels", "Tracing the photographs' pixels", self._trace, self._load_pixels)
            self._prepare()
            self._stage(
                "shadings",
                "Baking shadings from the photographs",
                self._bake,
                partial(self._load_shadings, "shadings"),
            )
            self._show("shadings")
            for index in range(rounds + 1):
                text = f" (round {index} of {rounds})" if index else ""
                if index:
                    self._stage(
                        f"refinement-{index}",
                        f"Refining shadings{text}",
                        partial(self._refine, f"refinement-{index}", index),
                        partial(self._load_shadings, f"refinement-{index}"),
                    )
                self._stage(
                    f"estimate-{index}",
                    f"Estimating materials and lamps{text}",
                    partial(self._estimate, f"estimate-{index}", index < rounds),
                    partial(self._resume_estimate, f"estimate-{index}"),
                )
                self._show(f"estimate-{index}")
            load = partial(self._load_networks, "training")
            self._stage("training", "Training materials", self._train, load)
            self._show("training")
            if self.told_again is not None:
                self._estimate_again(self.told_again)
            self._write_results()

    def _estimate_again(self, told: Sequence[Hint]) -> None:
        """Closed form and training again with these hints; pixels stay as they are, and shadings may."""
        self._units_before = self.units
        self._use_hints(told)
        if self.light_again:
            self._stage(
                HINTED_LAMPS,
                "Finding lamps with the hints",
                partial(self._estimate, HINTED_LAMPS, True),
                partial(self._resume_estimate, HINTED_LAMPS),
            )
            self._stage(
                HINTED_REFINEMENT,
                "Refining shadings with the hints",
                self._refine_again,
                self._load_shadings_again,
            )
        self._stage(
            HINTED_ESTIMATE,
            "Estimating materials with the hints",
            partial(self._estimate, HINTED_ESTIMATE, False),
            partial(self._resume_estimate, HINTED_ESTIMATE),
        )
        load = partial(self._load_networks, HINTED_TRAINING)
        self._stage(HINTED_TRAINING, "Training materials with the hints", self._train_again, load)
        self._show(HINTED_TRAINING)

    def _stage(self, name: str, text: str, work: Callable[[], Facts], load: Callable[[], None]) -> None:
        """Do one stage, or load the results of a finished one and repeat its warnings.

        Raises:
            DamagedStage: its results can't be loaded.
        """
        if self.checkpoints.done(name):
            try:
                load()
            except FiptError as error:
                if error.code != "file-damaged":
                    raise
                raise DamagedStage(name, error.text) from error
            self.reporter.skip()
            for warning in self.checkpoints.warnings(name):
                if warning not in self.reporter.warnings:  # after damage all stages come by once more
                    self.reporter.warning(**warning)
            return
        self.checkpoints.begin(name)
        self.reporter.stage(name, text)
        started, warned = time.monotonic(), len(self.reporter.warnings)
        facts = work()
        seconds = time.monotonic() - started
        facts["seconds"] = round(seconds, 2)
        if facts.get("rays") and seconds > 0.0:
            facts["mrays_per_second"] = round(facts["rays"] / seconds / 1e6, 3)
        self.checkpoints.mark(name, facts, self.reporter.warnings[warned:])

    def _show(self, name: str) -> None:
        """Send the window pictures of what a stage has found."""
        preview = Preview(self.folder.stage / "previews", self.pixels, self.room.triangle_object)
        paths = preview.existing(name)
        if not paths and name == "shadings":
            paths = preview.first_guess(name, self._open_shadings())
        elif not paths:
            colors = self._network_colors if name.endswith("training") else self._closed_form_colors
            paths = preview.estimate(name, colors, self._emitters()[0])
        relative = [path.relative_to(self.folder.root).as_posix() for path in paths]
        self.reporter.progress(1.0, force=True, pictures=relative)


def _stage_weights(names: Sequence[str], encoded: bool) -> list[float]:
    """Expected share of time of each stage, in no unit; for the progress bar.

    Args:
        names: of the stages.
        encoded: whether photographs are not HDR; their radiance is found in the stage `pixels`.
    """
    kinds = ("encoded-pixels" if encoded and name == "pixels" else name for name in names)
    return [_WEIGHTS.get(kind) or _WEIGHTS[kind.partition("-")[0]] for kind in kinds]
