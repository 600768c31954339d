"""Compiled loops of the shading term: features of the surface at pixels, fits, equations."""

import numba as nb
import numpy as np

from photoreg.geometry.projection import unproject

N_HARMONICS = 8


@nb.njit(cache=True, nogil=True)
def write_harmonics(x, y, z, out, first):
    """The spherical harmonics of degree 1 and 2, not normalised, of a normal."""
    length = np.sqrt(x * x + y * y + z * z)
    if length > 0.0:
        x, y, z = x / length, y / length, z / length
    out[first] = x
    out[first + 1] = y
    out[first + 2] = z
    out[first + 3] = x * y
    out[first + 4] = y * z
    out[first + 5] = x * z
    out[first + 6] = x * x - y * y
    out[first + 7] = 3.0 * z * z - 1.0


@nb.njit(cache=True, nogil=True)
def sample_texture(texture, u, v, out, first):
    """Bilinear colour of a texture (h, w, 3) at (u, v), v upwards; it repeats itself."""
    height, width = texture.shape[0], texture.shape[1]
    x = (u - np.floor(u)) * width - 0.5
    y = (1.0 - (v - np.floor(v))) * height - 0.5
    x = min(max(x, 0.0), width - 1.0)
    y = min(max(y, 0.0), height - 1.0)
    i, j = min(int(x), max(width - 2, 0)), min(int(y), max(height - 2, 0))
    right, below = min(i + 1, width - 1), min(j + 1, height - 1)
    s, t = x - i, y - j
    for k in range(3):
        upper = (1.0 - s) * texture[j, i, k] + s * texture[j, right, k]
        lower = (1.0 - s) * texture[below, i, k] + s * texture[below, right, k]
        out[first + k] = (1.0 - t) * upper + t * lower


@nb.njit(cache=True, nogil=True)
def draw_features(
    camera,
    center,
    face_index,
    vertices,
    faces,
    normals,
    scalars,
    corner_uv,
    texture,
):
    """Features of the surface that each pixel shows; 0 where it shows none.

    Args:
        camera: Record of ``CAMERA``.
        center: (3,) its centre.
        face_index: (h, w) face seen at each pixel, -1 where there is none.
        vertices: (n, 3).
        faces: (m, 3).
        normals: (scales, n, 3) at the vertices: their harmonics are features.
        scalars: (n, q) at the vertices: features as they are.
        corner_uv: (m, 3, 2) places of the faces' corners in the texture, v upwards; none
            where there is no texture.
        texture: (th, tw, 3) float32: three features more, where ``corner_uv`` has any.

    Returns:
        (8 scales + q, h, w) float32, or three more.
    """
    height, width = face_index.shape
    n_scales, n_scalars = len(normals), scalars.shape[1]
    n_untextured = N_HARMONICS * n_scales + n_scalars
    has_texture = len(corner_uv) > 0
    n = n_untextured + (3 if has_texture else 0)
    out = np.zeros((n, height, width), np.float32)
    own = np.zeros(n)
    R = camera.R
    for row in range(height):
        for column in range(width):
            face = face_index[row, column]
            if face < 0:
                continue
            x, y = unproject(camera, float(column), float(row))
            dx = R[0, 0] * x + R[1, 0] * y + R[2, 0]
            dy = R[0, 1] * x + R[1, 1] * y + R[2, 1]
            dz = R[0, 2] * x + R[1, 2] * y + R[2, 2]
            i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
            # Barycentrics of the ray: volumes that it spans with two corners each.
            ax = vertices[i, 0] - center[0]
            ay = vertices[i, 1] - center[1]
            az = vertices[i, 2] - center[2]
            bx = vertices[j, 0] - center[0]
            by = vertices[j, 1] - center[1]
            bz = vertices[j, 2] - center[2]
            cx = vertices[k, 0] - center[0]
            cy = vertices[k, 1] - center[1]
            cz = vertices[k, 2] - center[2]
            a = dx * (by * cz - bz * cy) + dy * (bz * cx - bx * cz)
            a += dz * (bx * cy - by * cx)
            b = dx * (cy * az - cz * ay) + dy * (cz * ax - cx * az)
            b += dz * (cx * ay - cy * ax)
            c = dx * (ay * bz - az * by) + dy * (az * bx - ax * bz)
            c += dz * (ax * by - ay * bx)
            total = a + b + c
            if total == 0.0:
                a, b, c, total = 1.0, 1.0, 1.0, 3.0
            a, b, c = a / total, b / total, c / total
            for s in range(n_scales):
                write_harmonics(
                    a * normals[s, i, 0] + b * normals[s, j, 0] + c * normals[s, k, 0],
                    a * normals[s, i, 1] + b * normals[s, j, 1] + c * normals[s, k, 1],
                    a * normals[s, i, 2] + b * normals[s, j, 2] + c * normals[s, k, 2],
                    own,
                    N_HARMONICS * s,
                )
            for q in range(n_scalars):
                own[N_HARMONICS * n_scales + q] = (
                    a * scalars[i, q] + b * scalars[j, q] + c * scalars[k, q]
                )
            if has_texture:
                uv = corner_uv[face]
                sample_texture(
                    texture,
                    a * uv[0, 0] + b * uv[1, 0] + c * uv[2, 0],
                    a * uv[0, 1] + b * uv[1, 1] + c * uv[2, 1],
                    own,
                    n_untextured,
                )
            for m in range(n):
                out[m, row, column] = own[m]
    return out


@nb.njit(cache=True, nogil=True)
def weighted_products(basis, weights, targets):
    """basis^T W basis (p, p) and basis^T W targets (p, q), for (n, p) and (n, q)."""
    n, p = basis.shape
    q = targets.shape[1]
    normal = np.zeros((p, p))
    right = np.zeros((p, q))
    for i in range(n):
        for j in range(p):
            weighted = weights[i] * basis[i, j]
            for k in range(j + 1):
                normal[j, k] += weighted * basis[i, k]
            for k in range(q):
                right[j, k] += weighted * targets[i, k]
    for j in range(p):
        for k in range(j):
            normal[k, j] = normal[j, k]
    return normal, right


@nb.njit(cache=True, nogil=True)
def subtract_products(targets, basis, coefficients):
    """Targets (n, q) less basis (n, p) times coefficients (p, q)."""
    out = targets.copy()
    for i in range(len(basis)):
        for j in range(basis.shape[1]):
            for k in range(targets.shape[1]):
                out[i, k] -= basis[i, j] * coefficients[j, k]
    return out


@nb.njit(cache=True, nogil=True)
def linear_equations(residual, slopes, step, cell_starts, cut):
    """Cost and normal equations of residuals that are linear in the increments.

    The residual of a point is e = residual + slopes . step over k channels, under the
    Cauchy cost k cut^2 / 2 log(1 + |e|^2 / (k cut^2)).

    Args:
        residual: (n, k) at step 0, those of a cell in a row.
        slopes: (n, k, p) by the increments.
        step: (p,) increments from there.
        cell_starts: (cells + 1,) first point of each cell.
        cut: Scale of the cost.

    Returns:
        Cost, gradients (cells, p), and the normal matrix (p, p).
    """
    n_channels, p = slopes.shape[1], slopes.shape[2]
    n_cells = len(cell_starts) - 1
    gradients = np.zeros((n_cells, p))
    normal = np.zeros((p, p))
    error = np.zeros(n_channels)
    scale = 1.0 / (n_channels * cut * cut)
    cost = 0.0
    for cell in range(n_cells):
        for i in range(cell_starts[cell], cell_starts[cell + 1]):
            square = 0.0
            for c in range(n_channels):
                value = residual[i, c]
                for j in range(p):
                    value += slopes[i, c, j] * step[j]
                error[c] = value
                square += value * value
            cost += 0.5 / scale * np.log(1.0 + scale * square)
            weight = 1.0 / (1.0 + scale * square)
            for c in range(n_channels):
                for j in range(p):
                    weighted = weight * slopes[i, c, j]
                    gradients[cell, j] += weighted * error[c]
                    for k in range(j + 1):
                        normal[j, k] += weighted * slopes[i, c, k]
    for j in range(p):
        for k in range(j):
            normal[k, j] = normal[j, k]
    return cost, gradients, normal
