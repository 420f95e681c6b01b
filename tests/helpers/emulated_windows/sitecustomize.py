"""Takes from every Python that starts with this folder on its path what only Unix has."""

import os
import signal
import sys

sys.modules["resource"] = None
for name in ("killpg", "setsid", "getpgid", "setpgid", "sched_getaffinity", "statvfs", "nice"):
    if hasattr(os, name):
        delattr(os, name)
for name in ("SIGKILL", "SIGHUP", "SIGQUIT", "SIGALRM"):
    if hasattr(signal, name):
        delattr(signal, name)
