"""Started by `blender --python`: tells the story that run.py asks for in $FIPT_GUI, from a thread."""

from __future__ import annotations

import json
import os
import sys
import threading
import traceback
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parent))

import agent
import chapters
import story
from window import Window

TOLD = 42  # exit status; Blender's own is 0 in any case


def play(window: Window, told: chapters.Options, only: list[str], first: str) -> None:
    """Act chapters, all or some, and end Blender."""
    status = 1
    try:
        window.ask(agent.redraws, ticks=5)
        names = [chapter.name for chapter in story.CHAPTERS]
        only = only or names[names.index(first or names[0]) :]
        chapters.act(window, told, [story.CHAPTERS[names.index(name)] for name in only])
        status = TOLD
    except BaseException:
        traceback.print_exc()
        window.shot("failed")
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def main() -> None:
    """Hide whatever would cover the window in pictures, and start the story's thread."""
    asked = json.loads(os.environ["FIPT_GUI"])
    told = chapters.Options(Path(asked["capture"]), Path(asked["engine"]), asked["fast"])
    preferences = bpy.context.preferences
    preferences.use_preferences_save = preferences.view.show_splash = preferences.view.show_tooltips = False
    bpy.types.SpaceView3D.draw_handler_add(agent.count_redraw, (), "UI", "POST_PIXEL")
    window = Window(Path(asked["shots"]))
    threading.Thread(target=play, args=(window, told, asked["only"], asked["first"]), daemon=True).start()


if __name__ == "__main__":
    main()
