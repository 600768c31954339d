"""How much of a file photoreg takes in; larger ones are refused in a sentence."""

import dataclasses
import os
from collections.abc import Mapping

from photoreg.errors import InputError


@dataclasses.dataclass(frozen=True)
class Limits:
    """The limits on what is read. Each can be set by an environment variable.

    The variable of ``file_mb`` is PHOTOREG_MAX_FILE_MB, and so on.
    """

    file_mb: float = 1000.0
    """Size of a mesh or photo file, and of each file that a browser sends, in MB."""
    camera_file_mb: float = 500.0
    """Size of a camera file, in MB: some hundred thousand cameras."""
    yaml_file_mb: float = 5.0
    """Size of a camera file in YAML, in MB: some five thousand cameras. YAML may take
    250 times its size in memory."""
    faces_millions: float = 20.0
    """Triangles of a mesh, in millions; vertices may be three times as many."""
    photo_megapixels: float = 120.0
    """Pixels of a photo, or of a mesh's own texture, in millions."""
    project_mb: float = 1000.0
    """Size of a project's database, and of the values that it unpacks to, in MB."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not 0.0 < value < 1e9:
                raise InputError(
                    f"{variable(field.name)} should be a number above 0, but is {value}."
                )

    @classmethod
    def of_environment(cls, environment: Mapping[str, str] | None = None) -> "Limits":
        """The defaults, and what environment variables say otherwise.

        Raises:
            InputError: if a variable is not a number above 0.
        """
        environment = os.environ if environment is None else environment
        given = {}
        for field in dataclasses.fields(cls):
            text = environment.get(variable(field.name))
            if text is not None:
                try:
                    given[field.name] = float(text)
                except ValueError:
                    raise InputError(
                        f"{variable(field.name)} should be a number above 0, but is "
                        f"{text!r}."
                    ) from None
        return cls(**given)

    @property
    def file_bytes(self) -> int:
        """``file_mb`` in bytes."""
        return int(self.file_mb * 1e6)

    @property
    def project_bytes(self) -> int:
        """``project_mb`` in bytes."""
        return int(self.project_mb * 1e6)

    @property
    def photo_pixels(self) -> int:
        """``photo_megapixels`` in pixels."""
        return int(self.photo_megapixels * 1e6)


def variable(name: str) -> str:
    """The environment variable that sets a limit."""
    return f"PHOTOREG_MAX_{name.upper()}"


def keep_blas_to_one_thread() -> None:
    """Has numpy and scipy solve small systems in one thread, in all processes from here.

    To be called before numpy is loaded. Of the tens of numbers that a set of cameras
    has, OpenBLAS's threads mostly wait for each other: beside a browser and a worker,
    on two cores, 36 x 36 took 36 ms instead of 0.8. It also gives the same bits on
    any number of cores. Who has set OPENBLAS_NUM_THREADS keeps it.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def check_address_space() -> None:
    """Checks that the libraries can be loaded: some crash where they should complain.

    With two cores numpy, OpenCV, embree and numba load and work from 1.2 GB up, and
    crash in libgomp at 1.0 GB (Linux); each thread takes room for stack and buffers.

    Raises:
        InputError: if the system's limit (ulimit -v) leaves less.
    """
    try:
        import resource  # noqa: PLC0415 - Windows has no such limits.
    except ImportError:
        return
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    needed_gb = 0.9 + 0.15 * (os.cpu_count() or 1)
    if limit != resource.RLIM_INFINITY and limit < needed_gb * 1e9:
        raise InputError(
            f"photoreg needs {needed_gb:.1f} GB of address space to begin with, but "
            f"{limit / 1e9:.1f} GB are allowed. Raise the limit (ulimit -v)."
        )
