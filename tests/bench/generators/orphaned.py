"""Generators that work on and on, beside a process of their own."""

import re
import subprocess
import sys
import time
from pathlib import Path


class Sleeping:
    def __init__(self, executor=None, map_size=None):
        self.executor = executor

    def start(self):
        helper = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
        Path("helper").write_text(str(helper.pid), encoding="utf-8")
        self.work()

    def work(self):
        time.sleep(600)


class Matching(Sleeping):
    """Lets no other thread run while it looks for what is not there."""

    def work(self):
        re.match("(a+)+$", "a" * 64 + "b")
