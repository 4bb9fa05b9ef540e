"""`python3 -m lumiscan_studio`."""

import sys

from .cli import main

sys.exit(main())
