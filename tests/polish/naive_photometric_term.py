"""Slow and obvious twins of the polish's kernels."""

import numpy as np


def catmull_rom(photo, u, v):
    """Value of each channel at (u, v), at least a pixel and a half inside."""
    i, j = int(np.floor(u)), int(np.floor(v))

    def weights(s):
        return np.array(
            [
                0.5 * (-(s**3) + 2 * s**2 - s),
                0.5 * (3 * s**3 - 5 * s**2 + 2),
                0.5 * (-3 * s**3 + 4 * s**2 + s),
                0.5 * (s**3 - s**2),
            ]
        )

    patch = photo[j - 1 : j + 3, i - 1 : i + 3].astype(np.float64)
    return np.einsum("y,x,yxc->c", weights(v - j), weights(u - i), patch)


def pair_cost(surface, images, cameras, gain, offsets, sigma, precision, cut):
    """Cost of a photo pair, a channel: each cell's offset by brute reweighting."""
    costs = np.zeros(3)
    pixels = [
        camera.resized(image.shape[1], image.shape[0]).project(surface.points)
        for camera, image in zip(cameras, images, strict=True)
    ]
    residual = np.array(
        [
            (
                catmull_rom(images[0], *pixels[0][i]) * gain
                - catmull_rom(images[1], *pixels[1][i]) / gain
                - offsets[i]
            )
            / sigma
            for i in range(len(surface.points))
        ]
    )
    for k in range(3):
        for first, last in zip(
            surface.cell_starts[:-1], surface.cell_starts[1:], strict=True
        ):
            r = residual[first:last, k]
            b = r.sum() / (len(r) + precision[k])
            for _ in range(4):
                w = 1.0 / (1.0 + ((r - b) / cut) ** 2)
                b = (w * r).sum() / (w.sum() + precision[k])
            costs[k] += 0.5 * precision[k] * b**2
            costs[k] += (0.5 * cut**2 * np.log(1.0 + ((r - b) / cut) ** 2)).sum()
    return costs


def weighted_moments(rows, target, weights):
    """Normal equations of a weighted linear fit, as a book has them."""
    W = np.diag(weights)
    return rows.T @ W @ rows, rows.T @ W @ target
