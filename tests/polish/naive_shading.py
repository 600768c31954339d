"""The kernels of the shading term, slow and obvious."""

import numpy as np


def naive_features(mesh, camera, pixels, normals, scalars):
    """Features at pixels (n, 2), by a ray and the weights of its triangle's corners."""
    center, rays = camera.rays(pixels)
    faces, distances = mesh.first_hits(np.broadcast_to(center, rays.shape), rays)
    rows = []
    for face, distance, ray in zip(faces, distances, rays, strict=True):
        corners = mesh.faces[face]
        point = center + distance * ray
        weights = np.linalg.lstsq(
            np.vstack([mesh.vertices[corners].T, np.ones(3)]), np.append(point, 1.0)
        )[0]
        row = []
        for scale in normals:
            x, y, z = weights @ scale[corners]
            length = np.sqrt(x * x + y * y + z * z)
            x, y, z = x / length, y / length, z / length
            row += [x, y, z, x * y, y * z, x * z, x * x - y * y, 3 * z * z - 1]
        rows.append([*row, *(weights @ scalars[corners])])
    return np.array(rows)


def naive_equations(residual, slopes, step, cut):
    """Cost, gradient and normal matrix, point by point."""
    n, k, p = slopes.shape
    cost, gradient, normal = 0.0, np.zeros(p), np.zeros((p, p))
    for i in range(n):
        error = residual[i] + slopes[i] @ step
        square = error @ error / (k * cut**2)
        cost += 0.5 * k * cut**2 * np.log(1.0 + square)
        weight = 1.0 / (1.0 + square)
        gradient += weight * slopes[i].T @ error
        normal += weight * slopes[i].T @ slopes[i]
    return cost, gradient, normal
