"""`python -m fuzz.second_readers`: many spoiled files through both readers."""

import sys

from .cases import main

sys.exit(main())
