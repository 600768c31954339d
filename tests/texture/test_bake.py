"""Baked textures against a surface of known colour, texel by texel."""

import dataclasses

import cv2
import numpy as np
import pytest
import trimesh

from photoreg.errors import InputError
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.rasteriser import render_geometry
from photoreg.imaging.photo import Photo
from photoreg.registration.refinement import refine
from photoreg.synthetic.options import SceneOptions
from photoreg.synthetic.scene import make_scene
from photoreg.texture.atlas import make_atlas
from photoreg.texture.bake import BakingStep, TexturedMesh, bake_texture, baking
from photoreg.texture.config import TextureConfig
from tests.painted import (
    BACKDROP,
    ball_and_moon,
    cameras_around,
    paint,
    photograph,
    render_textured,
)
from tests.texture.third_view import likeness, third_camera


@pytest.fixture(scope="module")
def mesh():
    return ball_and_moon(3)


@pytest.fixture(scope="module")
def cameras():
    return cameras_around(2)


@pytest.fixture(scope="module")
def photos(mesh, cameras):
    return [photograph(mesh, c, f"photo{i}.png") for i, c in enumerate(cameras)]


@pytest.fixture(scope="module")
def atlas(mesh):
    return make_atlas(mesh)


@pytest.fixture(scope="module")
def textured(mesh, photos, cameras, atlas):
    return bake_texture(mesh, photos, cameras, atlas=atlas)


def texel_points(textured: TexturedMesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Surface point and face of each texel whose centre is on a chart, and where."""
    height, width = textured.texture.shape[:2]
    face = textured.atlas.faces_at_texels(width, height)
    on_chart = face >= 0
    y, x = np.nonzero(on_chart)
    uv = np.column_stack(
        [(x + 0.5) / width, 1.0 - (y + 0.5) / height, np.zeros(len(x))]
    )
    corners = np.pad(textured.corner_uv[face[on_chart]], ((0, 0), (0, 0), (0, 1)))
    bary = trimesh.triangles.points_to_barycentric(corners, uv)
    vertices = textured.vertices[textured.faces[face[on_chart]]]
    return (bary[:, :, None] * vertices).sum(axis=1), face[on_chart], on_chart


def by_rays(mesh, camera, points, face) -> np.ndarray:
    """Whether the camera sees surface points of faces that look at it, in its photo."""
    view = camera.center - points
    seen = (mesh.face_normals[face] * view).sum(axis=1) > 0.0
    seen &= camera.contains(camera.project(points))
    return seen & mesh.is_unoccluded(points, camera.center)


@pytest.mark.workqueue
def test_painted_texels_have_the_true_colour(textured):
    points, _, on_chart = texel_points(textured)
    painted = (textured.photo_index >= 0)[on_chart]
    error = np.abs(textured.texture[on_chart] - paint(points))[painted]
    # Two interpolations of colours that change by up to 40 between pixels where the
    # surface is steep: worst observed 9, mean 0.5 (rounding alone is 0.25).
    assert error.max() < 16.0, error.max()
    assert error.mean() < 1.0, error.mean()


def test_nothing_is_painted_that_no_photo_sees(mesh, cameras, textured):
    points, face, on_chart = texel_points(textured)
    index = textured.photo_index[on_chart]
    for i, camera in enumerate(cameras):
        painted = index == i
        assert painted.sum() > 1000
        hidden = ~by_rays(mesh, camera, points[painted], face[painted])
        assert not hidden.any(), hidden.sum()


def test_what_a_photo_sees_well_is_painted(mesh, cameras, textured):
    points, face, on_chart = texel_points(textured)
    well = np.zeros(len(points), dtype=bool)
    for camera in cameras:
        view = camera.center - points
        view /= np.linalg.norm(view, axis=1, keepdims=True)
        cosine = (mesh.face_normals[face] * view).sum(axis=1)
        well |= by_rays(mesh, camera, points, face) & (cosine > 0.35)
    share = (textured.photo_index[on_chart] >= 0)[well].mean()
    # Missing: the margin around the small ball's outline and shadow. Observed 0.985.
    assert share > 0.97, share


def test_the_backdrop_never_bleeds_into_the_texture(textured):
    # Magenta has no green; the surface has 120 and more.
    assert textured.texture[:, :, 1].min() > 105, textured.texture[:, :, 1].min()
    nearest = np.abs(textured.texture.astype(int) - BACKDROP).max(axis=2).min()
    assert nearest > 100, nearest


def test_background_over_the_mesh_s_outline_is_not_painted(mesh, photos, cameras):
    """A mesh that is 3 px fatter than what was photographed."""
    moved = mesh.vertices + 0.02 * mesh.vertex_normals
    fat = dataclasses.replace(mesh, vertices=moved)
    textured = bake_texture(fat, photos, cameras)
    painted = textured.texture[textured.photo_index >= 0].astype(int)
    # Between the surface, whose green is 110 and more, and the backdrop, which has none.
    assert painted[:, 1].min() > 85, painted[:, 1].min()
    nearest = np.abs(painted - BACKDROP).max(axis=1).min()
    assert nearest > 85, nearest


def test_seen_shares_are_shares_of_the_area(mesh, cameras, textured):
    points, face, on_chart = texel_points(textured)
    counts = np.bincount(face, minlength=len(mesh.faces))
    area = mesh.face_areas[face] / counts[face]
    index = textured.photo_index[on_chart]
    shares = [area[index == i].sum() / mesh.area for i in range(2)]
    np.testing.assert_allclose(textured.seen_share_by_photo, shares, atol=1e-3)
    assert textured.seen_share == pytest.approx(sum(shares), abs=1e-3)
    visible = np.zeros(len(points), dtype=bool)
    for camera in cameras:
        visible |= by_rays(mesh, camera, points, face)
    # Less than what is visible at all: grazing angles and margins are left out.
    share = area[visible].sum() / mesh.area
    assert 0.7 * share < textured.seen_share < share, (textured.seen_share, share)


def test_texture_coordinates_are_in_range_and_keep_the_faces(mesh, textured):
    uv = textured.atlas.uv
    assert uv.min() >= 0.0
    assert uv.max() <= 1.0
    vertex = textured.atlas.uv_vertex[textured.atlas.uv_faces]
    np.testing.assert_array_equal(
        mesh.vertices[vertex], textured.vertices[textured.faces]
    )


def test_a_view_that_no_photo_had_shows_the_true_surface(mesh, textured):
    camera = cameras_around(3)[2]
    truth = photograph(mesh, camera).pixels
    picture, texel = render_textured(mesh, textured.corner_uv, textured.texture, camera)
    on_mesh = texel[:, :, 0] >= 0
    painted = np.zeros_like(on_mesh)
    rows, columns = texel[on_mesh].T
    painted[on_mesh] = textured.photo_index[rows, columns] >= 0
    error = (picture - truth)[painted]
    psnr = 10.0 * np.log10(255.0**2 / np.mean(error**2))
    # Observed 47 dB.
    assert psnr > 42.0, psnr
    assert painted.sum() > 0.5 * on_mesh.sum()


def test_no_seam_shows_at_the_borders_of_charts(mesh, photos, cameras):
    # Cut into a chart a face, every edge is a seam; looked up bilinearly from the
    # photo's own camera, the picture is still the photo.
    n = len(mesh.faces)
    side = int(np.ceil(np.sqrt(n)))
    corner = np.array([[0.15, 0.15], [0.85, 0.15], [0.15, 0.85]]) / side
    cell = np.column_stack(np.divmod(np.arange(n), side)) / side
    split = dataclasses.replace(mesh, corner_uv=cell[:, None, :] + corner)
    config = TextureConfig(size=1024)
    textured = bake_texture(split, photos[:1], cameras[:1], config)
    assert textured.atlas.is_own
    picture, texel = render_textured(
        split, textured.corner_uv, textured.texture, cameras[0]
    )
    on_mesh = texel[:, :, 0] >= 0
    face = render_geometry(split, cameras[0]).face_index[on_mesh]
    view = cameras[0].center - split.centroid
    facing = split.face_normals[face] @ (view / np.linalg.norm(view)) > 0.5
    # Away from silhouettes, where nothing is painted.
    inner = cv2.erode(on_mesh.astype(np.uint8), np.ones((13, 13))) > 0
    inner[on_mesh] &= facing
    error = np.abs(picture - photos[0].pixels)[inner]
    assert inner.sum() > 10_000, inner.sum()
    # Observed 2.0; the last per cent lies around the small ball's outline. Without
    # the texels grown beyond the charts, every edge would be off by tens.
    assert np.percentile(error, 99) < 4.0, np.percentile(error, 99)


@pytest.mark.workqueue
def test_different_exposures_are_evened_out(mesh, photos, cameras, atlas):
    dark = photograph(mesh, cameras[1], "dark.png", gain=0.7)
    textured = bake_texture(mesh, [photos[0], dark], cameras, atlas=atlas)
    # The photos meet half-way: gains with a geometric mean of 1.
    ratio = textured.gains[1] / textured.gains[0]
    np.testing.assert_allclose(ratio, 1.0 / 0.7, rtol=0.01)
    np.testing.assert_allclose(textured.gains.prod(axis=0), 1.0, rtol=1e-6)
    points, _, on_chart = texel_points(textured)
    painted = (textured.photo_index >= 0)[on_chart]
    expected = paint(points)[painted] * np.sqrt(0.7)
    error = np.abs(textured.texture[on_chart][painted] - expected)
    assert error.mean() < 1.5, error.mean()


def test_photos_of_equal_exposure_are_left_alone(textured):
    np.testing.assert_allclose(textured.gains, 1.0, atol=0.01)


@pytest.mark.workqueue
def test_best_view_takes_each_texel_from_one_photo(mesh, photos, cameras, atlas):
    grey = [
        dataclasses.replace(photo, pixels=np.full_like(photo.pixels, value))
        for photo, value in zip(photos, (90, 200), strict=True)
    ]
    config = TextureConfig(mode="best", even_exposure=False)
    textured = bake_texture(mesh, grey, cameras, config, atlas)
    values = textured.texture[textured.photo_index >= 0]
    assert set(np.unique(values)) == {90, 200}
    expected = np.where(textured.photo_index == 0, 90, 200)[textured.photo_index >= 0]
    np.testing.assert_array_equal(values[:, 0], expected)


def test_blending_passes_gradually_from_photo_to_photo(mesh, photos, cameras, atlas):
    grey = [
        dataclasses.replace(photo, pixels=np.full_like(photo.pixels, value))
        for photo, value in zip(photos, (90, 200), strict=True)
    ]
    config = TextureConfig(even_exposure=False)
    textured = bake_texture(mesh, grey, cameras, config, atlas)
    values = textured.texture[textured.photo_index >= 0][:, 0]
    between = ((values > 95) & (values < 195)).mean()
    assert between > 0.1, between
    assert values.min() >= 90
    assert values.max() <= 200


def test_unseen_surface_takes_the_colour_of_its_neighbours(textured):
    points, _, on_chart = texel_points(textured)
    unseen = (textured.photo_index == -1)[on_chart]
    colours = textured.texture[on_chart][unseen]
    painted = textured.texture[on_chart][~unseen]
    # Averages never leave the range of what is averaged.
    assert (colours.min(axis=0) >= painted.min(axis=0)).all()
    assert (colours.max(axis=0) <= painted.max(axis=0)).all()
    # The far side of the ball is filled smoothly: no painted detail.
    far = points[unseen][:, 0] < -0.6
    assert colours[far].std(axis=0).max() < 0.5 * painted.std(axis=0).max()


def test_unseen_surface_takes_a_chosen_colour(mesh, photos, cameras, atlas, textured):
    config = TextureConfig(unseen="colour", unseen_colour=(10, 20, 30))
    chosen = bake_texture(mesh, photos, cameras, config, atlas)
    unseen = chosen.photo_index == -1
    assert unseen.sum() > 1000
    np.testing.assert_array_equal(np.unique(chosen.texture[unseen], axis=0), [config.unseen_colour])  # fmt: skip
    seen = chosen.photo_index >= 0
    np.testing.assert_array_equal(chosen.texture[seen], textured.texture[seen])


def test_nothing_is_painted_from_outside_a_mask(mesh, photos, cameras, atlas):
    mask = np.ones(photos[0].pixels.shape[:2], dtype=bool)
    mask[:, 260:] = False
    masked = dataclasses.replace(photos[0], mask=mask)
    textured = bake_texture(mesh, [masked], cameras[:1], atlas=atlas)
    points, _, on_chart = texel_points(textured)
    painted = points[(textured.photo_index >= 0)[on_chart]]
    u = cameras[0].project(painted)[:, 0]
    assert len(u) > 1000
    assert u.max() < 259.0, u.max()


def test_a_mesh_with_inward_faces_is_painted_all_the_same(
    mesh, photos, cameras, textured
):
    inside_out = Mesh(mesh.vertices, mesh.faces[:, ::-1])
    turned = bake_texture(inside_out, photos, cameras)
    assert turned.seen_share == pytest.approx(textured.seen_share, abs=0.01)


@pytest.mark.parametrize(
    ("scale", "origin"),
    [
        (1e-6, (0.0, 0.0, 0.0)),
        (1e6, (0.0, 0.0, 0.0)),
        (1.0, (4_512_345.0, 5_401_234.0, 310.0)),
    ],
    ids=["micrometres", "megametres", "georeferenced"],
)
def test_a_texture_does_not_depend_on_units_and_origin(
    mesh, photos, cameras, atlas, textured, scale, origin
):
    scaled_mesh = dataclasses.replace(mesh, vertices=mesh.vertices * scale + origin)
    scaled = [
        dataclasses.replace(
            c, t_cam_world=c.t_cam_world * scale - c.R_cam_world @ np.array(origin)
        )
        for c in cameras
    ]
    other = bake_texture(scaled_mesh, photos, scaled, atlas=atlas)
    assert other.texture.shape == textured.texture.shape
    same = (other.photo_index == textured.photo_index).mean()
    assert same > 0.999, same


def test_the_texture_is_the_same_every_time(mesh, photos, cameras, atlas, textured):
    again = bake_texture(mesh, photos, cameras, atlas=atlas)
    np.testing.assert_array_equal(again.texture, textured.texture)


def test_automatic_size_gives_about_a_texel_for_a_pixel(mesh, cameras, textured):
    points, face, on_chart = texel_points(textured)
    texel_side = np.sqrt(mesh.area / on_chart.sum())
    z = cameras[0].to_camera(points)[:, 2]
    seen = by_rays(mesh, cameras[0], points, face)
    pixel_side = np.median(z[seen]) / cameras[0].focal_px
    assert 0.7 < texel_side / pixel_side < 1.2, texel_side / pixel_side
    assert textured.texture.shape[0] % 64 == 0
    assert textured.texture.shape[1] % 64 == 0


def test_a_given_size_is_kept(mesh, photos, cameras, atlas):
    textured = bake_texture(mesh, photos, cameras, TextureConfig(size=320), atlas)
    assert max(textured.texture.shape[:2]) == 320


def test_coverage_picture_tells_photos_unseen_and_empty_apart(textured):
    picture = textured.coverage_picture()
    assert (picture[textured.photo_index == -2] == 0).all()
    assert (picture[textured.photo_index == -1] == 60).all()
    first = picture[textured.photo_index == 0].astype(int)
    second = picture[textured.photo_index == 1].astype(int)
    hue = [int(np.argmax(c.mean(axis=0))) for c in (first, second)]
    assert hue[0] != hue[1]


def test_own_coordinates_are_kept_where_valid_and_not_where_they_overlap(mesh, atlas):
    own = dataclasses.replace(mesh, corner_uv=atlas.uv[atlas.uv_faces])
    kept = make_atlas(own)
    assert kept.is_own
    np.testing.assert_array_equal(kept.uv[kept.uv_faces], own.corner_uv)
    assert own.corner_uv is not None
    for bad in (
        own.corner_uv * 1.5,
        np.tile(own.corner_uv[:1], (len(mesh.faces), 1, 1)),
    ):
        assert not make_atlas(dataclasses.replace(mesh, corner_uv=bad)).is_own
    assert not make_atlas(own, keep_uv=False).is_own


def test_photos_and_cameras_must_match(mesh, photos, cameras):
    with pytest.raises(InputError, match="2 photos and 1 cameras"):
        bake_texture(mesh, photos, cameras[:1])
    small = Photo("small.png", photos[0].pixels[:100, :100].copy())
    with pytest.raises(InputError, match=r"small\.png is 100x100 px.*480x360"):
        bake_texture(mesh, [small], cameras[:1])


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"size": 7}, "size is 7"),
        ({"mode": "sharp"}, "mode is 'sharp'"),
        ({"unseen": "nothing"}, "unseen is 'nothing'"),
        ({"unseen_colour": (0, 0, 300)}, "0 to 255"),
        ({"max_angle_deg": 90.0}, "max_angle_deg is 90"),
        ({"margin": -0.1}, "margin is -0.1"),
    ],
)
def test_a_setting_out_of_range_is_refused_and_named(setting, message):
    with pytest.raises(InputError, match=message):
        TextureConfig(**setting)


def test_a_surface_that_no_photo_sees_is_an_error_that_says_what_may_be_wrong(
    mesh, photos, atlas
):
    away = Camera.look_at([5, 0, 0], [9, 0, 0], [0, 0, 1], 500, 480, 360)
    with pytest.raises(InputError, match=r"0 % of the surface is seen.*look away"):
        bake_texture(mesh, photos[:1], [away], atlas=atlas)


def test_a_face_too_small_for_a_texel_counts_for_what_is_seen(mesh, photos, cameras):
    """Of a face that is cut in a thousand, each part shows what the whole does."""
    whole = bake_texture(mesh, photos, cameras, TextureConfig(size=64))
    fine = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    fine = fine.subdivide().subdivide()
    dense = Mesh(fine.vertices, fine.faces)
    parts = bake_texture(dense, photos, cameras, TextureConfig(size=64))
    n_texels = np.bincount(
        parts.atlas.faces_at_texels(64, 64).ravel() + 1, minlength=len(fine.faces) + 1
    )[1:]
    assert (n_texels == 0).mean() > 0.5
    assert parts.seen_share == pytest.approx(whole.seen_share, abs=0.04)


def test_a_photo_far_finer_than_the_texture_stays_a_photo(mesh, cameras, photos):
    """The object on a ground of twenty diagonals, in a small texture."""
    ground = 40.0 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) - [
        0,
        0,
        2,
    ]
    n = len(mesh.vertices)
    faces = [[n, n + 1, n + 2], [n, n + 2, n + 3]]
    terrain = Mesh(np.vstack([mesh.vertices, ground]), np.vstack([mesh.faces, faces]))
    textured = bake_texture(terrain, photos, cameras, TextureConfig(size=256))
    assert 0.0 < textured.seen_share < 0.05


def test_a_narrow_photo_is_reduced_to_no_less_than_a_photo():
    strip = Photo("strip.png", np.zeros((40, 4000, 3), dtype=np.uint8))
    small = strip.resized(64)
    assert (small.width, small.height) == (64, 16)


def test_unseen_surface_keeps_the_vertices_own_colours(mesh, photos, cameras, atlas):
    own = np.rint(paint(mesh.vertices)).astype(np.uint8)
    coloured = dataclasses.replace(mesh, vertex_colours=own)
    config = TextureConfig(unseen="own")
    textured = bake_texture(coloured, photos[:1], cameras[:1], config, atlas)
    points, _, on_chart = texel_points(textured)
    unseen = (textured.photo_index == -1)[on_chart]
    error = np.abs(textured.texture[on_chart] - paint(points))[unseen]
    # Straight between vertices, which are 0.1 apart: a curved colour is cut short.
    assert error.mean() < 4.0, error.mean()


@pytest.mark.workqueue
def test_unseen_surface_keeps_the_mesh_s_own_texture(mesh, photos, cameras, textured):
    # The same surface has a whole texture on coordinates of its own.
    whole = bake_texture(
        mesh, [photograph(mesh, c) for c in cameras_around(12)], cameras_around(12)
    )
    own = dataclasses.replace(
        mesh, corner_uv=whole.corner_uv, own_texture=whole.texture
    )
    config = TextureConfig(unseen="own", keep_uv=False, size=512)
    kept = bake_texture(own, photos[:1], cameras[:1], config)
    points, _, on_chart = texel_points(kept)
    known = by_nearest_photo(mesh, points) & (kept.photo_index == -1)[on_chart]
    assert known.sum() > 5000
    error = np.abs(kept.texture[on_chart] - paint(points))[known]
    assert np.median(error) < 3.0, np.median(error)


def by_nearest_photo(mesh, points) -> np.ndarray:
    """Points on the equator of the big ball, which a dozen photos see."""
    return (np.abs(points[:, 2]) < 0.4) & (points[:, 0] < 0.0)


def test_a_mesh_without_colours_cannot_keep_them(mesh, photos, cameras):
    with pytest.raises(InputError, match="neither a texture nor colours"):
        bake_texture(mesh, photos, cameras, TextureConfig(unseen="own"))


def test_baking_tells_its_steps_and_ends_with_the_model(mesh, photos, cameras):
    *steps, last = baking(mesh, photos, cameras, TextureConfig(size=256))
    assert isinstance(last, TexturedMesh)
    assert all(isinstance(step, BakingStep) for step in steps)
    fractions = [step.fraction for step in steps if isinstance(step, BakingStep)]
    assert fractions == sorted(fractions)
    titles = [step.title for step in steps if isinstance(step, BakingStep)]
    assert all(f"Painting {photo.name}" in titles for photo in photos)
    # To stop is to ask no further.
    half = baking(mesh, photos, cameras, TextureConfig(size=256))
    assert isinstance(next(half), BakingStep)
    half.close()


def test_refined_cameras_cost_little_of_the_likeness():
    """Views that no photo had, against the true render: PSNR and SSIM."""
    scene = make_scene(SceneOptions(kind="clean", seed=3, width=384, height=288))
    *_, last = refine(scene.mesh, scene.photos, scene.rough_cameras)
    textures = [
        bake_texture(scene.mesh, scene.photos, cameras)
        for cameras in (scene.cameras, last.cameras)
    ]
    for way in (0.5, 1.4):  # between the photos, and beside them
        camera = third_camera(scene, way)
        truth = scene.render(camera)
        true, refined = (likeness(texture, camera, truth) for texture in textures)
        assert true.n_pixels > 10_000
        assert true.psnr_db > 30.0, true
        assert refined.psnr_db > true.psnr_db - 1.0, (true, refined)
        assert refined.ssim > true.ssim - 0.02, (true, refined)


def test_no_seam_shows_where_one_photo_gives_way_to_the_other(textured, mesh):
    """Steps between texels are no larger along the border between photos."""
    points, _, on_chart = texel_points(textured)
    wanted = np.zeros((*textured.texture.shape[:2], 3))
    wanted[on_chart] = paint(points)
    # Errors rather than colours: the surface's own pattern is no seam.
    error = textured.texture - wanted
    index = textured.photo_index
    steps = np.abs(error[:, 1:] - error[:, :-1]).mean(axis=2)
    both = (index[:, 1:] >= 0) & (index[:, :-1] >= 0)
    border = both & (index[:, 1:] != index[:, :-1])
    assert border.sum() > 100
    along, elsewhere = steps[border].mean(), steps[both & ~border].mean()
    # The eye's least step is one of CIE's units of colour, some 2.5 of 255 levels of
    # grey, and a screen's least is one level. What a border adds must be below both.
    assert along - elsewhere < 1.0, (along, elsewhere)
    # And it must not stand out of what the photos' own noise does inside the charts.
    # Measured: 0.55 levels along the border, 0.36 elsewhere, ratio 1.52; the best view
    # alone has 1.08.
    ratio = along / elsewhere
    assert ratio < 2.0, ratio
