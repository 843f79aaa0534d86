"""JSON of others: every fault is one error that names the place, within bounded time and memory."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar

import pytest

from fipt_blender.core.run import documents, kinds
from fipt_blender.core.run.documents import load_document, parse_document, read_document
from fipt_blender.core.run.runfolder import write_json
from samples.refusals import error_of


@dataclass(frozen=True)
class View:
    """With all that a field can be."""

    name: str
    width: Annotated[int, kinds.Number(1, 65536)]
    pose: kinds.Matrix
    shade: Annotated[str, kinds.choice("dark", "bright")] = "dark"
    file: kinds.FileName = "a"
    class_name: Annotated[str | None, kinds.Key("class")] = None
    points: tuple[kinds.Vector, ...] = ()
    share: Annotated[float, kinds.Number(0.0, 1.0)] | None = None
    counts: Mapping[str, int] = field(default_factory=dict)
    used: bool = True


@dataclass(frozen=True)
class Capture:
    """A whole document."""

    document: ClassVar[str] = "capture"
    views: Annotated[tuple[View, ...], kinds.SOME]


POSE = [[float(row == column) for column in range(4)] for row in range(4)]


def capture(**changes: Any) -> dict[str, Any]:
    view = {"name": "a", "width": 8, "pose": POSE, "class": None, "other": [1], **changes}
    return {**kinds.head("capture"), "views": [view]}


def test_what_fits_becomes_the_dataclass() -> None:
    view = View("a", 8, kinds.as_matrix(POSE))
    assert kinds.as_kind(capture(), Capture) == Capture((view,))
    more = capture(**{"class": "wall", "points": [[1, 2.5, 3]], "share": 1, "counts": {"b": 2}, "used": False})
    points = ((1.0, 2.5, 3.0),)
    changed = replace(view, class_name="wall", points=points, share=1.0, counts={"b": 2}, used=False)
    assert kinds.as_kind(more, Capture).views == (changed,)
    assert kinds.as_kind({"a": [1, "b"]}, dict) == {"a": [1, "b"]} and kinds.as_kind([1], tuple[float, ...]) == (1.0,)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (capture(width="8"), "views[0].width should be a whole number from 1 to 65536, not '8'"),
        (capture(width=8.5), "views[0].width"),
        (capture(width=True), "views[0].width"),
        (capture(width=10**6), "views[0].width"),
        (capture(name=None), "views[0].name should be a text, not null"),
        (capture(**{"class": 3}), "views[0].class should be a text, not 3"),
        (capture(pose=POSE[:3]), "views[0].pose should be a list of 4 x 4 finite numbers"),
        (capture(pose=[*POSE[:3], [0, 0, 0, "1"]]), "views[0].pose"),
        (capture(points=[[1, 2]]), "views[0].points should be a list of N x 3 finite numbers"),
        (capture(points=[[1, 2, math.nan]]), "views[0].points"),
        (capture(share=2), "views[0].share should be a number from 0 to 1, not 2"),
        (capture(shade="grey"), "views[0].shade should be one of 'dark', 'bright', not 'grey'"),
        (capture(file="../a"), "views[0].file should be a file name"),
        (capture(counts={"b": "c"}), "views[0].counts.b should be a whole number, not 'c'"),
        (capture(used=1), "views[0].used should be true or false, not 1"),
        ({**kinds.head("capture")}, "views should be there, not missing"),
        ({**kinds.head("capture"), "views": []}, "views should be a list of 1 or more"),
        ({**kinds.head("capture"), "views": 5}, "views should be a list, not 5"),
        ([1], "the document should be an object, not a list of 1"),
    ],
)
def test_a_fault_is_named_with_its_place(value: Any, text: str) -> None:
    with pytest.raises(kinds.ShapeError) as error:
        kinds.as_kind(value, Capture)
    assert str(error.value).startswith(text) and not isinstance(error.value, kinds.HeadError)


@pytest.mark.parametrize(("key", "value"), [("format", "fipt-run"), ("version", 2), ("version", True)])
def test_other_documents_and_versions_are_told_apart(tmp_path: Path, key: str, value: Any) -> None:
    path = tmp_path / "a.json"
    path.write_text(json.dumps({**capture(), key: value}))
    with pytest.raises(kinds.HeadError) as error:
        load_document(path, Capture)
    assert error.value.field == key
    assert error_of(read_document, path, Capture, other="capture-version").code == "capture-version"


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    view = View("a", 8, kinds.as_matrix(POSE), points=((0.1, -2.0, 1e-300),), class_name="wall")
    write_json(tmp_path / "a.json", Capture((view, replace(view, class_name=None))))
    assert read_document(tmp_path / "a.json", Capture).views[0] == view
    written = json.loads((tmp_path / "a.json").read_text())
    assert list(written) == ["format", "version", "views"] and "shade" not in written["views"][0]
    assert written["views"][0]["class"] == "wall" and "class" not in written["views"][1]
    with pytest.raises(TypeError):
        json.dumps({"a": object()}, default=kinds.as_json)


def test_hostile_texts_are_refused_and_ordinary_numbers_read_exactly() -> None:
    for text in ("[" * 100_000 + "]" * 100_000, "{", ""):
        with pytest.raises(ValueError, match=r"nested|Expecting"):
            parse_document(text)
    for number in ("NaN", "-Infinity", "1e999", "9" * 200_000):
        assert math.isnan(parse_document(number))
        for kind in (float, int, tuple[float, ...]):
            with pytest.raises(kinds.ShapeError):
                kinds.as_kind(parse_document(number), kind)
    values = [0, -3, 2**62, 0.1, 1e-300, -1.5e300, True, None]
    assert parse_document(json.dumps(values)) == values
    assert math.copysign(1.0, parse_document("-0.0")) == -1.0


def test_errors_of_files_name_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.json"
    assert error_of(read_document, path, dict).code == "file-missing"
    path.write_bytes(b"\xff\xfe{}")
    error = error_of(read_document, path, dict, remedy="Export it again.")
    assert (error.code, error.remedy) == ("file-damaged", "Export it again.")
    path.write_text(json.dumps(capture()))
    assert read_document(path, Capture) == kinds.as_kind(capture(), Capture)
    monkeypatch.setattr(documents, "MOST_BYTES", 10)
    assert "more than any such file" in str(error_of(read_document, path, Capture))
