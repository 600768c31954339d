"""Refinements of photos through real lenses, whose terms nobody knows beforehand."""

import dataclasses
from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import Lens
from photoreg.imaging.photo import Photo
from photoreg.imaging.undistort import undistorted_photo
from photoreg.parameters.freedom import Freedom
from photoreg.registration.config import RegistrationConfig
from photoreg.registration.refinement import refine
from photoreg.synthetic.options import SceneOptions
from photoreg.synthetic.scene import make_scene
from photoreg.texture.bake import bake_texture
from tests.bench.accuracy import load_set
from tests.bench.metrics import Metric, Setting, bench, spread
from tests.bench.outcomes import Outcome, error_figures, run, run_world, time_figures
from tests.bench.worlds import World, world
from tests.texture.third_view import likeness, third_camera

PHONE_FOCAL_SHARE = 0.78
"""Focal length of a phone over its photo's width."""

SOLVING = dataclasses.replace(RegistrationConfig(), distortion="auto")

PHONE_TERMS = (0.07, -0.1, 0.001, -0.001, 0.0)
"""k1, k2, p1, p2, k3 as of a phone: the middle of what ``_through_phones`` draws."""

FIRST_SEED = 100


def _through_k1(n: int, kind: str) -> Iterator[World]:
    """Scenes through one radial term, drawn from -0.15 to 0.05."""
    for seed in range(FIRST_SEED, FIRST_SEED + n):
        k1 = float(np.random.default_rng(seed).uniform(-0.15, 0.05))
        yield world(
            kind,
            seed,
            focal_share=PHONE_FOCAL_SHARE,
            distortion=(k1, 0.0, 0.0, 0.0, 0.0),
        )


def _through_phones(n: int, kind: str) -> Iterator[World]:
    """Scenes through terms as those of real phones."""
    for seed in range(FIRST_SEED, FIRST_SEED + n):
        rng = np.random.default_rng(seed)
        k1, k2 = float(rng.uniform(0.02, 0.12)), float(rng.uniform(-0.2, 0.05))
        p1, p2 = (0.001 * float(sign) for sign in rng.choice([-1.0, 1.0], 2))
        yield world(
            kind, seed, focal_share=PHONE_FOCAL_SHARE, distortion=(k1, k2, p1, p2, 0.0)
        )


def _ideal(n: int, kind: str) -> Iterator[World]:
    for seed in range(FIRST_SEED, FIRST_SEED + n):
        yield world(kind, seed)


def _cropped(n: int, kind: str) -> Iterator[World]:
    """Scenes whose principal points are 10 to 30 % of the width off."""
    for seed in range(FIRST_SEED, FIRST_SEED + n):
        crop = float(np.random.default_rng(seed).uniform(0.1, 0.3))
        yield world(kind, seed, crop=crop)


@bench
def lens(setting: Setting) -> Iterator[Metric]:
    """Unknown lenses solved along, and ideal ones solved all the same."""
    cases = (
        ("lens.k1", _through_k1, "clean", 0.10, 0.3),
        ("lens.phone", _through_phones, "clean", 0.15, 0.5),
        ("lens.k1_mid", _through_k1, "mid", None, None),
        ("lens.ideal", _ideal, "clean", 0.10, 0.3),
        ("lens.ideal_mid", _ideal, "mid", None, None),
    )
    for name, scenes, kind, mean_bar, worst_bar in cases:
        outcomes = [run_world(made, SOLVING) for made in scenes(setting.n, kind)]
        yield from error_figures(name, outcomes, mean_bar, worst_bar)
        yield from time_figures(name, outcomes)
        yield from _honesty(name, outcomes)


@bench
def lens_held(setting: Setting) -> Iterator[Metric]:
    """The same with every lens held at 0: what it costs not to solve them."""
    held = dataclasses.replace(SOLVING, distortion="none")
    for name, scenes in (("k1", _through_k1), ("ideal", _ideal)):
        outcomes = [run_world(made, held) for made in scenes(setting.n, "clean")]
        yield from error_figures(f"lens_held.{name}", outcomes)
        yield from time_figures(f"lens_held.{name}", outcomes)
        yield from _honesty(f"lens_held.{name}", outcomes)


@bench
def lens_price(setting: Setting) -> Iterator[Metric]:
    """Processor time of whole refinements with the lens over that without, in turn."""
    held = dataclasses.replace(SOLVING, distortion="none")
    for name, scenes in (("ideal", _ideal), ("k1", _through_k1)):
        ratios = [
            run_world(made, SOLVING).cpu_s / run_world(made, held).cpu_s
            for made in scenes(setting.n, "clean")
        ]
        yield from spread(f"lens_price.{name}", ratios, "x", 1.15, tolerance=0.1)


@bench
def lens_known(setting: Setting) -> Iterator[Metric]:
    """A lens that a camera file tells, kept: against the photos undistorted before."""
    held = dataclasses.replace(SOLVING, distortion="none")
    losses = []
    for made in _through_k1(setting.n, "clean"):
        lenses = [camera.lens for camera in made.cameras]
        start = map(Camera.with_lens, made.rough_cameras, lenses)
        kept = dataclasses.replace(made, rough_cameras=tuple(start))
        undistorted = dataclasses.replace(
            made,
            photos=tuple(map(undistorted_photo, made.photos, made.cameras)),
            cameras=tuple(camera.pinhole for camera in made.cameras),
        )
        ends = [run_world(one, held).end_px for one in (kept, undistorted)]
        losses.append(ends[0] - ends[1])
    yield from spread("lens_known.loss", losses, "px", 0.05)


@bench
def lens_texture(setting: Setting) -> Iterator[Metric]:
    """What a lens costs the texture: PSNR from a third view, against ideal photos."""
    losses = []
    for seed in range(FIRST_SEED, FIRST_SEED + setting.n):
        ideal = SceneOptions(kind="clean", seed=seed, focal_share=PHONE_FOCAL_SHARE)
        found = []
        for options in (ideal, dataclasses.replace(ideal, distortion=PHONE_TERMS)):
            scene = make_scene(options)
            *_, last = refine(scene.mesh, scene.photos, scene.rough_cameras, SOLVING)
            view = third_camera(scene, 0.5)
            baked = bake_texture(scene.mesh, scene.photos, last.cameras)
            found.append(likeness(baked, view, scene.render(view)).psnr_db)
        losses.append(found[0] - found[1])
    yield from spread("lens_texture.loss", losses, "dB", 0.3)


@bench
def lens_real(setting: Setting) -> Iterator[Metric]:
    """Photos of sets distorted by a lens that nobody tells, against the photos as they are."""
    if setting.data is None:
        return
    for name in ("fountain", "granite"):
        folder = setting.data / name
        losses, ends = [], []
        for path in sorted((folder / "starts").glob("*-easy-*.json"))[: setting.n]:
            mesh, photos, true, start = load_set(folder, path, folder / "photos")
            lens = Lens(*PHONE_TERMS)
            bent = [camera.with_lens(lens) for camera in true]
            distorted = list(map(_distorted_photo, photos, bent))
            plain = run(mesh, photos, true, start, SOLVING).end_px
            ends.append(run(mesh, distorted, bent, start, SOLVING).end_px)
            losses.append(ends[-1] - plain)
        note = f"ends {', '.join(f'{px:.2f}' for px in ends)} px"
        yield from spread(f"lens_real.{name}.loss", losses, "px", 0.1, note=note)


def _distorted_photo(photo: Photo, camera: Camera) -> Photo:
    """The photo of an ideal lens as ``camera``'s lens would have taken it."""
    K, lens = camera.K, camera.lens
    y, x = np.mgrid[: photo.height, : photo.width].astype(np.float64)
    # OpenCV 4 iterates often enough only in a function of its own.
    undistort = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)
    places = undistort(
        np.stack([x.ravel(), y.ravel()], axis=1)[:, None],
        K,
        np.array([lens.k1, lens.k2, lens.p1, lens.p2, lens.k3]),
        R=np.eye(3),
        P=K,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9),
    ).reshape(photo.height, photo.width, 2)
    columns, rows = np.moveaxis(places.astype(np.float32), 2, 0)
    pixels = cv2.remap(photo.pixels, columns, rows, cv2.INTER_CUBIC)
    shown = np.ones(pixels.shape[:2], np.uint8)
    mask = cv2.remap(shown, columns, rows, cv2.INTER_NEAREST) > 0
    return dataclasses.replace(photo, pixels=pixels, mask=mask, source=None)


@bench
def cropped(setting: Setting) -> Iterator[Metric]:
    """Photos of which a part was cut off, said and not said."""
    saying = Freedom(cropped=(0, 1))
    for kind, mean_bar in (("clean", 0.1), ("mid", 1.2)):
        for name, freedom in (("cropped", saying), ("cropped_unsaid", None)):
            outcomes = [
                run_world(made, freedom=freedom) for made in _cropped(setting.n, kind)
            ]
            bar = mean_bar if freedom is saying else None
            yield from error_figures(f"{name}.{kind}", outcomes, bar)
            yield from _honesty(f"{name}.{kind}", outcomes, 1.2)


def _honesty(
    name: str, outcomes: Sequence[Outcome], limit_px: float = 1.0
) -> Iterator[Metric]:
    """Whether verdict and expected error are as the true errors are."""
    ends = np.array([outcome.end_px for outcome in outcomes])
    convincing = np.array(
        [
            outcome.finished.verdict is not None
            and outcome.finished.verdict.grade == "convincing"
            for outcome in outcomes
        ]
    )
    note = f"n={ends.size}"
    yield Metric(
        f"{name}.convincing_wrongly",
        int((convincing & (ends > limit_px)).sum()),
        f"over {limit_px:g} px",
        "lower",
        0.0,
        0.0,
        note,
    )
    right = ends <= limit_px
    if right.any():
        yield Metric(
            f"{name}.convincing_rightly",
            float(convincing[right].mean()),
            f"of ends within {limit_px:g} px",
            "higher",
            None,
            0.05,
            f"n={right.sum()}",
        )
    expected = [outcome.finished.expected_error_px for outcome in outcomes]
    ratios = np.array(
        [end / px for end, px in zip(ends, expected, strict=True) if px is not None]
    )
    if ratios.size:
        yield Metric(
            f"{name}.within_twice",
            float((ratios <= 2.0).mean()),
            "of runs",
            "higher",
            0.9,
            0.1,
            f"n={ratios.size}; median true / expected {np.median(ratios):.2f}",
        )
