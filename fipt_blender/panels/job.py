"""How a section draws its job: progress while it runs, its error with the remedy, and its warnings.

What the artist does next comes first: a section draws the warnings last, folded to one line.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from bpy.types import Context, UILayout

from ..core.run.runfolder import RunFolder
from ..jobs import running
from .engine import draw_set_up
from .progress import draw_progress
from .sidebar import draw_text

if TYPE_CHECKING:
    from ..bridge.process import Message


def draw_job(layout: UILayout, context: Context, kind: str) -> bool:
    """Draw the running job of a kind, or the error of the last one; returns whether one is running."""
    job = running.current()
    if job is not None and job.kind == kind:
        draw_progress(layout, context, job)
        return True
    job = running.last(kind)
    if job is not None and job.error is not None and running.belongs_to(job, context.scene):
        run = RunFolder(job.run_folder) if context.scene.fipt.run_folder else None
        draw_error(layout, job.error, run)
    return False


def job_warnings(context: Context, *kinds: str) -> list[Message]:
    """Warnings of the scene's jobs of these kinds: of each the one that is running, or the last one."""
    current, found = running.current(), []
    for kind in kinds:
        if current is not None and current.kind == kind:
            found += current.warnings
        elif (job := running.last(kind)) is not None and running.belongs_to(job, context.scene):
            found += job.warnings
    return found


def draw_warnings(layout: UILayout, name: str, messages: Sequence[Message]) -> None:
    """One line that counts warnings; a click opens it and shows them with their remedies.

    Args:
        layout: that of a panel, as Blender allows nothing that folds inside rows, columns and boxes.
        name: under which the panel keeps whether the line is open.
        messages: the warnings; nothing is drawn without any.
    """
    if not messages:
        return
    header, body = layout.panel(f"fipt_warnings_{name}", default_closed=True)
    header.label(text=running.count_text(len(messages)), icon="ERROR", translate=False)
    if body is not None:
        for message in messages:
            _draw_message(body, message)


def draw_error(layout: UILayout, error: Message, run: RunFolder | None) -> None:
    """An error with its remedy, and a button for the remedy where there is one.

    Args:
        run: the run folder with the log, if there is one.
    """
    box = layout.box()
    _draw_message(box, error, alert=True)
    column = box.column(align=True)
    if error["code"] in ("engine-missing", "package-missing"):
        draw_set_up(column)
    elif error["code"] == "cameras-missing":
        column.operator("fipt.photographs_of_capture", icon="RENDERLAYERS")
    elif error["code"] == "out-of-memory":
        column.operator("fipt.smaller_preset", icon="TRIA_DOWN")
    if run is not None:
        column.operator("wm.path_open", text="Show Log", icon="TEXT").filepath = str(run.log)


def _draw_message(layout: UILayout, message: Message, alert: bool = False) -> None:
    """What is wrong, and what helps."""
    column = layout.column(align=True)
    draw_text(column, message["text"], icon="ERROR", alert=alert)
    draw_text(column, message["remedy"], icon="INFO")
    if fix := message.get("fix"):
        column.operator("fipt.fix_capture", icon="CHECKMARK").correct = fix
