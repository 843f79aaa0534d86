"""The table of whole jobs: differences between commits, and the files that hold it."""

from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from PIL import Image

from benchmarks import cycles_views, results, scoreboard
from fipt_blender.blend.marks import VIEW
from fipt_blender.core.capture.encoded import srgb_encoded
from fipt_blender.core.capture.images import write_exr
from samples.applied_rooms import make_applied_scene

ROOM, OFFICE = scoreboard.ROWS["room"].label, scoreboard.ROWS["office"].label


def table(date: str, *rows: tuple[str, int, dict[str, float]]) -> dict[str, Any]:
    return {"date": date, "rows": [{"label": name, "seed": seed, "figures": figures} for name, seed, figures in rows]}


def test_a_figure_is_compared_with_the_last_commit_that_has_its_row() -> None:
    known = [
        table("1", (ROOM, 0, {"kd_psnr": 30.0})),
        table("2", (ROOM, 0, {"kd_psnr": 35.0, "false_50": 0})),
        table("3", (OFFICE, 0, {"cycles_db": 17.0})),
    ]
    told = scoreboard.changes(known, ROOM, {"kd_psnr": 33.0, "false_50": 2, "relight_psnr": 20.0})
    assert told == {"kd_psnr": (-2.0, True), "false_50": (2, True)}  # more false lamps are worse
    assert scoreboard.changes(known, ROOM, {"kd_psnr": 36.0}) == {"kd_psnr": (1.0, False)}
    assert scoreboard.changes(known, "another room", {"kd_psnr": 36.0}) == {}


def test_what_another_seed_changes_is_no_loss() -> None:
    known = [table("1", (ROOM, 0, {"kd_psnr": 36.0}), (ROOM, 1, {"kd_psnr": 34.0}))]
    assert scoreboard.scatter(known, ROOM, "kd_psnr") == 2.0
    assert scoreboard.changes(known, ROOM, {"kd_psnr": 33.5}) == {"kd_psnr": (-1.5, False)}
    assert scoreboard.changes(known, ROOM, {"kd_psnr": 32.5}) == {"kd_psnr": (-2.5, True)}
    once = [table("1", (ROOM, 0, {"kd_psnr": 35.0}))]
    assert scoreboard.changes(once, ROOM, {"kd_psnr": 33.5}) == {"kd_psnr": (-1.5, True)}


def test_rows_are_stored_for_clean_trees_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scoreboard, "STORED", tmp_path)
    clean = {"commit": "0123456789", "machine": "2 cores", "capture": "", "seed": 0, "command": "scoreboard"}
    monkeypatch.setattr(results, "provenance", lambda *given: {**clean, "commit": "0123456789+"})
    row = {"label": ROOM, "seed": 0, "figures": {"kd_psnr": 35.0}}
    scoreboard.store([row], [], "draft")
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr(results, "provenance", lambda *given: dict(clean))
    before = [{**table("1", (ROOM, 0, {"kd_psnr": 34.0})), "common": {"commit": "older"}}]
    scoreboard.store([{"label": OFFICE, "seed": 0, "figures": {"cycles_db": 18.0}}], before, "draft")
    scoreboard.store([row], before, "draft")  # a row that is measured later joins the others of its commit
    stored = results.read_table(tmp_path / "0123456789.json")
    assert [each["label"] for each in stored["rows"]] == [ROOM, OFFICE]
    assert "35.0 (+1.0)" in results.markdown(stored)
    assert scoreboard.history(tmp_path) == [stored]


def test_a_row_that_is_unknown_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert scoreboard.main(["no-such-room"]) == 2
    assert "no-such-room" in capsys.readouterr().err


@pytest.mark.usefixtures("registered")
def test_what_is_displayed_has_the_exposure_of_the_view(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = make_applied_scene(tmp_path / "run", monkeypatch)
    camera = bpy.data.objects.new("a", bpy.data.cameras.new("a"))
    scene.collection.objects.link(camera)
    camera[VIEW] = "a"
    view = scene.fipt.capture.views.add()
    view.name, view.camera, view.exposure = "a", "a", -1.5
    white = 2.0**-scene.view_settings.exposure
    write_exr(tmp_path / "a.exr", np.full((2, 2, 3), 0.5 * white, np.float32))
    cycles_views.write_displayed(scene, "a", tmp_path / "a.exr")
    shown = np.asarray(Image.open(tmp_path / "a.png").convert("RGB")) / 255.0
    assert shown == pytest.approx(srgb_encoded(np.full((2, 2, 3), 0.5 * 2.0**-1.5)), abs=0.01)
