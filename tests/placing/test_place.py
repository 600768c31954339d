"""Cameras found without a click: near the truth, or said to be unsure."""

import dataclasses

import numpy as np
import pytest

from photoreg.errors import InputError
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.projection_error import projection_error
from photoreg.imaging.photo import Photo
from photoreg.placing.outcome import Placed, PlacingStep
from photoreg.placing.place import place
from photoreg.synthetic.render import encode_srgb, render_linear
from photoreg.synthetic.rock import icosphere
from tests.scenes import small_scene


def placed(mesh, photos, **hints) -> Placed:
    *steps, last = place(mesh, photos, **hints)
    assert isinstance(last, Placed)
    fractions = [step.fraction for step in steps if isinstance(step, PlacingStep)]
    assert fractions == sorted(fractions)
    assert 0.0 <= fractions[0] < fractions[-1] < 1.0
    return last


def errors_px(scene, found: Placed) -> list[float]:
    cameras = [one.candidates[0] for one in found.placements]
    true = scene.cameras[: len(cameras)]
    return [error.mean for error in projection_error(scene.mesh, true, cameras).cameras]


@pytest.mark.parametrize("kind", ["clean", "hard"])
def test_a_pair_before_a_plain_background_is_found_without_a_focal_length(kind):
    scene = small_scene(seed=5, kind=kind)
    found = placed(scene.mesh, scene.photos)
    # 40 px at 1,024 is what a refinement takes.
    assert max(errors_px(scene, found)) < 5.0, errors_px(scene, found)
    assert found.grade == "found", [one.sentence for one in found.placements]


def test_a_known_focal_length_is_kept_and_the_same_bits_come_again():
    scene = small_scene(seed=6)
    photo = dataclasses.replace(
        scene.photos[0], exif_focal_px=scene.cameras[0].focal_px
    )
    one, two = placed(scene.mesh, [photo]), placed(scene.mesh, [photo])
    camera = one.placements[0].candidates[0]
    assert camera.focal_px == scene.cameras[0].focal_px
    np.testing.assert_array_equal(camera.P, two.placements[0].candidates[0].P)
    assert errors_px(scene, one)[0] < 5.0
    told = placed(scene.mesh, scene.photos[:1], focals_px={scene.photos[0].name: 400.0})
    assert told.placements[0].candidates[0].focal_px == pytest.approx(400.0)


def drawn(mesh: Mesh, colour, camera, name: str) -> Photo:
    """A mesh in solid colours before black."""
    dark = np.full(3, 0.004)
    linear = render_linear(
        mesh,
        camera,
        lambda hits: colour(hits.points),
        lambda _, pixels: np.broadcast_to(dark, (len(pixels), 3)),
    )
    return Photo(name, np.rint(encode_srgb(linear)).astype(np.uint8))


def plain(points):
    return np.broadcast_to([0.5, 0.4, 0.3], points.shape)


def patchy(points):
    x, y, z = 9.0 * points.T
    return np.column_stack([0.4 + 0.3 * np.sin(x + y), 0.4 + 0.3 * np.cos(y - z), 0.4 + 0.3 * np.sin(z)])  # fmt: skip


def turned_body(radius) -> Mesh:
    """A body of revolution: ``radius`` of the height, in [-1, 1]."""
    directions, faces = icosphere(4)
    z = 1.4 * directions[:, 2]
    across = directions[:, :2] * radius(directions[:, 2])[:, None]
    return Mesh(np.column_stack([across, z]), faces)


@pytest.mark.parametrize("colour", [plain, patchy])
def test_a_bottle_is_unsure_because_any_turn_about_its_axis_fits(colour):
    bottle = turned_body(lambda z: np.where(z > 0.3, 0.45, 0.8) + 0.15 * z)
    scene = small_scene()
    middle = bottle.bounds.mean(axis=0)
    photos = []
    for k, camera in enumerate(scene.cameras):
        toward = camera.center - scene.mesh.bounds.mean(axis=0)
        seen = camera.look_at(
            middle + 1.6 * toward, middle, (0, 0, 1), camera.focal_px,
            camera.width, camera.height,
        )  # fmt: skip
        photos.append(drawn(bottle, colour, seen, f"{k}.png"))
    for some in (photos[:1], photos):
        found = placed(bottle, some)
        assert found.grade == "unsure", [one.sentence for one in found.placements]
        assert found.placements[0].is_tied
        assert "any turn about" in found.placements[0].sentence
        assert len(found.placements[0].candidates) == 3


def test_a_plain_sphere_is_unsure():
    ball = Mesh(*icosphere(4))
    scene = small_scene()
    camera = scene.cameras[0].look_at((0, -5, 1), (0, 0, 0), (0, 0, 1), 380.0, 320, 240)
    found = placed(ball, [drawn(ball, plain, camera, "ball.png")])
    assert found.grade == "unsure", found.placements[0].sentence
    assert found.placements[0].is_tied


def test_photos_of_another_object_are_not_called_found():
    scene, other = small_scene(seed=7), small_scene(seed=8)
    for photos in (other.photos, other.photos[:1]):
        found = placed(scene.mesh, photos)
        assert found.grade != "found", [one.sentence for one in found.placements]
        assert "points" in found.placements[0].sentence


def test_a_photo_that_shows_nothing_is_not_found_and_the_others_are():
    scene = small_scene(seed=5)
    empty = Photo("empty.png", np.full((240, 320, 3), 90, np.uint8))
    found = placed(scene.mesh, [*scene.photos, empty])
    assert [one.grade for one in found.placements] == ["found", "found", "not found"]
    assert found.grade == "not found"
    assert found.placements[2].candidates == ()
    assert "box" in found.placements[2].sentence


def test_hints_of_photos_that_are_not_there_are_refused():
    scene = small_scene()
    with pytest.raises(InputError, match="at least one photo"):
        place(scene.mesh, [])
    with pytest.raises(InputError, match=r"no photo x\.png"):
        place(scene.mesh, scene.photos, boxes={"x.png": (0, 0, 9, 9)})
    with pytest.raises(InputError, match="positive"):
        place(scene.mesh, scene.photos, focals_px={scene.photos[0].name: -1.0})
