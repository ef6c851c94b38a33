"""A window for `render_mode="human"`."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray


class Window:
    """Displays images at a fixed frame rate. Needs pygame-ce, whose windows are independent of each other."""

    def __init__(self, title: str, size: tuple[int, int], fps: int) -> None:
        try:
            import pygame
        except ImportError as error:
            raise DependencyNotInstalled("a window needs pygame: pip install pygame-ce") from error
        if not hasattr(pygame, "Window"):
            raise DependencyNotInstalled("a window needs pygame-ce 2.5.2 in place of pygame: pip install pygame-ce")
        self._pygame: Any = pygame
        # It stays open when a window closes, because other windows need it.
        pygame.display.init()
        self._window = pygame.Window(title, size)
        self._clock = pygame.time.Clock()
        self._fps = fps

    def show(self, picture: NDArray[np.uint8]) -> None:
        """Displays an image [height, width, 3], then waits as long as the frame rate requires."""
        self._pygame.event.pump()
        self._pygame.surfarray.blit_array(self._window.get_surface(), picture.swapaxes(0, 1))
        self._window.flip()
        self._clock.tick(self._fps)

    def close(self) -> None:
        """Closes the window."""
        self._window.destroy()
