"""Saving a file brings the textures of results beside it that were applied while it had no name, and notes in
its runs that a file knows them; one that was opened in a Blender without a denoiser renders without, unless
the artist has changed that.
"""

from __future__ import annotations

from contextlib import suppress

import bpy

from ..core.run.runfolder import RunFolder

_before: dict[str, str] = {}  # paths of images as they were, by name, until the file is saved


def register() -> None:
    """Listen to opening and saving."""
    bpy.app.handlers.load_post.append(_without_denoiser)
    bpy.app.handlers.save_pre.append(_bring)
    bpy.app.handlers.save_post.append(_after)


def unregister() -> None:
    """Stop listening."""
    bpy.app.handlers.load_post.remove(_without_denoiser)
    bpy.app.handlers.save_pre.remove(_bring)
    bpy.app.handlers.save_post.remove(_after)


@bpy.app.handlers.persistent
def _without_denoiser(*_: object) -> None:
    """Cycles fails where it shall denoise but can't."""
    from ..blend import render_settings

    if render_settings.can_denoise():
        return
    for scene in bpy.data.scenes:
        if scene.library is None and render_settings.is_set(scene):
            wanted = render_settings.picture_settings(scene)
            names = ("use_denoising", "samples", "sample_clamp_indirect")
            render_settings.set_once(
                scene, {path: wanted[path] for path in (f"cycles.{name}" for name in names)}
            )


@bpy.app.handlers.persistent
def _bring(path: str, *_: object) -> None:
    from pathlib import Path

    from ..blend.collecting import bring, pictures_in_runs
    from ..core.run.errors import FiptError

    _before.clear()
    # A file that has a name and is saved under another one is a copy, or finds its textures where they are.
    if not path or (bpy.data.filepath and Path(path) != Path(bpy.data.filepath)):
        return
    images = pictures_in_runs(Path(path).parent)
    _before.update({image.name: image.filepath_raw for image in images})
    try:
        bring(images, Path(path))
    except FiptError as error:  # the file is saved with the textures where they are
        from .window import show_notice

        _restore()
        print(f"fipt: {error}")
        if not bpy.app.background:
            show_notice(str(error), "WARNING")


@bpy.app.handlers.persistent
def _after(*_: object) -> None:
    if not bpy.data.filepath:  # a copy was saved, which has its own textures
        _restore()
    _before.clear()
    for scene in bpy.data.scenes if bpy.data.filepath else ():
        if scene.fipt.run_folder:
            with suppress(OSError):  # the folder may be gone
                RunFolder(bpy.path.abspath(scene.fipt.run_folder)).unsaved.unlink(missing_ok=True)


def _restore() -> None:
    for name, path in _before.items():
        if name in bpy.data.images:
            bpy.data.images[name].filepath_raw = path
