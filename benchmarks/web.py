"""The page of `pc-ground web` as its operator waits for it, in a real Chromium on this machine's own loopback.

    python -m benchmarks.web [--clicks 500] [--pictures 3600]

Press to answer: from the pointer's press on the picture until the frame of the screen with the answer is done, each
click a new pin on disk with its crop. First page: from the address to the first picture, in a browser without a cache,
right after the server's start. Ten thousand pins: the same clicks with as many in the file. A long flight: heap and DOM
nodes after each quarter of so many pictures, one a second of flight, faster than the page can show them all. Chromium
draws without a graphics card here: an operator's own machine is quicker.
"""

from __future__ import annotations


