"""The pointer moved by keys, for what has to be drawn or dragged: strokes, outlines, handles, keyframes.

While it is on, arrows move the pointer, Space is its button, and Enter holds the button down until it is pressed again.
Everything else works as with a mouse, so no tool needs keys of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import glfw
from imgui_bundle import ImVec2, imgui

from app.ui.keyboard import ARROWS
from app.ui.theme import palette, px, rgba

__all__ = ["PointerKeys", "warp_in"]

Key = imgui.Key

SLOW, FAST, SPEED_UP = 60.0, 900.0, 0.8
"""Pixels a second at which the pointer starts and at which it ends, and the seconds after which it does: a tap moves it
by a few pixels, and it crosses the window in two seconds."""

FINE = 1.0
"""Pixels by which a tap moves it while Ctrl is held."""

LONGEST = 0.05
"""Seconds that one frame counts for at most: after a pause the pointer must not jump."""

ARM, GAP = 14.0, 4.0
"""Length of the cross hair's arms and of the gap in its middle, pixels."""


def warp_in(window: Any) -> Callable[[float, float], None]:
    """Moves the system's pointer to a place in a GLFW window, where that can be done (not under Wayland)."""
    can = glfw.get_platform() != glfw.PLATFORM_WAYLAND
    return partial(glfw.set_cursor_pos, window) if can else lambda x, y: None


class PointerKeys:
    """Moves the pointer by keys while it is on. `warp` moves the system's pointer to a place in the window."""

    def __init__(self, warp: Callable[[float, float], None]) -> None:
        self.on = False
        self._warp = warp
        self._moving = 0.0  # seconds
        self._locked = False

    def toggle(self) -> None:
        """Turns it on or off; the button is let go."""
        self.on = not self.on
        if not self.on:
            self._press(False)

    @property
    def moving(self) -> bool:
        """Whether an arrow is held, so that frames are wanted."""
        return self._moving > 0

    def update(self) -> None:
        """Handles keys; called once a frame, before anything else that does."""
        io, owner = imgui.get_io(), imgui.get_id("pointer keys")
        if not self.on or io.want_text_input:
            self._moving = 0.0
            return
        keys = [*ARROWS, Key.space, Key.enter, Key.keypad_enter]
        if not self._locked:  # otherwise it ends what is being drawn, and only lets the button go
            keys.append(Key.escape)
        for key in keys:
            imgui.internal.set_key_owner(key, owner, imgui.internal.InputFlagsPrivate_.lock_this_frame)
        if self._locked and imgui.is_key_pressed(Key.escape, False):
            self._press(False)
        elif not self._locked and imgui.internal.is_key_pressed(Key.escape, 0, owner):
            self.toggle()
            return
        self._move(owner)
        pressed = imgui.internal.is_key_pressed
        if pressed(Key.enter, 0, owner) or pressed(Key.keypad_enter, 0, owner):
            self._press(not self._locked)
        elif not self._locked and pressed(Key.space, 0, owner):
            io.add_mouse_button_event(0, True)
        elif not self._locked and imgui.internal.is_key_released(Key.space, owner):
            io.add_mouse_button_event(0, False)
        self._draw()

    def _move(self, owner: int) -> None:
        io = imgui.get_io()
        held = [way for key, way in ARROWS.items() if imgui.internal.is_key_down(key, owner)]
        if not held:
            self._moving = 0.0
            return
        first = self._moving == 0
        self._moving += min(io.delta_time, LONGEST)
        speed = SLOW + (FAST - SLOW) * min(self._moving / SPEED_UP, 1) ** 2
        step = px(speed * min(io.delta_time, LONGEST))
        if io.key_ctrl:
            tapped = any(imgui.internal.is_key_pressed(key, imgui.InputFlags_.repeat, owner) for key in ARROWS)
            step = FINE if tapped else 0.0
        elif first:
            step = max(step, 1.0)
        x = io.mouse_pos.x + step * sum(way[0] for way in held)
        y = io.mouse_pos.y - step * sum(way[1] for way in held)
        size = io.display_size
        self._go(min(max(x, 0.0), size.x - 1), min(max(y, 0.0), size.y - 1))

    def _go(self, x: float, y: float) -> None:
        imgui.get_io().add_mouse_pos_event(x, y)
        self._warp(x, y)

    def _press(self, down: bool) -> None:
        self._locked = down
        imgui.get_io().add_mouse_button_event(0, down)

    def _draw(self) -> None:
        """A cross hair, with a ring while the button is held."""
        at, paint = imgui.get_io().mouse_pos, imgui.get_foreground_draw_list()
        for colour, width in ((rgba(palette().panel), px(4)), (rgba(palette().accent), px(2))):
            shade = imgui.get_color_u32(colour)
            for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
                first = ImVec2(at.x + px(GAP) * x, at.y + px(GAP) * y)
                last = ImVec2(at.x + px(ARM) * x, at.y + px(ARM) * y)
                paint.add_line(first, last, shade, width)
            if imgui.is_mouse_down(imgui.MouseButton_.left):
                paint.add_circle(at, px(ARM), shade, 0, width)
