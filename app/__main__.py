"""`python -m app`: the app, with the flags of `photoreg app`."""

import sys

from photoreg.limits import keep_blas_to_one_thread

keep_blas_to_one_thread()

from photoreg.cli import commands  # noqa: E402

if __name__ == "__main__":
    sys.exit(commands.run(["app", *sys.argv[1:]]))
