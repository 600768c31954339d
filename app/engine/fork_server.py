"""What the process imports that others are forked from; nobody else imports this.

None of it starts a thread or calls a compiled function: a fork would not survive that.
"""

import sys
from types import TracebackType

import app.engine.process
import app.engine.read_job  # noqa: F401
import photoreg.project.check  # noqa: F401


def _report(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    """Says nothing where the app was killed while it started a process."""
    if kind is not EOFError:
        sys.__excepthook__(kind, error, trace)


sys.excepthook = _report
