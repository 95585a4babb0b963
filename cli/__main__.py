"""`python -m facemime.cli`."""

import sys

from .main import main

sys.exit(main())
