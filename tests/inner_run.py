"""A run of pytest within a test."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def inner_run(*words: str, folder: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """Run pytest with these words in a folder, without what the environment states of the run that is around it."""
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *words]
    env = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}
    return subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, check=False, timeout=200)
