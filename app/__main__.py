"""`python -m app`: the app, with the flags of `photoreg app`."""

import sys

from photoreg.cli import commands

if __name__ == "__main__":
    sys.exit(commands.run(["app", *sys.argv[1:]]))
