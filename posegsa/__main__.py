"""`python -m posegsa`."""

import sys

from posegsa.cli import main

sys.exit(main())
