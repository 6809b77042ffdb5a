"""`python -m asimov_gym.cli`: the `asimov` command without its script."""

import sys

from asimov_gym.cli import main

sys.exit(main())
