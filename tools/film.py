"""The README's film, from the sample in draft: a half-opened watermelon turns once, then a plane sweeps through it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from app.model.film.motion import Film, Keyframe
from app.model.film.record import film_record
from engine.io.files import write_json
from engine.scene.plane import Plane

ROOT = Path(__file__).parents[1]
OUT = ROOT / "out/film"
SOLID = OUT / "watermelon/watermelon.ply"
SAMPLE = ROOT / "sample_scenes/watermelon"
NORMAL = (0.35, -0.2, 1.0)
"""Normal of the plane with which `make demo` opens the watermelon."""

OPEN, HIGH, LOW = (Plane.of(NORMAL, offset) for offset in (0.0, -1.06, 0.85))
TURN = 5.0
"""Seconds that the turn takes, and the sweep as well."""


def main() -> None:
    """Writes docs/pictures/film.webp; first trains the sample in draft unless that has been done."""
    if not SOLID.exists():
        program = [str(ROOT / ".venv/bin/fruitninja-train"), str(SAMPLE / "watermelon.ply"), "-o", str(SOLID.parent)]
        pictures = [f"{kind}={SAMPLE / f'{kind}_1.png'}" for kind in ("horizontal", "radial")]
        words = [word for picture in pictures for word in ("--exemplar", picture)]
        subprocess.run([*program, "--up", "z", "--detail", "draft", *words], check=True)
    turn = [Keyframe(TURN * k / 4, -60.0 + 90.0 * k, 32.0, 1.05, (OPEN,)) for k in range(5)]
    swept = ((1.2, HIGH), (3.4, LOW), (TURN, OPEN))
    sweep = [Keyframe(TURN + time, 300.0, 32.0, 1.05, (plane,)) for time, plane in swept]
    keyframes = OUT / "keyframes.json"
    write_json(keyframes, film_record(Film((*turn, *sweep))))
    command = [sys.executable, "-m", "app.render_cli", str(SOLID), "-o", str(ROOT / "docs/pictures/film.webp")]
    subprocess.run([*command, "--film", str(keyframes), "--fps", "12", "--size", "480x400"], cwd=ROOT, check=True)


if __name__ == "__main__":
    main()
