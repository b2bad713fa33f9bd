"""Files that run when they are imported: the tests run them, and nothing collects them."""

collect_ignore = ["mast.py", "robot.py", "symbols.py"]
