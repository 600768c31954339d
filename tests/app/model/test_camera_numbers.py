"""A camera in numbers, and back: round trips, and what stays when one is typed."""

import dataclasses

import numpy as np
import pytest

from app.control.camera_claims import CameraClaims
from app.model import camera_numbers
from app.model.camera_moves import orbited
from photoreg.errors import InputError
from photoreg.geometry.camera import Camera

UP = np.array([0.1, 1.0, 0.2])
ANCHOR = np.array([0.3, -0.2, 0.1])


@pytest.fixture
def camera() -> Camera:
    # fx != fy, principal point off the centre, rolled and turned.
    base = Camera.look_at((3, 1, 2), (0.2, 0.1, 0), (0.4, 1, 0.2), 700.0, 640, 480)
    K = np.array([[700.0, 0.0, 290.0], [0.0, 640.0, 265.0], [0.0, 0.0, 1.0]])
    return dataclasses.replace(base, K=K)


def test_directions_come_back(camera):
    angles = camera_numbers.direction_deg(camera, UP)
    again = camera_numbers.with_direction(camera, UP, angles)
    assert np.abs(again.P - camera.P).max() < 1e-9
    other = camera_numbers.with_direction(camera, UP, np.array([35.0, -20.0, 8.0]))
    assert camera_numbers.direction_deg(other, UP) == pytest.approx([35.0, -20.0, 8.0])
    assert other.center == pytest.approx(camera.center), "it turns on the spot"


def test_turn_tilt_and_roll_are_what_they_are_called(camera):
    level = camera_numbers.with_direction(camera, UP, np.array([50.0, 0.0, 0.0]))
    up = UP / np.linalg.norm(UP)
    assert level.R_cam_world[2] @ up == pytest.approx(0.0, abs=1e-12), "level ahead"
    assert -level.R_cam_world[1] @ up == pytest.approx(1.0), "upright"
    raised = camera_numbers.with_direction(camera, UP, np.array([50.0, 10.0, 0.0]))
    assert raised.R_cam_world[2] @ up == pytest.approx(np.sin(np.radians(10.0)))
    rolled = camera_numbers.with_direction(camera, UP, np.array([50.0, 10.0, 30.0]))
    assert rolled.R_cam_world[2] == pytest.approx(raised.R_cam_world[2])


def test_around_the_object_comes_back_and_keeps_the_object_s_place(camera):
    values = camera_numbers.around(camera, ANCHOR, UP)
    assert values[2] == pytest.approx(np.linalg.norm(camera.center - ANCHOR))
    same = camera_numbers.with_around(camera, ANCHOR, UP, values)
    assert np.abs(same.P - camera.P).max() < 1e-9
    wanted = np.array([120.0, -35.0, 5.5])
    other = camera_numbers.with_around(camera, ANCHOR, UP, wanted)
    assert camera_numbers.around(other, ANCHOR, UP) == pytest.approx(wanted)
    before, after = (c.project(ANCHOR[None])[0] for c in (camera, other))
    assert after == pytest.approx(before, abs=1e-6)


def test_an_orbit_there_and_back_is_no_move(camera):
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    there = orbited(camera, ANCHOR, turn)
    assert np.linalg.norm(there.center - ANCHOR) == pytest.approx(
        np.linalg.norm(camera.center - ANCHOR)
    )
    assert there.to_camera(ANCHOR[None]) == pytest.approx(
        camera.to_camera(ANCHOR[None])
    )
    assert np.abs(orbited(there, ANCHOR, turn.T).P - camera.P).max() < 1e-9


def test_a_lens_in_three_units_is_one_lens(camera):
    mm, angle = camera_numbers.film_mm(camera), camera_numbers.view_angle_deg(camera)
    assert camera_numbers.focal_of_film(camera, mm) == pytest.approx(camera.focal_px)
    assert camera_numbers.focal_of_angle(camera, angle) == pytest.approx(
        camera.focal_px
    )
    # 35 mm film has a diagonal of 43.27 mm: 53 degrees over it with 43.27 mm.
    assert camera_numbers.focal_of_film(camera, 43.27) == pytest.approx(800.0)


def test_stepping_aside_keeps_the_lens_and_turns_by_twenty_degrees(camera):
    other = Camera.look_at((9, 9, 9), (0, 0, 0), (0, 1, 0), 400.0, 640, 480)
    aside = camera_numbers.stepped_aside(camera, other, ANCHOR, UP, 2)
    assert np.array_equal(aside.K, camera.K)
    first, second = (camera_numbers.around(c, ANCHOR, UP) for c in (camera, aside))
    assert (second - first) == pytest.approx([40.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda c: camera_numbers.with_checked_focal(c, 5.0, None), "64 to 19200 px"),
        (lambda c: camera_numbers.focal_of_film(c, 0.0), r"3\.\d to .* mm"),
        (lambda c: camera_numbers.focal_of_angle(c, 179.0), "2 to 160 degrees"),
        (lambda c: camera_numbers.with_principal_point(c, 0.0, 1e4), "-480 to 960 px"),
        (
            lambda c: camera_numbers.with_center(c, np.array([1e9, 0, 0]), 100.0),
            "within 100",
        ),
        (
            lambda c: camera_numbers.with_direction(c, UP, np.array([0, 91.0, 0])),
            "tilt should be -90 to 90",
        ),
        (
            lambda c: camera_numbers.with_around(c, ANCHOR, UP, np.array([0, 0, -1.0])),
            "should be positive",
        ),
    ],
)
def test_what_no_camera_has_is_refused_in_one_sentence(camera, change, says):
    with pytest.raises(InputError, match=says) as caught:
        change(camera)
    assert str(caught.value).count(".") <= 3


def test_a_camera_is_in_one_hand_at_a_time():
    claims = CameraClaims()
    assert claims.take(1, 0, 60.0)
    assert not claims.take(2, 0, 60.0)
    assert claims.take(2, 1, 60.0), "the other camera is free"
    assert claims.take(1, 0, 60.0), "one's own hand may go on"
    claims.drop(1)
    assert claims.take(2, 0, 0.0)
    assert claims.take(1, 0, 1.0), "a hand that has rested lets go"
