"""Stands in for `fruitninja-train` in tests of the job: emits the same events, for a second or for N steps."""

from __future__ import annotations

import json
import signal
import sys
import time
from pathlib import Path


def main() -> None:
    """python app_stub_trainer.py [--steps N] [--die] [--paint ATOMS] SCENE -o OUT --events FILE [--resume]"""
    words = sys.argv[1:]
    out, events = Path(words[words.index("-o") + 1]), Path(words[words.index("--events") + 1])
    steps = int(words[words.index("--steps") + 1]) if "--steps" in words else 5
    state = out / "checkpoint.txt"
    first = int(state.read_text()) if "--resume" in words and state.exists() else 0
    asked: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: asked.append(number))

    def emit(event: str, **facts: object) -> None:
        with events.open("a", encoding="utf-8") as file:
            print(json.dumps({"event": event, "seconds": time.perf_counter(), **facts}), file=file, flush=True)

    emit("stage", stage="load", title="Reading the scene")
    emit("warning", message="3 rows were dropped")
    emit("stage", stage="train", title="Training")
    if "--paint" in words:
        paint(out, int(words[words.index("--paint") + 1]))
    for index in range(first, steps):
        if asked:
            state.write_text(str(index))
            print("stopped", file=sys.stderr)
            sys.exit(143)
        losses = {"section": 1 / (index + 1), "surface": 0.5}
        emit(
            "progress", stage="train", part=(index + 1) / steps, iteration=index + 1, iterations=steps,
            losses=losses,
        )  # fmt: skip
        if "--die" in words and index == 2 and not first:
            state.write_text(str(index))
            sys.exit("MemoryError: the machine has no memory left")
        time.sleep(0.02)
    emit("previews", paths=[str(out / "label.png")])
    emit("done", scene=str(out / "melon.ply"), sheet=str(out / "cuts.png"), report=str(out / "report.json"))


def paint(out: Path, count: int) -> None:
    """Leaves a checkpoint whose whole inside is red, and a picture of a label."""
    import numpy as np
    from PIL import Image
    from safetensors.numpy import save_file

    (out / "checkpoint").mkdir(exist_ok=True)
    red = np.tile(np.array([0.9, 0.1, 0.1], np.float32), (count, 1))
    save_file({"rgb": red}, out / "checkpoint" / "new.safetensors")
    (out / "checkpoint" / "new.safetensors").replace(out / "checkpoint" / "labels.safetensors")
    Image.new("RGB", (64, 32), (230, 30, 30)).save(out / "label.png")


if __name__ == "__main__":
    main()
