"""``python -m tenscontrol`` is the command ``tenscontrol``."""

from tenscontrol.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
