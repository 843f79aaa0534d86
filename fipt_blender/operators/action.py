"""Operators made from functions.

`@action("Reset Light", needs=own_lights)` above `def reset_light(scene, light: Annotated[str, "..."] = "")`
declares `bpy.ops.fipt.reset_light`: its tooltip is the docstring's first paragraph, its properties are the
annotated parameters. The function can be called from scripts as it is. Its first parameter is `scene` or,
where it needs more, `context`. It raises FiptError, and returns a text or messages to report, or a `Task` to
start.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Annotated, Any, TypeVar

import bpy

from ..core.run.declared import Declared, Option, declared
from ..core.run.errors import FiptError
from ..jobs.tasks import Task, begin
from ..properties.declared import property_of, values_of
from .polls import Condition, all_of

Function = TypeVar("Function", bound=Callable[..., Any])
Operator: Any = object  # a mix-in's view of `bpy.types.Operator`, from which only finished classes may derive
Glob = Annotated[str, Option("Files to show", shown={"options": {"HIDDEN"}})]
Messages = list[dict[str, Any]]  # see `bridge.process.Message`
UNDO = frozenset({"REGISTER", "UNDO"})  # `options` of what changes Blender's data
REGISTER = frozenset({"REGISTER"})
HIDDEN: dict[str, Any] = {"options": {"HIDDEN", "SKIP_SAVE"}}  # `shown` of what only scripts and buttons set
RowIndex = Annotated[int, Option("Number in the list, from 0; the active one if negative", "Index", low=-1)]


def action(
    label: str,
    needs: Sequence[Condition] = (),
    options: Collection[str] = UNDO,
    bases: tuple[type, ...] = (),
    **members: Any,
) -> Callable[[Function], Function]:
    """Declare the operator that calls a function; it becomes the function's attribute `operator`.

    Args:
        label: of buttons.
        needs: conditions for which the button is enabled.
        options: `bl_options`.
        bases: mix-ins, such as `pointer.PicksAlongRay`.
        members: further members of the class, such as `invoke`, which may return `self.run(context)`;
            `listed=False` keeps it out of the menu View > FIPT.
    """

    def declare(function: Function) -> Function:
        name, text = function.__name__, inspect.cleandoc(function.__doc__ or "").partition("\n\n")[0]
        made = {
            "__module__": function.__module__,
            "__doc__": text,
            "__annotations__": {key: _property(item) for key, item in declared(function).items()},
            "bl_idname": f"fipt.{name}",
            "bl_label": label,
            "bl_description": " ".join(text.split()).removesuffix("."),
            "bl_options": set(options),
            "function": staticmethod(function),
            "takes_context": next(iter(inspect.signature(function).parameters)) == "context",
            **({"poll": all_of(*needs)} if needs else {}),
            **members,
        }
        function.operator = type(f"FIPT_OT_{name}", (*bases, Action, bpy.types.Operator), made)  # type: ignore[attr-defined]
        return function

    return declare


class Action(Operator):
    """Base of the classes that `action` makes, and of mix-ins, which gather arguments for its function."""

    function: Callable[..., Any]
    takes_context: bool

    def execute(self, context: bpy.types.Context) -> set[str]:
        return self.run(context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self.run(context, wait=bpy.app.background)

    def run(self, context: bpy.types.Context, wait: bool = True) -> set[str]:
        """Call the function with the operator's properties; `wait` for the end of a job that it starts."""
        values = self.arguments()
        on = context if self.takes_context else context.scene
        return reported(self, context, wait, lambda: self.function(on, **values))

    def arguments(self) -> dict[str, Any]:
        """What the function gets besides scene or context: the operator's properties."""
        return values_of(self, self.function)


class ChoosesFiles(Action):
    """Base of an action on `folder` and `names`: the file browser asks for the files, or they are dropped."""

    directory: bpy.props.StringProperty(subtype="DIR_PATH", **HIDDEN)
    files: bpy.props.CollectionProperty(type=bpy.types.OperatorFileListElement, **HIDDEN)

    def execute(self, context: bpy.types.Context) -> set[str]:
        return self.run(context, wait=bpy.app.background)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self.execute(context) if self.directory else file_dialog(self, context, event)

    def arguments(self) -> dict[str, Any]:
        names = [file.name for file in self.files if file.name]
        return {**super().arguments(), "folder": self.directory, "names": names}


def _property(item: Declared) -> object:
    """A property of an operator, which does not remember its last value."""
    return property_of(item, **({} if "options" in item.option.shown else {"options": {"SKIP_SAVE"}}))


def reported(operator: Any, context: bpy.types.Context, wait: bool, work: Callable[[], object]) -> set[str]:
    """Do what an operator does, and report what it returns or raises; see the module."""
    result = None
    try:
        result = work()
        if isinstance(result, Task):
            return _started(operator, begin(result, context.scene, wait), wait)
    except FiptError as error:
        # Why a job could not start is in its section, too, with what helps: a popup would say it twice.
        shown = isinstance(result, Task) and result.folder is None and not wait
        operator.report({"WARNING" if shown else "ERROR"}, str(error))
        return {"CANCELLED"}
    if isinstance(result, str):
        operator.report({"INFO"}, result)
    elif isinstance(result, Sequence):
        report_messages(operator, result)
    return {"FINISHED"}


def _started(operator: Any, info: Any, wait: bool) -> set[str]:
    if not wait:
        # Nothing has been done yet that could be undone or repeated.
        return {"INTERFACE"}
    report_messages(operator, info.warnings)
    if info.error is not None:
        operator.report({"ERROR"}, f"{info.error['text']} {info.error['remedy']}")
    return {"FINISHED"} if info.state == "finished" else {"CANCELLED"}


def report_messages(operator: Any, messages: Iterable[Mapping[str, Any]]) -> None:
    """Report warnings with their remedies, and notes."""
    for message in messages:
        if message["type"] == "warning":
            operator.report({"WARNING"}, f"{message['text']} {message['remedy']}".strip())
        else:
            operator.report({"INFO"}, message["text"])


def row_index(rows: Any, index: int, active: int) -> int:
    """The place in a list of the row that a property names, the active one if it is negative."""
    index = active if index < 0 else index
    if index >= len(rows):
        raise FiptError("row-missing", index=index, number_of_rows=len(rows))
    return index


def dialog(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
    """An `invoke` that asks for the properties."""
    return context.window_manager.invoke_props_dialog(self)


def file_dialog(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
    """An `invoke` that asks for the property `filepath` or `directory`."""
    context.window_manager.fileselect_add(self)
    return {"RUNNING_MODAL"}


def note(text: str) -> dict[str, Any]:
    """A message that is reported as information."""
    return {"type": "note", "text": text}
