"""Synthetic scenes: repeatable, physically right, each option does what it says."""

import dataclasses
import functools
from pathlib import Path

import cv2
import numpy as np
import pytest

from photoreg.errors import InputError, OutputError
from photoreg.formats.cameras.cameras_json import load_cameras
from photoreg.formats.meshes.read import load_mesh
from photoreg.formats.photos.read import load_photo
from photoreg.geometry.projection_error import projection_error
from photoreg.geometry.sampling import sample_surface
from photoreg.geometry.visibility import visible
from photoreg.synthetic.options import SceneOptions
from photoreg.synthetic.render import decode_srgb, encode_srgb
from photoreg.synthetic.scene import Scene, make_scene, write_scene
from tests.scenes import HEIGHT, WIDTH, small_scene

DEMO = Path(__file__).parents[2] / "static" / "demo"


@functools.cache
def small_demo() -> Scene:
    """The demo at a quarter of its size (views scale with it), without noise and JPEG."""
    return make_scene(
        SceneOptions(
            kind="shell",
            seed=0,
            width=WIDTH,
            height=HEIGHT,
            error_px=(15.0 / 4.0, 25.0 / 4.0),
            sensor_noise=0.0,
            jpeg_quality=0,
        )
    )


def object_pixels(scene: Scene, index: int) -> np.ndarray:
    """True where the photo shows nothing but the object."""
    mesh, camera = scene.true_mesh, scene.cameras[index]
    grid = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), axis=-1)
    origin, rays = camera.rays(grid.reshape(-1, 2).astype(float))
    met = mesh.first_hits(np.broadcast_to(origin, rays.shape), rays)[0] >= 0
    solid = met.reshape(HEIGHT, WIDTH).astype(np.uint8)
    return cv2.erode(solid, np.ones((3, 3), np.uint8)) > 0


def pixels(scene: Scene, index: int) -> np.ndarray:
    return scene.photos[index].pixels.astype(np.float64)


def test_the_same_options_make_the_same_scene_whatever_the_global_random_state():
    options = SceneOptions(
        kind="hard", seed=3, width=96, height=64, n_faces=320, occluder_share=0.1
    )
    np.random.seed(1)  # noqa: NPY002
    first = make_scene(options)
    np.random.seed(2)  # noqa: NPY002
    second = make_scene(options)
    np.testing.assert_array_equal(first.mesh.vertices, second.mesh.vertices)
    assert first.encoded == second.encoded
    for a, b in zip(first.cameras, second.cameras, strict=True):
        np.testing.assert_array_equal(a.P, b.P)
    for a, b in zip(first.rough_cameras, second.rough_cameras, strict=True):
        np.testing.assert_array_equal(a.P, b.P)


def test_another_seed_changes_form_pattern_views_and_rough_cameras():
    first, second = small_scene(0), small_scene(1)
    assert np.abs(first.mesh.vertices - second.mesh.vertices).max() > 0.05
    assert np.abs(pixels(first, 0) - pixels(second, 0)).mean() > 5.0
    assert np.abs(first.cameras[0].P - second.cameras[0].P).max() > 1.0
    assert np.abs(first.rough_cameras[0].K - second.rough_cameras[0].K).max() > 0.1


@pytest.mark.parametrize("kind", ["clean", "mid", "clutter", "hard"])
def test_rough_cameras_of_every_kind_are_off_by_what_was_asked_for(kind):
    scene = small_scene(kind=kind)
    error = projection_error(scene.true_mesh, scene.cameras, scene.rough_cameras)
    for camera in error.cameras:
        assert 5.0 <= camera.mean <= 8.0, camera.mean


@pytest.mark.parametrize("n_photos", [2, 3, 8])
def test_neighbouring_photos_are_the_baseline_apart_and_hold_the_whole_object(n_photos):
    scene = small_scene(n_photos=n_photos, baseline_deg=20.0, n_faces=1_280)
    assert len(scene.photos) == len(scene.cameras) == n_photos
    assert len({photo.name for photo in scene.photos}) == n_photos
    middle = scene.mesh.bounds.mean(axis=0)
    offsets = np.array([camera.center - middle for camera in scene.cameras])
    azimuths_deg = np.degrees(np.unwrap(np.arctan2(offsets[:, 1], offsets[:, 0])))
    np.testing.assert_allclose(np.diff(azimuths_deg), 20.0, atol=1e-6)
    for camera in scene.cameras:
        assert camera.contains(camera.project(scene.mesh.vertices)).all()
        off = np.abs(camera.K[:2, 2] - 0.5 * np.array([WIDTH - 1, HEIGHT - 1]))
        assert off.min() >= 0.003 * WIDTH - 1e-9, off
        assert off.max() <= 0.006 * WIDTH + 1e-9, off


def test_a_flat_lit_photo_shows_the_albedo_where_the_camera_puts_it():
    scene = small_scene(width=640, height=480)
    samples = sample_surface(scene.true_mesh, 4_000, seed=2)
    seen = visible(samples, scene.cameras, scene.true_mesh, method="rays")
    for index, camera in enumerate(scene.cameras):
        points = samples.points[seen[index]]
        expected = encode_srgb(scene.albedo(points))
        at = camera.project(points).astype(np.float32)[:, None]
        found = cv2.remap(
            scene.photos[index].pixels, at[..., 0], at[..., 1], cv2.INTER_LINEAR
        )[:, 0]
        off = np.median(np.abs(found - expected))
        shifted = cv2.remap(
            scene.photos[index].pixels, at[..., 0] + 0.5, at[..., 1], cv2.INTER_LINEAR
        )[:, 0]
        # A pixel blurs the finest octave of the texture; half a pixel's shift shows.
        assert off < 6.0, off
        assert off < 0.9 * np.median(np.abs(shifted - expected))


def test_render_repeats_the_photos_and_shows_other_views():
    scene = small_demo()
    for index, camera in enumerate(scene.cameras):
        np.testing.assert_array_equal(
            scene.render(camera, lit_as=index), scene.photos[index].pixels
        )
    half = scene.cameras[0].resized(WIDTH // 2, HEIGHT // 2)
    reduced = cv2.resize(
        scene.photos[0].pixels, (WIDTH // 2, HEIGHT // 2), interpolation=cv2.INTER_AREA
    )
    off = np.abs(scene.render(half).astype(float) - reduced).mean()
    assert off < 1.5, off


def test_light_that_stays_gives_a_point_the_same_colour_in_both_photos():
    def differences(scene: Scene) -> float:
        samples = sample_surface(scene.true_mesh, 3_000, seed=2)
        seen = visible(samples, scene.cameras, scene.true_mesh, method="rays").all(0)
        values = []
        for index, camera in enumerate(scene.cameras):
            at = camera.project(samples.points[seen]).astype(np.float32)[:, None]
            blurred = cv2.GaussianBlur(scene.photos[index].pixels, (0, 0), 1.5)
            values.append(
                cv2.remap(blurred, at[..., 0], at[..., 1], cv2.INTER_LINEAR)[:, 0]
            )
        return float(np.median(np.abs(values[0].astype(float) - values[1])))

    same = differences(small_scene(light="same", contrast=0.3))
    moved = differences(small_scene(light="moved", contrast=0.3))
    assert same < 2.0, same
    assert moved > 10.0, moved


def test_mesh_noise_is_on_the_given_mesh_and_never_in_the_photos():
    clean, noisy = small_scene(), small_scene(mesh_noise=0.002)
    assert clean.mesh is clean.true_mesh
    assert clean.encoded == noisy.encoded
    np.testing.assert_array_equal(noisy.true_mesh.vertices, clean.mesh.vertices)
    errors = noisy.mesh.vertices - noisy.true_mesh.vertices
    along = np.einsum("nd,nd->n", errors, noisy.true_mesh.vertex_normals)
    assert along.std() / noisy.true_mesh.diagonal == pytest.approx(0.002, rel=0.05)
    # All of it is along the normal, but for the rounding to single precision.
    across = np.linalg.norm(errors, axis=1) - np.abs(along)
    assert np.abs(across).max() < 1e-6


def test_gain_and_offset_change_the_values_of_all_photos_but_the_first():
    plain = small_scene(n_photos=3)
    exposed = small_scene(n_photos=3, gain=(0.8, 1.1, 1.2), offset=(10.0, 0.0, -5.0))
    np.testing.assert_array_equal(pixels(plain, 0), pixels(exposed, 0))
    for index in (1, 2):
        expected = pixels(plain, index) * [0.8, 1.1, 1.2] + [10.0, 0.0, -5.0]
        off = np.abs(pixels(exposed, index) - np.clip(expected, 0.0, 255.0))
        # Rounded to bytes once in one scene, twice in the other.
        assert off.max() <= 0.5 + 0.5 * 1.2 + 1e-9, off.max()


def test_vignetting_takes_its_share_of_the_light_in_the_corners_and_none_in_the_middle():
    plain = small_scene(background="clutter")
    dark = small_scene(background="clutter", vignetting=0.4)
    ratio = decode_srgb(pixels(dark, 1)) / np.maximum(
        decode_srgb(pixels(plain, 1)), 0.02
    )
    bright = pixels(plain, 1).min(axis=2) > 100
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    radius = np.hypot(columns - 159.5, rows - 119.5) / np.hypot(160, 120)
    for low, high in ((0.0, 0.2), (0.45, 0.55), (0.85, 0.95)):
        ring = bright & (radius >= low) & (radius < high)
        expected = 1.0 - 0.4 * np.mean(radius[ring] ** 2)
        assert np.mean(ratio[ring]) == pytest.approx(expected, abs=0.01), (low, high)


def test_sensor_noise_has_the_sigma_asked_for_and_differs_between_photos():
    clean, noisy = small_scene(), small_scene(sensor_noise=4.0)
    noise = [pixels(noisy, index) - pixels(clean, index) for index in (0, 1)]
    inside = [object_pixels(clean, index) for index in (0, 1)]
    for values, mask, index in zip(noise, inside, (0, 1), strict=True):
        middling = mask & (np.abs(pixels(clean, index) - 128).max(axis=2) < 100)
        assert values[middling].std() == pytest.approx(4.0, rel=0.02)
    assert abs(np.corrcoef(noise[0].ravel(), noise[1].ravel())[0, 1]) < 0.02


def test_the_occluder_covers_its_share_of_the_last_photo_only():
    clear, covered = small_scene(), small_scene(occluder_share=0.2)
    np.testing.assert_array_equal(pixels(clear, 0), pixels(covered, 0))
    changed = (pixels(clear, 1) != pixels(covered, 1)).any(axis=2)
    assert changed.mean() == pytest.approx(0.2, abs=0.01)
    # It hides a part of the object, not only of what is beside it.
    hidden = (changed & object_pixels(clear, 1)).sum() / object_pixels(clear, 1).sum()
    assert 0.03 < hidden < 0.6, hidden


def test_clutter_is_behind_the_object_and_moves_with_the_view():
    dark, clutter = small_scene(), small_scene(background="clutter")
    for index in (0, 1):
        inside = object_pixels(dark, index)
        np.testing.assert_array_equal(
            pixels(dark, index)[inside], pixels(clutter, index)[inside]
        )
    around = ~object_pixels(dark, 0) & ~object_pixels(dark, 1)
    assert pixels(clutter, 0)[around].std() > 25.0
    apart = np.abs(pixels(clutter, 0)[around] - pixels(clutter, 1)[around]).mean()
    assert apart > 20.0, apart


def test_contrast_scales_the_differences_from_the_mean_colour():
    full, faint = small_scene(), small_scene(contrast=0.3)
    points = sample_surface(full.mesh, 3_000, seed=0).points
    spread = faint.albedo(points).std(axis=0) / full.albedo(points).std(axis=0)
    # The full texture is cut at black and white, so a little less than it would be.
    assert spread == pytest.approx(0.3, abs=0.03)


def test_an_option_given_outweighs_the_kind():
    settings = SceneOptions(kind="mid", gain=1.0, sensor_noise=0.0).settings()
    assert (settings.gain, settings.sensor_noise) == (1.0, 0.0)
    assert (settings.contrast, settings.mesh_noise) == (0.3, 0.001)
    assert settings.baseline_deg == 30.0


@pytest.mark.parametrize("jpeg_quality", [0, 80])
def test_a_written_scene_reads_back_as_it_was(tmp_path, jpeg_quality):
    scene = small_scene(kind="mid", jpeg_quality=jpeg_quality)
    written = write_scene(scene, tmp_path / "a" / "scene")
    assert all(path.stat().st_size > 0 for path in written)
    folder = tmp_path / "a" / "scene"
    mesh = load_mesh(folder / scene.mesh.name)
    np.testing.assert_array_equal(mesh.vertices, scene.mesh.vertices)
    np.testing.assert_array_equal(mesh.faces, scene.mesh.faces)
    photos = [load_photo(folder / photo.name) for photo in scene.photos]
    for photo, original in zip(photos, scene.photos, strict=True):
        np.testing.assert_array_equal(photo.pixels, original.pixels)
    for name, cameras in (
        ("cameras.json", scene.cameras),
        ("rough.json", scene.rough_cameras),
    ):
        read = load_cameras(folder / name).of_photos(photos)
        for camera, original in zip(read, cameras, strict=True):
            np.testing.assert_array_equal(camera.P, original.P)


def test_a_scene_is_not_written_into_a_file(tmp_path):
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(OutputError, match="Cannot write the scene"):
        write_scene(small_scene(), tmp_path / "taken")


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"kind": "clam"}, "no scene of kind 'clam'; there are shell, clean"),
        ({"seed": -1}, "seed is -1"),
        ({"n_photos": 1}, "at least 2 photos, not 1"),
        ({"width": 8}, "8x960 px are too small"),
        ({"occluder_share": 1.0}, "occluder's share is 1"),
        ({"jpeg_quality": 101}, "JPEG quality is 101"),
    ],
)
def test_an_impossible_option_is_refused_in_a_sentence(wrong, sentence):
    with pytest.raises(InputError, match=sentence):
        SceneOptions(**wrong)


def test_the_committed_demo_is_what_the_code_makes():
    small = small_demo()
    mesh = load_mesh(DEMO / small.mesh.name)
    assert len(mesh.faces) == len(small.mesh.faces) == 20_480
    # Other processors round otherwise, and the reduction may then cut otherwise.
    assert mesh.bounds == pytest.approx(small.mesh.bounds, abs=1e-3 * mesh.diagonal)
    assert mesh.area == pytest.approx(small.mesh.area, rel=1e-3)
    assert mesh.centroid == pytest.approx(small.mesh.centroid, abs=1e-3 * mesh.diagonal)
    photos = [load_photo(DEMO / name) for name in ("shell-left.jpg", "shell-right.jpg")]
    true = load_cameras(DEMO / "cameras.json").of_photos(photos)
    rough = load_cameras(DEMO / "rough.json").of_photos(photos)
    points = small.mesh.vertices
    for index, photo in enumerate(photos):
        assert (photo.width, photo.height) == (1280, 960)
        for committed, made in (
            (true[index], small.cameras[index]),
            (rough[index], small.rough_cameras[index]),
        ):
            off = committed.resized(320, 240).project(points) - made.project(points)
            assert np.abs(off).max() < 0.05, np.abs(off).max()
        off = photo.resized(320).pixels.astype(float) - small.photos[index].pixels
        assert np.abs(off).mean() < 3.0, np.abs(off).mean()


def test_the_demo_is_small_and_its_rough_cameras_are_15_to_25_px_off():
    files = [path for path in DEMO.iterdir() if path.is_file()]
    assert sum(path.stat().st_size for path in files) < 4_000_000
    mesh = load_mesh(DEMO / "shell.ply")
    true = list(load_cameras(DEMO / "cameras.json").cameras.values())
    rough = list(load_cameras(DEMO / "rough.json").cameras.values())
    for camera in projection_error(mesh, true, rough).cameras:
        assert 15.0 <= camera.mean <= 25.0, camera.mean
    # In millimetres, away from the origin, seen from 25 degrees apart.
    assert 60.0 < np.ptp(mesh.vertices[:, 2]) < 120.0
    assert np.linalg.norm(mesh.centroid) > 0.3 * mesh.diagonal
    a, b = (camera.center - mesh.centroid for camera in true)
    angle = np.degrees(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b)))
    assert angle == pytest.approx(25.0, abs=1.5)


def test_scenes_can_be_changed_one_setting_at_a_time():
    options = dataclasses.replace(SceneOptions(kind="clean"), sensor_noise=8.0)
    assert options.settings() == dataclasses.replace(
        SceneOptions(kind="clean").settings(), sensor_noise=8.0
    )


def test_a_crop_moves_the_principal_point_and_leaves_the_object_in_its_place():
    whole, part = small_scene(), small_scene(crop=0.2)
    middle = whole.true_mesh.bounds.mean(axis=0)[None]
    for before, after in zip(whole.cameras, part.cameras, strict=True):
        moved = (after.K[:2, 2] - before.K[:2, 2]) / (WIDTH, HEIGHT)
        assert np.hypot(*moved) == pytest.approx(0.2)
        np.testing.assert_allclose(before.center, after.center, atol=1e-9)
        gap = before.project(middle) - after.project(middle)
        np.testing.assert_allclose(gap, 0.0, atol=1e-6)
    # Nobody tells the rough cameras.
    for one, other in zip(whole.rough_cameras, part.rough_cameras, strict=True):
        np.testing.assert_array_equal(one.P, other.P)
    with pytest.raises(InputError, match="crop"):
        SceneOptions(crop=0.6)
