"""`python -m renet` is the command `renet`."""

import sys

from renet.cli import main

sys.argv[0] = "renet"  # What results name as the command that made them.
raise SystemExit(main())
