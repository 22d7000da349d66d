"""`python -m activelsd`: the command line."""

import os
import sys

from activelsd.cli import main

if __name__ == "__main__":
    code = main()
    if "TORCHELASTIC_RUN_ID" in os.environ:
        # PyTorch's threads for talking to other processes now and then abort what ends in the usual way, and
        # torchrun takes that for a failure (seen with 2.13 and gloo). All is written by now.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    raise SystemExit(code)
