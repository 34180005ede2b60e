"""``python -m pgcp`` is ``pgcp-run``."""

from pgcp.cli.main import run

if __name__ == "__main__":
    run()
