"""A chain of stages: what is kept, resumed, dropped and done again; outputs as files; work in threads."""

from __future__ import annotations

import io
import json
import os
import re
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import make_dataclass, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.run import chain as chain_module
from fipt_blender.core.run import finished_views, messages, method
from fipt_blender.core.run.chain import Chain, Given, Stage, Tools, Watch
from fipt_blender.core.run.errors import Problem
from fipt_blender.core.run.messages import Reporter
from fipt_blender.core.run.settings import Settings
from fipt_blender.core.run.stage_settings import Seeded, TrainingSettings
from fipt_blender.core.run.store import Gaps, loaded, saved, write_arrays
from fipt_blender.core.run.threads import MOST_THREADS, cached_property, in_threads
from samples.combinations import pairs
from samples.refusals import error_of


def record(name: str, **fields: type) -> type:
    """A frozen dataclass: outputs of a stage."""
    return make_dataclass(name, fields.items(), frozen=True)


Table = record("Table", table=np.ndarray, source=list[str])
Target = record("Target", total=float, doubled=np.ndarray)
SOURCE = ["photograph"]  # given, and passed on


def make_table(number: int, source: list[str], *, settings: Seeded, tools: Tools) -> Table:
    table = np.lib.format.open_memmap(tools.folder / "table.npy", mode="w+", dtype=np.float64, shape=(4, 2))
    table[:] = number + settings.seed
    tools.reporter.warn(Problem("a-code", "A text.", "A remedy."))
    tools.facts["rays"] = 7
    return Table(table, source)


def add_up(table: np.ndarray) -> float:
    return float(table.sum())


def double(table: np.ndarray) -> np.ndarray:
    return 2.0 * table


def train(doubled: np.ndarray, *, settings: TrainingSettings) -> float:
    return float(doubled.mean()) + settings.learning_rate


STAGES = [
    Stage("table", make_table, "Making"),
    Stage("sum", add_up, "Adding", gives="total"),
    Stage("double", double, gives="doubled"),  # quick: not kept
    Stage("train", train, "Training", gives="total"),
]


class Heard(Watch):
    """Which stages were done."""

    def __init__(self) -> None:
        self.done: list[str] = []

    def after(self, name: str, new: bool) -> None:
        self.done += [name] * new


def chain_on(
    folder: Path,
    settings: Settings | None = None,
    stages: Sequence[Stage] = STAGES,
    number: int = 3,
    reporter: Reporter | None = None,
) -> Chain:
    given = {"number": Given(number, str(number)), "source": Given(SOURCE, "")}
    return Chain(stages, given, settings or Settings(), folder, reporter or Reporter())


def work(folder: Path, **options) -> tuple[Target, list[str], Reporter]:
    heard, reporter = Heard(), Reporter()
    target = chain_on(folder, reporter=reporter, **options).run(Target, heard)
    return target, heard.done, reporter


def test_a_resumed_chain_does_what_has_changed_and_no_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target, done, _ = work(tmp_path)
    assert done == ["table", "sum", "train"]
    assert target.total == pytest.approx(6.0 + Settings().learning_rate) and (target.doubled == 6.0).all()
    again, done, reporter = work(tmp_path)
    assert done == [] and again.total == target.total and (again.doubled == 6.0).all()
    assert [warning["code"] for warning in reporter.warnings] == ["a-code"], "it is repeated"
    assert work(tmp_path, settings=Settings(learning_rate=1.0))[1] == ["train"]
    assert work(tmp_path, settings=Settings(learning_rate=1.0, checkpoint_steps=7))[1] == []
    assert work(tmp_path, settings=Settings(seed=1))[1] == ["table", "sum", "train"]
    assert work(tmp_path, number=4)[1] == ["table", "sum", "train"]
    assert work(tmp_path, number=4)[1] == []
    monkeypatch.setattr(chain_module, "code_digest", lambda module: "other")
    assert work(tmp_path, number=4)[1] == ["table", "sum", "train"]


def test_the_code_of_a_stage_is_what_it_may_run_and_no_more(tmp_path: Path) -> None:
    """Also what is imported inside of functions, and in circles; modules elsewhere, as of tests, may run all."""
    core, rooms = tmp_path / "core", ("light", "material")
    texts = {
        "light/stage.py": "from .baking import bake",
        "light/baking.py": "def bake():\n    from ..material import fit",
        "material/fit.py": "from ..light.baking import bake",
        "material/other.py": "",
    }

    def written(changed: str = "") -> tuple[str, str]:
        for name, text in texts.items():
            (core / name).parent.mkdir(parents=True, exist_ok=True)
            (core / name).write_text(f"{text}\n{'more = 1' if name == changed else ''}")
        for cached in (method.code_digest, method.method_digest, method.imported_files):
            cached.cache_clear()
        return method.code_digest("fipt_blender.core.light.stage", core, rooms), method.code_digest("t", core, rooms)

    before = written()
    assert [written(name)[0] != before[0] for name in texts] == [True, True, True, False]
    assert all(written(name)[1] != before[1] for name in texts)
    method.imported_files.cache_clear()


def test_cancelled_at_any_write_it_never_takes_one_settings_files_for_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A chain with a seed, then another seed that is stopped at its n-th write, then the first again."""
    writes = 0

    def stop_at(most: int) -> None:
        def counted(write: Callable, *given, **named) -> None:
            nonlocal writes
            writes += 1
            if writes == most:
                raise KeyboardInterrupt
            write(*given, **named)

        for module, name in ((os, "replace"), (np, "save")):
            monkeypatch.setattr(module, name, partial(counted, getattr(module, name)))

    right = work(tmp_path / "right", number=4)[0]
    for most in range(1, 100):
        folder, writes = tmp_path / str(most), 0
        work(folder, number=4)
        stop_at(most)
        try:
            work(folder, number=5)
            break
        except KeyboardInterrupt:
            pass
        finally:
            monkeypatch.undo()
        again = work(folder, number=4)[0]
        assert again.total == right.total and np.array_equal(again.doubled, right.doubled), most
    assert most > 5


@pytest.mark.parametrize(
    ("text", "views"), [('{"views": [2], "rays": 7}', {2}), ('{"view": [2]}', set()), ("[", set())]
)
def test_a_note_of_finished_views_that_lacks_something_costs_time_alone(tmp_path: Path, text: str, views: set) -> None:
    (tmp_path / "finished.json").write_text(text)
    assert finished_views.FinishedViews(tmp_path / "finished.json").views == views


@pytest.mark.parametrize("name", ["table/outputs.json", "table/table.npy", "sum/outputs.json", "train/outputs.json"])
@pytest.mark.parametrize("content", [b"", b"cut off", None])
def test_outputs_that_cannot_be_read_are_made_again(
    name: str, content: bytes | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where stages take no time, of which no rate follows: clocks may tick only every 16 ms."""
    monkeypatch.setattr(chain_module, "time", SimpleNamespace(monotonic=lambda: 7.0))
    first = work(tmp_path)[0]
    if content is None:
        (tmp_path / name).unlink()
    else:
        (tmp_path / name).write_bytes(content)
    target, done, reporter = work(tmp_path)
    assert (target.total, target.doubled.tolist()) == (first.total, first.doubled.tolist())
    stage = name.partition("/")[0]
    # What nobody needs is not read: the sum is no input of anything that is left to do.
    assert done == ([] if stage == "sum" else [stage])
    assert [w["code"] for w in reporter.warnings].count("checkpoint-damaged") == len(done)
    assert work(tmp_path)[1] == []


def test_a_list_of_stages_that_cannot_be_read_begins_anew(tmp_path: Path) -> None:
    first = work(tmp_path)[0]
    for text in ("", "[]", '{"keys": {}}', "{"):
        (tmp_path / "stages.json").write_text(text)
        target, done, reporter = work(tmp_path)
        assert done == ["table", "sum", "train"] and target.total == first.total
        assert "checkpoint-damaged" in [warning["code"] for warning in reporter.warnings]


def test_a_stage_that_replaces_another_removes_its_files_and_they_are_made_again_when_needed(tmp_path: Path) -> None:
    def remake(number: int) -> Table:
        return Table(np.full((4, 2), float(number)), SOURCE)

    other = Stage("other", remake, "Making again", replaces="table")
    stages = [STAGES[0], STAGES[1], other, *STAGES[2:]]
    assert work(tmp_path, stages=stages)[1] == ["table", "sum", "other", "train"]
    assert not (tmp_path / "table").exists() and work(tmp_path, stages=stages)[1] == []
    assert work(tmp_path, stages=STAGES)[1] == ["table", "train"], "the sum is still known"
    with pytest.raises(TypeError, match="needed after"):
        chain_on(tmp_path, stages=[*stages[:2], replace(other, work=add_up, gives="total")])


def test_a_kill_amid_a_stage_keeps_its_finished_views(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(finished_views, "NOTE_SECONDS", 0.0)
    seen: list[set[int]] = []

    def bake(source: list[str], *, settings: Seeded, tools: Tools) -> Table:
        seen.append(set(tools.finished.views))
        for view in range(3):
            if view not in tools.finished.views:
                tools.finished.add(view, 1)
                if view in kills:
                    raise KeyboardInterrupt
        return Table(np.zeros((4, 2)), source)

    stages = [Stage("table", bake, "Baking"), *STAGES[1:]]
    kills = [0, 1]
    for before in (set(), {0}):
        with pytest.raises(KeyboardInterrupt):
            work(tmp_path, stages=stages)
        assert seen[-1] == before
    with pytest.raises(KeyboardInterrupt):
        work(tmp_path, stages=stages, settings=Settings(seed=1))
    assert seen[-1] == set(), "those of another key do not count"
    kills = []
    work(tmp_path, stages=stages, settings=Settings(seed=1))
    assert seen[-1] == {0} and not (tmp_path / "table" / "finished.json").exists()


def test_a_stage_cannot_change_what_an_earlier_one_made_or_take_what_nothing_makes(tmp_path: Path) -> None:
    def spoil(table: np.ndarray) -> float:
        table[:] = 0.0
        return 0.0

    with pytest.raises(ValueError, match="read-only"):
        work(tmp_path, stages=[STAGES[0], Stage("spoil", spoil, "Spoiling", gives="total"), *STAGES[2:]])
    with pytest.raises(TypeError, match="nothing before"):
        chain_on(tmp_path, stages=STAGES[1:])


Inner = record("Inner", numbers=np.ndarray, names=tuple[str, ...])
# One of each kind of field
KINDS = {"inner": Inner, "maybe": Inner | None, "either": np.ndarray | float, "empty": np.ndarray}
KINDS |= {"tables": dict[str, np.ndarray], "several": list[Inner], "number": float, "count": int, "flag": bool}
Everything = record("Everything", **KINDS, source=list[str])


def everything() -> Everything:
    inner = Inner(np.arange(3, dtype=np.float16), ("a", "b"))
    empty, tables = np.zeros((0, 3), np.float32), {"grid.table": np.eye(2)}
    return Everything(inner, None, 0.1, empty, tables, [inner, inner], 1 / 3, 2**40, True, SOURCE)


def test_outputs_come_back_as_they_were(tmp_path: Path) -> None:
    value, given = everything(), {"source": SOURCE}
    document = json.loads(json.dumps(saved(value, tmp_path / "one", tmp_path, given)))
    back = loaded(document, Everything, tmp_path, given)
    assert back.source is SOURCE and back.number == value.number and back.count == value.count
    assert back.maybe is None and back.either == 0.1 and back.inner.names == ("a", "b")
    assert back.inner.numbers.dtype == np.float16 and back.inner.numbers.tolist() == [0.0, 1.0, 2.0]
    assert back.empty.shape == (0, 3) and (back.tables["grid.table"] == np.eye(2)).all()
    passed_on = saved(back, tmp_path / "two", tmp_path, given)
    assert passed_on["inner"] == document["inner"] and not (tmp_path / "two" / "inner").exists()


@pytest.mark.parametrize(
    "change",
    [
        *({"count": "2"}, {"number": None}, {"flag": 1}, {"inner": {"numbers": 3}}, {"inner": None}),
        *({"tables": {"x": {"stored": "../x.npy"}}}, {"tables": {"x": 1}}),
    ],
)
def test_documents_of_another_form_are_refused(change: dict, tmp_path: Path) -> None:
    document = saved(everything(), tmp_path / "one", tmp_path, {"source": SOURCE})
    with pytest.raises(ValueError):
        loaded({**document, **change}, Everything, tmp_path, {"source": SOURCE})


def not_finite(unknown: bool, value: float) -> Callable[[Path], object]:
    """Writes an array with a value that is no number as output of a stage."""
    kind = record("Rows", rows=list[Gaps if unknown else np.ndarray])
    return lambda root: saved(kind([np.array([1.0, value])]), root / "stage" / "outputs", root, {})


def mapped(folder: Path, values: np.ndarray) -> np.ndarray:
    """An array in a file of a stage's folder."""
    folder.mkdir()
    array = np.lib.format.open_memmap(folder / "made.npy", mode="w+", dtype=values.dtype, shape=values.shape)
    array[:] = values
    return array


@pytest.mark.parametrize(("unknown", "value"), pairs((False, True), (np.nan, np.inf)))
def test_no_array_with_nan_or_infinity_is_stored_unless_nan_stands_for_unknown(
    tmp_path: Path, unknown: bool, value: float
) -> None:
    array = np.array([0.5, value], np.float32)
    kind = record("Values", a=Gaps if unknown else np.ndarray)
    writers: list[Callable[[Path], object]] = [
        not_finite(unknown, value),
        lambda root: write_arrays(root / "a.npz", kind(array)),
    ]
    if not unknown:
        writers += [
            lambda root: write_exr(root / "a.exr", np.tile(array, (2, 1)), half=True),
            lambda root: saved(mapped(root / "stage", array), root / "stage" / "outputs", root, {}),
        ]
    allowed = unknown and np.isnan(value)
    for number, write in enumerate(writers):
        root = tmp_path / str(number)
        root.mkdir()
        if allowed:
            write(root)
        else:
            assert error_of(write, root).code == "not-finite"
            assert {path.name for path in root.rglob("*.*")} <= {"made.npy"}


def test_arrays_of_the_engine_are_written_where_they_are_checked() -> None:
    core = Path(chain_module.__file__).parents[1]
    written = {
        path.relative_to(core).as_posix()
        for path in core.rglob("*.py")
        if re.search(r"np\.save(z|z_compressed)?\b", path.read_text("utf-8"))
    }
    assert written == {"run/store.py"}


def test_a_full_disk_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "save", full)

    def plain(source: list[str]) -> Table:
        return Table(np.zeros((4, 2)), source)

    stages = [Stage("table", plain, "Making"), *STAGES[1:]]
    assert error_of(work, tmp_path, stages=stages).code == "disk-full"


class Clocked:
    """A reporter whose clock is set, and what it has told."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.seconds, self._stream = 0.0, io.StringIO()
        monkeypatch.setattr(messages.time, "monotonic", lambda: self.seconds)
        self.reporter = Reporter(self._stream)

    def told(self) -> list[dict]:
        """The messages of progress."""
        every = [json.loads(line) for line in self._stream.getvalue().splitlines()]
        return [each for each in every if each["type"] == "progress"]

    def left(self, seconds: float, share: float) -> float | None:
        """What is left, as told when so many seconds have passed since the start."""
        self.seconds = seconds
        self.reporter.progress(share, force=True)
        left: float | None = self.told()[-1]["remaining_seconds"]
        return left


def test_a_plan_is_continued_by_the_next_one_and_skipped_stages_tell_nothing_of_the_pace(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = Clocked(monkeypatch)
    clock.reporter.plan([1.0, 9.0])
    clock.reporter.stage("first", "First")
    clock.left(10.0, 1.0)
    clock.reporter.plan([1.0, 1.0, 1.0])
    clock.reporter.skip()
    clock.reporter.stage("second", "Second")
    # In 40 seconds 0.4 were done and not skipped.
    assert clock.left(40.0, 1.0) == pytest.approx(30.0)
    assert [each["fraction"] for each in clock.told()] == [0.0, 0.1, 0.4, 0.7]


def test_what_is_left_follows_from_what_is_expected_and_from_the_rate_of_the_stage(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = Clocked(monkeypatch)
    clock.reporter.plan([0.05, 0.95], 100.0)
    clock.reporter.stage("short", "Expected to take five seconds")
    assert clock.left(0.0, 0.0) == pytest.approx(100.0)  # at once
    # It takes 200: after half of that the stage itself is known well, and all others are not 20 times as long.
    left = clock.left(100.0, 0.5)
    assert left is not None and 150.0 < left < 700.0
    clock.seconds = 200.0
    clock.reporter.stage("long", "Expected to take the rest")
    left = clock.left(300.0, 0.95)
    assert left is not None and 4.0 < left < 8.0  # a twentieth, at this stage's rate


@pytest.mark.parametrize("cores", [None, 1, 2, 500])
def test_results_and_errors_come_in_the_order_of_the_items_and_few_are_read_ahead(
    monkeypatch: pytest.MonkeyPatch, cores: int | None
) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    assert list(in_threads(lambda item: item * item, range(50))) == [item * item for item in range(50)]
    assert list(in_threads(str, [])) == []
    items = iter(range(100))
    assert next(in_threads(str, items)) == "0" and next(items) <= MOST_THREADS + 1
    with pytest.raises(ZeroDivisionError):
        list(in_threads(lambda item: 1 / item, [1, 0, 2]))


def test_a_property_is_computed_once_by_all_threads_together() -> None:
    class Thing:
        computed = 0

        @cached_property
        def number(self) -> int:
            self.computed += 1
            time.sleep(0.05)  # long enough for all threads to ask
            return 7

    thing, ready = Thing(), threading.Barrier(4)

    def ask(_: int) -> int:
        ready.wait()
        return thing.number

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(ask, range(4))) == [7] * 4
    assert thing.computed == 1
