"""Cameras from clicked pairs: a point on the surface and the same point in the photo."""

import dataclasses
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import leastsq

from photoreg.checks import check_points, check_rows
from photoreg.errors import InputError
from photoreg.geometry.camera import Camera
from photoreg.geometry.lens import IDEAL, Lens
from photoreg.geometry.rotations import left_jacobian
from photoreg.resection import pinhole_model
from photoreg.resection.hypotheses import HypothesisSearch
from photoreg.resection.lens_fit import UNTRUSTED, LensFit, expected_errors, fit_k1
from photoreg.resection.pinhole_model import Models, Pairs
from photoreg.words import listed

Solved = Literal[
    "pose",
    "pose and focal length",
    "pose, focal length, principal point",
    "pose, focal length, principal point, lens",
]

N_POSE, N_FOCAL, N_PRINCIPAL = 4, 6, 8
"""Pairs from which pose, focal length, principal point and lens are solved for."""
K1_DECIDED = 3.0
"""Standard errors of k1 from which a lens is not taken for an ideal one: chance gives as
much once in 400 times."""
CLICK_SIGMA_PX = 1.5
"""Standard error of a click, each axis, of a person who zooms in."""
FOCAL_SIGMA = 0.1
"""Relative standard error of a prior's focal length: EXIF is about so good."""
GUESSED_FOCAL_SIDES, GUESSED_FOCAL_SIGMA = 1.2, 0.6
"""Without a prior the focal length is expected at so many longer sides of the photo, and
its logarithm has this standard error: phones lie at 0.7, portraits at 2.4."""
PRINCIPAL_SIGMA_SIDES = 0.02
"""Standard error of the principal point, in longer sides of the photo."""
EXACT_PX = 0.01
"""Pairs that agree so well without any prior were computed, not clicked: then the prior
is ignored."""
OUTLIER_SIGMAS = 4.0
"""Pairs within so many standard errors of where the lens puts them are no gross errors."""
SIGMA_WORTH = 4
"""How many residuals the expected error of a click counts for in the predicted error."""
FLAT_SHARE = 1e-3
"""Points within this share of their extent of a line are on a line."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Resection:
    """A camera solved from pairs, and how far to trust it."""

    camera: Camera
    solved: Solved
    """What was solved for; the rest is the prior's."""
    residuals_px: Float[np.ndarray, "n"]
    """Distance in the photo of each pair; infinite behind the camera."""
    inliers: Bool[np.ndarray, "n"]
    """The pairs that the camera was solved from; the others do not fit them."""
    rms_px: float
    """Root mean square of the inliers' residuals."""
    worst: int
    """Index, from 0, of the pair with the largest residual."""
    expected_error_px: float
    """Expected error over the surface (root mean square), from the errors of clicks."""
    k1: float | None = None
    """The first radial term of the lens, by the pairs; the camera has it if they show
    that it is not 0. None: too few pairs, or a known lens."""
    k1_error: float | None = None
    """Its standard error."""
    warnings: tuple[str, ...]
    """What the person should know, in plain sentences; pairs are numbered from 1."""

    @property
    def summary(self) -> str:
        """One sentence: what was solved, how well it fits, how well determined it is."""
        n = int(self.inliers.sum())
        lens = ""
        if self.k1 is not None:
            lens = f" The lens has k1 {self.k1:.3f} ± {self.k1_error:.2g}"
            lens += "." if self.camera.lens.k1 else ", which could be 0 as well."
        return (
            f"Solved {self.solved} from {n} pairs: they fit to {self.rms_px:.1f} px; "
            f"expect about {_plain_px(self.expected_error_px)} px over the surface.{lens}"
        )


def solve_camera(
    points_world: Float[np.ndarray, "n 3"],
    pixels: Float[np.ndarray, "n 2"],
    width: int,
    height: int,
    prior: Camera | None = None,
    *,
    focal_sigma: float = FOCAL_SIGMA,
    click_sigma_px: float = CLICK_SIGMA_PX,
    surface: Float[np.ndarray, "m 3"] | None = None,
    seed: int = 0,
) -> Resection:
    """The camera that sees surface points at the given pixels.

    From 4 pairs the pose, from 6 also the focal length, from 8 also the principal
    point and, if the prior has an ideal lens, the first radial term, which is kept where the
    pairs show that it is not 0. Pose hypotheses come from triples and from all pairs
    (OpenCV), over several focal lengths; they are refined robustly, and the one that
    explains the pairs best, with gross outliers at a price, is refined by least squares (MINPACK).

    Args:
        points_world: Points clicked on the surface, world axes, any unit.
        pixels: The same points clicked in the photo; (0, 0) is a pixel's centre.
        width: The photo's width in pixels.
        height: The photo's height in pixels.
        prior: Its K is what is expected before any pair (EXIF, or an earlier
            calibration), its lens is kept, its pose is not used. Pass the same prior each
            time, not the last solution: that would count the pairs twice. None: nothing
            is known.
        focal_sigma: Relative standard error of the prior's focal length.
        click_sigma_px: Standard error of a click, each axis.
        surface: Points over which the error is predicted, such as the mesh's vertices,
            or some of them; None: the clicked points, and the same points a third farther
            from their centre.
        seed: Same seed, same camera.

    Raises:
        InputError: if there are fewer than 4 different pairs, if they are not finite or lie
            on one line, or if no camera sees them like this.
    """
    points = check_points(points_world, "The list of surface points")
    pixels = check_rows(pixels, 2, "The list of photo points")
    if len(points) != len(pixels):
        raise InputError(
            f"There are {len(points)} surface points and {len(pixels)} photo points; "
            "each pair needs one of both."
        )
    if not (focal_sigma > 0.0 and click_sigma_px > 0.0):
        raise InputError(
            "The standard errors of focal length and clicks should be positive, but are "
            f"{focal_sigma:g} and {click_sigma_px:g} px."
        )
    n = _n_different(points, pixels, width, height)
    if n < N_POSE:
        more = "one more pair is" if n == N_POSE - 1 else f"{N_POSE - n} more pairs are"
        raise InputError(
            f"{n} different pairs so far; {more} needed to place the camera."
        )
    _check_spread(points, pixels)
    n_free = 6 if n < N_FOCAL else 7 if n < N_PRINCIPAL else 9
    origin = points.mean(axis=0)
    size = float(np.sqrt(((points - origin) ** 2).sum(axis=1).mean()))
    lens, clicked = IDEAL, pixels
    if prior is not None and not prior.lens.is_ideal:
        # Solved where an ideal lens would show the points; the clicks' errors grow by
        # less than a third there.
        lens, pixels = prior.lens, prior.resized(width, height).undistort(pixels)
        if not np.isfinite(pixels).all():
            raise InputError(
                "A photo point lies where, by the photo's lens distortion, nothing can be "
                "seen; correct the distortion, or the point."
            )
    pairs = _pairs((points - origin) / size, pixels, width, height, prior, focal_sigma)
    search = HypothesisSearch(pairs, n_free, width * height, click_sigma_px, seed)
    model, inliers, sigma_px, twin = search.best()
    model = _polished(model, pairs, n_free, sigma_px, inliers)
    fit = None
    if n_free == pinhole_model.N_PARAMETERS and lens.is_ideal:
        fit, those = _with_lens(model, pairs, sigma_px, inliers)
        if _is_lens(fit, model, pairs, those):
            model, lens, inliers = fit.model, Lens(k1=fit.k1), those
    camera = _camera(model, pairs, origin, size, width, height).with_lens(lens)
    offsets = camera.project(points) - clicked
    residuals = np.hypot(offsets[:, 0], offsets[:, 1])
    residuals[np.isnan(residuals)] = np.inf
    if surface is None:
        where = np.concatenate([pairs.X, 1.3 * pairs.X])
    else:
        where = (
            check_points(surface, "The list of points of the surface") - origin
        ) / size
    if fit is not None and not lens.is_ideal:
        expected, focal_error = expected_errors(fit, pairs, where)
    else:
        expected, focal_error = _expected_errors(
            model, pairs, n_free, sigma_px, inliers, where
        )
    solved: Solved = "pose"
    if n_free > 6:
        solved = "pose and focal length"
    if n_free > 7:
        solved = "pose, focal length, principal point"
    if fit is not None and not lens.is_ideal:
        solved = "pose, focal length, principal point, lens"
    return Resection(
        camera=camera,
        solved=solved,
        residuals_px=residuals,
        inliers=inliers,
        rms_px=float(np.sqrt(np.mean(residuals[inliers] ** 2))),
        worst=int(np.argmax(residuals)),
        expected_error_px=expected,
        k1=None if fit is None else fit.k1,
        k1_error=None if fit is None else fit.k1_error,
        warnings=_warnings(
            residuals,
            inliers,
            n,
            n_free,
            prior,
            focal_error,
            twin,
            sigma_px / click_sigma_px,
        ),
    )


def _pairs(
    X: np.ndarray,
    pixels: np.ndarray,
    width: int,
    height: int,
    prior: Camera | None,
    focal_sigma: float,
) -> Pairs:
    side = max(width, height)
    if prior is None:
        K = np.diag([GUESSED_FOCAL_SIDES * side, GUESSED_FOCAL_SIDES * side, 1.0])
        K[:2, 2] = 0.5 * (width - 1), 0.5 * (height - 1)
        focal_sigma = GUESSED_FOCAL_SIGMA
    else:
        K = prior.resized(width, height).K
    return Pairs(
        X=X,
        pixels=pixels,
        A=K[:2, :2] / K[0, 0],
        log_f=float(np.log(K[0, 0])),
        log_f_sigma=focal_sigma,
        c=K[:2, 2],
        c_sigma_px=PRINCIPAL_SIGMA_SIDES * side,
        unit_px=float(side),
    )


def _camera(
    model: Models,
    pairs: Pairs,
    origin: np.ndarray,
    size: float,
    width: int,
    height: int,
) -> Camera:
    f, R = np.exp(model.log_f[0]), model.R[0]
    K = np.eye(3)
    K[:2, :2], K[:2, 2] = f * pairs.A, model.c[0]
    distance = np.exp(model.log_f[0] - model.log_s[0])
    aim = np.linalg.solve(pairs.A, model.a[0] - model.c[0]) / f
    t = size * distance * np.array([aim[0], aim[1], 1.0])
    return Camera(K, R, t - R @ origin, width, height)


def _polished(
    model: Models, pairs: Pairs, n_free: int, sigma_px: float, inliers: np.ndarray
) -> Models:
    """The minimum itself, by MINPACK; without the prior where the pairs are exact."""
    used = dataclasses.replace(pairs, X=pairs.X[inliers], pixels=pairs.pixels[inliers])

    def minimum(start: Models, trust: float) -> Models:
        roots = trust * np.sqrt(pairs.prior_weights[6:n_free])

        def residuals(step: np.ndarray) -> np.ndarray:
            moved = start.moved(step[None], pairs.unit_px)
            offsets = pinhole_model.project(moved, used.X, used.A)[0] - used.pixels
            off = used.prior_steps(moved)[0, 6:n_free]
            return np.concatenate([offsets.ravel() / sigma_px, roots * off])

        def derivatives(step: np.ndarray) -> np.ndarray:
            moved = start.moved(step[None], pairs.unit_px)
            _, J = pinhole_model.project_with_derivatives(
                moved, used.X, used.A, pairs.unit_px
            )
            by_turn = left_jacobian(step[:3])
            J = J[0].reshape(-1, pinhole_model.N_PARAMETERS)[:, :n_free] / sigma_px
            J[:, :3] = J[:, :3] @ by_turn
            prior_rows = np.zeros((n_free - 6, n_free))
            prior_rows[:, 6:] = np.diag(roots)
            return np.concatenate([J, prior_rows])

        step = leastsq(
            residuals,
            np.zeros(n_free),
            Dfun=derivatives,
            xtol=1e-14,
            ftol=1e-15,
            gtol=0.0,
            maxfev=60,
            full_output=True,
        )[0]
        return start.moved(step[None], pairs.unit_px)

    model = minimum(model, 1.0)
    if n_free > 6 and 2 * int(inliers.sum()) > n_free:
        free = minimum(model, 1e-9)
        offsets = pinhole_model.project(free, used.X, used.A)[0] - used.pixels
        if np.sqrt(np.mean(offsets**2)) < EXACT_PX:
            return free
    return model


def _with_lens(
    model: Models, pairs: Pairs, sigma_px: float, inliers: np.ndarray
) -> tuple[LensFit, np.ndarray]:
    """The same with a radial term, and the pairs that fit then.

    Among them are those that did not fit only because of the lens.
    """
    fit = fit_k1(model, pairs, sigma_px, inliers)
    near = (np.abs(fit.offsets_px) <= OUTLIER_SIGMAS * sigma_px).all(axis=1)
    if (near & ~inliers).any():
        inliers = inliers | near
        fit = fit_k1(fit.model, pairs, sigma_px, inliers)
    n_free = pinhole_model.N_PARAMETERS + 1
    left_over = max(2 * int(inliers.sum()) - n_free, 0)
    if left_over > 0:
        free = fit_k1(fit.model, pairs, sigma_px, inliers, UNTRUSTED)
        if np.sqrt(np.mean(free.offsets_px[inliers] ** 2)) < EXACT_PX:
            fit = free
    squares = float((fit.offsets_px[inliers] ** 2).sum())
    sigma = (SIGMA_WORTH * sigma_px**2 + squares) / (SIGMA_WORTH + left_over)
    scaled = fit.covariance * (sigma / sigma_px**2)
    return dataclasses.replace(fit, covariance=scaled), inliers


def _is_lens(fit: LensFit, model: Models, pairs: Pairs, inliers: np.ndarray) -> bool:
    """Whether the pairs show that the lens is not an ideal one."""
    ideal = pinhole_model.project(model, pairs.X, pairs.A)[0] - pairs.pixels
    is_exact, was_exact = (
        np.sqrt(np.mean(offsets[inliers] ** 2)) < EXACT_PX
        for offsets in (fit.offsets_px, ideal)
    )
    if was_exact:
        return False
    return bool(is_exact or abs(fit.k1) > K1_DECIDED * fit.k1_error)


def _expected_errors(
    model: Models,
    pairs: Pairs,
    n_free: int,
    sigma_px: float,
    inliers: np.ndarray,
    where: np.ndarray,
) -> tuple[float, float]:
    """Root mean square error over ``where`` in pixels; relative error of the focal length.

    To first order: clicks err by ``sigma_px``, or as the residuals show where there
    are enough, and what was not solved for errs as its prior does and shifts the rest.
    """
    unit, A = pairs.unit_px, pairs.A
    pixels, J = pinhole_model.project_with_derivatives(model, pairs.X[inliers], A, unit)
    squares = float(((pixels[0] - pairs.pixels[inliers]) ** 2).sum())
    left_over = max(2 * int(inliers.sum()) - n_free, 0)
    # The expected variance is worth SIGMA_WORTH residuals (inverse gamma).
    sigma_px = np.sqrt(
        (SIGMA_WORTH * sigma_px**2 + squares) / (SIGMA_WORTH + left_over)
    )
    J = J[0].reshape(-1, pinhole_model.N_PARAMETERS) / sigma_px
    weights = pairs.prior_weights
    fitted, kept = J[:, :n_free], J[:, n_free:]
    normal = fitted.T @ fitted + np.diag(weights[:n_free])
    # A direction about which nothing is known errs by a photo's side or a radian.
    covariance = np.zeros((pinhole_model.N_PARAMETERS, pinhole_model.N_PARAMETERS))
    inverse = np.linalg.inv(normal + 1e-9 * np.diag(np.diag(normal)) + np.eye(n_free))
    covariance[:n_free, :n_free] = inverse
    if kept.shape[1] > 0:
        drag = np.concatenate([-inverse @ fitted.T @ kept, np.eye(kept.shape[1])])
        covariance += drag @ np.diag(1.0 / weights[n_free:]) @ drag.T
    where = where[pinhole_model.depths(model, where)[0] > 0.1]
    _, J = pinhole_model.project_with_derivatives(model, where, A, unit)
    variance = np.einsum("nij,jk,nik->n", J[0], covariance, J[0])
    return float(np.sqrt(variance.mean())), float(np.sqrt(covariance[6, 6]))


def _n_different(
    points: np.ndarray, pixels: np.ndarray, width: int, height: int
) -> int:
    """Pairs that differ from every other pair before, on the surface and in the photo."""
    if len(points) == 0:
        return 0
    extent = float(np.ptp(points, axis=0).max())
    # Far from the origin, coordinates cannot resolve less than their last digit.
    extent = max(extent, 1e-9 * float(np.abs(points).max()))
    near_px = 1e-6 * max(width, height)
    count = 0
    for i in range(len(points)):
        same_point = np.abs(points[:i] - points[i]).max(axis=1) <= 1e-6 * extent
        same_pixel = np.abs(pixels[:i] - pixels[i]).max(axis=1) <= near_px
        count += not bool((same_point | same_pixel).any())
    return count


def _check_spread(points: np.ndarray, pixels: np.ndarray) -> None:
    for what, places, help in (
        ("surface", points, "Click points off that line as well"),
        ("photo", pixels, "Click points off that line, or look from another side"),
    ):
        values = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
        if not values[1] > FLAT_SHARE * values[0]:
            raise InputError(
                f"The {len(places)} points on the {what} lie on one line, which leaves "
                f"the camera free to turn about it. {help}."
            )


def _warnings(
    residuals: np.ndarray,
    inliers: np.ndarray,
    n: int,
    n_free: int,
    prior: Camera | None,
    focal_error: float,
    twin: bool,
    noise_factor: float,
) -> tuple[str, ...]:
    sentences = []
    wrong = np.flatnonzero(~inliers)
    if len(wrong) > 0:
        names = listed([f"{i + 1}" for i in wrong])
        sizes = listed([f"{residuals[i]:.0f}" for i in wrong])
        one = len(wrong) == 1
        sentences.append(
            f"{'Pair' if one else 'Pairs'} {names} {'does' if one else 'do'} not fit the "
            f"others ({sizes} px off) and {'was' if one else 'were'} left out: correct or "
            f"delete {'it' if one else 'them'}."
        )
    if noise_factor > 1.0:
        sentences.append(
            "The pairs agree less well than careful clicks do: zoom in and correct the "
            f"worst, pair {int(np.argmax(residuals)) + 1}."
        )
    if n == N_POSE:
        sentences.append(
            "With four pairs there is nothing to check them by: add a fifth."
        )
    if twin:
        sentences.append(
            "Two different cameras explain these pairs about equally well: add a pair at "
            "another depth."
        )
    if n_free == 6 and prior is None:
        sentences.append(
            f"The focal length is a guess: enter it, or click at least {N_FOCAL} pairs."
        )
    elif n_free > 6 and focal_error > 0.15:
        sentences.append(
            f"The pairs hardly determine the focal length (±{100 * focal_error:.0f} %): add "
            "pairs that are nearer and farther."
        )
    return tuple(sentences)


def _plain_px(value: float) -> str:
    return f"{value:.1f}" if value < 9.95 else f"{value:.0f}"
