"""The list of projects opened lately, and the log beside a project."""

import logging
from pathlib import Path

import pytest

from app import shelf
from photoreg.project import DATABASE


@pytest.fixture(autouse=True)
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PHOTOREG_DATA", str(tmp_path / "data"))
    return tmp_path / "data"


def made(folder: Path) -> Path:
    folder.mkdir()
    (folder / DATABASE).touch()
    return folder


def test_projects_opened_lately_are_listed_newest_first_and_once(tmp_path: Path):
    one, two, three = (made(tmp_path / name) for name in ("one", "two", "three"))
    for folder in (one, two, three, one):
        shelf.remember(folder)
    assert shelf.recent() == [one, three, two]
    (three / DATABASE).unlink()
    assert shelf.recent() == [one, two], "one that is gone is not offered"


def test_the_list_ends_and_damage_to_it_costs_only_itself(tmp_path: Path, data: Path):
    folders = [made(tmp_path / str(i)) for i in range(shelf.MAX_RECENT + 3)]
    for folder in folders:
        shelf.remember(folder)
    assert shelf.recent() == folders[: -1 - shelf.MAX_RECENT : -1]
    for damage in (b"", b"{", b"\xff\xfe", b'{"a": 1}', b"[7, null]", b"null"):
        (data / "recent.json").write_bytes(damage)
        assert shelf.recent() == []
    shelf.remember(folders[0])
    assert shelf.recent() == [folders[0]]


def test_a_typed_name_cannot_lead_out_of_the_projects_folder(data: Path):
    assert shelf.folder_named(" Head ") == data / "projects" / "Head"
    for name in ("..", ".", "a:b", "con", "\x00", "'; --"):
        assert shelf.folder_named(name).parent == data / "projects", name


def test_the_log_of_a_week_stays_small_and_keeps_the_newest(tmp_path: Path):
    handler = shelf.log_into(tmp_path)
    assert handler is not None
    log = logging.getLogger("app.of_the_test")
    log.propagate = False
    log.addHandler(handler)
    try:
        n_lines = 3 * shelf.LOG_COPIES * shelf.LOG_BYTES // 1000
        for i in range(n_lines):
            log.warning("%06d %s", i, "x" * 940)
    finally:
        log.removeHandler(handler)
        logging.getLogger().removeHandler(handler)
        handler.close()
    files = sorted(tmp_path.glob(f"{shelf.LOG_FILE}*"))
    assert len(files) == 1 + shelf.LOG_COPIES
    n_bytes = sum(file.stat().st_size for file in files)
    assert n_bytes <= (1 + shelf.LOG_COPIES) * shelf.LOG_BYTES
    assert f"{n_lines - 1:06d} " in (tmp_path / shelf.LOG_FILE).read_text()
