"""`photoreg`: the app when no command is named, else the command line."""

import atexit
import os
import signal
import sys
from pathlib import Path

if (
    __name__ == "__main__"
    and not sys.flags.safe_path
    and Path(sys.path[0]).resolve() != Path(__file__).resolve().parents[1]
):
    # `python -m` looks into the working folder first, and so would every process that is
    # started from here: somebody's own app.py there would be taken for ours.
    del sys.path[0]

from photoreg.cli.stopping import ctrl_c_ends_at_once
from photoreg.errors import InputError
from photoreg.limits import check_address_space, keep_blas_to_one_thread

keep_blas_to_one_thread()
try:
    check_address_space()
except InputError as error:
    sys.stderr.write(f"photoreg: {error}\n")
    sys.exit(2)
with ctrl_c_ends_at_once():
    # They take a second or two.
    from photoreg.cli import commands


def main() -> int:
    """Runs the command that the terminal names; returns the exit status."""
    status = commands.run(sys.argv[1:] or ["app"])
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        # What is left is the interpreter's own end.
        signal.signal(signal.SIGINT, lambda *_: os._exit(status))
        # At its very end Python gives signals back to the system, which would kill it.
        atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)
    return status


if __name__ == "__main__":
    sys.exit(main())
