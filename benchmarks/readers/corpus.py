"""Gives every file of some folders to every reader: none may crash, hang, lie, print, write, or start anything.

    python -m benchmarks.readers.corpus DIR... [--quick] [-o out/corpus.json] [--workers 2]

Each reader runs in a process that is replaced when it dies or hangs; `benchmarks.readers.all_readers` has the readers
and the checks. Writes what was loaded, what was refused with which words, and what failed, as JSON and, beside it, as
a readable table (.md); files are named by folder and path within it, so that the tables can be kept. The folders
should hold files by other people: sdists of Pillow and trimesh, captures, scans. Exit status 1 if anything failed.
"""

from __future__ import annotations

import argparse
import json
import os
import queue
import re
import select
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

from rich.progress import Progress

from benchmarks.readers.all_readers import PICTURE, READERS, SOLID, Verdict
from engine.io.files import atomic, write_json
from engine.io.picture_file import open_picture
from engine.io.trained import Meta, save_trained, sidecar_path
from tests.helpers.solids import scatter

ROOT = Path(__file__).parents[2]

HANG = 30.0
"""Seconds that reading a file may take: users wait no longer to learn that it cannot be opened."""

START = 300.0
"""Seconds until a process has to be ready, on a busy machine with kernels to compile."""

QUICK = 3
"""Files of each kind in each folder that --quick takes."""


class Child:
    """A process that reads files, replaced by a new one when it is lost."""

    def __init__(self, folder: Path, solid: Path) -> None:
        self.work = Path(tempfile.mkdtemp(dir=folder))
        self.solid = solid
        self.process: subprocess.Popen[bytes] | None = None
        self.noise = tempfile.TemporaryFile()  # noqa: SIM115 (for as long as this lives)

    def ask(self, reader: str, path: Path) -> Verdict:
        """The verdict on a file; failed if the process died or hung."""
        if self.process is None:
            self._start()
        assert self.process is not None and self.process.stdin is not None
        begun = time.perf_counter()
        self.process.stdin.write(json.dumps({"reader": reader, "file": str(path)}).encode() + b"\n")
        self.process.stdin.flush()
        answer = self._line(HANG)
        if answer:
            return json.loads(answer)
        code = self.process.poll() if answer is None else self.process.wait()
        words = f"still at work after {HANG:.0f} s" if code is None else f"the process died of {code}"
        self.noise.seek(0)
        said = self.noise.read(2000).decode("utf-8", "replace").strip()
        self.end()
        return {
            "what": "failed",
            "words": words + (f", saying {said[-200:]!r}" if said else ""),
            "seconds": round(time.perf_counter() - begun, 3),
        }

    def end(self) -> None:
        """Kills the process and empties its folder."""
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            assert self.process.stdin is not None and self.process.stdout is not None
            self.process.stdin.close()
            self.process.stdout.close()
            self.process = None
        self.noise.seek(0)
        self.noise.truncate()
        for left in self.work.iterdir():
            left.unlink()

    def _start(self) -> None:
        environment = {
            "PATH": os.environ.get("PATH", ""),
            "HOME": str(self.work.parent / "home"),
            "FRUITNINJA_HOME": str(self.work.parent / "home"),
            "TMPDIR": str(self.work),
            "PYTHONPATH": str(ROOT),
            "OMP_NUM_THREADS": "1",
        }
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-m", "benchmarks.readers.all_readers", str(self.work), str(self.solid)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.noise,
            cwd=self.work,
            env=environment,
            bufsize=0,
        )
        if self._line(START) != b"ready\n":
            self.noise.seek(0)
            sys.exit(f"the readers do not start: {self.noise.read(2000).decode('utf-8', 'replace')}")

    def _line(self, seconds: float) -> bytes | None:
        """The next line, b'' if the process ended, None if it takes too long."""
        assert self.process is not None and self.process.stdout is not None
        line = b""
        until = time.monotonic() + seconds
        while not line.endswith(b"\n"):
            if not select.select([self.process.stdout], [], [], max(until - time.monotonic(), 0))[0]:
                return None
            block = os.read(self.process.stdout.fileno(), 1 << 16)
            if not block:
                return b""
            line += block
        return line


def files_of(folder: Path, quick: bool) -> list[Path]:
    """All files below the folder, sorted; if `quick`, only some of each kind in each folder."""
    found = sorted(path for path in folder.rglob("*") if path.is_file())
    if not quick:
        return found
    taken: Counter[tuple[Path, str]] = Counter()
    few = []
    for path in found:
        kind = path.parent, path.suffix.lower()
        taken[kind] += 1
        if taken[kind] <= QUICK:
            few.append(path)
    return few


def stamps(folder: Path) -> dict[str, tuple[int, int]]:
    """Size and time of everything below a folder: native code could write unseen."""
    found = (path for path in folder.rglob("*") if not path.is_dir())
    return {str(path): (path.lstat().st_size, path.lstat().st_mtime_ns) for path in found}


def sound_solid(folder: Path) -> Path:
    """Saves a small trained object, and beside it a small picture of a cut; returns the object's path."""
    save_trained(folder / SOLID, scatter(3, 4), Meta(source="none"))
    with open_picture(ROOT / "sample_scenes/orange/horizontal_1.png") as picture:
        picture.resize((128, 128)).save(folder / PICTURE)
    return folder / SOLID


def read_all(files: list[Path], workers: int, folder: Path) -> dict[tuple[Path, str], Verdict]:
    """Every reader's verdict on every file."""
    (folder / "solid").mkdir()
    solid = sound_solid(folder / "solid")
    waiting: queue.SimpleQueue[Path] = queue.SimpleQueue()
    for path in files:
        waiting.put(path)
    found: dict[tuple[Path, str], Verdict] = {}
    with Progress(disable=not sys.stderr.isatty()) as progress:
        task = progress.add_task("files", total=len(files))

        def work() -> None:
            child = Child(folder, solid)
            try:
                while True:
                    path = waiting.get_nowait()
                    for reader in READERS:
                        found[path, reader] = child.ask(reader, path)
                    progress.advance(task)
            except queue.Empty:
                pass
            finally:
                child.end()

        threads = [threading.Thread(target=work) for _ in range(workers)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    return found


def shape(words: str, path: Path) -> str:
    """The message without file names and numbers, so that equal refusals of many files count as one."""
    for name in (str(path), str(path.parent), sidecar_path(path).name):
        words = words.replace(name, "FILE")
    words = re.sub(r"^\S*/(solid|training|a|job)\.[\w.]+", "FILE", words)
    words = re.sub(r"'[^']*'", "'...'", words)
    return re.sub(r"\d[\d,.]*", "N", words)[:400]


def record_of(folders: list[Path], found: dict[tuple[Path, str], Verdict], changed: list[str]) -> dict[str, Any]:
    """The table as plain data, without paths of this machine."""
    place = {path: (f, str(path.relative_to(f))) for f in folders for path, _ in found if path.is_relative_to(f)}

    def named(path: Path) -> str:
        folder, rest = place[path]
        return f"{folder.name}/{rest}"

    def plain(words: str, path: Path) -> str:
        words = words.replace(str(path), named(path)).replace(str(path.parent), str(Path(named(path)).parent))
        return re.sub(r"(?<![\w.])/[\w./+-]*/", ".../", words)

    readers: dict[str, Any] = {}
    refusals: dict[tuple[str, str], list[Path]] = defaultdict(list)
    for name in READERS:
        mine = {path: verdict for (path, reader), verdict in found.items() if reader == name}
        counts = Counter(verdict["what"] for verdict in mine.values())
        slowest = max(mine, key=lambda path: mine[path]["seconds"])
        readers[name] = {
            **{what: counts[what] for what in ("loaded", "refused", "failed")},
            "slowest_seconds": mine[slowest]["seconds"],
            "slowest": named(slowest),
        }
        for path, verdict in mine.items():
            if verdict["what"] == "refused":
                refusals[name, shape(verdict["words"], path)].append(path)
    failures = [
        {"file": named(path), "reader": reader, "words": plain(verdict["words"], path)}
        for (path, reader), verdict in sorted(found.items())
        if verdict["what"] == "failed"
    ]
    failures += [{"file": name, "reader": "", "words": "another file than before the run"} for name in changed]
    loaded: dict[str, list[str]] = defaultdict(list)
    for (path, reader), verdict in sorted(found.items()):
        if verdict["what"] == "loaded" and reader not in QUIET:
            loaded[reader].append(named(path))
    return {
        "folders": {folder.name: sum(place[p][0] == folder for p, r in found if r == "scene") for folder in folders},
        "files": len({path for path, _ in found}),
        "readings": len(found),
        "failed": len(failures),
        "failures": failures,
        "readers": readers,
        "refusals": [
            {"reader": reader, "words": words, "files": len(paths), "example": named(sorted(paths)[0])}
            for (reader, words), paths in sorted(refusals.items(), key=lambda item: (item[0][0], -len(item[1])))
        ],
        "loaded": loaded,
    }


QUIET = ("settings", "job", "autosave", "batch result")
"""Readers that refuse nothing: that they loaded a file says little."""


def table(record: dict[str, Any]) -> str:
    """The record as Markdown."""
    folders = ", ".join(f"{name} ({count})" for name, count in record["folders"].items())
    lines = ["# Files of other people's making, each through every reader", ""]
    lines += [
        f"{record['files']} files of {folders}; {record['readings']} readings, {record['failed']} of them failed.",
        "",
    ]
    lines += ["| reader | loaded | refused | failed | slowest s |", "|---|---|---|---|---|"]
    for name, row in record["readers"].items():
        lines.append(
            f"| {name} | {row['loaded']} | {row['refused']} | {row['failed']} | {row['slowest_seconds']:.1f} |"
        )
    if record["failures"]:
        lines += ["", "## Failed", "", "| file | reader | what |", "|---|---|---|"]
        lines += [f"| {cell(f['file'])} | {f['reader']} | {cell(f['words'])} |" for f in record["failures"]]
    lines += ["", "## Refused, in which words", "", "| reader | words | files | such as |", "|---|---|---|---|"]
    for row in record["refusals"]:
        lines.append(f"| {row['reader']} | {cell(row['words'])} | {row['files']} | {cell(row['example'])} |")
    return "\n".join(lines) + "\n"


def cell(text: str) -> str:
    """The text for a table cell: bars escaped, newlines replaced by spaces."""
    return text.replace("|", "\\|").replace("\n", " ")


def main(arguments: list[str] | None = None) -> int:
    """Reads all files and writes the table; returns 1 if anything failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "folders", nargs="+", type=Path, metavar="DIR", help="folders of files of other people's making"
    )
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "out/corpus.json", metavar="FILE.json")
    parser.add_argument("--quick", action="store_true", help=f"at most {QUICK} files of each kind in each folder")
    parser.add_argument("--workers", type=int, default=2, help="processes that read")
    options = parser.parse_args(arguments)
    folders = [folder.resolve() for folder in options.folders]
    for folder in folders:
        if not folder.is_dir():
            parser.error(f"{folder}: no such folder")
    if len({folder.name for folder in folders}) < len(folders):
        parser.error("two folders have the same name, by which the table tells them apart")
    before = [stamps(folder) for folder in folders]
    files = [path for folder in folders for path in files_of(folder, options.quick)]
    if not files:
        parser.error("there is no file in these folders")
    with tempfile.TemporaryDirectory() as folder:
        found = read_all(files, options.workers, Path(folder))
    now = [stamps(folder) for folder in folders]
    changed = sorted({name for a, b in zip(before, now, strict=True) for name, _ in a.items() ^ b.items()})
    record = record_of(folders, found, [Path(name).name for name in changed])
    write_json(options.out, record)
    with atomic(options.out.with_suffix(".md")) as temporary:
        temporary.write_text(table(record), encoding="utf-8")
    for failure in record["failures"]:
        print(f"{failure['file']}: {failure['reader']}: {failure['words']}", file=sys.stderr)
    print(f"{record['files']} files, {record['readings']} readings, {record['failed']} failed: {options.out}")
    return 1 if record["failed"] else 0


if __name__ == "__main__":
    sys.exit(main())
