"""Metashape's cameras XML as a text, by the numbers that stand in it."""

import numpy as np
from scipy.spatial.transform import Rotation

F, CX, CY, B1, B2 = 905.0, 11.5, -7.25, 0.5, -0.3
K1, K2, K3, P1, P2 = -0.09, 0.04, -0.01, -0.003, 0.0012
CALIBRATION = (
    f"<f>{F}</f><cx>{CX}</cx><cy>{CY}</cy><b1>{B1}</b1><b2>{B2}</b2><k1>{K1}</k1>"
    f"<k2>{K2}</k2><k3>{K3}</k3><p1>{P1}</p1><p2>{P2}</p2>"
)
R_CHUNK_CAM = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix()
C_CHUNK = np.array([0.4, -1.1, -6.0])
Q, SCALE = Rotation.from_rotvec([-0.7, 0.2, 1.0]).as_matrix(), 2.5
SHIFT = np.array([10.0, -20.0, 30.0])


def row(values: np.ndarray) -> str:
    """Numbers as text."""
    return " ".join(repr(float(v)) for v in np.ravel(values))


PLACE = (
    f'<transform><rotation locked="true">{row(Q)}</rotation><translation>{row(SHIFT)}'
    f"</translation><scale>{SCALE}</scale></transform>"
)


def document(
    calibration: str = CALIBRATION,
    *,
    sensor: str = 'type="frame"',
    within: str = "",
    camera: str = 'label="a"',
    place: str = PLACE,
    chunk: str = "",
    second: str = "<orientation>1</orientation>",
) -> str:
    """A file of the cameras a and b; b is not aligned, unless ``second`` says so."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = R_CHUNK_CAM, C_CHUNK
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<document version="2.0.0">'
        f'<chunk label="Chunk 1" enabled="true"><sensors next_id="1"><sensor id="0" '
        f'label="unknown" {sensor}><resolution width="1200" height="900"/>{within}'
        '<calibration type="frame" class="initial"><resolution width="1200" '
        'height="900"/><f>1</f></calibration><calibration type="frame" '
        f'class="adjusted"><resolution width="1200" height="900"/>{calibration}'
        f'</calibration></sensor></sensors>{chunk}<cameras><group><camera id="0" '
        f'sensor_id="0" {camera}><transform>{row(pose)}</transform></camera></group>'
        f'<camera id="1" sensor_id="0" label="b">{second}</camera>'
        f"</cameras>{place}</chunk></document>"
    )
