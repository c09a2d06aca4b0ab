"""`python -m renet` is the command `renet`."""

from renet.cli import main

raise SystemExit(main())
