"""The Python interface: against closed forms, against the commands, and the pages that show it."""

from __future__ import annotations

import ast
import inspect
import json
import re
import runpy
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import fruitninja
from app.render_cli import main as render_command
from engine.io.trained import Meta, load_trained
from fruitninja.solid import Whole
from tests.helpers.solids import Waves, ball, filled_ball, waves
from tests.paths import ROOT
from tests.training.test_train_command import SCENE, make_tiny
from training.events import Reporter
from training.families import COUNTS, Family, Kind
from training.pipeline import run
from training.request import Request

PITCH = 1 / 12
PLANE = (0.35, -0.2, 1.0, 0.1)


@pytest.fixture(scope="module")
def front(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, fruitninja.Solid]]:
    """The folder where the README's lines have run on the sample, with draft made tiny, and the solid they made."""
    place = tmp_path_factory.mktemp("front")
    (place / "sample_scenes").symlink_to(ROOT / "sample_scenes")
    section = (ROOT / "README.md").read_text(encoding="utf-8").split("### From Python")[1]
    match = re.search(r"\n\n((?:    .*\n|\n)+)", section)
    assert match is not None
    with pytest.MonkeyPatch.context() as patch:
        tiny(patch)
        patch.chdir(place)
        names: dict[str, fruitninja.Solid] = {}
        with pytest.warns(UserWarning, match="haze") as said:
            exec(match.group(1).replace("\n    ", "\n").removeprefix("    "), names)
        assert {warning.filename for warning in said} == {"<string>"}, "the caller's line, not one of ours"
        yield place, names["solid"]


@pytest.fixture(scope="module")
def folder(front: tuple[Path, fruitninja.Solid]) -> Path:
    return front[0]


def tiny(patch: pytest.MonkeyPatch) -> None:
    make_tiny(patch)
    few: dict[Kind, int] = {"horizontal": 4, "radial": 3}
    for kind, count in few.items():
        patch.setitem(COUNTS, kind, count)


@pytest.fixture
def solid() -> fruitninja.Solid:
    return fruitninja.Solid(Whole(ball(PITCH), Meta(), Waves(), Path("ball.ply")))


def test_the_lines_of_the_front_page_make_what_the_command_makes(
    front: tuple[Path, fruitninja.Solid], tmp_path: Path
) -> None:
    folder, solid = front
    families = (
        Family("horizontal", 4, (SCENE / "horizontal_1.png",)),
        Family("radial", 3, (SCENE / "radial_1.png",)),
    )
    request = Request(SCENE / "watermelon.ply", families, "draft", (0.0, 0.0, 1.0))
    made = run(request, tmp_path, Reporter(), False, lambda: False)
    truth = load_trained(made)[0]
    for part, other in ((solid.atoms.surface, truth.surface), (solid.atoms.interior, truth.interior)):
        for name, values in vars(part).items():
            assert np.array_equal(values, getattr(other, name)), name
    inside = made.with_name("watermelon.inside.safetensors")
    assert (folder / "melon.inside.safetensors").read_bytes() == inside.read_bytes()
    assert np.asarray(Image.open(folder / "half.png")).std() > 10


def test_pictures_are_those_of_the_command_to_the_bit(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = fruitninja.open(folder / "melon.ply")
    assert opened.inside is not None
    for cut, camera in ((opened.cut(PLANE), []), (opened, ["--camera", "20,60,1.1"])):
        plane = ["--plane", ",".join(map(str, PLANE))] if cut.planes else []
        out = folder / "command.png"
        arguments = ["fruitninja-render", str(folder / "melon.ply"), "-o", str(out), "--size", "160x90"]
        monkeypatch.setattr(sys, "argv", [*arguments, *plane, *camera])
        with pytest.raises(SystemExit) as ended:
            render_command()
        assert not ended.value.code
        view = cut.camera(20, 60, 1.1, (160, 90)) if camera else cut.camera(size=(160, 90))
        assert (cut.render(view) == np.asarray(Image.open(out))).all()


def test_every_example_runs(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("manifold3d", reason="the export extra is not installed")
    scene = [str(SCENE / name) for name in ("watermelon.ply", "horizontal_1.png", "radial_1.png")]
    outputs = {
        "film": "film.webp",
        "profile": "profile.csv",
        "solid_texture": "texture.npy",
        "stack_of_sections": "stack.npy",
        "to_blender": "halves.glb",
        "turntable": "turn",
        "unrolled": "unrolled.png",
        "volumes": None,
    }
    of_captures = {"keep_part", "photographs_to_slices"}
    assert {path.stem for path in (ROOT / "examples").glob("*.py")} == {*outputs} | of_captures
    for name, out in outputs.items():
        out_argument = [] if out is None else [str(tmp_path / out)]
        monkeypatch.setattr(sys, "argv", [name, str(folder / "melon.ply"), *out_argument])
        runpy.run_path(str(ROOT / f"examples/{name}.py"), run_name="__main__")
    monkeypatch.setattr(sys, "argv", ["photographs_to_slices", *scene, str(tmp_path / "slices")])
    with pytest.warns(UserWarning, match="haze"):
        runpy.run_path(str(ROOT / "examples/photographs_to_slices.py"), run_name="__main__")
    monkeypatch.setattr(sys, "argv", ["keep_part", scene[0], str(tmp_path / "part.ply")])
    runpy.run_path(str(ROOT / "examples/keep_part.py"), run_name="__main__")
    assert fruitninja.open(tmp_path / "part.ply").volume > 0
    rind_to_rind = np.loadtxt(tmp_path / "profile.csv", delimiter=",", skiprows=1)
    assert rind_to_rind.shape == (200, 4) and rind_to_rind[100, 1] > rind_to_rind[100, 2] + 0.3  # red in the middle
    assert len(list((tmp_path / "turn").glob("*.png"))) == 12
    unrolled = np.asarray(Image.open(tmp_path / "unrolled.png"), np.float32)
    assert np.abs(unrolled[:, 0] - unrolled[:, -1]).mean() < 8 < unrolled.std()  # it closes on itself
    stack, texture = np.load(tmp_path / "stack.npy"), np.load(tmp_path / "texture.npy")
    assert stack.shape == (16, 128, 128, 4) and 0.1 < (stack[8, ..., 3] > 0).mean() < 0.9
    assert texture.ndim == 4 and texture.shape[3] == 3 and texture.std() > 0.05
    assert Image.open(tmp_path / "film.webp").n_frames == 12  # type: ignore[attr-defined]
    assert (tmp_path / "halves.glb").read_bytes()[:4] == b"glTF"
    assert len(list((tmp_path / "slices").glob("slice_*.png"))) == 3


@pytest.mark.parametrize("name", ["photographs_to_slices", "solid_texture"])
def test_every_notebook_runs(name: str, front: tuple[Path, fruitninja.Solid], monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs cell by cell; the README's solid stands in for the one that the notebook would grow."""
    folder, solid = front
    place = folder / "notebooks"
    place.mkdir(exist_ok=True)
    monkeypatch.chdir(place)
    growing = inspect.signature(fruitninja.grow)

    def grow(*given: object, **named: object) -> fruitninja.Solid:
        growing.bind(*given, **named)
        return solid

    monkeypatch.setattr(fruitninja, "grow", grow)
    solid.save("melon.ply")
    notebook = json.loads((ROOT / f"examples/{name}.ipynb").read_text(encoding="utf-8"))
    assert (notebook["nbformat"], len({cell["id"] for cell in notebook["cells"]})) == (4, len(notebook["cells"]))
    names: dict[str, object] = {}
    pictures = 0
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            *lines, last = ast.parse("".join(cell["source"])).body
            exec(compile(ast.Module(lines, []), name, "exec"), names)
            if isinstance(last, ast.Expr):
                shown = eval(compile(ast.Expression(last.value), name, "eval"), names)
                pictures += isinstance(shown, Image.Image | fruitninja.Solid)
            else:
                exec(compile(ast.Module([last], []), name, "exec"), names)
    assert pictures >= 3


def test_a_run_ends_when_its_listener_raises(tmp_path: Path) -> None:
    stages: list[str] = []

    def stop(stage: str, part: float) -> None:
        assert 0 <= part <= 1
        stages.append(stage)
        if stage == "body":
            raise KeyError("enough")

    threads = torch.get_num_threads()
    with pytest.raises(KeyError, match="enough"):
        fruitninja.grow(
            SCENE / "watermelon.ply", horizontal=SCENE / "horizontal_1.png", detail="draft", out=tmp_path, progress=stop
        )
    assert stages[0] == "load" and stages[-1] == "body"
    assert torch.get_num_threads() == threads and not list(tmp_path.glob("*.*"))


def test_volumes_are_those_of_a_ball_and_add_up() -> None:
    solid = fruitninja.Solid(Whole(filled_ball(PITCH), Meta(), None, Path("ball.ply")))
    whole = solid.volume
    assert whole == pytest.approx(4 / 3 * np.pi * 0.5**3, rel=0.03)
    cap = solid.cut((0, 0, -1, 0.2))  # above z = 0.2: height 0.3
    assert cap.volume / whole == pytest.approx(
        (np.pi * 0.3**2 * (3 * 0.5 - 0.3) / 3) / (4 / 3 * np.pi * 0.5**3), rel=0.03
    )
    pieces = solid.pieces((1, 0.3, 0, 0), (0, 1, 0.4, 0.05), (0, 0, 1, 3))
    assert len(pieces) == 4  # the third plane misses
    assert sum(piece.volume for piece in pieces) == pytest.approx(whole, rel=1e-9)
    assert cap.bounds[0, 2] >= 0.2 and solid.bounds[0, 2] < -0.4


def test_a_section_shows_the_inside_itself(solid: fruitninja.Solid) -> None:
    size, width = 96, 1.4
    face = solid.section((0, 0, 1, 0.03), size, width)
    steps = ((np.arange(size) + 0.5) / size - 0.5) * width
    x, y, _ = solid.bounds.mean(0)
    points = np.stack([*np.meshgrid(x + steps, y - steps), np.full((size, size), -0.03)], -1)
    radius = np.linalg.norm(points, axis=-1)
    deep, off = radius < 0.5 - 3 * PITCH, radius > 0.5 + 2 * PITCH
    assert (face[deep, 3] == 255).all() and (face[off, 3] == 0).all()
    assert np.abs(face[deep, :3] - 255 * waves(points[deep])).max() <= 1
    assert (solid.colours(points[deep], 0.01) == np.clip(waves(points[deep]), 0, 1)).all()
    half = solid.cut((1, 0, 0, 0)).section((0, 0, 1, 0.03), size, width)
    left = points[..., 0] < -0.01
    assert (half[left] == face[left]).all() and not half[points[..., 0] > 0.01].any()


def test_a_capture_is_solid_without_photographs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_tiny(monkeypatch)
    capture = fruitninja.load(SCENE / "watermelon.ply")
    assert capture.means.shape == (len(capture), 3) and len(capture) > 1000 and capture.middle is None
    grey = capture.solidify(detail="draft", up="-z", keep=[fruitninja.Sphere((0.0, 0.0, 0.0), 9.0)])
    assert grey.inside is None and grey.up.tolist() == [0, 0, -1]
    assert grey._repr_png_()[:4] == b"\x89PNG"
    grey.save(tmp_path / "grey.spz")
    again = fruitninja.open(tmp_path / "grey.spz")
    assert len(again.atoms) == len(grey.atoms) and again.volume == pytest.approx(grey.volume, rel=0.01)


def test_what_cannot_be_is_one_line(solid: fruitninja.Solid, tmp_path: Path) -> None:
    scene = SCENE / "watermelon.ply"
    for call, line in (
        (lambda: fruitninja.load(tmp_path / "no.ply"), "no.ply"),
        (lambda: fruitninja.open(scene), "no watermelon.fruitninja.json beside it"),
        (lambda: fruitninja.grow(scene), "no picture of a cut face"),
        (lambda: fruitninja.grow(scene, radial="no.png"), "no.png: no such file"),
        (lambda: fruitninja.grow(scene, radial=scene, detail="fine"), "detail 'fine': unknown"),
        (lambda: fruitninja.grow(scene, radial=scene, up="w"), "up w: give x, y, z"),
        (lambda: fruitninja.grow(scene, radial=scene, up=(1, 2, None)), "up (1, 2, None): give x, y, z"),  # type: ignore[arg-type]
        (lambda: fruitninja.load(scene, seed=-1), "seed -1: give a whole number"),
        (lambda: solid.export(tmp_path / "a.spz", metres=0.1), "a file without a unit"),
        (lambda: solid.export(tmp_path / "a.ply", step=0.1), "Gaussians have their own sizes"),
        (lambda: solid.cut((1, 2, 3)), "give four numbers"),
        (lambda: solid.cut((0, 0, 0, 1)), "not zero"),
        (lambda: solid.colours([[1, 2]]), "points of shape (1, 2)"),
        (lambda: solid.section((0, 0, 1, 0), 0), "size 0x0"),
        (lambda: solid.render(distance=0), "distance 0"),
        (lambda: solid.render(azimuth=float("nan")), "azimuth nan: give an angle"),
        (lambda: solid.html(tmp_path / "a.html", elevation=float("inf")), "elevation inf: give an angle"),
        (lambda: solid.export(tmp_path / "a.zip", inks=["#fff", "#000"]), "ink '#fff': give three whole numbers"),  # type: ignore[list-item]
        (lambda: fruitninja.grow(scene, radial=scene, keep="box:0,0,0,1"), "keep 'b': give shapes"),  # type: ignore[arg-type]
        (lambda: fruitninja.grow(scene, radial=scene, keep=[None], detail="fine"), "detail 'fine': unknown"),
        (lambda: solid.cut((0, 0, 1, 0)).save(tmp_path / "a.ply"), "only a whole object"),
        (lambda: solid.save(tmp_path / "a.glb"), "saved as .ply or .spz"),
        (lambda: solid.export(tmp_path / "a.doc"), "a.doc: an object is saved as"),
    ):
        with pytest.raises(fruitninja.Error) as error:
            call()
        assert line in str(error.value) and "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())
