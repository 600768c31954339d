"""Fixtures that several files of tests share."""

from pathlib import Path

import pytest


@pytest.fixture
def photo_folder(tmp_path: Path) -> Path:
    """A folder for photos, with a space in its name."""
    folder = tmp_path / "my photos"
    folder.mkdir()
    return folder
