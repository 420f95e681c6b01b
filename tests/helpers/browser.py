"""A real browser for pages: headless Chromium."""

from __future__ import annotations

import shutil
import subprocess

import pytest

BROWSER = next((b for b in map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))
                if b), None)

FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
         "--disable-background-networking", "--disable-component-update", "--disable-sync",
         "--hide-scrollbars", "--enable-logging=stderr", "--v=0")

WIDTH, HEIGHT = 1320, 1500


def browse(address, tmp_path, *flags):
    """Open an address; what the browser printed and what it told about the console."""
    if BROWSER is None:
        pytest.skip("no Chromium here")
    profile = tmp_path / "profile"
    done = subprocess.run(
        [BROWSER, *FLAGS, f"--user-data-dir={profile}", f"--window-size={WIDTH},{HEIGHT}", *flags,
         address], capture_output=True, text=True, timeout=120, check=True)
    shutil.rmtree(profile, ignore_errors=True)
    return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]
