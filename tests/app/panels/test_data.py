"""What a photo's card says."""

import dataclasses
import io

import numpy as np
from PIL import ExifTags, Image

from app.model.camera_moves import first_camera
from app.model.state import PhotoEntry
from app.panels.data import focal_text
from photoreg.formats.photos.read import load_photo
from tests.formats.photo_files import details_of


def test_a_card_says_where_the_focal_length_came_from_and_that_a_photo_is_cropped(
    tmp_path,
):
    texts = []
    for name, size in (("whole.jpg", (400, 300)), ("part.jpg", (200, 280))):
        exif = Image.Exif()
        details = details_of(exif)
        details[ExifTags.Base.FocalLengthIn35mmFilm] = 28
        details[ExifTags.Base.ExifImageWidth] = 400
        details[ExifTags.Base.ExifImageHeight] = 300
        file = io.BytesIO()
        Image.fromarray(np.zeros((*size[::-1], 3), np.uint8)).save(
            file, "JPEG", exif=exif.tobytes()
        )
        (tmp_path / name).write_bytes(file.getvalue())
        photo = load_photo(tmp_path / name)
        entry = PhotoEntry(photo, first_camera(None, photo, (0, 1, 0)))
        texts.append(focal_text(entry))
    whole, part = texts
    assert "35 mm equivalent" in whole
    assert "crop" not in whole
    assert "cropped: its middle may not be the lens's" in part
    said_whole = dataclasses.replace(entry, cropped=False)
    assert "its middle" not in focal_text(said_whole)
