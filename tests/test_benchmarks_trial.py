"""The trial of mechanisms: the jury, switches, numbers of the source, runs that begin with stored stages."""

import dataclasses

import numpy as np
import pytest

from benchmarks import constants, lamps, results, trial_changes, trial_table
from fipt_blender.core.run.declared import declared
from fipt_blender.core.run.errors import FiptError
from fipt_blender.core.run.settings import Settings, make_settings

SOURCE = """
# Of a wall.
# In metres.
WIDTH, HEIGHT = 2.0, 1.0 / 4.0
_COUNT = 3  # of walls
AREA = WIDTH * HEIGHT
NAME, small = "wall", 5
"""


def test_numbers_in_capitals_are_found_with_their_comments() -> None:
    found = constants.module_constants(SOURCE, "room.wall")
    assert [(each.key, each.value, each.comment) for each in found] == [
        ("room.wall.WIDTH", 2.0, "Of a wall. In metres."),
        ("room.wall.HEIGHT", 0.25, "Of a wall. In metres."),
        ("room.wall._COUNT", 3, "of walls"),
    ]
    assert [found[0].scaled(2.0), found[2].scaled(0.5), found[2].scaled(2.0)] == [4.0, 2, 6]
    one = dataclasses.replace(found[2], value=1)
    assert [one.scaled(0.5), one.scaled(2.0)] == [0, 2]
    assert len(constants.all_constants()) > 100
    shared = constants.module_constants("# In metres.\nDEPTH = 1.0\nWIDTH = 2.0\n\nHEIGHT = 3.0\n", "room.wall")
    assert [each.comment for each in shared] == ["In metres.", "In metres.", ""]
    assert not [each.key for each in constants.all_constants(skipped=()) if not each.comment]


def test_every_switch_is_on_and_is_tried() -> None:
    switches = {
        item.name
        for item in declared(Settings).values()
        if item.default is True and item.option.text.endswith("(not in the paper)")
    }
    tried = {name for mechanism in trial_changes.MECHANISMS.values() for name in mechanism.off}
    assert switches - {"detail"} <= tried  # of the textures, which have figures of their own
    for name, mechanism in trial_changes.MECHANISMS.items():
        make_settings("draft", dict(mechanism.off))
        assert trial_changes.lines_of(name) >= 0 and trial_changes.without(name).settings == mechanism.off
    with pytest.raises(FiptError, match="no mechanism"):
        trial_changes.without("no_such")


def row(capture: str, change: str, seconds: dict[str, float], **figures: float) -> dict:
    classes = [{"share": 0.5, "expected": 0.2, "made": 0.1}]
    every = dict.fromkeys(trial_table.COLUMNS, 20.0) | {"confidence": classes} | figures
    return {
        "capture": capture,
        "change": change,
        "seconds": seconds,
        "figures": dict.fromkeys(trial_table.SPLITS, every),
        "lamps": {"true": 2, "false": 0, "lost": 0},
    }


def test_a_mechanism_pays_where_it_gains_more_than_it_loses() -> None:
    rows = [
        row("a", "", {"pixels": 9.0, "training": 5.0}), row("b", "", {"pixels": 7.0}),
        row("a", "panes", {"pixels": 4.0}, kd_psnr=19.0, relight_psnr=20.1),
        row("b", "panes", {"pixels": 4.0}, kd_psnr=20.0),  # nothing there has a hole
        row("a", "outlines", {}, sigma_psnr=19.5, relight_psnr=20.6),
        row("a", "unmix", {}, kd_psnr=19.8),
        row("a", "presumed_lamps", {}, emission_iou=20.05) | {"lamps": {"false": 3, "lost": 0}},
        {"capture": "b", "change": "unmix", "error": ["failed"]},
    ]  # fmt: skip
    found = trial_table.effects(rows)
    assert (found["panes"].acted, found["panes"].tried, found["panes"].seconds) == (1, 2, 4.0)
    assert found["panes"].mean == pytest.approx([1.0, 0, 0, 0, 0, 0, -0.1, 0, 0, 0])
    verdicts = {name: effect.verdict() for name, effect in found.items()}
    assert verdicts == {
        "panes": "pays", "outlines": "loses as much", "unmix": "does not pay", "presumed_lamps": "pays",
    }  # fmt: skip
    lines = results.markdown(trial_table.as_table(rows, {})).splitlines()
    assert lines[2].startswith("| `panes` | 1 of 2 | +1.00 |") and lines[2].endswith("| pays |")
    assert "| relit −0.10 | 4 |" in lines[2] and "| IoU −0.050 |" in lines[5]


def test_a_gain_must_be_more_than_another_seed_changes_in_the_same_capture() -> None:
    rows = [row("a", "", {}), row("a", "panes", {}, kd_psnr=19.5), row("a", "outlines", {}, kd_psnr=19.0)]
    rows += [row("a", "seed1", {}, kd_psnr=20.6), row("a", "seed2", {}, sigma_psnr=20.1)]
    rows += [row("b", "", {}), row("b", "unmix", {}, kd_psnr=19.5)]
    found = trial_table.effects(rows)
    assert found["panes"].noise[:3] == pytest.approx([0.6, 0.0, 0.1])
    verdicts = [found[name].verdict() for name in ("panes", "outlines", "unmix")]
    assert verdicts == ["does not pay", "pays", "pays"]


def test_lamps_are_compared_by_where_they_are() -> None:
    square = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]])
    away, behind, small = square + (3.0, 0.0, 0.0), square + (0.0, 0.0, 0.03), 0.4 * square
    counts = lamps.count_lamps([behind, 0.5 * away + 5.0], [square, away])
    quarter = pytest.approx(0.25)
    assert (counts.true, counts.false, counts.lost, counts.certain) == (1, 1, 1, 1)
    assert (counts.false_area, counts.certain_area) == (quarter, quarter)
    assert counts.claims == ((1.0, 1), (1.0, 0))
    # A fixture that is a piece of a lamp is right, but the lamp is lost with it.
    piece, none = lamps.count_lamps([small], [square], likely=[0.6]), lamps.count_lamps([], [square])
    assert (piece.true, piece.false, piece.lost, piece.claims) == (1, 0, 1, ((0.6, 1),))
    assert (none.true, none.false, none.lost, none.claims) == (0, 0, 1, ())
    assert lamps.count_lamps([square], []).false == 1
    spread = lamps.points_on(square, 4000, np.random.default_rng(0))
    assert np.abs(spread.mean(axis=0) - (0.5, 0.5, 0.0)).max() < 0.02
