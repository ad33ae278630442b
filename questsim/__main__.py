"""``python -m questsim``: the command ``questsim`` if its script is not on the path."""

import sys

from questsim.cli import main

sys.exit(main())
