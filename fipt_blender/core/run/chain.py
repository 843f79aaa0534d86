"""A computation as a chain of stages, which is resumed after a kill or with other settings.

A stage is a pure function, whose signature says what it takes. A parameter is the output of that name of the
last stage before it, or a value that the chain was given; `settings` is a dataclass of settings, and `tools`
is :class:`Tools`. What it returns is a frozen dataclass, whose fields are its outputs, or one output. Its key
is a hash of its code, of the settings that it reads and of the keys of what it takes; a stage is done again
when its key changes. The chain keeps the outputs (:mod:`.store`), gives a stage
that was interrupted its finished views back, repeats warnings, and does again what can't be read.
"""

from __future__ import annotations

import inspect
import json
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from .declared import declared
from .documents import read_document
from .errors import FiptError, Problem
from .finished_views import FinishedViews
from .messages import Progress, Reporter, within
from .method import code_digest, digest
from .per_view import LocalWorkers, Workers
from .result_contents import Stages
from .runfolder import explained_write_errors, write_json
from .settings import Settings
from .stage_settings import chosen
from .store import DamagedStage, loaded, saved

_DOCUMENT, _FINISHED = "outputs.json", "finished.json"
_NOT_TAKEN = ("settings", "tools")  # parameters that are no values of the chain
Target = TypeVar("Target")
Source = tuple[int | None, str]  # the stage that makes an output, and its name; None: a value that was given
Sources = dict[str, Source]  # of parameters


@dataclass(frozen=True)
class Tools:
    """What a stage may use beside what it takes.

    Attributes:
        folder: of the stage: for arrays that do not fit into memory and for unfinished work.
        reporter: gets progress and warnings.
        workers: do the work that each view needs for itself.
        finished: views that an interrupted run has finished.
        facts: the stage's entry in the statistics, such as the number of `rays`.
    """

    folder: Path
    reporter: Reporter
    workers: Workers
    finished: FinishedViews
    facts: dict[str, Any]

    def progress_within(self, begin: float, end: float) -> Progress:
        """Progress of a piece of work that takes the stage from the share `begin` to `end`."""
        return within(self.reporter.progress, begin, end)


@dataclass(frozen=True)
class Stage:
    """A stage of a chain.

    Attributes:
        name: in files and messages.
        work: the function; see the module.
        text: what it does, for the user; "" if the outputs are quick to make and are not kept.
        cost: expected time relative to other stages, for the progress bar only.
        gives: name of its one output; "" where it returns a dataclass of several.
        takes: names of values by the parameters that are called otherwise.
        replaces: a stage whose files are removed when this one begins; nothing that follows needs them.
    """

    name: str
    work: Callable[..., Any]
    text: str = ""
    cost: float = 0.0
    gives: str = ""
    takes: Mapping[str, str] = field(default_factory=dict)
    replaces: str = ""

    @cached_property
    def types(self) -> dict[str, Any]:
        """Of the parameters, and of what it returns, ``return``."""
        return get_type_hints(self.work)

    @cached_property
    def outputs(self) -> set[str]:
        """Their names."""
        return {self.gives} if self.gives else {item.name for item in fields(self.types["return"])}

    def by_name(self, made: Any) -> dict[str, Any]:
        """The outputs, of what the function has returned."""
        return {self.gives: made} if self.gives else {name: getattr(made, name) for name in self.outputs}


@dataclass(frozen=True, eq=False)
class Given:
    """A value that a chain starts from, and the key that changes with it."""

    value: Any
    key: str


class Watch:
    """Is told of the stages that have a text; does nothing by itself."""

    def before(self, name: str) -> None:
        """A stage begins, or would if it were not done."""

    def after(self, name: str, new: bool) -> None:
        """A stage has ended; `new`: it was done just now."""


class Chain:
    """A chain of stages on a folder.

    Args:
        stages: in their order.
        given: the values that it starts from, by name.
        settings: of the run.
        folder: for the files of all stages; those of other keys are removed.
        reporter: gets stages, progress and warnings.
        workers: None: this process.
        afterwards: cost of what follows the chain, for the progress bar.
    """

    def __init__(
        self,
        stages: Sequence[Stage],
        given: Mapping[str, Given],
        settings: Settings,
        folder: Path,
        reporter: Reporter,
        workers: Workers | None = None,
        afterwards: float = 0.0,
    ) -> None:
        self._afterwards = afterwards
        self.stages, self.given, self.settings = list(stages), dict(given), settings
        self._reporter, self._workers = reporter, workers or LocalWorkers()
        self._values = {name: each.value for name, each in given.items()}
        self._outputs: dict[Source, Any] = {}
        self._places = {stage.name: index for index, stage in enumerate(stages)}
        self._sources = [self._sources_of(stage.work, stage.takes, i) for i, stage in enumerate(stages)]
        for index, stage in enumerate(stages):
            later = {of for sources in self._sources[index:] for of, _ in sources.values()}
            if self._places.get(stage.replaces) in later - {None}:
                raise TypeError(f"{stage.replaces} is needed after {stage.name} has replaced it")
        self._keys: list[str] = []
        for index in range(len(stages)):
            self._keys.append(self._key(index))
        self._root = folder.resolve()
        self._path = self._root / "stages.json"
        self._data: dict[str, Any] = {}

    # What each stage takes

    def _maker(self, name: str, before: int) -> int | None:
        """The last stage before another one that makes an output; None where none does."""
        return next((i for i in reversed(range(before)) if name in self.stages[i].outputs), None)

    def _sources_of(self, work: Callable[..., Any], takes: Mapping[str, str], before: int) -> Sources:
        """For each parameter what it is taken from; those with a default may have nothing."""
        found: Sources = {}
        for parameter, item in inspect.signature(work).parameters.items():
            name = takes.get(parameter, parameter)
            maker = self._maker(name, before)
            if parameter in _NOT_TAKEN:
                continue
            if maker is not None or name in self.given:
                found[parameter] = maker, name
            elif item.default is inspect.Parameter.empty:
                raise TypeError(f"nothing before stage {before} makes {name}")
        return found

    def _key(self, index: int) -> str:
        stage = self.stages[index]
        sources = {
            parameter: [name, self.given[name].key if of is None else self._keys[of]]
            for parameter, (of, name) in self._sources[index].items()
        }
        options = declared(stage.types["settings"]) if "settings" in stage.types else {}
        read = {name: getattr(self.settings, name) for name, item in options.items() if item.option.keyed}
        return digest(code_digest(stage.work.__module__), stage.name, sources, read)

    def _kept(self, index: int) -> bool:
        return bool(self.stages[index].text)

    # What an earlier run has left

    def _open(self) -> None:
        keys = {stage.name: key for stage, key in zip(self.stages, self._keys, strict=True) if stage.text}
        before = Stages({}, {}, {})
        try:
            if self._path.exists():
                before = read_document(self._path, Stages)
        except FiptError as error:
            self._warn_of_damage(error.text)
        valid = {name: key for name, key in keys.items() if before.keys.get(name) == key}
        done = [name for name in keys if name in before.stages and name in valid]
        self._data = {
            "keys": keys,
            "stages": {name: before.stages[name] for name in done},
            "warnings": {name: list(map(asdict, before.warnings.get(name, ()))) for name in done},
            "dropped": [name for name in before.dropped if name in done],
        }
        self._root.mkdir(parents=True, exist_ok=True)
        if self._path.exists():
            write_json(self._path, {**self._data, "keys": valid})  # first: it never lists what is gone
        for path in self._root.iterdir():
            if path.is_dir() and path.name not in valid:
                shutil.rmtree(path)
        write_json(self._path, self._data)

    def _done(self, index: int) -> bool:
        return self.stages[index].name in self._data["stages"]

    # Work

    def run(self, target: type[Target], watch: Watch | None = None) -> Target:
        """Do all stages that are not done, and return what `target` takes of their outputs, like a stage.

        Args:
            target: a dataclass, whose fields are filled like parameters.
            watch: is told of the stages.
        """
        with explained_write_errors(self._root):
            self._open()
        sources = self._sources_of(target, {}, len(self.stages))
        damaged: set[str] = set()
        while True:
            try:
                with explained_write_errors(self._root):
                    self._do_all(sources, watch or Watch())
                    return target(**self._taken(sources))
            except DamagedStage as damage:
                if damage.stage in damaged:  # its files can't be kept here
                    raise FiptError("file-damaged.run", damage=str(damage)) from None
                damaged.add(damage.stage)
                self._warn_of_damage(str(damage))
                self._outputs.clear()
                self._data["stages"].pop(damage.stage, None)
                write_json(self._path, self._data)
                shutil.rmtree(self._root / damage.stage, ignore_errors=True)

    def value(self, name: str, after: str) -> Any:
        """The output of this name as it is after a stage; made where it is not kept."""
        index = self._maker(name, self._places[after] + 1)
        assert index is not None, name
        return self._output(index, name)

    def key(self, name: str) -> str:
        """The key of the stage that makes the last output of this name."""
        index = self._maker(name, len(self.stages))
        return self.given[name].key if index is None else self._keys[index]

    def facts(self) -> list[dict[str, Any]]:
        """The facts of all finished stages in order, each with its name."""
        listed = [stage.name for stage in self.stages if stage.name in self._data["stages"]]
        return [{"name": name, **self._data["stages"][name]} for name in listed]

    def _do_all(self, target: Sources, watch: Watch) -> None:
        kept = [index for index in range(len(self.stages)) if self._kept(index)]
        due = self._due(target)
        last_use = self._last_uses(target)
        afterwards = [self._afterwards] if self._afterwards else []
        self._reporter.plan([*(self.stages[index].cost for index in kept), *afterwards])
        for index in kept:
            watch.before(self.stages[index].name)
            if index in due:
                self._do_kept(index)
            else:
                self._reporter.skip()
                for warning in self._data["warnings"][self.stages[index].name]:
                    if warning not in self._reporter.warnings:  # after damage all stages come by once more
                        self._reporter.warn(Problem(**warning))
            watch.after(self.stages[index].name, index in due)
            for output in [each for each in self._outputs if last_use.get(each, -1) <= index]:
                del self._outputs[output]

    def _due(self, target: Sources) -> set[int]:
        """The stages to do: those that are not done, and those that they need and whose files are removed."""
        due: set[int] = set()

        def demand(sources: Sources) -> None:
            for of, _ in sources.values():
                if of is not None:
                    visit(of)

        def visit(index: int) -> None:
            if self._kept(index):
                dropped = self.stages[index].name in self._data["dropped"]
                if index in due or (self._done(index) and not dropped):
                    return
                due.add(index)
            demand(self._sources[index])

        demand(target)
        for index in range(len(self.stages)):
            if self._kept(index) and not self._done(index):
                visit(index)
        return due

    def _last_uses(self, target: Sources) -> dict[Source, int]:
        """For each output the last stage with files of its own that takes it, maybe through others."""
        end = len(self.stages)
        last = dict.fromkeys(target.values(), end)
        for index in reversed(range(end)):
            use = index
            if not self._kept(index):
                use = max((place for (of, _), place in last.items() if of == index), default=-1)
            for source in self._sources[index].values():
                last[source] = max(last.get(source, -1), use)
        return last

    def _do_kept(self, index: int) -> None:
        stage = self.stages[index]
        self._reporter.stage(stage.name, stage.text)
        if stage.replaces and stage.replaces in self._data["stages"]:
            replaced = self._places[stage.replaces]
            for output in [each for each in self._outputs if each[0] == replaced]:
                del self._outputs[output]
            if stage.replaces not in self._data["dropped"]:
                self._data["dropped"].append(stage.replaces)
            write_json(self._path, self._data)
            shutil.rmtree(self._root / stage.replaces, ignore_errors=True)
        started, warned = time.monotonic(), len(self._reporter.warnings)
        outputs, facts = self._work(index)
        folder = self._root / stage.name
        write_json(folder / _DOCUMENT, saved(outputs, folder / "outputs", self._root, self._values))
        for path in (folder / _FINISHED, *folder.glob("unfinished*")):
            path.unlink(missing_ok=True)
        seconds = time.monotonic() - started
        facts["seconds"] = round(seconds, 2)
        if facts.get("rays") and seconds > 0.0:
            facts["mrays_per_second"] = round(facts["rays"] / seconds / 1e6, 3)
        name = stage.name
        self._data["stages"][name], self._data["warnings"][name] = facts, self._reporter.warnings[warned:]
        if name in self._data["dropped"]:
            self._data["dropped"].remove(name)
        write_json(self._path, self._data)

    def _work(self, index: int) -> tuple[Any, dict[str, Any]]:
        """The outputs of a stage, made now, and its facts."""
        stage = self.stages[index]
        values = self._taken(self._sources[index])
        folder, facts = self._root / stage.name, dict[str, Any]()
        folder.mkdir(exist_ok=True)
        if "settings" in stage.types:
            values["settings"] = chosen(self.settings, stage.types["settings"])
        if "tools" in stage.types:
            finished = FinishedViews(folder / _FINISHED)
            values["tools"] = Tools(folder, self._reporter, self._workers, finished, facts)
        return stage.work(**values), facts

    def _taken(self, sources: Sources) -> dict[str, Any]:
        """The values of parameters."""
        return {
            parameter: self._values[name] if of is None else self._output(of, name)
            for parameter, (of, name) in sources.items()
        }

    def _output(self, index: int, name: str) -> Any:
        """An output of a stage: read, or made where it is not kept."""
        if (index, name) not in self._outputs:
            made = self._read(index) if self._kept(index) else self._work(index)[0]
            outputs = self.stages[index].by_name(made)
            self._outputs |= {(index, each): value for each, value in outputs.items()}
        return self._outputs[index, name]

    def _read(self, index: int) -> Any:
        stage, path = self.stages[index], self._root / self.stages[index].name / _DOCUMENT
        try:
            return loaded(
                json.loads(path.read_text("utf-8")), stage.types["return"], self._root, self._values
            )
        except (OSError, ValueError, RecursionError) as error:
            raise DamagedStage(stage.name, f"{path} can't be read ({error}).") from None
        except DamagedStage as damage:  # it may have passed on an array of a stage before it
            damage.stage = damage.stage if damage.stage in self._data["stages"] else stage.name
            raise

    def _warn_of_damage(self, text: str) -> None:
        self._reporter.warning("checkpoint-damaged.warn-of-damage", text=text)
