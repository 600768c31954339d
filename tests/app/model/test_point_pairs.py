"""Clicks become pairs, pairs become cameras: the rules, without a browser."""

import dataclasses
from threading import Event

import numpy as np
import pytest

from app.control.resection_solver import ResectionSolver, solved
from app.engine.warm_up import toy_scene
from app.model import point_pairs
from app.model import session as rules
from app.model.run import Run
from app.model.session import Session, select
from app.model.state import Document, PhotoEntry, PointPair, State
from app.panels.pair_table import pair_rows, table_html
from photoreg.errors import InputError
from photoreg.geometry.camera import same_camera
from photoreg.geometry.projection_error import projection_error
from photoreg.geometry.sampling import sample_surface
from photoreg.imaging.photo import Photo
from tests.bench.resection import clicked_points
from tests.browser.driver import wait_until


@pytest.fixture(scope="module")
def document() -> Document:
    mesh, photos, cameras = toy_scene()
    return Document(mesh, mesh, tuple(map(PhotoEntry, photos, cameras)))


@pytest.fixture
def session(document) -> Session:
    return Session(State(document=document))


def pairs_of(session: Session) -> list[tuple[int, bool, bool]]:
    entry = session.state.document.photos[0]
    return [(p.number, p.pixel is not None, p.world is not None) for p in entry.pairs]


def photo(session: Session, u: float, v: float) -> None:
    session.change("Point", point_pairs.with_photo_point("toy-0.png", (u, v)))


def surface(session: Session, *xyz: float) -> None:
    session.change("Point", point_pairs.with_surface_point("toy-0.png", xyz))  # pyright: ignore[reportArgumentType]


def test_points_may_be_clicked_in_either_order(session):
    photo(session, 10, 20)
    surface(session, 1, 2, 3)
    surface(session, 4, 5, 6)
    photo(session, 30, 40)
    assert session.state.document.photos[0].pairs == (
        PointPair(1, (1, 2, 3), (10, 20)),
        PointPair(2, (4, 5, 6), (30, 40)),
    )


def test_all_photo_points_first_then_those_of_the_surface_in_the_same_order(session):
    for u in (10, 20, 30):
        photo(session, u, 5)
    assert "point 1 on the model" in point_pairs.next_click(session.state)
    surface(session, 1, 0, 0)
    assert pairs_of(session) == [(1, True, True), (2, True, False), (3, True, False)]
    assert "point 2 on the model" in point_pairs.next_click(session.state)


def test_a_chosen_pair_is_what_the_next_click_moves(session):
    photo(session, 10, 20)
    surface(session, 1, 2, 3)
    session.change(None, point_pairs.chosen("toy-0.png", 1))
    surface(session, 7, 8, 9)
    assert session.state.document.photos[0].pairs == (
        PointPair(1, (7, 8, 9), (10, 20)),
    )
    assert session.state.chosen_pair is None


def test_a_deleted_pair_leaves_the_other_numbers_and_comes_back_by_undo(session):
    for u in (10, 20, 30):
        photo(session, u, 5)
    session.change("Delete point 2", point_pairs.without_point("toy-0.png", 2))
    assert [n for n, *_ in pairs_of(session)] == [1, 3]
    photo(session, 40, 5)
    assert [n for n, *_ in pairs_of(session)] == [1, 3, 4]
    session.undo()
    assert session.undo() == "Delete point 2"
    assert [n for n, *_ in pairs_of(session)] == [1, 2, 3]


def test_a_point_outside_the_photo_is_refused(session):
    with pytest.raises(InputError, match="within 160x120 px"):
        photo(session, 170, 20)
    with pytest.raises(InputError, match="no photo"):
        session.change("Point", point_pairs.with_photo_point("gone.png", (1, 1)))
    assert pairs_of(session) == []


def test_surface_points_of_one_photo_serve_the_other(session):
    surface(session, 1, 2, 3)
    surface(session, 4, 5, 6)
    session.change("Take", point_pairs.with_surface_points_of("toy-1.png", "toy-0.png"))
    assert session.state.document.photos[1].pairs == (
        PointPair(1, (1, 2, 3)),
        PointPair(2, (4, 5, 6)),
    )
    with pytest.raises(InputError, match="no surface points"):
        session.change(
            "Take", point_pairs.with_surface_points_of("toy-1.png", "toy-0.png")
        )


def test_points_to_be_clicked_are_told_where_the_other_photo_has_them(session):
    surface(session, 1, 2, 3)
    photo(session, 11, 12)
    surface(session, 4, 5, 6)
    assert point_pairs.to_be_clicked(session.state) == []
    session.change("Take", point_pairs.with_surface_points_of("toy-1.png", "toy-0.png"))
    session.change(None, select(1))
    (told,) = point_pairs.to_be_clicked(session.state)
    number, other, pixel = told
    assert (number, other.name, pixel) == (1, "toy-0.png", (11, 12))
    session.change("Point", point_pairs.with_photo_point("toy-1.png", (20, 21)))
    assert point_pairs.to_be_clicked(session.state) == []


def true_pairs(entry: PhotoEntry, mesh, n: int) -> tuple[PointPair, ...]:
    """Vertices that face the camera, and where it sees them, exactly."""
    toward = entry.camera.center - mesh.vertices
    facing = np.flatnonzero((mesh.vertex_normals * toward).sum(axis=1) > 0)
    some = np.random.default_rng(3).permutation(facing)[:n]
    worlds = mesh.vertices[some]
    pixels = entry.camera.project(worlds)
    return tuple(
        PointPair(i + 1, tuple(map(float, w)), tuple(map(float, p)))  # pyright: ignore[reportArgumentType]
        for i, (w, p) in enumerate(zip(worlds, pixels, strict=True))
    )


def test_a_click_and_the_camera_that_follows_are_one_undo_step(session, document):
    solver = ResectionSolver(session)
    try:
        entry = document.photos[0]
        truth = entry.camera
        pairs = true_pairs(entry, document.mesh, 8)
        wrong = dataclasses.replace(truth, t_cam_world=truth.t_cam_world * 1.2)
        session.change("Spoil", rules.with_entry(0, camera=wrong, pairs=pairs[:7]))
        step, gesture = "Point of photo 1", ("points", 1)
        last = pairs[7]
        assert last.pixel is not None
        assert last.world is not None
        change = point_pairs.with_photo_point("toy-0.png", last.pixel)
        session.change(step, change, gesture)
        change = point_pairs.with_surface_point("toy-0.png", last.world)
        session.change(step, change, gesture)
        solver.place("toy-0.png", step, gesture)
        wait_until(
            lambda: not same_camera(session.state.document.photos[0].camera, wrong),
            "the camera is placed",
            20,
        )
        found = session.state.document.photos[0].camera
        off = found.project(document.mesh.vertices) - truth.project(
            document.mesh.vertices
        )
        assert np.abs(off).max() < 1e-3, f"{np.abs(off).max():.2g} px off"
        assert session.undo() == step
        entry = session.state.document.photos[0]
        assert same_camera(entry.camera, wrong)
        assert len(entry.pairs) == 7
    finally:
        solver.close()


def test_the_pairs_of_a_photo_selected_during_a_run_are_solved(session, document):
    start = document.used_cameras
    shift = np.array([0.01, 0.0, 0.0])
    better = tuple(
        dataclasses.replace(camera, t_cam_world=camera.t_cam_world + shift)
        for camera in start
    )
    names = tuple(entry.name for entry in document.photos)
    run = Run(
        status="running", number=1, photo_names=names, start=start, cameras=better
    )
    pairs = true_pairs(document.photos[1], document.mesh, 8)
    session.change("Points", rules.with_entry(1, pairs=pairs))
    session.change(None, rules.setting(run=run))
    solver = ResectionSolver(session)
    try:
        session.change(None, rules.select(1))
        wait_until(lambda: session.state.current_solution, "photo 2 is solved", 20)
    finally:
        solver.close()


def test_the_old_verdict_stays_until_the_new_one_is_there(session, document):
    entry = document.photos[0]
    entry = dataclasses.replace(entry, pairs=true_pairs(entry, document.mesh, 7))
    old = dataclasses.replace(entry, pairs=entry.pairs[:6])
    session.change("Points", rules.with_entry(0, pairs=entry.pairs))

    def table() -> str:
        return table_html(session.state, pair_rows(session.state))

    assert "Solving" in table()
    session.change(None, rules.setting(solution=solved(old, document.mesh)))
    assert "from 6 pairs" in table()
    session.change(None, rules.setting(solution=solved(entry, document.mesh)))
    assert "from 7 pairs" in table()
    session.change("Clear", rules.with_entry(0, pairs=()))
    assert "4 more pairs" in table()


def test_a_click_while_older_pairs_are_solved_still_places_the_camera(
    session, document, monkeypatch
):
    entry = document.photos[0]
    pairs, begun, go = true_pairs(entry, document.mesh, 8), Event(), Event()
    wrong = dataclasses.replace(
        entry.camera, t_cam_world=entry.camera.t_cam_world * 1.2
    )

    def slowly(entry, mesh):
        if len(entry.pairs) == 7:
            begun.set()
            assert go.wait(20)
        return solved(entry, mesh)

    monkeypatch.setattr("app.control.resection_solver.solved", slowly)
    session.change("Spoil", rules.with_entry(0, camera=wrong, pairs=pairs[:7]))
    solver = ResectionSolver(session)
    try:
        assert begun.wait(20)
        session.change("Point", rules.with_entry(0, pairs=pairs), "click")
        solver.place(entry.name, "Point", "click")
        go.set()
        wait_until(
            lambda: not same_camera(session.state.document.photos[0].camera, wrong),
            "the camera is placed",
            20,
        )
        solution = session.state.current_solution
        assert solution is not None
        assert len(solution.pairs) == 8
    finally:
        solver.close()


@pytest.mark.parametrize("seed", range(4))
def test_gross_errors_are_named_and_the_answer_holds(document, seed):
    mesh, size = document.mesh, (1280, 960)
    truth = document.photos[0].camera.resized(*size)
    blank = Photo("blank.png", np.zeros((size[1], size[0], 3), np.uint8))
    rng = np.random.default_rng(seed)
    world = clicked_points(mesh, sample_surface(mesh, 20_000, seed=1), truth, 8, rng)
    pixels = truth.project(world) + rng.normal(size=(8, 2))
    wrong = sorted(rng.permutation(8)[:2].tolist())
    pixels[wrong] += rng.choice([-1, 1], (2, 2)) * rng.uniform(60, 160, (2, 2))
    pairs = tuple(
        PointPair(i + 1, tuple(w), tuple(p))
        for i, (w, p) in enumerate(zip(world.tolist(), pixels.tolist(), strict=True))
    )
    solution = solved(PhotoEntry(blank, truth, pairs=pairs), mesh)
    resection = solution.resection
    assert resection is not None
    assert np.flatnonzero(~resection.inliers).tolist() == wrong
    named = " and ".join(str(i + 1) for i in wrong)
    assert f"Pairs {named} do not fit" in resection.warnings[0]
    error = projection_error(mesh, [truth], [resection.camera]).cameras[0].mean
    assert error < 20.0, f"{error:.1f} px"


def test_a_surface_point_is_moved_and_nothing_else(session):
    for u in (10.0, 20.0):
        photo(session, u, 5)
        surface(session, u, 0, 0)
    before = session.state.document.photos[0].pairs
    change = point_pairs.with_moved_surface_point("toy-0.png", 2, (7.0, 8.0, 9.0))
    session.change("Move point 2", change)
    now = session.state.document.photos[0].pairs
    assert now == (before[0], PointPair(2, (7.0, 8.0, 9.0), before[1].pixel))
    with pytest.raises(InputError, match="no point 5"):
        point_pairs.with_moved_surface_point("toy-0.png", 5, (0.0, 0.0, 0.0))(
            session.state
        )
