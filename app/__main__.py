"""`python -m app`: the app, with the flags of `photoreg app`."""

import sys

from photoreg import cli
from photoreg.__main__ import app_command

if __name__ == "__main__":
    sys.exit(cli.run(["app", *sys.argv[1:]], {"app": app_command}))
