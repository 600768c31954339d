"""Tab 3, Refine: choose, start, watch, pause, stop; accept or revert."""

import viser

from app.control.controller import Controller
from app.model.durations import expected_seconds
from app.model.markup import escaped, in_markdown, opening
from app.model.reducers import has_moved
from app.model.run import PRESET_NAMES, Run
from app.model.session import setting
from app.model.state import State
from app.model.wanted_pictures import current_comparison
from app.panels.advanced import AdvancedPanel
from app.panels.freedom import FreedomPanel
from app.panels.meter import VERDICTS
from app.panels.runs import RunsPanel
from app.web.controls import guarded, guarded_slow, put, put_value
from photoreg.registration.config import PresetName, RegistrationConfig
from photoreg.words import in_words, number

PRESETS: dict[str, PresetName] = {name: key for key, name in PRESET_NAMES.items()}
PRESET_HELP: dict[PresetName, str] = {
    "default": "Search, then polish: right for most starts.",
    "fast": "A short search and polish, for a first look.",
    "thorough": "A wider search, for very rough starts.",
    "paper": "The genetic algorithm of the paper alone, as published.",
}
FIND = "Find the cameras and refine"
FIND_AGAIN = f"{FIND} again"
NEXT_HTML = (
    f'<div class="pr-row"><button title="Opens tab 4, Export" class="pr-option pr-next" '
    f"{opening('4 Export')}>Next: make the texture</button></div>"
)


class RefinePanel:
    """Controls of the Refine tab."""

    def __init__(self, gui: viser.GuiApi, controller: Controller) -> None:
        self._controller = controller
        gui.add_markdown(
            "Moves all cameras together until the photos agree over the whole surface; "
            "one photo's, until it agrees with the surface itself."
        )
        self._preset = gui.add_dropdown(
            "Thoroughness",
            tuple(PRESETS),
            initial_value="Standard",
            hint="How widely and how long cameras are sought.",
        )
        self._preset_help = gui.add_markdown("")
        self._checks = gui.add_markdown("")
        self._start = gui.add_button(
            "Refine",
            icon=viser.Icon.PLAYER_PLAY,
            hint="Starts from the cameras as they are now.",
        )
        self._next = gui.add_html(NEXT_HTML, visible=False)
        self._pause = gui.add_button(
            "Pause",
            icon=viser.Icon.PLAYER_PAUSE,
            color="gray",
            visible=False,
            hint="Halts the run; nothing of it is lost.",
        )
        self._resume = gui.add_button(
            "Resume",
            icon=viser.Icon.PLAYER_PLAY,
            visible=False,
            hint="Goes on with the run that was halted.",
        )
        self._stop = gui.add_button(
            "Stop and keep the best",
            icon=viser.Icon.PLAYER_STOP,
            visible=False,
            hint="Ends the run; you may accept the best cameras it found.",
        )
        self._drop = gui.add_button(
            "Stop and revert",
            icon=viser.Icon.ARROW_BACK_UP,
            color="gray",
            visible=False,
            hint="Ends the run; the cameras are as before it.",
        )
        self._bar = gui.add_progress_bar(0.0, visible=False)
        self._verdict = gui.add_html("", visible=False)
        self._accept = gui.add_button(
            "Accept",
            icon=viser.Icon.CHECK,
            color="teal",
            visible=False,
            hint="Takes the refined cameras; Undo brings the old ones back.",
        )
        self._revert = gui.add_button(
            "Revert",
            icon=viser.Icon.ARROW_BACK_UP,
            color="gray",
            visible=False,
            hint="Leaves the cameras as they were before the run.",
        )
        self._on = gui.add_button(
            "Go on where it was",
            icon=viser.Icon.PLAYER_PLAY,
            visible=False,
            hint="Goes on with the run that was cut short.",
        )
        self._again = gui.add_button(
            "Refine again from here",
            icon=viser.Icon.REPEAT,
            visible=False,
            hint="Takes the refined cameras, and starts another run from them; it searches "
            "wider where they did not convince.",
        )
        self._find = gui.add_button(
            FIND,
            icon=viser.Icon.CAMERA_SEARCH,
            color="gray",
            visible=False,
            hint="Looks for all cameras anew, by the object's outline, and refines from there. "
            "Undo brings those of now back.",
        )
        self._report = gui.add_button(
            "Download report",
            icon=viser.Icon.FILE_DOWNLOAD,
            color="gray",
            visible=False,
            hint="This run as one HTML file, with its pictures and figures.",
        )
        self._text = gui.add_markdown("")
        self._freedom = FreedomPanel(gui, controller.session)
        self._runs = RunsPanel(gui, controller)
        self._advanced = AdvancedPanel(gui, controller.session)
        self._listen()

    def _listen(self) -> None:
        controller, refinement = self._controller, self._controller.refinement

        @self._preset.on_update
        @guarded
        def _(_: viser.GuiEvent) -> None:
            preset = PRESETS[self._preset.value]
            controller.session.change(None, setting(preset=preset, config=None))

        for button, action in (
            (self._start, refinement.start),
            (self._pause, refinement.pause),
            (self._resume, refinement.resume),
            (self._stop, refinement.stop),
            (self._drop, lambda: refinement.stop(revert=True)),
            (self._accept, refinement.accept),
            (self._revert, refinement.revert),
            (self._on, refinement.go_on),
            (self._again, refinement.start_again),
            (self._find, controller.finder.find_and_refine),
        ):
            button.on_click(guarded(lambda _, action=action: action()))

        @self._report.on_click
        @guarded_slow
        def _(event: viser.GuiEvent) -> None:
            name, content = refinement.report()
            if event.client is not None:
                event.client.send_file_download(name, content, save_immediately=True)

    def show(self, state: State) -> None:
        """Makes the controls as ``state`` has them."""
        run = state.run
        idle, review = run.status == "idle", run.status == "review"
        put_value(
            self._preset, next(k for k, v in PRESETS.items() if v == state.preset)
        )
        put(self._preset, "disabled", not idle)
        put(self._preset_help, "content", _preset_help(state))
        ready = state.document.mesh is not None and bool(state.document.used)
        put(self._checks, "content", _checks(state) if idle and ready else "")
        put(self._start, "visible", idle)
        put(self._start, "disabled", not ready or state.job is not None)
        is_next = idle and state.wears_run and state.grade != "unconvincing"
        put(self._next, "visible", is_next)
        stopping = run.status == "stopping"
        paused = run.status == "paused"
        put(self._pause, "visible", run.is_active and not paused)
        put(self._pause, "disabled", stopping)
        put(self._resume, "visible", paused)
        for button in (self._stop, self._drop):
            put(button, "visible", run.is_active)
            put(button, "disabled", stopping)
        put(self._bar, "visible", run.is_active)
        put_value(self._bar, round(100.0 * run.fraction, 1))
        for button in (self._accept, self._revert, self._again, self._report):
            put(button, "visible", review)
        doubtful = review and run.grade == "unconvincing"
        first, second = sorted((self._accept.order, self._revert.order))
        put(self._accept, "order", second if doubtful else first)
        put(self._revert, "order", first if doubtful else second)
        put(self._accept, "label", "Keep anyway" if doubtful else "Accept")
        put(self._accept, "color", "gray" if doubtful else "teal")
        put(self._revert, "color", "teal" if doubtful else "gray")
        put(self._find, "visible", doubtful or (idle and ready and _is_lost(state)))
        put(self._find, "disabled", state.job is not None)
        put(self._find, "label", FIND_AGAIN if doubtful else FIND)
        put(self._on, "visible", state.can_go_on)
        put(self._report, "disabled", current_comparison(state) is None)
        put(self._verdict, "visible", review and bool(run.verdict))
        put(self._verdict, "content", verdict_html(run))
        put(self._text, "content", _report(state, ready))
        self._freedom.show(state)
        self._runs.show(state)
        self._advanced.show(state)


def _is_lost(state: State) -> bool:
    """Whether a camera sees nothing of the surface, or none what another sees."""
    readiness = state.readiness
    if readiness is None or readiness.refusals:
        return False
    return bool(readiness.blind) or not readiness.is_possible


def verdict_html(run: Run) -> str:
    """How far the answer is to be believed, in a box of its own colour."""
    if run.grade is None:
        return ""
    colour, sign = VERDICTS[run.grade]
    word, _, reason = run.verdict.partition(": ")
    return (
        f'<div style="margin:2px 12px 8px;padding:8px 11px;border-radius:7px;'
        f"border-left:4px solid {colour};background:{colour}22;font-size:13px;"
        f'line-height:1.4"><b><span style="color:{colour}">{sign}</span> '
        f"{escaped(word)}</b><br>"
        f"{escaped(reason[:1].upper() + reason[1:])}</div>"
    )


def _preset_help(state: State) -> str:
    """What the preset is for, and what each costs in time on this machine."""
    text = f"*{PRESET_HELP[state.preset]}*"
    speed = state.speed
    if speed is None:
        return text
    seconds = expected_seconds(speed, state.preset, state.settings)
    others = " · ".join(
        f"{name} {in_words(expected_seconds(speed, p, RegistrationConfig.preset(p)))}"
        for name, p in PRESETS.items()
    )
    return (
        f"{text}\n\nAbout **{in_words(seconds)}** on this machine, as measured.\n\n"
        f"*{others}*"
    )


def _checks(state: State) -> str:
    """What can be expected, in plain words."""
    readiness = state.readiness
    if readiness is None:
        return ""
    text = (
        "One photo: it is compared with the shape of the surface, by shading and outline. "
        "A second photo makes the answer surer."
    )
    if readiness.overlap is not None:
        text = "" if readiness.problems else "The photos overlap on the surface."
    return text + "".join(
        f"\n\n⚠ {in_markdown(problem)}" for problem in readiness.problems
    )


def _report(state: State, ready: bool) -> str:
    run = state.run
    if run.status == "idle":
        if not ready:
            return "A mesh and a photo are needed. Load them in the Data tab."
        if run.error_px is not None:
            return (
                f"True error now: **{run.error_px:.2f} px** (the truth is known here)."
            )
        return ""
    if run.status == "review":
        return f"{_outcome(run)}{_table(run)}{_certainty(run)}"
    return f"{_progress(run)}{_table(run)}"


def _outcome(run: Run) -> str:
    took = f" {run.elapsed_s:.1f} s." if run.elapsed_s > 0 else ""
    warnings = "".join(f"\n\n⚠ {in_markdown(warning)}" for warning in run.warnings)
    advice = ""
    if not has_moved(run):
        advice = (
            "\n\nThe cameras are as they were. Align them more closely in tab 2, or try "
            "Thorough."
        )
    outcome = in_markdown(run.outcome)
    return f"**Run {in_markdown(run.number)}.** {outcome}{took}{advice}{warnings}"


def _progress(run: Run) -> str:
    """The phase in words, speed, and time left."""
    words = {"prepare": "Getting ready", "search": "Searching", "polish": "Polishing"}
    phase = words.get(run.phase, "Starting")
    if run.status in ("paused", "stopping"):
        phase = "Paused" if run.status == "paused" else "Stopping"
    step = run.step.removeprefix("polish, ")
    text = f"**{phase}**" + (f": {in_markdown(step)}" if step else "")
    text += f"\n\n{run.elapsed_s:.1f} s at work"
    if run.time_left_s is not None and run.status == "running":
        text += f", about {in_words(run.time_left_s)} left"
    text += f" · {run.evaluations:,} evaluations"
    if run.evaluations_per_s is not None and run.phase == "search":
        text += f", {run.evaluations_per_s:,.0f} a second"
    return text


def _table(run: Run) -> str:
    rows = []
    if run.start_error_px is not None and run.error_px is not None:
        rows.append(
            ("True error", f"{run.start_error_px:.2f}", f"{run.error_px:.2f} px")
        )
    if run.told_error_px is not None:
        rows.append(("Expected error", "", f"{run.told_error_px:.2f} px"))
    elif run.is_active:
        rows.append(("Expected error", "", "once it polishes"))
    if run.is_active and run.curve:
        rows.append(("Cost", "100 %", f"{number(100 * run.curve[-1].best)} %"))
    if not rows:
        return ""
    return "\n\n| | start | now |\n|:--|--:|--:|\n" + "\n".join(
        f"| {name} | {before} | **{after}** |" for name, before, after in rows
    )


def _certainty(run: Run) -> str:
    """How sure each camera is, and what the photos leave open."""
    if not run.standard_errors or run.grade == "unconvincing":
        return ""
    # A number keeps to its unit where a line breaks.
    sentences = [
        words.replace(" %", "\N{NO-BREAK SPACE}%") for words in run.standard_errors
    ]
    sure = "".join(f"\n- {in_markdown(words)}" for words in sentences)
    text = f"\n\n**How sure**\n{sure}"
    if run.undetermined:
        weak = "".join(f"\n- {in_markdown(sentence)}" for sentence in run.undetermined)
        text += (
            "\n\n**The photos leave something open.** If you know one of these, set it in "
            "tab 2 and lock it under What may move. A photo from another side helps, too."
            f"\n{weak}"
        )
    return text
