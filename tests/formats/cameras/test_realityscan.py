"""RealityScan's XMP files: what their numbers mean, and what is refused by name."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from photoreg.errors import InputError, OutputError
from photoreg.formats.cameras.camera_set import CameraSet
from photoreg.formats.cameras.find import find_camera_file
from photoreg.formats.cameras.registry import (
    format_to_read,
    read_cameras,
    write_cameras,
)
from photoreg.formats.mark import is_marked
from photoreg.geometry.lens import Lens
from tests.formats.camera_files import camera_set, general_cameras, points_before, write

R = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix()
POSITION = np.array([2.5, -1.0, 0.75])
F35, ASPECT, U, V = 28.5, 1.02, 0.0125, -0.0075
K1, K2, K3, T1, T2 = -0.09, 0.04, -0.01, -0.003, 0.0012
SIZE = 900, 1200


def words(*values: float) -> str:
    return " ".join(repr(float(value)) for value in values)


def sidecar(within: str = "", **changes: str | None) -> str:
    """As RealityScan writes it, with attributes changed, or left out (None)."""
    attributes: dict[str, str | None] = {
        "Version": "3",
        "PosePrior": "initial",
        "Coordinates": "absolute",
        "DistortionModel": "brown3t2",
        "FocalLength35mm": str(F35),
        "Skew": "0",
        "AspectRatio": str(ASPECT),
        "PrincipalPointU": str(U),
        "PrincipalPointV": str(V),
        "CalibrationPrior": "initial",
        "CalibrationGroup": "-1",
        "DistortionGroup": "-1",
        "InTexturing": "1",
        "InMeshing": "1",
        "DistortionCoeficients": words(K1, K2, K3, 0.0, T1, T2),
        "Position": words(*POSITION),
        "Rotation": words(*R.ravel()),
        **changes,
    }
    given = " ".join(f'xcr:{k}="{v}"' for k, v in attributes.items() if v is not None)
    return (
        '<?xpacket begin="" id="W5M0MpCehiHzreSzNTczkc9d"?>'
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF '
        'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description '
        f'{given} xmlns:xcr="http://www.capturingreality.com/ns/xcr/1.1#">{within}'
        "</rdf:Description></rdf:RDF></x:xmpmeta>"
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    Image.new("RGB", SIZE).save(tmp_path / "a.png")
    return tmp_path


def read(folder: Path, text: str):
    (folder / "a.xmp").write_text(text, encoding="utf-8")
    return read_cameras(folder, "realityscan")


def as_realityscan_projects(points_world: np.ndarray) -> np.ndarray:
    """Word by word as its documentation has it, pixel (0, 0) the first one's corner."""
    pixels = []
    t = -R @ POSITION
    side = max(SIZE)
    for world in points_world:
        X, Y, Z = R @ world + t
        x, y = X / Z, Y / Z
        r2 = x * x + y * y
        radial = 1 + K1 * r2 + K2 * r2**2 + K3 * r2**3
        dx = x * radial + T1 * (r2 + 2 * x * x) + 2 * T2 * x * y
        dy = y * radial + T2 * (r2 + 2 * y * y) + 2 * T1 * x * y
        f = F35 / 36
        pixels.append(
            [
                (f * dx + U) * side + 0.5 * SIZE[0],
                (f * ASPECT * dy + V) * side + 0.5 * SIZE[1],
            ]
        )
    return np.array(pixels)


def test_a_camera_projects_as_realityscan_does(folder):
    file = read(folder, sidecar())
    camera = file.cameras["a.png"]
    assert (camera.width, camera.height) == SIZE
    assert file.notes == ()
    points = points_before(camera)
    np.testing.assert_allclose(
        camera.project(points) + 0.5, as_realityscan_projects(points), atol=1e-9
    )


def test_values_may_be_elements(folder):
    (by_attributes,) = read(folder, sidecar()).cameras.values()
    names = {
        "Rotation": words(*R.ravel()),
        "Position": words(*POSITION),
        "DistortionCoeficients": words(K1, K2, K3, 0.0, T1, T2),
    }
    within = "".join(f"<xcr:{k}> {v}\n</xcr:{k}>" for k, v in names.items())
    text = sidecar(within, **dict.fromkeys(names))
    (by_elements,) = read(folder, text).cameras.values()
    np.testing.assert_array_equal(by_elements.P, by_attributes.P)
    assert by_elements.lens == by_attributes.lens == Lens(K1, K2, T2, T1, K3)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"Skew": "0.01"}, "Skew"),
        ({"DistortionModel": "division"}, "division"),
        ({"DistortionModel": None}, "the model ''"),
        ({"DistortionModel": "brown3"}, "brown3 has no t1"),
        (
            {
                "DistortionModel": "brown4",
                "DistortionCoeficients": words(K1, 0, 0, 0.1, 0, 0),
            },
            "k4",
        ),
        ({"DistortionCoeficients": "1 2"}, "6 numbers"),
        ({"Coordinates": "relative"}, "relative"),
        ({"ProjectionModel": "equirectangular"}, "equirectangular"),
        ({"Wobble": "1"}, "xcr:Wobble"),
        ({"FocalLength35mm": None}, "FocalLength35mm"),
        ({"Rotation": None}, "Rotation should be 9 numbers"),
        ({"Position": "1 2 nan"}, "finite"),
        ({"Rotation": words(*(2.0 * R).ravel())}, "rotation"),
    ],
)
def test_what_is_not_known_is_refused_by_name(folder, changes, named):
    with pytest.raises(InputError, match=named):
        read(folder, sidecar(**changes))


def test_a_division_model_without_distortion_is_fine(folder):
    zeros = words(*[0] * 6)
    text = sidecar(DistortionModel="division", DistortionCoeficients=zeros)
    assert read(folder, text).cameras["a.png"].lens.is_ideal


def test_files_of_other_programs_and_maps_are_named(folder):
    (folder / "b.xmp").write_text(
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/'
        '02/22-rdf-syntax-ns#"/></x:xmpmeta>'
    )
    notes = read(folder, sidecar(ExportCoordinateSystemType="3")).notes
    assert "1 XMP files hold no pose of RealityScan (b.xmp)" in notes[0]
    assert "name a coordinate system" in notes[1]
    (folder / "a.xmp").unlink()
    with pytest.raises(InputError, match="holds no cameras"):
        format_to_read(folder)


def test_a_photo_that_is_not_there_is_asked_for(tmp_path):
    with pytest.raises(InputError, match="Give the photos too"):
        read(tmp_path, sidecar())


def test_written_files_lie_beside_copies_of_the_photos(tmp_path, photo_folder):
    cameras = camera_set(photo_folder)
    folder, saved = write(tmp_path, "realityscan", cameras)
    assert len(saved.files) == 6
    assert find_camera_file(tmp_path) == folder
    assert format_to_read(folder).name == "realityscan"
    for path in folder.glob("*.xmp"):
        assert is_marked(path)
        (one,) = read_cameras(path).cameras
        assert Path(one).stem == path.stem
    write_cameras(folder, cameras, "realityscan")  # Over its own files.


def test_photos_of_one_stem_are_refused(tmp_path):
    camera = next(iter(general_cameras().values()))
    cameras = CameraSet({"a.png": camera, "a.jpg": camera})
    with pytest.raises(OutputError, match="without suffix"):
        write(tmp_path, "realityscan", cameras)
