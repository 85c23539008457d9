"""Runs the real window with ImGui's test engine: a script moves the pointer and presses keys, and takes pictures."""

from __future__ import annotations

import os
import time
import traceback
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from pathlib import Path
from typing import TypeVar

import numpy as np
from imgui_bundle import ImVec2, hello_imgui, imgui
from numpy.typing import NDArray
from PIL import Image

from app.model.measure import extent
from app.session.session import Session
from app.ui.window import Window

__all__ = ["Driver", "drive"]

HOUR = 3600.0
"""Seconds until the test engine stops waiting for a script: longer than any training on a busy machine."""

T = TypeVar("T")


class Driver:
    """The actions of a script, which runs in step with the window's frames."""

    def __init__(self, window: Window, context: imgui.test_engine.TestContext) -> None:
        self.window, self.session, self.context = window, window.session, context
        window.params.callbacks.before_imgui_render = self._skip_unseen
        self._seen = False
        """Whether frames are looked at, and must be painted."""

    def frames(self, count: int = 1) -> None:
        """Lets frames pass."""
        self.context.yield_(count)

    def until(self, done: Callable[[], bool], seconds: float = 60.0, what: str = "") -> None:
        """Lets frames pass until a condition holds."""
        start = time.monotonic()
        while not done():
            waited = time.monotonic() - start
            assert waited < seconds, (
                f"waited {seconds:g} s for {what or done}: {self.session.message} {self.session.error}"
            )
            # Leaves the CPU to what is awaited: a frame on software GL takes more of it than a short sleep.
            time.sleep(min(max(waited / 10, 0.02), 0.5))
            self.context.yield_()

    def still(self) -> None:
        """Lets frames pass until nothing moves."""
        self.until(lambda: not (self.window.viewport.moving or self.window.painter.unfinished), 30.0)
        self.frames(2)

    def point(self, x: float, y: float) -> ImVec2:
        """A point of the viewport, given as fractions of its sides."""
        view = self.window.viewport
        return ImVec2(view.origin.x + x * view.size[0], view.origin.y + y * view.size[1])

    def drag(
        self,
        start: tuple[float, float],
        end: tuple[float, float],
        button: int = 0,
        hold: Callable[[], object] | None = None,
    ) -> None:
        """Drags across the viewport; `hold` is called before the button is released."""
        self.context.mouse_move_to_pos(self.point(*start))
        self.context.mouse_down(button)
        for part in (0.5, 1.0):
            at = tuple(a + part * (b - a) for a, b in zip(start, end, strict=True))
            self.context.mouse_move_to_pos(self.point(*at))
        if hold is not None:
            hold()
        self.context.mouse_up(button)
        self.frames(2)

    def draw(self, path: Iterable[tuple[float, float]]) -> None:
        """Drags along a line through the viewport."""
        start, *corners = path
        self.context.mouse_move_to_pos(self.point(*start))
        self.context.mouse_down(0)
        for corner in corners:
            self.context.mouse_move_to_pos(self.point(*corner))
        self.context.mouse_up(0)
        self.frames(2)

    def click(self, reference: str) -> None:
        """Clicks an item, by its ImGui path."""
        self.context.item_click(self.item(reference))

    def item(self, reference: str) -> str:
        """A path that ImGui finds: the scrolling part of the inspector is a window inside it."""
        name = "//Inspector/"
        if not reference.startswith(name):
            return reference
        self.context.set_ref(imgui.test_engine.TestRef(self.context.window_info(f"{name}##sections").id_))
        return reference.removeprefix(name)

    def press(self, chord: int) -> None:
        """Presses keys."""
        self.context.key_press(chord)
        self.frames(2)

    def picture(self, path: Path | None = None) -> NDArray[np.uint8]:
        """(H, W, 3). The whole window as it is now; also saved if a path is given."""
        picture = self.painted(self._read)
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(picture).save(path, compress_level=1)
        return picture

    def view(self) -> NDArray[np.uint8]:
        """(H, W, 3). The viewport's part of the picture."""
        picture, view = self.picture(), self.window.viewport
        x, y = int(view.origin.x), int(view.origin.y)
        return picture[y : y + view.size[1], x : x + view.size[0]]

    def between_frames(self, act: Callable[[], T]) -> T:
        """Calls a function where the GL context is current: at the end of a frame, in the window's own thread."""
        ended: Future[T] = Future()

        def once() -> None:
            if not ended.done():
                try:
                    ended.set_result(act())
                except BaseException as error:  # it would end the window while the script waits for it
                    ended.set_exception(error)

        callbacks = self.window.params.callbacks
        callbacks.before_swap = once
        start = time.monotonic()
        while not ended.done():
            # A window that ended with an error draws no frame, and waits for the script.
            assert time.monotonic() - start < 60, "no frame is drawn any more"
            self.frames(1)
        return ended.result()

    def painted(self, act: Callable[[], T]) -> T:
        """Calls a function at the end of a frame that is painted in full, as the ones before it."""
        self._seen = True
        self.frames(2)
        try:
            return self.between_frames(act)
        finally:
            self._seen = False

    def gl_error(self) -> str:
        """OpenGL's error since the last call, which the script's own thread cannot query."""
        return self.painted(lambda: self.window.ctx.error)

    def _skip_unseen(self) -> None:
        """Leaves out the painting of ImGui's shapes, a third of a script's time without a graphics card, in frames that
        nobody looks at. All else of a frame is done, and the object is drawn into its texture.

        To ImGui the window has no extent, as a minimized one, until the next frame asks for its size again.
        """
        if not self._seen:
            imgui.get_main_viewport().size = ImVec2(0, 0)

    def _read(self) -> NDArray[np.uint8]:
        assert self.window.ctx.error == "GL_NO_ERROR"
        width, height = (int(side) for side in imgui.get_io().display_size)
        data = self.window.ctx.screen.read(viewport=(0, 0, width, height), components=3, alignment=1)
        _ = self.window.ctx.error  # moderngl asks for an attachment, which a window lacks, but reads the back buffer
        return np.frombuffer(data, np.uint8).reshape(height, width, 3)[::-1].copy()


def drive(
    session: Session,
    script: Callable[[Driver], None],
    start: Callable[[Session], None] | None = None,
    prepare: Callable[[Window], None] = lambda window: None,
) -> Window:
    """Runs the window until the script has ended; an error of the script is raised here.

    `start` is called in the window once it exists, `prepare` before.
    """
    os.environ.setdefault("LIBGL_ALWAYS_SOFTWARE", "1")
    extent.CELLS = 32  # volumes are measured in the background; no script checks their digits
    window = Window(session, start)
    failures: list[BaseException] = []
    params = window.params
    params.use_imgui_test_engine = True
    params.fps_idling.enable_idling = False
    params.fps_idling.vsync_to_monitor = False
    params.ini_disable = True
    prepare(window)

    def register() -> None:
        engine = hello_imgui.get_imgui_test_engine()
        io = imgui.test_engine.get_io(engine)
        io.config_run_speed = imgui.test_engine.TestRunSpeed.fast
        io.config_log_to_tty = False
        io.config_watchdog_warning = io.config_watchdog_kill_test = HOUR
        test = imgui.test_engine.register_test(engine, "app", "script")

        def run(context: imgui.test_engine.TestContext) -> None:
            try:
                script(Driver(window, context))
            except BaseException as error:
                traceback.print_exc()
                failures.append(error)
            session.autosave.clear()
            session.closing = True

        test.test_func = run
        imgui.test_engine.queue_test(engine, test)

    params.callbacks.register_tests = register
    window.run()
    if failures:
        raise failures[0]
    return window
