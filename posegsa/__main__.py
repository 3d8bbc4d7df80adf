"""`python -m posegsa`."""

import sys

from posegsa.cli.command import main

sys.exit(main())
