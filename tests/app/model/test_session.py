"""The rules of the app's state: undo by name, gestures, equal states, runs."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from app.engine.warm_up import toy_scene
from app.model import photo_list, reducers
from app.model import session as rules
from app.model.run import KeptSearch, Run, Status
from app.model.session import Session
from app.model.state import Agreement, Document, PhotoEntry, State
from app.model.wanted_pictures import needs_overlay
from photoreg.errors import InputError, RefinementError
from photoreg.geometry.camera import Camera, same_camera


@pytest.fixture(scope="module")
def document() -> Document:
    mesh, photos, cameras = toy_scene()
    entries = tuple(map(PhotoEntry, photos, cameras))
    return Document(mesh, mesh, entries)


@pytest.fixture
def session(document: Document) -> Session:
    return Session(State(document=document))


def moved(camera: Camera, by: float) -> Camera:
    t = camera.t_cam_world + np.array([by, 0.0, 0.0])
    return dataclasses.replace(camera, t_cam_world=t)


def move(session: Session, index: int, by: float, gesture: Any = None) -> bool:
    camera = moved(session.state.document.photos[index].camera, by)
    return session.change(
        f"Move camera {index + 1}", rules.with_entry(index, camera=camera), gesture
    )


def test_undo_and_redo_restore_the_very_document_and_tell_the_step(session):
    before = session.state.document
    move(session, 1, 0.1)
    after = session.state.document
    assert (session.state.undo_name, session.state.redo_name) == ("Move camera 2", None)
    assert session.undo() == "Move camera 2"
    assert session.state.document is before
    assert (session.state.undo_name, session.state.redo_name) == (None, "Move camera 2")
    assert session.redo() == "Move camera 2"
    assert session.state.document is after


def test_undo_without_a_step_does_nothing(session):
    before = session.state
    assert session.undo() is None
    assert session.redo() is None
    assert session.state is before


def test_a_new_step_ends_what_could_be_redone(session):
    move(session, 0, 0.1)
    session.undo()
    move(session, 1, 0.2)
    assert session.state.redo_name is None
    assert session.redo() is None


def test_a_drag_is_one_step_however_many_updates_it_sends(session):
    before = session.state.document
    for _ in range(25):
        assert move(session, 0, 0.01, gesture=("gizmo", 1))
    for _ in range(3):
        assert move(session, 0, 0.01, gesture=("gizmo", 2))
    assert session.undo() == "Move camera 1"
    x = session.state.document.photos[0].camera.t_cam_world[0]
    start = before.photos[0].camera.t_cam_world[0]
    assert x - start == pytest.approx(0.25), f"moved {x - start} after one undo"
    assert session.undo() == "Move camera 1"
    assert session.state.document is before


def test_a_gesture_does_not_go_on_across_an_undo(session):
    move(session, 0, 0.1, gesture="drag")
    session.undo()
    move(session, 0, 0.2, gesture="drag")
    assert session.state.undo_name == "Move camera 1"


def test_equal_states_reach_no_listener(session):
    heard = []
    session.listen(lambda old, new: heard.append(new))
    camera = session.state.document.photos[0].camera
    # A quaternion's way there and back: equal to rounding, not to the bit.
    echo = dataclasses.replace(
        camera, t_cam_world=camera.t_cam_world * (1.0 + 1e-15), K=camera.K.copy()
    )
    assert not session.change("Echo", rules.with_entry(0, camera=echo))
    assert not session.change(None, rules.setting(mesh_opacity=0.55))
    assert heard == []
    assert session.state.undo_name is None
    assert session.change(None, rules.setting(mesh_opacity=0.3))
    assert [state.mesh_opacity for state in heard] == [0.3]


def test_settings_of_the_view_are_no_undo_steps(session):
    session.change(None, rules.select(1))
    session.change(None, rules.setting(overlay_style="edges"))
    assert session.undo() is None
    assert session.state.selected == 1


def test_a_listener_that_left_hears_nothing(session):
    heard = []
    leave = session.listen(lambda old, new: heard.append(new))
    leave()
    move(session, 0, 0.1)
    assert heard == []


def test_a_change_that_raises_leaves_everything_as_it_was(session):
    before = session.state
    with pytest.raises(InputError, match="no photo 8"):
        session.change(None, rules.select(7))
    assert session.state is before


def test_removing_a_photo_keeps_the_choice_within_the_list(session):
    session.change(None, rules.select(1))
    session.change("Remove", rules.with_photo_removed(1))
    assert session.state.selected == 0
    assert session.undo() == "Remove"
    assert len(session.state.document.photos) == 2


def test_a_photo_of_a_taken_name_gets_a_number(session):
    entry = session.state.document.photos[0]
    for _ in range(2):
        session.change("Add", rules.with_photo_added(entry.photo, entry.camera))
    names = [e.name for e in session.state.document.photos]
    assert names == ["toy-0.png", "toy-1.png", "toy-0-2.png", "toy-0-3.png"]
    assert session.state.selected == 3


def names(session: Session) -> list[str]:
    return [entry.name for entry in session.state.document.photos]


def test_a_photo_moved_in_the_list_stays_selected_and_stops_at_the_ends(session):
    before = session.state.document
    assert session.change("Move", photo_list.shifted("toy-0.png", 1))
    assert names(session) == ["toy-1.png", "toy-0.png"]
    assert session.state.selected == 1, "the selected photo stays selected"
    assert not session.change("Move", photo_list.shifted("toy-0.png", 1))
    assert session.state.document.used_cameras[1] is before.photos[0].camera
    session.undo()
    assert session.state.document is before


def test_a_new_name_takes_everything_along_and_must_be_free(session):
    entry = session.state.document.photos[0]
    session.change("Truth", rules.with_document(truth=(("toy-0.png", entry.camera),)))
    before = session.state
    session.change("Rename", photo_list.renamed("toy-0.png", "  left side.png "))
    assert needs_overlay(before, session.state), "what was measured is dropped"
    renamed = session.state.document.photos[0]
    assert names(session) == ["left side.png", "toy-1.png"]
    assert renamed.photo.pixels is entry.photo.pixels
    assert renamed.camera is entry.camera
    assert session.state.document.true_cameras(["left side.png"]) == (entry.camera,)
    document = session.state.document
    for bad in ("toy-1.png", "", "a/b.png", "x" * 200, "two\nlines"):
        with pytest.raises(InputError):
            session.change("Rename", photo_list.renamed("left side.png", bad))
    with pytest.raises(InputError, match="no photo gone"):
        session.change("Remove", photo_list.removed("gone.png"))
    assert session.state.document is document


def test_photos_are_left_out_and_removed_by_name(session):
    before = session.state.document
    session.change("Leave out", photo_list.enabled("toy-0.png", False))
    assert [e.name for e in session.state.document.used] == ["toy-1.png"]
    session.change("Remove", photo_list.removed("toy-0.png"))
    assert names(session) == ["toy-1.png"]
    session.undo()
    session.undo()
    assert session.state.document is before


def run_of(document: Document, status: Status) -> Run:
    names = tuple(entry.name for entry in document.photos)
    refined = tuple(moved(camera, 0.5) for camera in document.used_cameras)
    return Run(
        status=status, photo_names=names, start=document.used_cameras, cameras=refined
    )


def test_while_a_refinement_runs_the_document_is_closed(session, document):
    session.change(None, rules.setting(run=run_of(document, "running")))
    with pytest.raises(RefinementError, match="running"):
        move(session, 0, 0.1)
    with pytest.raises(RefinementError):
        session.change(None, rules.accepted)
    assert session.state.document is document


def test_a_run_s_cameras_are_shown_but_not_taken(session, document):
    session.change(None, rules.setting(run=run_of(document, "review")))
    shown = [entry.camera for entry in session.state.photos]
    assert all(map(same_camera, shown, session.state.run.cameras))
    assert session.state.document is document
    session.change(None, rules.reverted)
    assert session.state.photos == document.photos


def test_accepting_a_run_is_one_undo_step(session, document):
    run = run_of(document, "review")
    session.change(None, rules.setting(run=run))
    session.change("Refine", rules.accepted)
    assert session.state.run.status == "idle"
    assert all(map(same_camera, session.state.document.used_cameras, run.cameras))
    assert session.undo() == "Refine"
    assert session.state.document is document


def test_undo_waits_for_the_decision_on_a_run(session, document):
    move(session, 0, 0.1)
    session.change(None, rules.setting(run=run_of(document, "review")))
    with pytest.raises(RefinementError, match="Accept or revert"):
        session.undo()


def test_a_photo_that_is_not_used_takes_no_part(session):
    session.change("Leave out", rules.with_entry(0, enabled=False))
    assert [entry.name for entry in session.state.document.used] == ["toy-1.png"]


def test_true_cameras_are_known_only_if_all_are(document):
    names = [entry.name for entry in document.photos]
    one = dataclasses.replace(document, truth=((names[0], document.used_cameras[0]),))
    assert one.true_cameras(names) is None
    assert one.true_cameras(names[:1]) == (document.used_cameras[0],)
    assert document.true_cameras(names) is None


def test_what_was_measured_does_not_outlive_its_scene(session):
    measured = Agreement(1.0, 2.0, 0.5)
    session.change(
        None, rules.setting(agreement=measured, run=Run(error_px=18.0), readiness=None)
    )
    move(session, 0, 1.0)
    assert session.state.agreement is measured, "it is measured anew in no time"
    session.change("Leave out", rules.with_entry(1, enabled=False))
    assert session.state.agreement is None
    assert session.state.run.error_px is None


def test_a_run_whose_engine_dies_can_go_on_however_early_it_was(session):
    cameras = session.state.document.used_cameras
    run = Run(
        status="running",
        number=4,
        photo_names=("a", "b"),
        start=cameras,
        cameras=cameras,
    )
    session.change(None, rules.setting(run=run))

    def died(**more: Any) -> State:
        state = dataclasses.replace(session.state, **more)
        return reducers.broken_off(state, "The engine died")

    assert died().run.status == "idle", "nothing was done yet"
    early = died(kept_search=KeptSearch(4, 0, b"where it stands"))
    assert early.can_go_on
    assert early.run.outcome.startswith("The engine died before anything better")
    assert [run.number for run in early.runs] == [4]
    better = dataclasses.replace(run, cameras=(moved(cameras[0], 0.1), *cameras[1:]))
    late = died(run=better)
    assert late.run.status == "review"
    assert not late.can_go_on, "it was never told where it stands"
    assert late.run.outcome == "The engine died; this is the best until then."


def test_a_photo_is_cropped_as_exif_tells_or_as_a_person_says(session, document):
    assert session.state.freedom.cropped == ()
    session.change("Crop", photo_list.cropped("toy-1.png", True))
    assert session.state.freedom.cropped == (1,)
    session.change("Crop", photo_list.cropped("toy-1.png", False))
    assert session.state.freedom.cropped == ()
    by_exif = dataclasses.replace(document.photos[0].photo, is_cropped=True)
    session.change("Photo", rules.with_entry(0, photo=by_exif))
    assert session.state.freedom.cropped == (0,)
    assert session.undo() == "Photo"
    assert session.undo() == "Crop"
    assert session.state.freedom.cropped == (1,)
