"""``python -m pgcp`` is ``pgcp-run``."""

import sys

from pgcp.cli import main

if __name__ == "__main__":
    sys.exit(main())
