"""Files that cannot be read for want of what the system gives: told, and all goes on."""

import errno

import pytest

from app.control.file_intake import FileIntake
from app.engine import read_job
from app.model.session import Session
from photoreg.errors import InputError


@pytest.fixture
def intake():
    intake = FileIntake(Session(), lambda: None, lambda _: None)
    yield intake
    intake.close()


def announced(intake: FileIntake) -> None:
    intake.expect(1, 2)


def opened(intake: FileIntake) -> None:
    intake.open_one("left.png", b"x")


@pytest.mark.parametrize("act", [announced, opened])
def test_after_too_many_open_files_nothing_goes_on_and_one_sentence_says_so(
    act, intake, monkeypatch
):
    def fail(*_: object) -> None:
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(read_job, "spawned", fail)
    with pytest.raises(InputError, match="Too many open files"):
        act(intake)
    assert not intake.is_busy
    assert intake._session.state.job is None
