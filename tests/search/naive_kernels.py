"""Slow, obvious twins of ``photoreg.search.kernels`` and ``photoreg.search.kernels_mncc``.

Written from the definitions with cameras and photos, one point at a time, in float64:
all pairs of photos are visited, and nothing is normalised or rearranged.
"""

import itertools

import numpy as np

from tests.search.naive_trimmed_mean import trimmed_mean

MAX_GAIN = 2.0


def bilinear(picture, x, y):
    """Colour of an (h, w, c) picture at a pixel inside it."""
    height, width = picture.shape[:2]
    column, row = min(int(x), width - 2), min(int(y), height - 2)
    fx, fy = x - column, y - row
    top = (1 - fx) * picture[row, column] + fx * picture[row, column + 1]
    bottom = (1 - fx) * picture[row + 1, column] + fx * picture[row + 1, column + 1]
    return (1 - fy) * top + fy * bottom


def sees(point, normal, camera, min_cosine) -> bool:
    pixel = camera.project(point[None])[0]
    if not (np.isfinite(pixel).all() and camera.contains(pixel[None])[0]):
        return False
    to_camera = camera.center - point
    return float(normal @ to_camera) >= min_cosine * np.linalg.norm(to_camera)


def colours_seen(samples, pictures, valid, cameras, allowed, min_cosine):
    """For each sample that two photos see: {photo: colour}."""
    found = []
    for k, (point, normal) in enumerate(
        zip(samples.points, samples.normals, strict=True)
    ):
        colours = {}
        for i, camera in enumerate(cameras):
            if not allowed[i][k] or not sees(point, normal, camera, min_cosine):
                continue
            x, y = camera.project(point[None])[0]
            if bilinear(valid[i][:, :, None], x, y)[0] < 0.999:
                continue
            colours[i] = bilinear(pictures[i].astype(float), x, y)
        if len(colours) >= 2:
            found.append(colours)
    return found


def with_equal_exposure(seen, n_photos):
    """The colours after each photo's gain and offset a channel are evened out."""
    gains, offsets = np.ones((n_photos, 3)), np.zeros((n_photos, 3))
    for i in range(n_photos):
        mine = [colours for colours in seen if i in colours]
        if mine:
            offsets[i] = np.mean(
                [np.mean(list(c.values()), axis=0) - c[i] for c in mine], axis=0
            )
    moved = [{i: c + offsets[i] for i, c in colours.items()} for colours in seen]
    means = np.zeros((n_photos, 3))
    for i in range(n_photos):
        mine = [colours for colours in moved if i in colours]
        if not mine:
            continue
        means[i] = np.mean([c[i] for c in mine], axis=0)
        own = np.mean([(c[i] - means[i]) ** 2 for c in mine], axis=0)
        theirs = np.mean(
            [np.mean([(v - means[i]) ** 2 for v in c.values()], axis=0) for c in mine],
            axis=0,
        )
        gains[i] = np.clip(np.sqrt(theirs / own), 1 / MAX_GAIN, MAX_GAIN)
    return [
        {i: means[i] + gains[i] * (c - means[i]) for i, c in colours.items()}
        for colours in moved
    ]


def pair_cost(seen, low_share, high_share) -> float:
    """Trimmed mean over the samples of the mean squared difference of their pairs."""
    values = [
        np.mean(
            [np.sum((a - b) ** 2) for a, b in itertools.combinations(c.values(), 2)]
        )
        for c in seen
    ]
    n = len(values)
    return trimmed_mean(values, int(low_share * n), int(high_share * n))


def variance_cost(seen) -> float:
    """Mean over the samples of the summed channel variances of their colours."""
    return float(np.mean([np.var(list(c.values()), axis=0).sum() for c in seen]))


def mncc_cost(samples, patches, pictures, cameras, allowed, min_cosine) -> float:
    """Mean over the patches of 1 - MNCC, over all ordered pairs of photos."""
    values = []
    for k, patch in enumerate(patches):
        patterns = []
        n_facing = 0
        for i, camera in enumerate(cameras):
            point, normal = samples.points[k], samples.normals[k]
            if not allowed[i][k] or not sees(point, normal, camera, min_cosine):
                continue
            n_facing += 1
            pixels = camera.project(patch)
            if not camera.contains(pixels).all():
                continue
            colours = np.array(
                [bilinear(pictures[i].astype(float), *p) for p in pixels]
            )
            patterns.append(colours - colours.mean(axis=0))
        if n_facing < 2 or len(patterns) < 2:
            continue
        covariance = sum(np.sum(a * b) for a, b in itertools.permutations(patterns, 2))
        variances = sum(np.sum(a * a) for a in patterns)
        values.append(1 - covariance / (len(patterns) - 1) / variances)
    return float(np.mean(values))
