"""Fixtures that several files of tests share, and what all tests keep to."""

import functools
import importlib
import pkgutil
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from numba.core.registry import CPUDispatcher

from tests import shape_checks

shape_checks.install()

import photoreg  # noqa: E402


@pytest.fixture
def photo_folder(tmp_path: Path) -> Path:
    """A folder for photos, with a space in its name."""
    folder = tmp_path / "my photos"
    folder.mkdir()
    return folder


@pytest.fixture(scope="session", autouse=True)
def projects_are_kept_apart(
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[None]:
    """No test, nor a program that it starts, touches the user's own projects."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PHOTOREG_DATA", str(tmp_path_factory.mktemp("data")))
        yield


@pytest.fixture(scope="session", autouse=True)
def parallel_functions_are_for_the_main_thread() -> Iterator[None]:
    """Refuses what numba's workqueue layer, macOS's default, aborts the process for.

    By chance two threads may miss each other, and under other layers they may meet;
    here a second thread is told at its first call.
    """
    with pytest.MonkeyPatch.context() as patch:
        for module in _engine_modules():
            for name, value in list(vars(module).items()):
                if _is_parallel(value):
                    patch.setattr(module, name, _for_main_thread(value))
        yield


def _engine_modules() -> list[ModuleType]:
    for found in pkgutil.walk_packages(photoreg.__path__, "photoreg."):
        if not found.name.endswith("__main__"):
            importlib.import_module(found.name)
    return [m for name, m in sys.modules.items() if name.startswith("photoreg.")]


def _is_parallel(value: object) -> bool:
    return isinstance(value, CPUDispatcher) and value.targetoptions.get(
        "parallel", False
    )


def _for_main_thread(function: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(function)
    def guarded(*args: Any, **kwargs: Any) -> Any:
        assert threading.current_thread() is threading.main_thread(), (
            f"{function.__name__} is compiled parallel=True and was called from a "
            "helper thread"
        )
        return function(*args, **kwargs)

    return guarded
