"""Each estimate of a capture is a run folder of its own."""

from __future__ import annotations

import os
from pathlib import Path

from fipt_blender.core.run import versions
from fipt_blender.core.run.lock import hold
from fipt_blender.core.run.runfolder import RunFolder, write_json
from fipt_blender.core.run.settings import make_settings
from samples.refusals import error_of


def estimate(run: RunFolder, text: str, hints: int = 0, **changes: int) -> None:
    """Results of an estimation as the engine writes them, with this content."""
    run.create(make_settings("draft", changes))
    keys = {"training": text, **({"hinted-training": text} if hints else {})}
    write_json(run.stages_json, {"keys": keys, "stages": {k: {} for k in keys}, "warnings": {}, "values": {}})
    run.fields_npz.write_text(text)
    run.emitters_json.write_text("{}")
    figures = {"triangles": 1, "roughness": None, "metallic": None, "emits": None, "left_alone": False}
    settings = {"preset": "draft", **changes}
    facts = {"hints": [{"name": "Sofa", **figures}] * hints, "settings": settings}
    write_json(run.statistics_json, facts)
    (run.results / "stages.json").write_bytes(run.stages_json.read_bytes())


def test_estimates_of_one_capture_are_listed(tmp_path: Path) -> None:
    first, second, other = (RunFolder(tmp_path / name) for name in ("first", "second", "other"))
    for run, hints in ((first, 0), (second, 2), (other, 0)):
        estimate(run, run.root.name, hints=hints, **({"rounds": 2} if hints else {}))
        run.ingest_json.write_text("other" if run is other else "same ")
    os.utime(first.fields_npz, (1e9, 1e9))
    newest, oldest = versions.list_versions(first)
    assert (newest.folder, oldest.folder) == (second.root, first.root) and oldest.current and not newest.current
    assert newest.preset == "draft"
    assert oldest.title.startswith("Draft 2001")
    assert versions.find_version(first, "second").root == second.root
    for wrong in ("other", "", "..", str(second.root)):
        assert error_of(versions.find_version, first, wrong).code == "version-missing"
    second.emitters_json.unlink()
    assert [version.folder for version in versions.list_versions(second)] == [first.root]


def test_a_new_run_has_the_capture_and_nothing_of_the_estimate(run_folder: RunFolder, tmp_path: Path) -> None:
    estimate(run_folder, "first")
    (run_folder.images / "preview").mkdir(parents=True)
    (run_folder.images / "preview" / "0.jpg").write_text("photograph")
    run_folder.survey.mkdir()
    run_folder.survey_json.write_text("{}")
    for path in (run_folder.ingest_json, run_folder.capture_json, run_folder.room_npz):
        path.write_text(path.name)
    new = RunFolder(tmp_path / "new")
    new.root.mkdir()
    with hold(RunFolder(run_folder.survey), ["survey"]):
        versions.copy_capture(run_folder, new)
        with hold(RunFolder(new.survey), ["survey"]):
            pass  # it is another folder
    assert new.survey_json.read_text() == "{}"
    assert (new.images / "preview" / "0.jpg").read_text() == "photograph"
    assert {path.name for path in new.root.iterdir()} == {"images", "survey", "ingest.json", "capture.json"}
