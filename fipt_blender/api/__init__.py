"""The Python API: what the buttons do, for scripts (docs/api.md).

Each function works on one scene, the context's by default, waits for its end and raises a FiptError, whose
`remedy` says what helps. The extension must be enabled. Everything works in background.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ..core.run.errors import FiptError

if TYPE_CHECKING:
    from ..core.run.settings import Value
    from ..core.run.versions import Version
    from ..jobs.tasks import Task
    from ..properties.lights import FIPT_Light
    from ..properties.materials import FIPT_Part

__all__ = (
    *("FiptError", "Outcome", "import_capture", "estimate", "reestimate", "apply"),
    *("fixtures", "materials", "blender_materials", "render", "export"),
    *("remove_from_room", "bring_back"),
    *("versions", "use_version", "delete_version"),
)


@dataclass(frozen=True)
class Outcome:
    """What a job has left.

    Attributes:
        run: the run folder.
        warnings: what it has warned of, with remedies.
    """

    run: Path
    warnings: tuple[str, ...]


def import_capture(
    path: str | Path, scene: bpy.types.Scene | None = None, options: Mapping[str, object] | None = None
) -> Outcome:
    """Read and check a capture, and add its cameras and the room's mesh to the scene.

    Args:
        path: folder or camera file of the capture.
        scene: see the module.
        options: import settings of the panel by name (`scene.fipt.capture`), such as ``mesh``, ``up_axis``,
            ``scale`` or ``hold_back``.

    Raises:
        FiptError: ``option-unknown``, or why the capture can't be read.
    """
    from .importing import capture_import

    settings = (scene or bpy.context.scene).fipt.capture
    for name, value in (options or {}).items():
        if name not in settings.bl_rna.properties:
            raise FiptError("option-unknown", name=name)
        setattr(settings, name, str(value) if isinstance(value, Path) else value)
    settings.path = str(path)
    return _run(capture_import(), scene)


def estimate(
    scene: bpy.types.Scene | None = None,
    preset: str | None = None,
    settings: Mapping[str, Value] | None = None,
    keep_stages: bool = False,
) -> Outcome:
    """Estimate materials and lights of the scene's capture, in a run folder of its own (see `versions`).

    Args:
        scene: see the module.
        preset: "draft", "medium" or "high"; None for that of the panel.
        settings: other values of settings (core/run/settings.py), by name.
        keep_stages: go on in the scene's run folder, and keep finished stages that nothing has changed for.

    Raises:
        FiptError: ``setting-unknown``, ``setting-invalid``, or why the estimation has failed.
    """
    from ..core.run.settings import make_settings
    from .estimating import estimation

    if preset is not None:
        make_settings(preset)  # raises for another name
        (scene or bpy.context.scene).fipt.estimate.preset = preset
    return _run(estimation(keep_stages=keep_stages, changes=settings), scene)


def reestimate(scene: bpy.types.Scene | None = None) -> Outcome:
    """Estimate the materials again with the hints of the scene, from the light of its results; apply them.

    Raises:
        FiptError: ``run-missing``, ``results-missing``, or why it has failed.
    """
    from .estimating import reestimation

    return _run(reestimation(), scene)


def apply(scene: bpy.types.Scene | None = None) -> Outcome:
    """Apply the results of the scene's run to its room, with the settings in ``scene.fipt.materials``.

    Raises:
        FiptError: ``run-missing``, ``results-missing``, or why it has failed.
    """
    from .applying import application

    return _run(application(), scene)


def fixtures(scene: bpy.types.Scene | None = None) -> list[FIPT_Light]:
    """The estimated lamps of applied results: rows of the section Lights.

    Set ``on``, ``stops`` (0 is as estimated), ``watts`` or ``radiance``, ``color`` or ``kelvin``.
    They are valid until the lights of the scene change.
    """
    from ..blend.lights.light_state import list_lights
    from ..blend.marks import FIXTURE

    scene = scene or bpy.context.scene
    list_lights(scene)
    return [row for row in scene.fipt.lights.lights if FIXTURE in row.object]


def materials(scene: bpy.types.Scene | None = None) -> list[FIPT_Part]:
    """The parts of applied results, those that most pixels saw first: rows of *Materials of Parts*.

    They have ``name``, the means ``base_color`` (scene-linear), ``roughness`` and ``metallic``, the
    ``confidence`` of each (0 to 1), and adjustments to set: ``roughness_offset``, ``metallic_offset``,
    ``hue``, ``saturation``, ``value``. They are valid until results are applied again.
    """
    return list((scene or bpy.context.scene).fipt.materials.parts)


def blender_materials(part: FIPT_Part) -> list[bpy.types.Material]:
    """The materials of a part in Blender."""
    from ..blend.results.part_list import part_materials

    return part_materials(part.id_data, part.key)


def render(
    path: str | Path, view: str = "", scene: bpy.types.Scene | None = None, samples: int = 128
) -> Path:
    """Render a view of the capture in Cycles, in linear Rec.709 and with Blender's light paths unclamped.

    The scene's render settings have no influence, except for what decides on its content.

    Args:
        path: of the file, which ends in .exr.
        view: its name; "" for the scene's camera.
        scene: see the module.
        samples: per pixel.

    Returns:
        The path.

    Raises:
        FiptError: ``render-format``, ``view-missing``, ``render-failed``, or the errors of writing.
    """
    from ..blend.capture.cameras import find_camera
    from ..blend.pictures.cycles import RenderOptions, render_exr

    scene, path = scene or bpy.context.scene, Path(bpy.path.abspath(str(path))).absolute()
    if path.suffix.lower() != ".exr":
        raise FiptError("render-format", path=path)
    camera = find_camera(view, scene) if view else None
    if camera is None and scene.camera is None:
        raise FiptError("view-missing.render")
    render_exr(scene, path, RenderOptions(samples), camera)
    return path


def export(
    path: str | Path,
    scene: bpy.types.Scene | None = None,
    texture_size: int = 4096,
    lamp_lights: bool = True,
) -> list[str]:
    """Write the room with plain materials and lights as glTF or USD; returns what the file does not hold.

    Args:
        path: the suffix chooses the format.
        scene: the context's by default.
        texture_size: the most texels of a texture's side.
        lamp_lights: in glTF, give lamps lights besides their glowing surfaces; path tracers need none.

    Raises:
        FiptError: ``export-format``, ``export-nothing``, ``export-failed``, or the errors of writing.
    """
    from ..blend.export.exporting import export_room

    path = Path(bpy.path.abspath(str(path))).absolute()
    exported = export_room(scene or bpy.context.scene, path, texture_size, lamp_lights)
    return [f"{warning['text']} {warning['remedy']}" for warning in exported.warnings]


def remove_from_room(
    objects: Collection[bpy.types.Object] = (),
    box: bpy.types.Object | None = None,
    scene: bpy.types.Scene | None = None,
) -> list[str]:
    """Hide furniture, and complete the planes and materials behind it; returns the names of the new surfaces.

    Args:
        objects: of the room's results, lamps among them.
        box: an empty, whose cube encloses further faces.
        scene: see the module.

    Raises:
        FiptError: ``removal-empty`` where these are none of the room's, ``run-missing``,
            ``textures-unwritable``.
    """
    from ..blend.results import emptying
    from .applying import run_of

    scene = scene or bpy.context.scene
    chosen = emptying.faces_in_box(scene, box) if box is not None else {}
    return emptying.remove(scene, run_of(scene), {**chosen, **dict.fromkeys(objects)})[1]


def bring_back(scene: bpy.types.Scene | None = None) -> None:
    """Show all that was removed from the room again."""
    from ..blend.results import emptying

    emptying.bring_back(scene or bpy.context.scene)


def versions(scene: bpy.types.Scene | None = None) -> list[Version]:
    """The estimates of the scene's capture, the newest first: run folders beside the scene's.

    Raises:
        FiptError: ``run-missing``.
    """
    from ..core.run.versions import list_versions
    from .applying import run_of

    return list_versions(run_of(scene or bpy.context.scene))


def use_version(version: str, scene: bpy.types.Scene | None = None) -> Outcome:
    """Make a version, by the name of its folder, the scene's run, and apply it.

    Raises:
        FiptError: ``version-missing``, ``run-busy``; those of `apply`.
    """
    from .applying import version_change

    return _run(version_change(version), scene)


def delete_version(version: str, scene: bpy.types.Scene | None = None) -> None:
    """Delete the run folder of a version, by its name.

    Raises:
        FiptError: ``version-missing``; ``run-busy`` for one that is in use.
    """
    from . import applying

    applying.delete_version(scene or bpy.context.scene, version)


def _run(task: Task, scene: bpy.types.Scene | None) -> Outcome:
    """Do a task in the context of a scene.

    Raises:
        FiptError: why it has failed; ``job-running`` where another one runs.
    """
    from ..jobs import running
    from ..jobs.tasks import begin

    scene = scene or bpy.context.scene
    if (job := running.current()) is not None:
        raise FiptError("job-running.run", title=job.title)
    with bpy.context.temp_override(scene=scene):
        info = begin(task, scene, wait=True)
    if info.error is not None:
        raise FiptError.of(info.error["code"], info.error["text"], info.error["remedy"])
    warnings = tuple(f"{warning['text']} {warning['remedy']}" for warning in info.warnings)
    return Outcome(Path(bpy.path.abspath(scene.fipt.run_folder)), warnings)
