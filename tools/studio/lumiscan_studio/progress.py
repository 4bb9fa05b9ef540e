"""Progress on stderr."""

from __future__ import annotations

import sys
import time

# Seconds between two lines where stderr is no terminal.
INTERVAL = 10.0


class Progress:
    """Shows how many scans are done, failed and left, and about how long those take."""

    def __init__(self, total: int) -> None:
        self.total = total
        self.began = time.monotonic()
        # Tasks that had ended when this client came, and the time of the last line.
        self.before: int = -1
        self.shown = float("-inf")

    def __call__(self, finished: int, failed: int) -> None:
        ended, now = finished + failed, time.monotonic()
        if self.before < 0:
            self.before = ended
        left = self.total - ended
        is_terminal = sys.stderr.isatty()
        if not is_terminal and left > 0 and now - self.shown < INTERVAL:
            return
        self.shown = now
        rate = (ended - self.before) / max(now - self.began, 1e-3)
        time_left = f", about {duration(left / rate)} left" if rate > 0 and left > 0 else ""
        line = f"{finished} done, {failed} failed, {left} remaining{time_left}"
        print(f"\r\x1b[K{line}" if is_terminal else line, end="" if is_terminal and left > 0 else "\n", file=sys.stderr, flush=True)


def duration(seconds: float) -> str:
    """Two units at most."""
    minutes = round(seconds / 60)
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"
