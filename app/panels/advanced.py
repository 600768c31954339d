"""The Advanced fold of the Refine tab: every setting of a run, made from its dataclass."""

import ast
import dataclasses
import functools
import inspect
import textwrap
import typing
from collections.abc import Sequence
from typing import Any

import viser

from app.model.session import Session, setting
from app.model.state import State
from app.web.controls import guarded, put, put_value
from photoreg.errors import InputError
from photoreg.registration.config import RegistrationConfig


@dataclasses.dataclass(frozen=True)
class Setting:
    """One field of the settings, however deep."""

    path: tuple[str, ...]
    """Names of the fields that lead to it."""
    kind: Any
    """Its type, as annotated."""
    help: str

    @property
    def label(self) -> str:
        """Its name in words."""
        words = self.path[-1].replace("_", " ")
        return words[:1].upper() + words[1:]

    def value(self, config: RegistrationConfig) -> Any:
        """Its value in some settings."""
        return functools.reduce(getattr, self.path, config)

    def changed(self, config: RegistrationConfig, value: Any) -> RegistrationConfig:
        """The settings with another value.

        Raises:
            InputError: if the value is not allowed there.
        """
        return _changed(config, self.path, value)


def _changed(config: Any, path: Sequence[str], value: Any) -> Any:
    first, *rest = path
    if rest:
        value = _changed(getattr(config, first), rest, value)
    return dataclasses.replace(config, **{first: value})


def all_settings(kind: type, path: tuple[str, ...] = ()) -> list[Setting]:
    """Every field of a dataclass and of those within it, in their order."""
    hints, helps = typing.get_type_hints(kind), field_helps(kind)
    found: list[Setting] = []
    for field in dataclasses.fields(kind):
        annotation, place = hints[field.name], (*path, field.name)
        if dataclasses.is_dataclass(annotation):
            assert isinstance(annotation, type)
            found += all_settings(annotation, place)
        else:
            found.append(Setting(place, annotation, helps.get(field.name, "")))
    return found


@functools.cache
def field_helps(kind: type) -> dict[str, str]:
    """The text under each field of a dataclass, which Python itself forgets."""
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    assert isinstance(definition, ast.ClassDef)
    helps = {}
    for field, text in zip(definition.body, definition.body[1:], strict=False):
        if (
            isinstance(field, ast.AnnAssign)
            and isinstance(field.target, ast.Name)
            and isinstance(text, ast.Expr)
            and isinstance(text.value, ast.Constant)
        ):
            helps[field.target.id] = " ".join(str(text.value.value).split())
    return helps


def as_text(value: Any) -> Any:
    """A value as its control holds it: tuples as text."""
    return ", ".join(f"{x:g}" for x in value) if isinstance(value, tuple) else value


def from_text(setting: Setting, entered: Any) -> Any:
    """What was entered as a value of the setting's type.

    Raises:
        InputError: if it is not one.
    """
    kind = setting.kind
    if typing.get_origin(kind) is tuple:
        number = typing.get_args(kind)[0]
        try:
            return tuple(
                number(part) for part in str(entered).split(",") if part.strip()
            )
        except ValueError:
            raise InputError(
                f"{setting.label} should be numbers with commas between them, like "
                f"4, 2, 1, but is {entered!r}."
            ) from None
    if kind is int:
        if float(entered) != round(float(entered)):
            raise InputError(
                f"{setting.label} should be a whole number, but is {entered}."
            )
        return round(float(entered))
    return kind(entered) if kind in (float, bool, str) else entered


class AdvancedPanel:
    """A control for each setting of the next run."""

    def __init__(self, gui: viser.GuiApi, session: Session) -> None:
        self._session = session
        self._controls: list[tuple[Setting, Any]] = []
        self._folder = gui.add_folder("Advanced", expand_by_default=False)
        with self._folder:
            self._text = gui.add_markdown("")
            self._back = gui.add_button(
                "Back to the preset",
                icon=viser.Icon.RESTORE,
                color="gray",
                hint="Every setting as the preset has it.",
            )
            groups: dict[tuple[str, ...], list[Setting]] = {}
            for found in all_settings(RegistrationConfig):
                groups.setdefault(found.path[:-1], []).append(found)
            for path, members in groups.items():
                if not path:
                    self._add(gui, members)
                    continue
                title = path[-1][:1].upper() + path[-1][1:].replace("_", " ")
                with gui.add_folder(title, expand_by_default=False):
                    self._add(gui, members)

        @self._back.on_click
        @guarded
        def _(_: viser.GuiEvent) -> None:
            session.change(None, setting(config=None))

    def show(self, state: State) -> None:
        """Makes the controls as ``state`` has them."""
        config = state.settings
        usual = RegistrationConfig.preset(state.preset)
        for found, control in self._controls:
            put_value(control, as_text(found.value(config)))
            put(control, "disabled", state.run.is_active)
        changed = [
            found.label.lower()
            for found, _ in self._controls
            if found.value(config) != found.value(usual)
        ]
        text = "*Point at a setting to read what it does, its unit and its range.*"
        if changed:
            text = f"Changed against the preset: **{', '.join(changed)}**."
        put(self._text, "content", text)
        put(self._back, "disabled", not changed or state.run.is_active)

    def _add(self, gui: viser.GuiApi, members: list[Setting]) -> None:
        usual = RegistrationConfig()
        for found in members:
            value = as_text(found.value(usual))
            if typing.get_origin(found.kind) is typing.Literal:
                control: Any = gui.add_dropdown(
                    found.label,
                    typing.get_args(found.kind),
                    initial_value=value,
                    hint=found.help,
                )
            elif found.kind is bool:
                control = gui.add_checkbox(found.label, value, hint=found.help)
            elif found.kind in (int, float):
                # The step says how many digits the box shows.
                step = 1 if found.kind is int else 1e-4
                control = gui.add_number(found.label, value, step=step, hint=found.help)
            else:
                control = gui.add_text(found.label, value, hint=found.help)
            self._controls.append((found, control))
            self._listen(found, control)

    def _listen(self, found: Setting, control: Any) -> None:
        @control.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            state = self._session.state
            try:
                value = from_text(found, control.value)
                config = found.changed(state.settings, value)
            except (InputError, ValueError) as error:
                control.value = as_text(found.value(state.settings))
                raise InputError(f"{error} The setting stays as it was.") from error
            if config != state.settings:
                self._session.change(None, setting(config=config))
