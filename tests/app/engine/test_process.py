"""The worker process, and the controller between it and the state. No browser."""

import dataclasses
import io
import os
import queue
import signal
import threading
from collections.abc import Iterator
from multiprocessing.reduction import ForkingPickler
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from app.control.controller import Controller
from app.engine.agreement_meter import AgreementMeter
from app.engine.client import Worker, newest
from app.engine.overlay_job import Drawing
from app.engine.picture_stream import PictureStream
from app.engine.refine_job import Preparation, RefineJob
from app.model import session as rules
from app.model.masks import encode_mask
from app.model.messages import (
    Event,
    Failed,
    Job,
    Live,
    MeasureReach,
    Ready,
    Refine,
    Refined,
    SetScene,
    Stop,
    SurfaceDrawn,
    Watch,
)
from app.model.pictures import OverlayView, Picture
from app.model.session import Session, with_entry
from app.model.state import Document, ModelChoice, PhotoEntry, State
from app.model.undo_history import UndoStep
from photoreg.errors import InputError, RefinementError
from photoreg.geometry.camera import same_camera
from photoreg.registration.config import RegistrationConfig
from photoreg.registration.events import Finished
from photoreg.registration.refinement import refine
from photoreg.report.cost_curve import CurvePoint
from photoreg.synthetic.options import SceneOptions
from photoreg.synthetic.scene import Scene, make_scene
from photoreg.texture.config import TextureConfig
from tests.browser.driver import wait_until

VIEW = OverlayView(style="blend", onto=0)
FAST = RegistrationConfig.preset("fast")
THOROUGH = RegistrationConfig.preset("thorough")


class Listener:
    """Collects a worker's events and waits for the one wanted."""

    def __init__(self) -> None:
        self.events: queue.Queue[Event] = queue.Queue()

    def wait_for(self, kind: type, timeout_s: float = 90.0) -> Any:
        while True:
            event = self.events.get(timeout=timeout_s)
            if isinstance(event, kind):
                return event
            assert not isinstance(event, Failed), event.message + event.details


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Small, but true: a rock, two photos of it, and cameras 4 to 6 px off."""
    return make_scene(
        SceneOptions(kind="clean", width=320, height=240, error_px=(4.0, 6.0))
    )


@pytest.fixture(scope="module")
def direct(scene) -> Finished:
    """What the engine by itself makes of the scene with the preset fast."""
    *_, last = refine(scene.mesh, scene.photos, scene.rough_cameras, FAST)
    assert isinstance(last, Finished)
    return last


@pytest.fixture(scope="module")
def shared() -> Iterator[tuple[Worker, Listener]]:
    """One worker for the tests that leave it alive."""
    listener = Listener()
    worker = Worker(listener.events.put, warm_up=False)
    listener.wait_for(Ready)
    yield worker, listener
    worker.close()


@pytest.mark.workqueue
def test_the_worker_s_answer_is_the_engine_s_to_the_bit(shared, scene, direct):
    worker, listener = shared
    mesh, photos, cameras = scene.mesh, scene.photos, scene.cameras
    start = scene.rough_cameras
    worker.send(
        SetScene(mesh, photos),
        Refine(cameras=start, config=FAST, view=VIEW, truth=cameras),
    )
    refined = listener.wait_for(Refined)
    for ours, own in zip(refined.cameras, direct.cameras, strict=True):
        assert np.array_equal(ours.P, own.P)
    assert refined.finished.cost == direct.cost
    assert refined.error_px < 0.5 * refined.start_error_px


def test_a_run_begun_in_spare_time_has_the_same_answer_and_counts_no_idle_time(
    scene, direct
):
    mesh, photos, start = scene.mesh, scene.photos, scene.rough_cameras
    job = Refine(cameras=start, config=FAST, view=VIEW, truth=None)
    preparation = Preparation(mesh, photos, start, FAST, job.freedom)
    assert preparation.is_for(job)
    nudged = np.nextafter(start[0].t_cam_world, np.inf)
    moved = (dataclasses.replace(start[0], t_cam_world=nudged), *start[1:])
    assert not preparation.is_for(dataclasses.replace(job, cameras=moved))
    assert not preparation.is_for(dataclasses.replace(job, config=THOROUGH))
    events: list[Event] = []
    RefineJob(
        job, mesh, photos, Drawing(mesh, photos), PictureStream(events.append),
        lambda _: None, events.append, preparation,
    ).run(lambda _: iter(()))  # fmt: skip
    refined = events[-1]
    assert isinstance(refined, Refined)
    for ours, own in zip(refined.cameras, direct.cameras, strict=True):
        assert np.array_equal(ours.P, own.P)
    assert refined.paused_s > 0.0, "it stood still until it was wanted"


def test_of_a_run_that_nobody_watches_nothing_is_drawn(shared, scene):
    worker, listener = shared
    worker.send(Watch(False), SetScene(scene.mesh, scene.photos))
    worker.send(
        Refine(cameras=scene.rough_cameras, config=THOROUGH, view=VIEW, truth=None)
    )
    told: list[Event] = []
    while sum(isinstance(event, Live) for event in told) < 8:
        told.append(listener.events.get(timeout=90.0))
    assert not any(isinstance(event, Picture | SurfaceDrawn) for event in told)
    worker.send(Watch(True))
    listener.wait_for(Picture)
    worker.stop_refinement()
    listener.wait_for(Refined)


def test_a_picture_stream_without_memory_to_say_so_keeps_nobody_waiting(scene):
    sent: list[Event] = []
    tried, has_memory, finished = (threading.Event() for _ in range(3))

    def send(event: Event) -> None:
        tried.set()
        if not has_memory.is_set():
            raise MemoryError
        sent.append(event)

    stream, drawing = PictureStream(send), Drawing(scene.mesh, scene.photos)

    def finish() -> None:
        stream.finish()
        finished.set()

    stream.offer(drawing, scene.cameras, VIEW, None)
    assert tried.wait(60.0)
    threading.Thread(target=finish, daemon=True).start()
    assert finished.wait(20.0)
    has_memory.set()
    stream.offer(drawing, scene.cameras, VIEW, None)
    wait_until(lambda: sent, "the next picture is drawn")
    assert isinstance(sent[0], Picture)


def test_stop_ends_the_run_with_the_best_so_far(shared, scene):
    worker, listener = shared
    start = scene.rough_cameras
    worker.send(SetScene(scene.mesh, scene.photos))
    worker.send(Refine(cameras=start, config=THOROUGH, view=VIEW, truth=None))
    lives = [listener.wait_for(Live)]
    while not lives[-1].curve or lives[-1].curve[-1].best > 0.9:
        lives.append(listener.wait_for(Live))
    worker.stop_refinement()
    refined = listener.wait_for(Refined)
    assert refined.finished is None
    assert refined.error_px is None
    assert any(
        not same_camera(a, b) for a, b in zip(refined.cameras, start, strict=True)
    )


@pytest.mark.workqueue
def test_pictures_come_while_the_search_runs(shared, scene):
    worker, listener = shared
    job = Refine(
        cameras=scene.rough_cameras, config=THOROUGH, view=VIEW, truth=scene.cameras
    )
    worker.send(SetScene(scene.mesh, scene.photos), job)
    pictures = [listener.wait_for(Picture) for _ in range(3)]
    worker.send(OverlayView(style="difference", onto=1))
    pictures += [listener.wait_for(Picture) for _ in range(3)]
    worker.stop_refinement()
    listener.wait_for(Refined)
    images = [np.asarray(Image.open(io.BytesIO(p.jpeg))) for p in pictures]
    assert {image.shape for image in images} == {(240, 320, 3)}
    change = np.abs(images[0].astype(int) - images[-1]).mean()
    assert change > 1.0, f"the pictures differ by {change:.2f} only"
    assert all(p.error_px is not None and p.error_px > 0.0 for p in pictures)


def test_a_stop_that_comes_too_late_does_no_harm(shared, scene):
    worker, listener = shared
    worker.send(Stop(), SetScene(scene.mesh, scene.photos))
    worker.send(Refine(cameras=scene.rough_cameras, config=FAST, view=VIEW, truth=None))
    assert listener.wait_for(Refined).finished is not None


def test_of_passing_events_the_newest_is_told_and_the_curve_is_whole():
    a, b, c = (CurvePoint(i, 1.0, 1.0) for i in range(3))
    pictures = [Picture(bytes([i]), None) for i in range(3)]
    end = Refined((), None, None, None)
    live, told_end, picture = newest(
        [Live(1, (a,)), pictures[0], Live(2, (b, c)), pictures[1], end, pictures[2]]
    )
    assert isinstance(live, Live)
    assert (live.progress, live.curve) == (2, (a, b, c))
    assert told_end is end
    assert picture is pictures[2]


@pytest.fixture(scope="module")
def shared_controller() -> Iterator[Controller]:
    controller = Controller(Session(), warm_up=False)
    yield controller
    controller.close()


@pytest.fixture
def controller(shared_controller, scene) -> Controller:
    """The controller of all tests, with the scene opened anew."""
    entries = tuple(map(PhotoEntry, scene.photos, scene.rough_cameras))
    truth = tuple(zip((e.name for e in entries), scene.cameras, strict=True))
    mesh = dataclasses.replace(scene.mesh)
    shared_controller.session.change(
        "Open", lambda _: State(document=Document(mesh, mesh, entries, truth))
    )
    return shared_controller


def notices(controller: Controller) -> list[str]:
    """What all are told from now on."""
    told: list[str] = []

    def hear(old: State, new: State) -> None:
        if new.notice is not None and new.notice is not old.notice:
            told.append(f"{new.notice.title}: {new.notice.sentence}")

    controller.session.listen(hear)
    return told


def wait(controller: Controller, condition, what: str) -> State:
    wait_until(lambda: condition(controller.session.state), what, timeout_s=90)
    return controller.session.state


def improved(state: State) -> bool:
    return bool(state.run.curve) and state.run.curve[-1].best < 0.9


def test_killing_the_worker_keeps_the_best_and_the_next_run_works(controller):
    problems = notices(controller)
    session = controller.session
    session.change(None, rules.setting(preset="thorough"))
    controller.refinement.start()
    wait(controller, improved, "the search finds something better")
    first_pid = controller.worker.pid
    assert first_pid is not None
    os.kill(first_pid, signal.SIGKILL)
    state = wait(controller, lambda s: not s.run.is_active, "the death is noticed")
    assert state.run.status == "review"
    assert "died" in state.run.outcome
    wait_until(lambda: problems, "the user is told")
    assert "cut short" in problems[0]
    controller.refinement.accept()
    session.change(None, rules.setting(preset="fast"))
    controller.refinement.start()
    state = wait(controller, lambda s: s.run.status == "review", "the next run ends")
    assert controller.worker.pid != first_pid
    assert state.run.cost is not None
    assert state.run.start_cost is not None
    assert state.run.cost <= state.run.start_cost


@pytest.mark.workqueue
def test_a_run_goes_from_start_to_accept_and_back_by_undo(controller):
    session = controller.session
    session.change(None, rules.setting(preset="fast"))
    before = session.state.document
    controller.refinement.start()
    with pytest.raises(RefinementError, match="running"):
        controller.refinement.start()
    state = wait(controller, lambda s: s.run.status == "review", "the run ends")
    costs = [point.best for point in state.run.curve]
    assert len(costs) > 3
    assert session.state.document is before, "nothing is taken before Accept"
    controller.refinement.accept()
    assert session.undo() == "Refine"
    assert session.state.document is before


def test_after_a_stop_the_run_waits_for_a_decision(controller):
    session = controller.session
    session.change(None, rules.setting(preset="thorough"))
    controller.refinement.start()
    wait(controller, lambda s: s.run.status == "running", "the search runs")
    controller.refinement.stop()
    state = wait(controller, lambda s: s.run.status == "review", "it stops")
    assert state.run.outcome.startswith("Stopped")
    controller.refinement.revert()
    assert session.state.run.status == "idle"


def test_a_run_that_was_stopped_goes_on_to_the_answer_of_one_without_a_break(
    controller, scene
):
    session, steps = controller.session, []
    config = dataclasses.replace(
        FAST, genetic=dataclasses.replace(FAST.genetic, generations=80)
    )
    session.listen(lambda _, new: steps.append(new.run.step))
    session.change(None, rules.setting(preset="fast", config=config))
    controller.refinement.start()
    wait(controller, lambda s: s.kept_search is not None, "something is kept")
    controller.refinement.stop()
    wait(controller, lambda s: s.run.status == "review", "it stops")
    assert session.state.can_go_on
    steps.clear()
    controller.refinement.go_on()
    state = wait(controller, lambda s: s.run.status == "review", "it ends")
    assert not state.can_go_on, "it came to its end"
    assert len(state.runs) == 1
    assert "generation 0 of 80" not in steps, "what was done is not done again"
    names = [point.step for point in state.run.curve]
    assert names == sorted(set(names)), "the curve goes on where it was"
    *_, last = refine(scene.mesh, scene.photos, state.run.start, config)
    assert isinstance(last, Finished)
    for ours, direct in zip(state.run.cameras, last.cameras, strict=True):
        assert np.array_equal(ours.P, direct.P)


def test_an_uploaded_photo_gets_a_camera_that_sees_the_object(controller, scene):
    session = controller.session
    data = cv2.imencode(".png", scene.photos[0].pixels)[1].tobytes()
    controller.intake.open_one("../../etc/new one.png", data)
    state = wait(controller, lambda s: len(s.document.photos) == 3, "it is added")
    entry = state.document.photos[2]
    assert entry.name == "new one.png"
    assert entry.camera.contains(entry.camera.project(scene.mesh.vertices)).all()
    assert state.undo_name == "Add new one.png"
    assert session.undo() == "Add new one.png"


def test_a_bad_upload_is_told_and_changes_nothing(controller):
    problems = notices(controller)
    document = controller.session.state.document
    controller.intake.open_one("notes.jpg", b"not a picture")
    wait_until(lambda: problems, "the user is told")
    assert "notes.jpg could not be read" in problems[0]
    with pytest.raises(InputError, match="not a file photoreg opens"):
        controller.intake.open_one("mesh.exe", b"MZ")
    assert controller.session.state.document is document
    assert controller.session.state.job is None


def test_cancel_ends_the_reading_of_a_camera_file_and_leaves_no_trace(controller):
    document = controller.session.state.document
    # Read to its end, it takes seconds and is refused.
    controller.intake.open_one("slow.yml", b"%YAML:1.0\n---\n" + b"- a\n" * 1_200_000)
    wait(controller, lambda s: s.job.title == "Reading the cameras", "it is read")
    assert controller.intake.cancel()
    state = controller.session.state
    assert state.document is document
    assert state.job is None
    assert state.note == "Cancelled; nothing was opened."
    data = b"%YAML:1.0\n---\ncameras: [ ]\n"
    told = notices(controller)
    controller.intake.open_one("none.yml", data)
    wait_until(lambda: told, "the next file is read")
    assert told == ["Could not open none.yml: none.yml has no cameras."]


def test_the_overlay_follows_the_cameras_and_tells_the_true_error(controller):
    session = controller.session
    wait(controller, lambda s: s.run.error_px is not None, "the first overlay")
    first, error = session.state.picture, session.state.run.error_px
    true = dict(session.state.document.truth)
    session.change("Put right", rules.with_cameras(true))
    assert error is not None
    assert error > 1.0
    wait(
        controller,
        lambda s: s.run.error_px is not None and s.run.error_px < 1e-6,
        "the overlay follows",
    )
    assert session.state.picture != first


def test_of_a_stroke_of_a_mask_only_the_mask_is_sent(controller, scene, monkeypatch):
    session, worker = controller.session, controller.worker
    first = wait(controller, lambda s: s.agreement is not None, "the first number")
    n_bytes: list[int] = []

    def send(*jobs: Job) -> None:
        n_bytes.extend(len(ForkingPickler.dumps(job)) for job in jobs)
        Worker.send(worker, *jobs)

    monkeypatch.setattr(worker, "send", send)
    left = np.indices(scene.photos[0].pixels.shape[:2])[1] < 150
    for mask in (left, np.ones_like(left)):
        session.change("Paint", with_entry(0, mask_png=encode_mask(mask)))
        photos = [entry.masked_photo for entry in session.state.document.used]
        true = AgreementMeter(scene.mesh, photos).agreement(scene.rough_cameras)
        # What was measured before the stroke may still be under way.
        wait(controller, lambda s, true=true: s.agreement == true, "the number")
        assert (true == first.agreement) == mask.all()
    # One mask and one overlay a stroke; the mesh and photos are a megabyte.
    assert len(n_bytes) == 4
    assert sum(n_bytes) < 20_000
    assert len(ForkingPickler.dumps(SetScene(scene.mesh, scene.photos))) > 500_000


@pytest.mark.workqueue
def test_baking_is_stopped_between_its_steps_and_then_works(controller):
    session = controller.session
    controller.bake()
    controller.stop_job()
    state = wait(controller, lambda s: s.job is None, "it stops")
    assert state.texture is None
    assert state.note.startswith("Stopped")
    config = TextureConfig(size=256, unseen="colour")
    session.change(None, rules.setting(texture_config=config))
    controller.bake()
    state = wait(controller, lambda s: s.texture is not None, "the texture is made")
    assert state.texture_is_current
    session.change(None, rules.setting(texture_config=TextureConfig()))
    assert not session.state.texture_is_current
    files: list[tuple[str, bytes]] = []
    session.change(None, rules.setting(model_choice=ModelChoice("glb")))
    controller.pack_model(lambda name, content: files.append((name, content)))
    wait_until(lambda: files, "the file is packed")
    assert files[0][0].endswith(".glb")
    assert files[0][1][:4] == b"glTF"
    assert session.state.job is None


def test_what_may_move_reaches_the_worker_with_the_photos_that_it_is_about(
    controller, scene, monkeypatch
):
    sent: list[Job] = []
    monkeypatch.setattr(controller.worker, "send", lambda *jobs: sent.extend(jobs))
    two = controller.session.state.document
    third = dataclasses.replace(two.photos[0].photo, name="third.png")
    three = dataclasses.replace(
        two, photos=(*two.photos, PhotoEntry(third, two.photos[0].camera))
    )
    for document in (three, two, three):
        last = document.photos[-1].name
        controller.session.restore(
            [UndoStep(None, document)], 0, {"held": ((last, "focal"),)}
        )
    photos = len(two.photos)
    n_told = 0
    for job in sent:
        if isinstance(job, SetScene):
            photos = len(job.photos)
        if isinstance(job, MeasureReach):
            n_told += 1
            assert len(job.freedom.held) == photos
    assert n_told == 3
