"""``python -m questsim``: the command ``questsim`` where its script is not on the path."""

import sys

from questsim.cli import main

sys.exit(main())
