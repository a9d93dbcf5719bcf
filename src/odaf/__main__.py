"""`python -m odaf` is the command `odaf`."""

import sys

from odaf.cli import main

if __name__ == "__main__":
    sys.exit(main())
