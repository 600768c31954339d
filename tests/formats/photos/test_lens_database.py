"""Lenses by EXIF: the terms that are fitted, and what becomes of a lens that is known."""

import dataclasses

import numpy as np
import pytest

from photoreg.formats.photos import lens_database
from photoreg.formats.photos.lens_database import known_lens, radial_terms
from photoreg.geometry.camera import Camera, centred_intrinsics
from photoreg.geometry.lens import Lens
from photoreg.imaging.photo import KnownLens, Photo
from photoreg.placing.outcome import Placed, Placement
from photoreg.registration.find_cameras import _through_known_lenses

WIDTH, HEIGHT, FOCAL_PX = 61, 40, 70.0


def bent_grid(radial: np.ndarray, magnified: float = 1.0) -> np.ndarray:
    """Where each ideal pixel is seen by a lens; ``radial`` are k1, k2, k3."""
    centre = 0.5 * np.array([WIDTH - 1.0, HEIGHT - 1.0])
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    ideal = (np.stack([x, y], axis=-1) - centre) / FOCAL_PX
    r2 = (ideal**2).sum(axis=-1, keepdims=True)
    q = 1.0 + sum(k * r2 ** (i + 1) for i, k in enumerate(radial))
    return centre + magnified * FOCAL_PX * ideal * q


@pytest.mark.parametrize("magnified", [1.0, 1.03, 0.97])
def test_two_radial_terms_are_found_whatever_the_middle_is_magnified_by(magnified):
    bent = bent_grid(np.array([-0.11, 0.06]), magnified)
    terms = radial_terms(bent, FOCAL_PX)
    # The magnification belongs to the focal length; the angle of a ray stays.
    assert terms == pytest.approx((-0.11, 0.06), abs=1e-9)


def test_a_lens_that_two_terms_do_not_describe_is_left_out():
    assert radial_terms(bent_grid(np.array([0.3, -4.0, 14.0])), FOCAL_PX) is None


def test_without_the_database_nothing_is_known(monkeypatch):
    monkeypatch.setattr(lens_database, "_database", lambda: (None, None))
    found = known_lens("Canon", "Canon EOS 5D", "EF50mm f/1.4 USM", 50.0, 1e3, (9, 6))
    assert found is None


def test_cameras_that_are_found_start_with_the_lenses_that_are_known():
    lens = Lens(k1=-0.07, k2=0.02)
    pixels = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    known = Photo("known.jpg", pixels, known_lens=KnownLens(lens, "50 mm"))
    unknown = Photo("unknown.jpg", pixels)
    camera = Camera(
        centred_intrinsics(FOCAL_PX, WIDTH, HEIGHT),
        np.eye(3),
        np.array([0.1, 0.2, 3.0]),
        WIDTH,
        HEIGHT,
    )
    other = dataclasses.replace(camera, t_cam_world=np.array([0.0, 0.0, 4.0]))
    placed = Placed(
        (
            Placement("unsure", "", (camera, other)),
            Placement("found", "", (camera,)),
            Placement("not found", ""),
        )
    )
    ends = _through_known_lenses([known, unknown, known], placed).placements
    assert [c.lens for c in ends[0].candidates] == [lens, lens]
    assert np.array_equal(ends[0].candidates[1].t_cam_world, other.t_cam_world)
    assert ends[1] is placed.placements[1]
    assert ends[2].candidates == ()
