"""Which frame is shown when: playing, stepping, speed and loop. A clock is given to it, so nothing here waits."""

from __future__ import annotations

from dataclasses import dataclass

SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)


@dataclass
class Player:
    """count: frames; fps: frames a second at speed 1; frame: the one shown."""

    count: int
    fps: float
    frame: int = 0
    playing: bool = False
    loop: bool = True
    speed: float = 1.0
    _since: float = 0.0
    _at: float = 0.0

    def tick(self, now: float) -> bool:
        """Go on to the time ``now``, seconds; returns whether the frame is another one."""
        if not self.playing:
            return False
        place = self._at + (now - self._since) * self.fps * self.speed
        if place >= self.count:
            if self.loop:
                place %= self.count
            else:
                place, self.playing = self.count - 1, False
            self._at, self._since = place, now
        changed = int(place) != self.frame
        self.frame = int(place)
        return changed

    def toggle(self, now: float) -> None:
        """Play or pause; at the end without loop, playing starts anew."""
        if not self.playing and not self.loop and self.frame == self.count - 1:
            self.frame = 0
        self.playing = not self.playing
        self._anchor(now)

    def go(self, frame: int, now: float) -> None:
        """Show a frame; playing goes on from there."""
        self.frame = min(max(frame, 0), self.count - 1)
        self._anchor(now)

    def step(self, by: int, now: float) -> None:
        """Pause and go some frames on or back, around the end where looping."""
        self.playing = False
        self.go((self.frame + by) % self.count if self.loop else self.frame + by, now)

    def faster(self, by: int, now: float) -> None:
        """The next speed up or down."""
        place = min(range(len(SPEEDS)), key=lambda k: abs(SPEEDS[k] - self.speed)) + by
        self.speed = SPEEDS[min(max(place, 0), len(SPEEDS) - 1)]
        self._anchor(now)

    def _anchor(self, now: float) -> None:
        self._at, self._since = float(self.frame), now
