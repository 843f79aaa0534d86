"""The story's chapter on hints: a part clicked, an estimate again, a question answered."""

from __future__ import annotations

import inside
from chapters import Options, finish
from window import Window

_ENGINE_SECONDS = 500.0


def hints(window: Window, options: Options) -> None:
    """Say of a clicked part that it is a metal, estimate again, and answer the first question."""
    window.open_section("Estimate", "Hints")
    assert window.ask(inside.hints)["icon"]  # also in a file that was opened
    window.shot("32_hints_empty")
    window.click("fipt.add_hint", what="PART")
    window.point_in_view(0.45, 0.35)
    window.press()
    window.wait(inside.hints, until=lambda now: len(now["hints"]) == 1)
    window.open_section("Estimate", "Hints")
    window.choose("hints.hints[0].material", "METAL")
    found = window.wait(inside.hints, until=lambda now: now["hints"][0]["material"] == "METAL")
    assert found["hints"][0]["object"], found
    window.shot("32_hints_metal")
    window.click("fipt.reestimate")
    finish(window, "estimate", _ENGINE_SECONDS)
    window.open_section("Estimate", "Hints")
    found = window.ask(inside.hints)
    assert found["told"][0]["metallic"] == 1.0, found
    window.shot("33_hints_questions")
    if found["questions"]:  # with few rays and steps, which these are is chance
        window.click("fipt.answer_doubt", answer="LEAVE")
        window.wait(inside.hints, until=lambda now: len(now["hints"]) == 2)
        window.shot("33_hints_answered")
