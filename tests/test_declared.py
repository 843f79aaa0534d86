"""What is declared once: options in panel and command line, operators of functions."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Annotated

import bpy
import pytest

from fipt_blender.core.capture.options import CaptureOptions
from fipt_blender.core.run.declared import Option, add_options, arguments_of, converted, options_of
from fipt_blender.core.run.errors import FiptError, Problem, as_message
from fipt_blender.operators.action import REGISTER, action, note
from fipt_blender.properties.declared import fill, values_of
from samples.operator_calls import refused
from samples.refusals import error_of

pytestmark = pytest.mark.usefixtures("registered")

CHANGED = CaptureOptions(
    mesh=Path("/room/mesh.obj"),
    format="colmap",
    up_axis="-y",
    scale=0.25,
    hold_back=0,
    layer="beauty",
    clamp_negative=True,
    panorama_place=(-1.0, 0.5, 2.0),
    panorama_heading=90.0,
    triangles=5000,
)


def test_options_go_through_the_command_line_and_the_panel() -> None:
    parser = argparse.ArgumentParser()
    add_options(parser, CaptureOptions)
    words = arguments_of(CHANGED, CaptureOptions)
    assert "--up-axis=-y" in words and not arguments_of(CaptureOptions(), CaptureOptions)
    assert CaptureOptions(**options_of(parser.parse_args(words), CaptureOptions)) == CHANGED
    panel = bpy.context.scene.fipt.capture
    assert CaptureOptions(**values_of(panel, CaptureOptions)) == CaptureOptions()
    fill(panel, CaptureOptions, vars(CHANGED))
    found = values_of(panel, CaptureOptions)
    assert found.pop("panorama_heading") == pytest.approx(90.0)
    assert found == {name: getattr(CHANGED, name) for name in found} and "views" not in found


@pytest.mark.parametrize(
    "change", [{"hold_back": 1}, {"scale": "nan"}, {"up_axis": "w"}, {"panorama_place": "1,2"}, {"views": "many"}]
)
def test_impossible_values_are_refused_with_what_is_possible(change: dict) -> None:
    error = error_of(converted, CaptureOptions, change)
    assert error.code == "setting-invalid" and next(iter(change)) in error.text and error.remedy.startswith("Give ")


@action("Try Action", options=REGISTER)
def try_action(
    scene: bpy.types.Scene,
    count: Annotated[int, Option("How many", low=0, high=9)] = 3,
    kind: Annotated[str, Option("Which", choices=(("A", "First", ""), ("B", "Second", "")))] = "A",
) -> str | list:
    """Do something.

    This is for programmers.
    """
    if count > 5:
        raise FiptError.of("too-many", "These are too many.", "Take fewer.")
    scene["tried"] = f"{kind}{count}"
    return (
        "Done" if count else [note("Nothing"), as_message("warning", Problem("none", "There are none.", "Take some."))]
    )


def test_a_function_is_an_operator_and_stays_a_function(capfd: pytest.CaptureFixture) -> None:
    bpy.utils.register_class(try_action.operator)
    try:
        scene, operator = bpy.context.scene, bpy.ops.fipt.try_action
        declared = operator.get_rna_type()
        assert (declared.name, declared.description) == ("Try Action", "Do something")
        assert operator() == {"FINISHED"} and scene["tried"] == "A3"
        assert operator(count=0, kind="B") == {"FINISHED"} and scene["tried"] == "B0"
        assert "There are none. Take some." in capfd.readouterr().out
        assert "These are too many. Take fewer." in refused(operator, count=6)
        assert try_action(scene, 2) == "Done" and scene["tried"] == "A2"
    finally:
        bpy.utils.unregister_class(try_action.operator)
