"""`python -m activelsd`: the command line."""

import os

from activelsd.cli import main

if __name__ == "__main__":
    code = main()
    if "TORCHELASTIC_RUN_ID" in os.environ:
        from activelsd.train.parallel import leave

        leave(code)
    raise SystemExit(code)
