"""The project in the Data tab: its name and place, new, open, save as, files to find."""

import contextlib
from collections.abc import Callable, Iterator

import viser

from app.control import user_data
from app.control.controller import Controller
from app.control.projects import NOT_KEPT
from app.model.formatting import shortened
from app.model.markup import escaped
from app.model.state import State, WaitingProject
from app.web.controls import confirm, guarded, guarded_slow, put, put_value
from app.web.widgets import help_line
from photoreg.errors import InputError, OutputError, PhotoregError
from photoreg.project.files import FileProblem
from photoreg.project.folder import FolderInUseError

MAX_SHOWN = 6
"""How many of the projects opened lately are offered."""
LABEL_CHARACTERS, BUTTON_CHARACTERS = 24, 36
"""How much of a project's name there is room for; its folder is told whole below."""


class ProjectPanel:
    """Where the work is kept, and the ways to another project."""

    def __init__(self, gui: viser.GuiApi, controller: Controller) -> None:
        self._projects, self._session = controller.projects, controller.session
        self._asked: FileProblem | None = None
        # A folder without a heading: viser shows an upload button whatever it is told.
        with gui.add_folder(None, visible=False) as self._asking:
            self._question = gui.add_html("")
            self._path = gui.add_text(
                "It is now at", "", hint="The path of the file, or of its folder."
            )
            self._look = gui.add_button(
                "Look there",
                icon=viser.Icon.SEARCH,
                hint="Takes the file from the path above.",
            )
            self._upload = gui.add_upload_button(
                "Bring it from this computer",
                icon=viser.Icon.UPLOAD,
                hint="Sends the file from the computer that this page is open on.",
            )
            self._change = gui.add_button(
                "Use the changed file",
                icon=viser.Icon.FILE_ALERT,
                hint="Goes on with the file as it is now.",
            )
            self._leave = gui.add_button(
                "Leave this project closed",
                color="gray",
                hint="Stays with what is open now; nothing is changed.",
            )
        with gui.add_folder("Project", expand_by_default=False) as self._folder:
            self._facts = gui.add_html("")
            self._new = gui.add_button(
                "New project",
                icon=viser.Icon.FILE_PLUS,
                color="gray",
                hint="Begins an empty project. What is open now is kept.",
            )
            self._open = gui.add_button(
                "Open a project",
                icon=viser.Icon.FOLDER_OPEN,
                color="gray",
                hint="Goes on with another project. What is open now is kept.",
            )
            self._save = gui.add_button(
                "Save as",
                icon=viser.Icon.COPY,
                color="gray",
                hint="Copies the project to another folder, and goes on there.",
            )

        self._new.on_click(guarded(lambda event: self._ask_new(event.client)))
        self._open.on_click(guarded(lambda event: self._ask_open(event.client)))
        self._save.on_click(guarded(lambda event: self._ask_save(event.client)))
        self._leave.on_click(guarded_slow(lambda _: self._projects.cancel()))

        @self._look.on_click
        @guarded_slow
        def _(event: viser.GuiEvent) -> None:
            assert event.client is not None
            self._locate(event.client, self._problem(), self._path.value.strip())

        @self._change.on_click
        @guarded_slow
        def _(_: viser.GuiEvent) -> None:
            problem = self._problem()
            self._projects.locate(problem, problem.path, changed=True)

        @self._upload.on_upload
        @guarded_slow
        def _(event: viser.GuiEvent) -> None:
            assert event.client is not None
            file, problem = event.target.value, self._problem()
            path = self._projects.locate_upload(problem, file.name, file.content)
            self._locate(event.client, problem, str(path))

    # What is asked for.

    def _ask_new(self, client: viser.ClientHandle) -> None:
        question = _Question(client, "New project")
        with question.modal:
            name = client.gui.add_text("Name", "")
            client.gui.add_html(
                help_line(
                    "A name, or the whole path of a new folder; empty: named after the "
                    "day. The project that is open now stays as it is."
                )
            )

            def make() -> None:
                text = name.value.strip()
                with _offering_another(name):
                    self._projects.new(
                        folder=user_data.folder_named(text) if text else None
                    )

            question.end("Create", make)

    def _ask_open(self, client: viser.ClientHandle) -> None:
        now = self._session.state.project
        folders = [folder for folder in user_data.recent() if folder != now]
        question = _Question(client, "Open a project")
        with question.modal:
            for folder in folders[:MAX_SHOWN]:
                button = client.gui.add_button(
                    shortened(folder.name, BUTTON_CHARACTERS),
                    icon=viser.Icon.FOLDER_OPEN,
                    color="gray",
                )
                client.gui.add_html(help_line(escaped(str(folder))))
                question.answer(
                    button, lambda folder=folder: self._projects.open(folder)
                )
            name = client.gui.add_text("Or another", "")
            client.gui.add_html(
                help_line(
                    "Its name, or the whole path of its folder. What is open now is "
                    "kept already."
                )
            )
            question.end(
                "Open",
                lambda: self._projects.open(user_data.folder_named(name.value)),
            )

    def _ask_save(self, client: viser.ClientHandle) -> None:
        question = _Question(client, "Save as")
        with question.modal:
            name = client.gui.add_text("Name", "")
            client.gui.add_html(
                help_line(
                    "A name, or the whole path of a new folder. The work goes on in the "
                    "copy; the project as it is now stays."
                )
            )
            gather = client.gui.add_checkbox("Copy files too", False)
            client.gui.add_html(
                help_line("To take it along: it then needs nothing outside its folder.")
            )

            def save() -> None:
                with _offering_another(name):
                    self._projects.save_as(
                        user_data.folder_named(name.value), gather.value
                    )

            question.end("Save", save)

    def _problem(self) -> FileProblem:
        waiting = self._session.state.waiting
        if waiting is None:
            raise InputError("No file is being looked for any more.")
        return waiting.problems[0]

    def _locate(
        self, client: viser.ClientHandle, problem: FileProblem, path: str
    ) -> None:
        if self._projects.is_same(problem, path):
            self._projects.locate(problem, path, changed=False)
            return
        confirm(
            client,
            "Not the same content",
            f"{path} is not the same as {problem.path.name} was when it was last used. "
            "The cameras were placed on what it was, and may not fit.",
            "Use it all the same",
            lambda: self._projects.locate(problem, path, changed=True),
        )

    # What is shown.

    def show(self, state: State) -> None:
        """Makes the panel as ``state`` has it."""
        self._show_question(state.waiting)
        project = state.project
        busy = state.run.is_active or state.job is not None
        for button in (self._new, self._open, self._save):
            put(button, "disabled", busy)
        if project is None:
            name, facts = "not kept", escaped(state.saving or NOT_KEPT)
        else:
            name = project.name
            facts = f"In {escaped(str(project))}.<br>" + (
                "Open to look at only; the line at the top says why."
                if state.read_only
                else "Everything is kept as you work, undo included."
            )
        put(self._folder, "label", f"Project: {shortened(name, LABEL_CHARACTERS)}")
        put(self._facts, "content", help_line(f'<div style="height:4px"></div>{facts}'))

    def _show_question(self, waiting: WaitingProject | None) -> None:
        put(self._asking, "visible", waiting is not None)
        if waiting is not None:
            put(self._question, "content", _question(waiting))
            put(self._change, "visible", waiting.problems[0].kind == "changed")
        asked = None if waiting is None else waiting.problems[0]
        if asked != self._asked:
            self._asked = asked
            put_value(self._path, "")  # What was typed was about another file.


def _question(waiting: WaitingProject) -> str:
    problem, n_files = waiting.problems[0], len(waiting.problems)
    count = f" ({n_files} files to find)" if n_files > 1 else ""
    what = {
        "missing": "Type where it is now, or its folder; what else is missing is looked "
        "for there too.",
        "changed": "Use it as it is now, or say where the file is that has the old "
        "content.",
    }[problem.kind]
    return (
        '<div style="margin:10px 12px 8px;padding:10px 12px;border-radius:6px;'
        "background:rgba(232,163,61,.16);border-left:3px solid #e8a33d;font-size:13px;"
        'line-height:1.4;overflow-wrap:anywhere"><b>Before '
        f"{escaped(waiting.name)} opens{count}</b><br>{escaped(problem.sentence)} {what}"
        "</div>"
    )


@contextlib.contextmanager
def _offering_another(name: viser.GuiInputHandle[str]) -> Iterator[None]:
    """Where other things are in a folder, a free one in it stands in the name then."""
    try:
        yield
    except FolderInUseError as error:
        name.value = str(error.suggestion)
        raise OutputError(
            f"{error.folder} holds other files already, and a project is kept in a "
            "folder of its own. The name above is now that of a new folder in it: "
            "press again to use that, or type another."
        ) from error


class _Question:
    """A question to one browser. It stays until an answer could be followed."""

    def __init__(self, client: viser.ClientHandle, title: str) -> None:
        self._gui = client.gui
        self.modal = client.gui.add_modal(title)
        self._objection: viser.GuiHtmlHandle | None = None

    def end(self, yes: str, then: Callable[[], object]) -> None:
        """The last two buttons, and above them room for what speaks against an answer."""
        self._objection = self._gui.add_html("", visible=False)
        self.answer(self._gui.add_button(yes), then)
        self.answer(self._gui.add_button("Cancel", color="gray"), lambda: None)

    def answer(self, button: viser.GuiButtonHandle, then: Callable[[], object]) -> None:
        """Has a button do something, which may take long, and then close the question."""

        @button.on_click
        @guarded_slow
        def _(_: viser.GuiEvent) -> None:
            button.disabled = True
            try:
                then()
            except PhotoregError as error:
                assert self._objection is not None
                self._objection.content = _objection_html(str(error))
                self._objection.visible = True
            else:
                self.modal.close()
            finally:
                if not self.modal.closed:
                    button.disabled = False


def _objection_html(sentence: str) -> str:
    return (
        '<div role="alert" style="margin:2px 12px 10px;padding:8px 10px;border-radius:'
        "6px;background:rgba(229,72,77,.16);border-left:3px solid #e5484d;"
        f'font-size:13px;line-height:1.4;overflow-wrap:anywhere">{escaped(sentence)}'
        "</div>"
    )
