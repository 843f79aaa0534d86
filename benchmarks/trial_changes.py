"""What benchmarks/trial.py changes: mechanisms, steps of the paper, and tuned numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from benchmarks.constants import CORE, Constant, all_constants
from benchmarks.trial_captures import JPEG, MASKS, SCAN
from benchmarks.trial_run import BAKED, COMPLETED
from fipt_blender.core.run.declared import declared
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.settings import Settings, make_settings
from fipt_blender.core.run.stage_settings import TextureSettings

FACTORS = (0.5, 2.0)
SETTINGS = "settings"
BASE = ""  # the method as it is
SEED = "seed"  # and a number: another one
# Rooms whose numbers have an effect after the shadings alone, and those of which only the mesh's are before.
AFTER_SHADINGS, AFTER_MESH = ("material", "estimate"), ("light", "radiometry", "optics")


@dataclass(frozen=True)
class Mechanism:
    """Something that the paper does not have.

    Attributes:
        text: what it does.
        modules: files below core/ that only it needs.
        off: settings without it.
        needs: of a capture: SCAN, JPEG, MASKS (of any kind), or the kind of masks.
    """

    text: str
    modules: tuple[str, ...]
    off: Mapping[str, Any]
    needs: tuple[str, ...] = ()


_SURFACE = ("clean", "planes", "normals", "patches")
_TABLE = (
    # name, what it does, modules that only it needs, settings without it, what a capture must have
    (
        "clean_scan",
        "a scan is cleaned, and not trusted as a modelled mesh is",
        [f"surface/{name}" for name in _SURFACE],
        {"clean_scan": False},
        (SCAN,),
    ),
    ("closing", "small holes are closed", ["surface/closing"], {"close_holes_edges": 0}, (SCAN,)),
    ("panes", "panes in flat holes", ["surface/holes"], {}, (SCAN,)),
    (
        "lost_surfaces",
        "lost things by colors",
        ["completion/lost_surfaces", "checks/agreement"],
        {},
        (SCAN,),
    ),
    (
        "torn_parts",
        "torn parts are completed",
        ["completion/torn_parts", "completion/shapes"],
        {},
        (SCAN,),
    ),
    ("outlines", "outlines of parts", ["parts/outlines", "parts/outline_misses"], {}, (SCAN, MASKS)),
    ("unmix", "mixed pixels are used", ["pixels/unmixing", "pixels/fragments"], {}, ()),
    ("reject_views", "misaligned views are left out", ["checks/registration"], {}, ()),
    ("correct_exposure", "unlike exposures are corrected", [], {}, ()),
    (
        "clipped_lamps",
        "clipped lamps by the light that they cast",
        ["photometry/clipped_surfaces", "light/clipped"],
        {},
        (JPEG,),
    ),
    ("refit_photographs", "codes again with baked light", ["photometry/refit"], {}, (JPEG,)),
    ("unseen_light", "light from unseen directions", ["light/unseen_light"], {}, ()),
    ("presumed_lamps", "presumed lamps in stage 1", [], {}, ()),
    ("denoise_specular", "denoised specular shadings", [], {}, ()),
    ("shrink_detail", "detail as far as it is reliable", ["material/reliability"], {}, ()),
    ("lamp_doubt", "errors of the light of uncertain lamps", ["light/lamp_doubt"], {}, ()),
)
MECHANISMS = {
    name: Mechanism(text, tuple(modules), off or {name: False}, needs)
    for name, text, modules, off, needs in _TABLE
}
# The paper's own steps and choices without which it has ablations (docs/method.md).
ABLATIONS: dict[str, dict[str, Any]] = {
    "no-stage-3": {"rounds": 0},
    "no-cache": {"refine_cache": False},
    "fewer-views": {"view_share": 0.3},
    "cycles-g": {"masking": "smith"},
}


@dataclass(frozen=True)
class Change:
    """How a run differs from the method as it is.

    Attributes:
        name: of the mechanism that is off, or "module.NAME*factor".
        settings: that differ. constants: by "module.NAME".
        needs: of a capture.
        begins: folder of what the capture's first run has left with which it begins, "" for its input alone.
    """

    name: str = BASE
    settings: Mapping[str, Any] = field(default_factory=dict)
    constants: Mapping[str, float] = field(default_factory=dict)
    needs: tuple[str, ...] = ()
    begins: str = BAKED


_MESH_SETTINGS = ("clean_scan", "close_holes_edges")
_COMPLETION_SETTINGS = ("panes", "lost_surfaces", "torn_parts", "outlines")


def without(name: str) -> Change:
    """A mechanism off, an ablation, or ``seed1``: the method with another seed.

    Raises:
        FiptError: ``trial-unknown``.
    """
    if name.startswith(SEED):
        return Change(name, {"seed": int(name.removeprefix(SEED) or 1)}, begins=COMPLETED)
    if name in ABLATIONS:
        return Change(name, ABLATIONS[name], begins="" if "view_share" in ABLATIONS[name] else BAKED)
    if name not in MECHANISMS:
        raise FiptError.of("trial-unknown", f"There is no mechanism {name}.", "See --list.")
    mechanism = MECHANISMS[name]
    begins = BAKED
    if any(key in _COMPLETION_SETTINGS for key in mechanism.off):
        begins = COMPLETED
    if any(key in _MESH_SETTINGS for key in mechanism.off):
        begins = ""
    return Change(name, mechanism.off, {}, mechanism.needs, begins)


def scaled(constant: Constant, factor: float) -> Change:
    """A number times a factor."""
    value = constant.scaled(factor)
    if constant.module == SETTINGS:
        begins = "" if constant.name in _MESH_SETTINGS else BAKED
        return Change(f"{constant.key}*{factor:g}", {constant.name: value}, begins=begins)
    room = constant.module.partition(".")[0]
    begins = BAKED if room in AFTER_SHADINGS else COMPLETED if room in AFTER_MESH else ""
    return Change(f"{constant.key}*{factor:g}", {}, {constant.key: value}, (), begins)


def all_numbers(preset: str = "draft") -> list[Constant]:
    """The settings of a preset that are numbers and decide something, and the engine's constants."""
    settings = make_settings(preset)
    unread = {"seed", "rounds", *(item.name for item in fields(TextureSettings))}
    found = [
        Constant(SETTINGS, item.name, getattr(settings, item.name), item.option.text)
        for item in declared(Settings).values()
        if item.kind in (int, float) and item.option.keyed and item.name not in unread
    ]
    return found + all_constants()


def changes_of(off: str, numbers: str, preset: str) -> list[Change]:
    """The changes that two options name.

    Raises:
        FiptError: ``trial-unknown``.
    """
    names = list(MECHANISMS) if off == "all" else [name for name in off.split(",") if name]
    changes = [without(name) for name in names]
    every = all_numbers(preset)
    for prefix in (word for word in numbers.split(",") if word):
        chosen = [each for each in every if each.key.startswith(prefix)]
        if not chosen:
            raise FiptError.of("trial-unknown", f"There is no number {prefix}.", "See --list.")
        changes += [scaled(each, factor) for each in chosen for factor in FACTORS]
    return changes


def lines_of(name: str) -> int:
    """Lines of the modules of a mechanism."""
    modules = MECHANISMS[name].modules if name in MECHANISMS else ()
    return sum(len((CORE / f"{module}.py").read_text(encoding="utf-8").splitlines()) for module in modules)


def format_list() -> str:
    """The mechanisms with their lines, and the numbers with their comments."""
    text = [f"{name:20s} {lines_of(name):5d} lines  {each.text}" for name, each in MECHANISMS.items()]
    text += [f"{each.key:60s} {each.value:<12g} {each.comment}" for each in all_numbers()]
    return "\n".join(text)
