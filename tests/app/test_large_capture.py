"""A part of a large capture is shown before the whole is."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from app.jobs import coarse_picture as module
from app.jobs.coarse_picture import coarse_picture
from app.model.autosave import Autosave
from app.model.document import Document
from app.model.project import Viewing
from app.session.session import Session
from engine.io.load import load
from engine.io.splats.ply import write_ply
from tests.engine.scene.test_gather import painted


def test_a_part_is_enlarged_until_it_covers_what_all_cover(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = painted(20_000)
    write_ply(tmp_path / "ball.ply", whole)
    assert coarse_picture(tmp_path / "ball.ply") is None  # so small a file is read in one go
    monkeypatch.setattr(module, "LEAST_FILE", 0)
    monkeypatch.setattr(module, "MOST", 5000)
    part = coarse_picture(tmp_path / "ball.ply")
    assert part is not None and len(part.gaussians) == 5000
    area = [float((g.scales[:, 0] * g.scales[:, 1]).sum()) for g in (part.gaussians, whole)]
    assert 0.5 < area[0] / area[1] < 2
    assert np.array_equal(part.gaussians.means, load(tmp_path / "ball.ply").gaussians.means[::4])
    assert coarse_picture(tmp_path / "nowhere.ply") is None


@pytest.mark.slow
def test_the_window_shows_a_part_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FRUITNINJA_HOME", str(tmp_path / "home"))
    path = tmp_path / "ball.ply"
    write_ply(path, painted(300_000))
    assert path.stat().st_size > module.LEAST_FILE
    session = Session(autosave=Autosave(tmp_path))
    session.files.open_document(Document(scene=path), Viewing())
    shown: list[tuple[int, float]] = []
    end = time.monotonic() + 120
    while session.object is None or session.object.capture is None:
        assert time.monotonic() < end and not session.error, session.error
        session.tick()
        if session.shown_capture is not None and not session.isolation.available:
            shown.append((len(session.shown_capture), session.solid.radius))
        time.sleep(0.01)
    session.scene.cancel()
    assert shown and module.MOST / 2 < shown[0][0] <= module.MOST
    assert session.shown_capture is not None and len(session.shown_capture) == 300_000
    assert session.object.coarse is None
    assert shown[0][1] == pytest.approx(session.solid.radius, rel=0.02)  # so that the view does not have to change
