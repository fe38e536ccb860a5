"""The command `vibroscreen` as `python -m vibroscreen`."""

from vibroscreen.cli import main

if __name__ == "__main__":
    main()
