"""A script for the real window: the object is stood on a face, and turned."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from imgui_bundle import imgui
from numpy.typing import NDArray

from app.model.camera_control import project_points
from app.ui.view.gizmo import on_handles
from tests.helpers.app_driver import Driver

__all__ = ["upright"]

Key = imgui.Key


def upright(driver: Driver, folder: Path) -> None:
    """The melon is stood on what is clicked, turned by the rings, by the menu and by numbers; all of it is undone."""
    session, view = driver.session, driver.window.viewport

    def normal_at(x: float, y: float) -> NDArray[np.float64]:
        """The outward normal of the ellipsoid x^2/a^2 + y^2/a^2 + z^2 = 1 where the pointer meets it."""
        at = (x * view.size[0], y * view.size[1])
        _, point = driver.between_frames(lambda: driver.window.painter.pick(*at))
        assert point is not None
        normal = point / (0.85**2, 0.85**2, 1.0)
        return np.asarray(normal / np.linalg.norm(normal))

    def click(x: float, y: float, button: int = 0) -> None:
        driver.context.mouse_move_to_pos(driver.point(x, y))
        driver.context.mouse_click(button)
        driver.frames(3)

    driver.press(Key.u)
    assert session.tool == "upright"
    driver.still()
    driver.picture(folder / "shots" / "upright_1_rings.png")
    down = normal_at(0.6, 0.54)
    click(0.6, 0.54)
    assert np.dot(session.up, -down) > np.cos(np.radians(6)), (session.up, down)
    driver.still()
    driver.picture(folder / "shots" / "upright_2_stands.png")

    # In the capture, which has no depth to read; a miss says so.
    driver.press(Key.mod_ctrl | Key.z)
    assert session.document.up is None
    driver.still()
    session.viewing = replace(session.viewing, mode="capture")
    driver.still()
    click(0.6, 0.54)
    assert np.dot(session.up, -down) > np.cos(np.radians(8)), (session.up, down)
    click(0.02, 0.9)
    assert "Click on the object" in session.message
    session.viewing = replace(session.viewing, mode="solid")

    # From the context menu, with any tool.
    driver.press(Key.v)
    driver.still()
    before, down = session.up, normal_at(0.45, 0.6)
    click(0.45, 0.6, button=1)
    driver.click("//$FOCUSED/Stand on this face")
    driver.frames(3)
    assert session.up != before and np.dot(session.up, -down) > np.cos(np.radians(6))

    # The outermost ring turns the object in the picture; a drag is one step.
    session.jump(0)
    driver.press(Key.u)
    driver.still()
    forward = view.camera().forward
    drag_ring(driver, session.solid.centre)
    assert session.history.cursor == 1 and session.document.up is not None
    assert session.up[2] < np.cos(np.radians(10))
    driver.picture(folder / "shots" / "upright_3_turned.png")
    # Half the way round the melon's top: the same side is still in front, turned about the line of sight.
    assert view.camera().forward @ forward > 0.99
    driver.press(Key.mod_ctrl | Key.z)
    assert session.document.up is None

    # Three numbers.
    driver.click("//Inspector/##up")
    driver.frames(2)
    driver.context.item_input("//$FOCUSED/##up numbers/$$0")
    for value in "30":
        driver.context.key_chars_replace(value)
        driver.press(Key.tab)
    driver.context.key_chars_replace("4")
    driver.picture(folder / "shots" / "upright_4_numbers.png")
    driver.press(Key.enter)
    driver.frames(2)
    assert np.dot(session.up, (0.6, 0.0, 0.8)) > 1 - 1e-6, session.up
    session.jump(0)

    # The handles of a piece, by the same ring.
    driver.press(Key.k)
    driver.drag((0.5, 0.13), (0.5, 0.97))
    driver.press(Key.t)
    piece = session.pieces[0]
    session.selection = frozenset([piece.key])
    driver.still()
    drag_ring(driver, piece.motion.apply(session.solid.points[piece.rows]).mean(0))
    assert session.pieces[0].motion != piece.motion and session.history.entries[-1].name == "Turn"


def drag_ring(driver: Driver, centre: NDArray[np.float64]) -> None:
    """Drags the outermost ring of the handles around a point (3,) to the right, at its top."""
    view = driver.window.viewport
    x, y = project_points(view.camera(), centre[None])[0][0] / view.size
    for distance in np.arange(0.3, 0.0, -0.01):
        driver.context.mouse_move_to_pos(driver.point(float(x), float(y - distance)))
        driver.frames(2)
        if on_handles():
            driver.drag((float(x), float(y - distance)), (float(x) + 0.1, float(y - distance)))
            driver.still()
            return
    raise AssertionError("no ring")
