"""A window for `render_mode="human"`."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray


class Window:
    """Displays images at a fixed frame rate. Needs pygame-ce."""

    def __init__(self, title: str, size: tuple[int, int], fps: int) -> None:
        try:
            import pygame
        except ImportError as error:
            raise DependencyNotInstalled("a window needs pygame: pip install pygame-ce") from error
        self._pygame: Any = pygame
        pygame.display.init()
        pygame.display.set_caption(title)
        self._surface = pygame.display.set_mode(size)
        self._clock = pygame.time.Clock()
        self._fps = fps

    def show(self, picture: NDArray[np.uint8]) -> None:
        """Displays an image [height, width, 3], then waits as long as the frame rate requires."""
        self._pygame.event.pump()
        self._pygame.surfarray.blit_array(self._surface, picture.swapaxes(0, 1))
        self._pygame.display.flip()
        self._clock.tick(self._fps)

    def close(self) -> None:
        """Closes the window."""
        self._pygame.display.quit()
