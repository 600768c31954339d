"""Who moves which camera now: two hands on one camera would pull it to and fro."""

import threading
import time


class CameraClaims:
    """Cameras in the hands of browsers. Safe to call from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._held: dict[int, tuple[int, float]] = {}

    def take(self, browser: int, camera: int, seconds: float) -> bool:
        """Takes a camera for some seconds; False while another browser has it."""
        now = time.monotonic()
        with self._lock:
            owner, until = self._held.get(camera, (browser, now))
            if owner != browser and now < until:
                return False
            self._held[camera] = (browser, now + seconds)
            return True

    def drop(self, browser: int) -> None:
        """Lets go of everything; also when the browser leaves."""
        with self._lock:
            self._held = {
                camera: held
                for camera, held in self._held.items()
                if held[0] != browser
            }
