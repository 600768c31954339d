"""Kernels of texture baking: photo to texel, fill of the unseen, gutter.

Parallel over texels, each of which is written by one thread alone: the result does not
depend on the number of threads. Called from one compute thread only.
"""

import numba as nb
import numpy as np

from photoreg.geometry.projection import homogeneous

MIN_FACING = 0.05
"""The face itself, and not only the smooth surface, must face the camera."""

SHARPNESS = 6
"""Power of the weight for detail: nearly the best view alone, yet without a cut."""


@nb.njit(nogil=True, cache=True, inline="always")
def _barycentric(corners, x, y):  # noqa: ANN001, ANN202
    """Barycentrics of a texel in its triangle, also outside it; zeros if flat."""
    ax, ay = corners[0, 0], corners[0, 1]
    bx, by = corners[1, 0] - ax, corners[1, 1] - ay
    cx, cy = corners[2, 0] - ax, corners[2, 1] - ay
    det = bx * cy - by * cx
    if det == 0.0:
        return 0.0, 0.0, 0.0
    px, py = x - ax, y - ay
    b = (px * cy - py * cx) / det
    c = (bx * py - by * px) / det
    return 1.0 - b - c, b, c


@nb.njit(nogil=True, cache=True, inline="always")
def _surface_point(vertices, corners, a, b, c):  # noqa: ANN001, ANN202
    """The point with barycentrics a, b, c of a face with these vertex indices."""
    i, j, k = corners[0], corners[1], corners[2]
    return (
        a * vertices[i, 0] + b * vertices[j, 0] + c * vertices[k, 0],
        a * vertices[i, 1] + b * vertices[j, 1] + c * vertices[k, 1],
        a * vertices[i, 2] + b * vertices[j, 2] + c * vertices[k, 2],
    )


@nb.njit(nogil=True, cache=True, inline="always")
def _projected(P, x, y, z):  # noqa: ANN001, ANN202
    """Pixel and depth of a point; NaN pixels behind the camera."""
    u, v, depth = homogeneous(P, x, y, z)
    if not depth > 0.0:
        return np.nan, np.nan, depth
    return u / depth, v / depth, depth


@nb.njit(nogil=True, cache=True, inline="always")
def _bilinear(image, ix, iy, fx, fy, channel):  # noqa: ANN001, ANN202
    upper = (1.0 - fx) * image[iy, ix, channel] + fx * image[iy, ix + 1, channel]
    lower = (1.0 - fx) * image[iy + 1, ix, channel] + (
        fx * image[iy + 1, ix + 1, channel]
    )
    return (1.0 - fy) * upper + fy * lower


@nb.njit(nogil=True, cache=True, parallel=True)
def sample(picture, uv):  # noqa: ANN001, ANN201
    """Colours (n, 3) of a picture at texture coordinates (n, >= 2), v upwards."""
    height, width = picture.shape[0], picture.shape[1]
    colours = np.zeros((len(uv), 3))
    for i in nb.prange(len(uv)):
        x = min(max(uv[i, 0] * width - 0.5, 0.0), width - 1.0)
        y = min(max((1.0 - uv[i, 1]) * height - 0.5, 0.0), height - 1.0)
        ix, iy = max(min(int(x), width - 2), 0), max(min(int(y), height - 2), 0)
        for channel in range(3):
            colours[i, channel] = _bilinear(picture, ix, iy, x - ix, y - iy, channel)
    return colours


@nb.njit(nogil=True, cache=True)
def photo_edges(depth, face_index, face_normals, N, focal_px, tolerance_px):  # noqa: ANN001, ANN201
    """Where a photo's depth jumps: pixels off the plane of a neighbour's face.

    Args:
        depth: (h, w) float32, infinite off the mesh.
        face_index: (h, w) int32.
        face_normals: (m, 3) unit.
        N: (3, 3) K^-T R, taking a normal to its plane's 1 / z in the picture.
        focal_px: Focal length in pixels.
        tolerance_px: Jump allowed, in pixel sizes on the surface, more where steep.

    Returns:
        (h, w) bool; true on both sides of a jump and off the mesh.
    """
    height, width = depth.shape
    edges = np.zeros((height, width), dtype=np.bool_)
    for y in range(height):
        for x in range(width):
            face = face_index[y, x]
            if face < 0:
                edges[y, x] = True
                continue
            z = depth[y, x]
            nx = face_normals[face, 0]
            ny = face_normals[face, 1]
            nz = face_normals[face, 2]
            ax = N[0, 0] * nx + N[0, 1] * ny + N[0, 2] * nz
            ay = N[1, 0] * nx + N[1, 1] * ny + N[1, 2] * nz
            aw = N[2, 0] * nx + N[2, 1] * ny + N[2, 2] * nz
            here = ax * x + ay * y + aw
            if here == 0.0:
                edges[y, x] = True
                continue
            # Change of 1 / z from pixel to pixel, relative: the plane's steepness.
            gx, gy = ax / here, ay / here
            steep = np.sqrt(gx * gx + gy * gy)
            allowed = tolerance_px * (1.0 / focal_px + steep)
            for step in range(2):
                jx, jy = (x + 1, y) if step == 0 else (x, y + 1)
                if jx >= width or jy >= height:
                    continue
                expected = 1.0 + (gx if step == 0 else gy)
                # Depth relative to the plane's there; infinity fails as well.
                if not abs(depth[jy, jx] / z * expected - 1.0) <= allowed:
                    edges[y, x] = True
                    edges[jy, jx] = True
    return edges


@nb.njit(nogil=True, cache=True, parallel=True)
def clearance_of(distance, margin_px, feather_px):  # noqa: ANN001, ANN201
    """Clearance (h, w) uint8 of distances from edges: 0 within the margin, then rising."""
    height, width = distance.shape
    clearance = np.zeros((height, width), dtype=np.uint8)
    for y in nb.prange(height):
        for x in range(width):
            beyond = distance[y, x] - margin_px
            if beyond >= 0.0:
                clearance[y, x] = np.uint8(
                    min(beyond * (254.0 / feather_px) + 1.0, 255.0)
                )
    return clearance


@nb.njit(nogil=True, cache=True, parallel=True)
def points_at(  # noqa: ANN201
    texel,  # noqa: ANN001
    texel_face,  # noqa: ANN001
    width,  # noqa: ANN001
    corners_px,  # noqa: ANN001
    vertices,  # noqa: ANN001
    faces,  # noqa: ANN001
):
    """Surface point (n, 3) of each texel."""
    points = np.zeros((len(texel), 3))
    for t in nb.prange(len(texel)):
        corners = corners_px[texel_face[t]]
        a, b, c = _barycentric(corners, texel[t] % width, texel[t] // width)
        x, y, z = _surface_point(vertices, faces[texel_face[t]], a, b, c)
        points[t, 0], points[t, 1], points[t, 2] = x, y, z
    return points


@nb.njit(nogil=True, cache=True, parallel=True)
def weigh(  # noqa: ANN201
    texel,  # noqa: ANN001
    texel_face,  # noqa: ANN001
    width,  # noqa: ANN001
    corners_px,  # noqa: ANN001
    vertices,  # noqa: ANN001
    faces,  # noqa: ANN001
    vertex_normals,  # noqa: ANN001
    face_normals,  # noqa: ANN001
    P,  # noqa: ANN001
    N,  # noqa: ANN001
    center,  # noqa: ANN001
    focal_px,  # noqa: ANN001
    depth,  # noqa: ANN001
    clearance,  # noqa: ANN001
    texels_per_unit,  # noqa: ANN001
    min_cosine,  # noqa: ANN001
):
    """How much a photo counts at each texel, (n,) float32, and how well it sees it.

    Zero where it does not: outside the photo, near an edge, seen at a grazing angle or
    from behind, or hidden as far as the depth at the nearest pixel tells; rays tell the
    rest.

    Args:
        texel: (n,) flat index of each texel in the atlas.
        texel_face: (n,) its face.
        width: Width of the atlas in texels.
        corners_px: (m, 3, 2) corners of the faces in texels.
        vertices: (k, 3) world axes.
        faces: (m, 3).
        vertex_normals: (k, 3) unit, outwards, for smooth weights.
        face_normals: (m, 3) unit, outwards.
        P: (3, 4) projection matrix.
        N: (3, 3) K^-T R.
        center: (3,) camera centre.
        focal_px: Mean focal length.
        depth: (h, w) of the nearest surface.
        clearance: (h, w) uint8; 0 too near to an edge or border, 255 far from any.
        texels_per_unit: Resolution of the atlas.
        min_cosine: Of the angle between normal and view; flatter is not painted.

    Returns:
        The weights, and the quality in [0, 1]: cosine times photo pixels a texel.
    """
    height_px, width_px = depth.shape
    weights = np.zeros(len(texel), dtype=np.float32)
    quality = np.zeros(len(texel), dtype=np.float32)
    for t in nb.prange(len(texel)):
        face = texel_face[t]
        i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
        nx = face_normals[face, 0]
        ny = face_normals[face, 1]
        nz = face_normals[face, 2]
        # Distance of the camera from the face's plane: behind it, nothing is seen.
        offset = nx * (center[0] - vertices[i, 0])
        offset += ny * (center[1] - vertices[i, 1])
        offset += nz * (center[2] - vertices[i, 2])
        if offset <= 0.0:
            continue
        x, y = texel[t] % width, texel[t] // width
        a, b, c = _barycentric(corners_px[face], x, y)
        px, py, pz = _surface_point(vertices, faces[face], a, b, c)
        u, v, z = _projected(P, px, py, pz)
        if not (0.0 <= u <= width_px - 1 and 0.0 <= v <= height_px - 1):
            continue
        ix, iy = int(u + 0.5), int(v + 0.5)
        clear = clearance[iy, ix]
        if clear == 0:
            continue
        sx, sy, sz = center[0] - px, center[1] - py, center[2] - pz
        distance = np.sqrt(sx * sx + sy * sy + sz * sz)
        face_cosine = offset / distance
        if face_cosine < MIN_FACING:
            continue
        mx = a * vertex_normals[i, 0] + b * vertex_normals[j, 0]
        my = a * vertex_normals[i, 1] + b * vertex_normals[j, 1]
        mz = a * vertex_normals[i, 2] + b * vertex_normals[j, 2]
        mx += c * vertex_normals[k, 0]
        my += c * vertex_normals[k, 1]
        mz += c * vertex_normals[k, 2]
        length = np.sqrt(mx * mx + my * my + mz * mz) * distance
        cosine = (mx * sx + my * sy + mz * sz) / length if length > 0.0 else 0.0
        if not cosine > min_cosine:
            continue

        # The nearest pixel must show the plane of the texel's own face. Its depth
        # there is exact, however steep the face; the tolerance is for curvature.
        inverse = N[0, 0] * nx + N[0, 1] * ny + N[0, 2] * nz
        inverse = inverse * ix + (N[1, 0] * nx + N[1, 1] * ny + N[1, 2] * nz) * iy
        inverse += N[2, 0] * nx + N[2, 1] * ny + N[2, 2] * nz
        inverse /= -offset
        steep = np.sqrt(max(0.0, 1.0 - face_cosine * face_cosine)) / face_cosine
        tolerance = (1.5 + steep) * z / focal_px
        if not abs(depth[iy, ix] * inverse - 1.0) <= tolerance * inverse:
            continue

        resolution = focal_px / (z * texels_per_unit)
        weight = (cosine - min_cosine) / (1.0 - min_cosine) * (clear / 255.0)
        weights[t] = weight * min(resolution * resolution, 1e3)
        quality[t] = min(1.0, resolution) * cosine
    return weights, quality


@nb.njit(nogil=True, cache=True, parallel=True)
def accumulate_photo(  # noqa: ANN201
    row,  # noqa: ANN001
    points,  # noqa: ANN001
    weights,  # noqa: ANN001
    qualities,  # noqa: ANN001
    P,  # noqa: ANN001
    pixels,  # noqa: ANN001
    low,  # noqa: ANN001
    low_scale,  # noqa: ANN001
    gain,  # noqa: ANN001
    best_only,  # noqa: ANN001
    photo,  # noqa: ANN001
    sums,  # noqa: ANN001
    best_weight,  # noqa: ANN001
    best_photo,  # noqa: ANN001
    quality,  # noqa: ANN001
):
    """Adds what one photo sees to the sums of the texels that it sees.

    The photo is split in two bands: the low one is blended by weights that fall off
    slowly, so that photos of different light pass into each other; the high one
    comes nearly from the best view alone, so that small errors of registration do not
    double every detail.

    Args:
        row: (s,) rows, in the arrays below, of the texels that the photo sees.
        points: (s, 3) their surface points, inside the photo.
        weights: (s,) float32, how much the photo counts there.
        qualities: (s,) float32, how well it sees them.
        P: (3, 4) projection matrix.
        pixels: (h, w, 3) uint8.
        low: (hl, wl, 3) float32, the blurred photo on a coarse grid.
        low_scale: (2,) size of the coarse grid by that of the photo, x and y.
        gain: (3,) by which the photo's channels are multiplied.
        best_only: Take the best photo's colour alone.
        photo: Index of the photo.
        sums: (n, 8) float32: weight, low x 3, sharp weight, high x 3; changed.
        best_weight: (n,) float32; changed.
        best_photo: (n,) int16; changed.
        quality: (n,) float32; changed.
    """
    height_px, width_px = pixels.shape[0], pixels.shape[1]
    height_low, width_low = low.shape[0], low.shape[1]
    for s in nb.prange(len(row)):
        t, weight = row[s], weights[s]
        u, v, _ = _projected(P, points[s, 0], points[s, 1], points[s, 2])
        if weight > best_weight[t]:
            best_weight[t] = weight
            best_photo[t] = photo
            quality[t] = qualities[s]
            if best_only:
                sums[t, :] = 0.0
        elif best_only:
            continue
        sharp = max(weight**SHARPNESS, np.float32(1e-30))
        sums[t, 0] += weight
        sums[t, 4] += sharp
        ix, iy = min(int(u), width_px - 2), min(int(v), height_px - 2)
        ul = min(max((u + 0.5) * low_scale[0] - 0.5, 0.0), width_low - 1.0)
        vl = min(max((v + 0.5) * low_scale[1] - 0.5, 0.0), height_low - 1.0)
        jx, jy = min(int(ul), width_low - 2), min(int(vl), height_low - 2)
        for channel in range(3):
            colour = _bilinear(pixels, ix, iy, u - ix, v - iy, channel)
            base = _bilinear(low, jx, jy, ul - jx, vl - jy, channel)
            sums[t, 1 + channel] += weight * gain[channel] * base
            sums[t, 5 + channel] += sharp * gain[channel] * (colour - base)


@nb.njit(nogil=True, cache=True, parallel=True)
def write_texels(  # noqa: ANN201
    texel,  # noqa: ANN001
    inside,  # noqa: ANN001
    sums,  # noqa: ANN001
    best_photo,  # noqa: ANN001
    best_quality,  # noqa: ANN001
    texture,  # noqa: ANN001
    photo_index,  # noqa: ANN001
    quality,  # noqa: ANN001
):
    """Writes what the photos say of each texel into the pictures, which are flat.

    Args:
        texel: (n,) flat index of each texel.
        inside: (n,) whether its centre lies in its face.
        sums: (n, 8) as of `accumulate_photo`.
        best_photo: (n,) the photo that counts most; -1: none sees it.
        best_quality: (n,) how well that photo sees it, in [0, 1].
        texture: (h * w, 3) uint8; changed where a photo sees the texel.
        photo_index: (h * w,) int16; changed where the texel is inside.
        quality: (h * w,) uint8; changed where it is inside and seen.
    """
    for t in nb.prange(len(texel)):
        if inside[t]:
            photo_index[texel[t]] = best_photo[t]
            if best_photo[t] >= 0:
                quality[texel[t]] = np.uint8(255.0 * best_quality[t] + 0.5)
        if sums[t, 0] > 0.0:
            for channel in range(3):
                value = sums[t, 1 + channel] / sums[t, 0]
                value += sums[t, 5 + channel] / sums[t, 4]
                texture[texel[t], channel] = np.uint8(min(max(value + 0.5, 0.0), 255.0))


@nb.njit(nogil=True, cache=True, parallel=True)
def fill_gutter(labels, texel, is_on_chart, texture):  # noqa: ANN001, ANN201
    """Gives each texel off the charts the colour of the nearest on them.

    Args:
        labels: (h * w,) int32; texels whose nearest is the same have the same, and the
            nearest itself has it too, alone of those on charts.
        texel: (n,) the texels on charts.
        is_on_chart: (h * w,) bool, where they are.
        texture: (h * w, 3) uint8; changed off the charts.
    """
    nearest = np.zeros(labels.max() + 1, dtype=np.int64)
    for t in range(len(texel)):
        nearest[labels[texel[t]]] = texel[t]
    for i in nb.prange(len(labels)):
        if not is_on_chart[i]:
            for channel in range(3):
                texture[i, channel] = texture[nearest[labels[i]], channel]


@nb.njit(nogil=True, cache=True, parallel=True)
def grow_faces(face_at_texel):  # noqa: ANN001, ANN201
    """Gives each empty texel beside a chart the face of a neighbour.

    A bilinear lookup at the chart's border reaches half a texel beyond it. There the
    face's plane goes on, and the photos show what lies beyond the seam.
    """
    height, width = face_at_texel.shape
    grown = face_at_texel.copy()
    for y in nb.prange(height):
        for x in range(width):
            if face_at_texel[y, x] >= 0:
                continue
            for step in range(8):
                # The four sides first, then the corners.
                dx = (1, -1, 0, 0, 1, 1, -1, -1)[step]
                dy = (0, 0, 1, -1, 1, -1, 1, -1)[step]
                if 0 <= x + dx < width and 0 <= y + dy < height:
                    face = face_at_texel[y + dy, x + dx]
                    if face >= 0:
                        grown[y, x] = face
                        break
    return grown


@nb.njit(nogil=True, cache=True)
def gather_at_vertices(  # noqa: ANN201
    texel,  # noqa: ANN001
    texel_face,  # noqa: ANN001
    is_seen,  # noqa: ANN001
    width,  # noqa: ANN001
    corners_px,  # noqa: ANN001
    faces,  # noqa: ANN001
    n_vertices,  # noqa: ANN001
    texture,  # noqa: ANN001
):
    """Mean colour of the seen texels around each vertex, and the share seen there.

    Returns:
        (n_vertices, 3) colours, zero where nothing is seen, and (n_vertices,) shares.
    """
    colours = np.zeros((n_vertices, 3))
    seen = np.zeros(n_vertices)
    total = np.zeros(n_vertices)
    for t in range(len(texel)):
        face = texel_face[t]
        weights = _barycentric(corners_px[face], texel[t] % width, texel[t] // width)
        for corner in range(3):
            vertex = faces[face, corner]
            weight = max(weights[corner], 0.0)
            total[vertex] += weight
            if is_seen[t]:
                seen[vertex] += weight
                for channel in range(3):
                    colours[vertex, channel] += weight * texture[texel[t], channel]
    for vertex in range(n_vertices):
        if seen[vertex] > 0.0:
            colours[vertex] /= seen[vertex]
        if total[vertex] > 0.0:
            seen[vertex] /= total[vertex]
    return colours, seen


@nb.njit(nogil=True, cache=True, parallel=True)
def write_from_vertices(  # noqa: ANN201
    texel,  # noqa: ANN001
    texel_face,  # noqa: ANN001
    width,  # noqa: ANN001
    corners_px,  # noqa: ANN001
    faces,  # noqa: ANN001
    colours,  # noqa: ANN001
    texture,  # noqa: ANN001
):
    """Writes colours (n_vertices, 3) between vertices into the flat texture."""
    for t in nb.prange(len(texel)):
        face = texel_face[t]
        a, b, c = _barycentric(corners_px[face], texel[t] % width, texel[t] // width)
        # Beyond the chart's border the nearest inside; flat faces take one corner.
        a, b, c = max(a, 0.0), max(b, 0.0), max(c, 0.0)
        total = a + b + c
        if total == 0.0:
            a, total = 1.0, 1.0
        i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
        for channel in range(3):
            value = a * colours[i, channel] + b * colours[j, channel]
            value = (value + c * colours[k, channel]) / total
            texture[texel[t], channel] = np.uint8(min(max(value + 0.5, 0.0), 255.0))
