"""Request files: every field survives, anything else is refused in one line, and the command runs one."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from engine.errors import InputError
from engine.isolate.selection import Box, Detected, Step, keep_only
from engine.scene.plane import Plane
from tests.paths import SAMPLES
from training import cli
from training.events import Reporter
from training.faces.marks import Marks
from training.families import Family
from training.pipeline import run
from training.request import Request, read_request


def full(folder: Path) -> Request:
    """A request in which no field has its default value."""
    marks = ((folder / "b é.png", Marks(((0.1, 0.2), (0.9, 1 / 3), (0.5, 1.0)), (0.5, 1 / 3))),)
    families = (
        Family("horizontal", 7, (folder / "a.png", folder / "b é.png"), "a slice", span=(0.1, 2 / 3), marks=marks),
        Family("parallel", 12, (folder / "c.png",), "Käse", (0.6, 0.0, 0.8)),
        Family("custom", 2, custom=(Plane.of((1, 2, 3), 0.1), Plane.of((0, 0, -1), 1e-17))),
    )
    folders = folder / "model", folder / "midas"
    up = (0.0, -0.6, 0.8)
    isolation = (keep_only(Box((-1, -1, -1), (1, 1, 1 / 3))), (Step("add", Detected("floor")), Step("grow")))
    return Request(
        folder / "melon.ply",
        families,
        "high",
        up,
        2**53,
        50,
        "stable-diffusion",
        *folders,
        "rye bread",
        isolation,
        True,
        True,
    )


def written(request: Request, folder: Path) -> Path:
    path = folder / "request.json"
    path.write_text(request.to_json(), encoding="utf-8")
    return path


def test_every_field_of_a_request_survives_its_file(tmp_path: Path) -> None:
    request = full(tmp_path)
    default = Request(request.scene, (Family("radial", 3, (tmp_path / "a.png",)),))
    for given in (request, default):
        assert read_request(written(given, tmp_path)) == given
    assert all(getattr(request, name) != getattr(default, name) for name in vars(request) if name != "scene")


def test_the_form_of_the_result_makes_no_other_run(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(b"ply")
    standard = Request(tmp_path / "a.ply", (Family("radial", 3),))
    compact = replace(standard, compact=True)
    assert (standard.result_name, compact.result_name) == ("a.ply", "a.spz")
    assert standard.fingerprint() == compact.fingerprint() != replace(compact, seed=1).fingerprint()


def test_an_axis_of_another_picture_makes_another_run(tmp_path: Path) -> None:
    names = "horizontal.png", "radial.png"
    for name in ("a.ply", *names):
        (tmp_path / name).write_bytes(name.encode())
    request = Request(
        tmp_path / "a.ply",
        tuple(Family(Path(n).stem, 3, (tmp_path / n,)) for n in names),  # type: ignore[arg-type]
    )
    (tmp_path / "horizontal.axis.json").write_text("[0, 0]")
    before = request.fingerprint()
    (tmp_path / "horizontal.axis.json").rename(tmp_path / "radial.axis.json")
    assert len(request.files) == 4 and request.fingerprint() != before
    (tmp_path / "radial.png").unlink()
    with pytest.raises(InputError, match="no such file"):
        request.fingerprint()


def test_a_relative_request_is_written_with_absolute_paths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    request = Request(Path("melon.ply"), (Family("radial", 3, (Path("a.png"),)),))
    assert read_request(written(request, tmp_path)).files == [tmp_path / "melon.ply", tmp_path / "a.png"]


BREAK: dict[str, Callable[[dict], object]] = {
    "version": lambda r: r.update(fruitninja_request=6),
    "no version": lambda r: r.pop("fruitninja_request"),
    "version is a flag": lambda r: r.update(fruitninja_request=True),
    "unknown field": lambda r: r.update(command="rm"),
    "missing field": lambda r: r.pop("midas"),
    "scene is null": lambda r: r.update(scene=None),
    "scene is relative": lambda r: r.update(scene="melon.ply"),
    "nul in a path": lambda r: r.update(scene="/a\0b"),
    "no family": lambda r: r.update(families=[]),
    "family twice": lambda r: r["families"].append(r["families"][0]),
    "family is text": lambda r: r.update(families=["horizontal:40"]),
    "no plane": lambda r: r["families"][0].update(count=0),
    "too many planes": lambda r: r["families"][0].update(count=10**6),
    "kind": lambda r: r["families"][0].update(kind="oblique"),
    "picture is relative": lambda r: r["families"][0].update(exemplars=["a.png"]),
    "range": lambda r: r["families"][0].update(range=[0.5, 0.1]),
    "normal": lambda r: r["families"][2].update(planes=[[2, 0, 0, 0]]),
    "axis": lambda r: r["families"][1].update(axis=[0, 0, 2]),
    "detail": lambda r: r.update(detail="extreme"),
    "up": lambda r: r.update(up=[0, 0]),
    "up is no direction": lambda r: r.update(up=[0, 0, 0]),
    "seed": lambda r: r.update(seed=-1),
    "seed is a fraction": lambda r: r.update(seed=1.5),
    "iterations": lambda r: r.update(iterations=-1),
    "prior": lambda r: r.update(prior="oracle"),
    "model without diffusion": lambda r: r.update(prior="exemplar"),
    "thing": lambda r: r.update(thing=3),
    "isolation": lambda r: r["isolation"][0][0].update(shape="cone"),
    "no picture": lambda r: r.update(
        prior="exemplar", model=None, midas=None, families=[dict(r["families"][0], exemplars=[])]
    ),
}


@pytest.mark.parametrize("name", BREAK)
def test_a_broken_request_is_refused_in_one_line(tmp_path: Path, name: str) -> None:
    path = written(full(tmp_path), tmp_path)
    record = json.loads(path.read_text(encoding="utf-8"))
    BREAK[name](record)
    path.write_text(json.dumps(record), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_request(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", '{"fruitninja_request": NaN}', "[" * 100_000, "x" * (2 << 20)])
def test_what_is_no_request_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "request.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"not a request|far too large"):
        read_request(path)


@pytest.mark.parametrize(
    ("more", "complaint"),
    [
        (["--detail", "draft"], "leave out --detail"),
        (["--seed", "0"], "leave out --seed"),
        (["--exemplar", "radial=a.png"], "leave out --exemplar"),
        (["melon.ply"], "leave out the scene"),
        ([], "a.png: no such file"),
    ],
)
def test_the_command_takes_a_request_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], more: list[str], complaint: str
) -> None:
    scene = SAMPLES / "watermelon/watermelon.ply"
    path = written(Request(scene, (Family("radial", 3, (tmp_path / "a.png",)),)), tmp_path)
    out = tmp_path / "out"
    words = ["fruitninja-train", "--request", str(path), "-o", str(out), "--resume", "--events", "-", *more]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2 and complaint in capsys.readouterr().err
    assert not out.exists()


def test_the_command_asks_for_a_compact_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Request] = []

    def pretend(request: Request, out: Path, *_: object) -> Path:
        asked.append(request)
        return out / request.result_name

    monkeypatch.setattr("training.pipeline.run", pretend)
    scene, picture = SAMPLES / "bread/bread.ply", SAMPLES / "bread/parallel_1.png"
    words = ["fruitninja-train", str(scene), "-o", str(tmp_path), "--exemplar", f"parallel={picture}"]
    for more in ([], ["--compact"]):
        monkeypatch.setattr(sys, "argv", [*words, *more])
        with pytest.raises(SystemExit, match=r"^0$"):
            cli.main()
    assert [request.result_name for request in asked] == ["bread.ply", "bread.spz"]


def test_a_result_replaces_no_file_of_the_user(tmp_path: Path) -> None:
    (tmp_path / "melon.spz").write_bytes(b"the capture")
    (tmp_path / "melon.ply").write_bytes(b"what it was made from")
    request = Request(tmp_path / "melon.spz", (Family("radial", 3),))
    with pytest.raises(InputError, match="is in the way"):
        run(request, tmp_path, Reporter.open(None), False, lambda: False)
    assert (tmp_path / "melon.ply").read_bytes() == b"what it was made from"


def test_the_same_files_elsewhere_are_the_same_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for folder in (tmp_path / "here", tmp_path / "there"):
        folder.mkdir()
        for name in ("melon.ply", "cut.png", "other.png"):
            (folder / name).write_bytes(name.encode())
    monkeypatch.chdir(tmp_path / "here")
    prints = [
        Request(folder / "melon.ply", (Family("radial", 3, (folder / picture,)),)).fingerprint()
        for folder in (Path(), tmp_path / "here", tmp_path / "there")
        for picture in ("cut.png", "other.png")
    ]
    assert prints[::2] == prints[:1] * 3 and prints[1::2] == prints[1:2] * 3 and prints[0] != prints[1]


@pytest.mark.parametrize("compact", [False, True])
def test_a_result_never_replaces_its_capture(tmp_path: Path, compact: bool) -> None:
    scene = tmp_path / ("a.spz" if compact else "a.ply")
    scene.write_bytes(b"the capture")
    request = Request(scene, (Family("radial", 3),), compact=compact)
    with pytest.raises(InputError, match="would replace the capture itself"):
        run(request, tmp_path, Reporter.open(None), False, lambda: False)
    assert scene.read_bytes() == b"the capture"
