# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""JSON of others: every fault is one error that names the place, within bounded time and memory."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from fipt_blender.core.run import documents
from fipt_blender.core.run.documents import (
    Choice,
    Fields,
    Items,
    Maybe,
    Number,
    Numbers,
    ShapeError,
    check_shape,
    parse_document,
    read_json,
)
from samples.refusals import error_of

VIEW = Fields(
    {"name": str, "width": Number(1, 65536, whole=True), "pose": Numbers(4, 4)}, {"mask": Maybe(str)}
)
CAPTURE = Fields({"format": Choice("fipt-capture"), "views": Items(VIEW, least=1)})
POSE = [[float(row == column) for column in range(4)] for row in range(4)]


def capture(**changes: Any) -> dict[str, Any]:
    view = {"name": "a", "width": 8, "pose": POSE, "mask": None, "other": [1], **changes}
    return {"format": "fipt-capture", "views": [view]}


def test_what_fits_passes() -> None:
    check_shape(capture(), CAPTURE)
    check_shape(capture(mask="m.png"), CAPTURE)
    check_shape([[1, 2.5, 3]] * 2, Numbers(None, 3))
    check_shape({}, dict)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (capture(width="8"), "views[0].width should be a whole number from 1 to 65536, not '8'"),
        (capture(width=8.5), "views[0].width"),
        (capture(width=True), "views[0].width"),
        (capture(width=10**6), "views[0].width"),
        (capture(name=None), "views[0].name should be a text, not null"),
        (capture(mask=3), "views[0].mask"),
        (capture(pose=POSE[:3]), "views[0].pose should be a list of 4 x 4 finite numbers"),
        (capture(pose=[*POSE[:3], [0, 0, 0, "1"]]), "views[0].pose"),
        ({"format": "fipt-capture"}, "views should be there, not missing"),
        ({"format": "fipt-capture", "views": []}, "views should be a list of 1 or more"),
        ({"format": "fipt-capture", "views": 5}, "views should be a list, not 5"),
        ({"format": "fipt-run", "views": []}, "format should be one of 'fipt-capture'"),
        ([1], "the document should be an object, not a list of 1"),
    ],
)
def test_a_fault_is_named_with_its_place(value: Any, text: str) -> None:
    with pytest.raises(ShapeError) as error:
        check_shape(value, CAPTURE)
    assert str(error.value).startswith(text)


@pytest.mark.parametrize(
    "text",
    [
        "[" * 100_000 + "]" * 100_000,
        '{"a": NaN}',
        '{"a": -Infinity}',
        '{"a": 1e999}',
        '{"a": ' + "9" * 200_000 + "}",
        '{"a": 9223372036854775808}',
        "{",
        "",
    ],
    ids=["nested", "nan", "infinity", "float", "digits", "integer", "cut", "empty"],
)
def test_hostile_texts_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"nested|no number|too large|Expecting"):
        parse_document(text)


def test_ordinary_numbers_are_read_exactly() -> None:
    values = [0, -3, 2**62, 0.1, 1e-300, -1.5e300, True, None]
    assert parse_document(json.dumps(values)) == values
    assert math.copysign(1.0, parse_document("-0.0")) == -1.0


def test_errors_of_files_name_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.json"
    error = error_of(read_json, path)
    assert error.code == "file-missing"
    path.write_bytes(b"\xff\xfe{}")
    error = error_of(read_json, path, remedy="Export it again.")
    assert (error.code, error.remedy) == ("file-damaged", "Export it again.")
    path.write_text(json.dumps(capture()))
    assert read_json(path, CAPTURE) == capture()
    monkeypatch.setattr(documents, "MOST_BYTES", 10)
    assert "more than any such file" in str(error_of(read_json, path, CAPTURE))
