"""`python -m activelsd`: the command line."""

from activelsd.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
