"""A link in the user's browser, where there is a screen."""

from __future__ import annotations

import os
import sys
import threading
import webbrowser


def open_in_browser(link: str) -> None:
    """Open the link without waiting. Without a screen it prints that: a text browser would take the terminal."""
    if not has_screen():
        print("no screen here: open the link in a browser (of another machine: ssh -L, or pc-ground web --host)")
        return
    threading.Thread(target=webbrowser.open, args=(link,), name="browser", daemon=True).start()


def has_screen() -> bool:
    return sys.platform in ("darwin", "win32") or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
