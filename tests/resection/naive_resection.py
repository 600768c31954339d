"""Resection as the textbook has it: the true camera, least squares, no search."""

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from photoreg.geometry.camera import Camera


def refined_from_truth(
    points: np.ndarray,
    pixels: np.ndarray,
    true: Camera,
    expected: Camera,
    focal_sigma: float,
    principal_sigma_px: float,
    click_sigma_px: float,
    used: np.ndarray,
) -> Camera:
    """The least-squares camera next to the true one: no solver knows more.

    The focal length is free from 6 pairs, the principal point from 8; both are drawn to
    those ``expected``. Only the pairs ``used`` count.
    """
    n = len(points)
    K0 = expected.K
    center, R_true = true.center, true.R_cam_world
    size = np.linalg.norm(points - points.mean(axis=0), axis=1).mean()

    def camera(x: np.ndarray) -> Camera:
        R = Rotation.from_rotvec(x[:3]).as_matrix() @ R_true
        K = K0.copy()
        if n >= 6:
            K[:2, :2] *= np.exp(x[6])
        if n >= 8:
            K[:2, 2] += principal_sigma_px * x[7:9]
        t = -R @ (center + size * x[3:6])
        return Camera(K, R, t, true.width, true.height)

    def residuals(x: np.ndarray) -> np.ndarray:
        offsets = np.nan_to_num(camera(x).project(points[used]) - pixels[used], nan=1e6)
        prior = [x[6] / focal_sigma] * (n >= 6) + list(x[7:9]) * (n >= 8)
        return np.concatenate([offsets.ravel() / click_sigma_px, prior])

    n_free = 6 if n < 6 else 7 if n < 8 else 9
    full = np.zeros(9)
    full[6] = np.log(true.K[0, 0] / K0[0, 0])
    full[7:9] = (true.K[:2, 2] - K0[:2, 2]) / principal_sigma_px
    found = least_squares(
        lambda x: residuals(np.concatenate([x, np.zeros(9 - n_free)])),
        full[:n_free],
        x_scale="jac",
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-12,
    )
    return camera(np.concatenate([found.x, np.zeros(9 - n_free)]))
