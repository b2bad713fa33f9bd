"""``python -m tenscontrol.accuracy.suite``."""

import sys

from tenscontrol.accuracy.suite.runner import main

sys.exit(main())
