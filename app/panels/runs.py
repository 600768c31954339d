"""The list of runs in the Refine tab: look at one, compare it, take its cameras again."""

import viser

from app.control.controller import Controller
from app.model.markup import in_markdown
from app.model.run import Run
from app.model.session import looking_at, setting
from app.model.state import State
from app.web.controls import guarded, put, put_value
from photoreg.errors import RefinementError
from photoreg.geometry.camera import same_camera
from photoreg.words import in_words, number

NOTHING = "No run yet"
ITS_START = "Its own start"


class RunsPanel:
    """The runs that have ended."""

    def __init__(self, gui: viser.GuiApi, controller: Controller) -> None:
        session = controller.session
        self._folder = gui.add_folder("Runs", expand_by_default=False)
        with self._folder:
            self._table = gui.add_markdown("")
            self._choice: viser.GuiDropdownHandle[str] = gui.add_dropdown(
                "Run", [NOTHING], hint="One of the runs in the table."
            )
            self._look = gui.add_button(
                "Look at it",
                icon=viser.Icon.EYE,
                hint="Shows its cameras; you may accept them, or leave all as it is.",
            )
            self._other: viser.GuiDropdownHandle[str] = gui.add_dropdown(
                "Compare with",
                [ITS_START],
                hint="What is left of the line in the picture at the left.",
            )

        @self._look.on_click
        @guarded
        def _(_: viser.GuiEvent) -> None:
            chosen = _number(self._choice.value)
            if chosen == 0:
                raise RefinementError("There is no run to look at yet.")
            session.change(None, looking_at(chosen))

        @self._other.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            session.change(None, setting(compared_with=_number(self._other.value)))

    def show(self, state: State) -> None:
        """Makes the list as ``state`` has it."""
        names = tuple(_name(run) for run in reversed(state.runs))
        put(self._folder, "visible", bool(names))
        if not names:
            return
        if self._choice.options != names:
            self._choice.options = names
        others = (ITS_START, *names)
        if self._other.options != others:
            self._other.options = others
        chosen = next(
            (n for n in others if _number(n) == state.compared_with), ITS_START
        )
        put_value(self._other, chosen)
        put(self._other, "visible", state.run.status == "review")
        put(self._look, "disabled", state.run.is_active)
        put(self._table, "content", table(state))


def table(state: State) -> str:
    """The runs as a table in markdown, the newest first."""
    rows = ["| | settings | seed | cost | px | time |", "|--:|:--|--:|--:|--:|--:|"]
    for run in reversed(state.runs):
        cost = "" if run.cost is None else number(run.cost)
        error = run.error_px if run.error_px is not None else run.told_error_px
        pixels = "" if error is None else f"{error:.2f}"
        seed = run.config.seed if run.config is not None else 0
        mark = " ✓" if in_use(state, run) else ""
        rows.append(
            f"| {in_markdown(run.number)}{mark} | {in_markdown(run.settings_name)} | "
            f"{in_markdown(seed)} | {cost} | {pixels} | "
            f"{in_words(run.elapsed_s)} |"
        )
    note = "\n\n*✓: its cameras are in use. px: true error where it is known, else the expected one.*"
    return "\n".join(rows) + note


def in_use(state: State, run: Run) -> bool:
    """Whether the document has this run's cameras."""
    now = {entry.name: entry.camera for entry in state.document.photos}
    return all(
        name in now and same_camera(now[name], camera)
        for name, camera in zip(run.photo_names, run.cameras, strict=True)
    )


def _name(run: Run) -> str:
    return f"{run.number}: {run.settings_name}, {run.began[11:16]}"


def _number(name: str) -> int:
    first = name.partition(":")[0]
    return int(first) if first.isdigit() else 0
