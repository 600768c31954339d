"""The list of projects opened lately, and the log beside a project."""

import logging
from pathlib import Path

import pytest

from app.control import user_data
from photoreg.project.folder import DATABASE


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
        user_data.remember(folder)
    assert user_data.recent() == [one, three, two]
    (three / DATABASE).unlink()
    assert user_data.recent() == [one, two], "one that is gone is not offered"


def test_the_list_ends_and_damage_to_it_costs_only_itself(tmp_path: Path, data: Path):
    folders = [made(tmp_path / str(i)) for i in range(user_data.MAX_RECENT + 3)]
    for folder in folders:
        user_data.remember(folder)
    assert user_data.recent() == folders[: -1 - user_data.MAX_RECENT : -1]
    for damage in (b"", b"{", b"\xff\xfe", b'{"a": 1}', b"[7, null]", b"null"):
        (data / "recent.json").write_bytes(damage)
        assert user_data.recent() == []
    user_data.remember(folders[0])
    assert user_data.recent() == [folders[0]]


def test_a_typed_name_cannot_lead_out_of_the_projects_folder(data: Path):
    assert user_data.folder_named(" Head ") == data / "projects" / "Head"
    for name in ("..", ".", "a:b", "con", "\x00", "'; --"):
        assert user_data.folder_named(name).parent == data / "projects", name


def test_the_log_of_a_week_stays_small_and_keeps_the_newest(tmp_path: Path):
    handler = user_data.log_into(tmp_path)
    assert handler is not None
    log = logging.getLogger("app.of_the_test")
    log.propagate = False
    log.addHandler(handler)
    try:
        n_lines = 3 * user_data.LOG_COPIES * user_data.LOG_BYTES // 1000
        for i in range(n_lines):
            log.warning("%06d %s", i, "x" * 940)
    finally:
        log.removeHandler(handler)
        logging.getLogger().removeHandler(handler)
        handler.close()
    files = sorted(tmp_path.glob(f"{user_data.LOG_FILE}*"))
    assert len(files) == 1 + user_data.LOG_COPIES
    n_bytes = sum(file.stat().st_size for file in files)
    assert n_bytes <= (1 + user_data.LOG_COPIES) * user_data.LOG_BYTES
    assert f"{n_lines - 1:06d} " in (tmp_path / user_data.LOG_FILE).read_text()
