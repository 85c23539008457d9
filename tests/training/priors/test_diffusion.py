"""Stable Diffusion behind the prior's interface, on a tiny model with random weights."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image, ImageDraw

from engine.errors import InputError
from tests.helpers.tiny_diffusion import NATIVE, save_midas, save_tiny
from training.cli import main
from training.families import Family
from training.labels import make_prior
from training.priors.prior import Condition, LatentDenoiser, VolumeSolver
from training.priors.sds import distill, latent_mask
from training.request import Request


@pytest.fixture(scope="module", autouse=True)
def _alone():
    """One thread: more would slow the tiny networks down. No network access: models come from local folders only."""
    threads, connect = torch.get_num_threads(), socket.socket.connect

    def refuse(*_):
        raise AssertionError("asked for the network")

    torch.set_num_threads(1)
    socket.socket.connect = refuse
    yield
    socket.socket.connect = connect
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    for name in ("diffusers", "transformers", "peft"):
        pytest.importorskip(name, reason="the extra 'diffusion' is not installed")
    return save_tiny(tmp_path_factory.mktemp("models") / "tiny")


@pytest.fixture(scope="module")
def prior(tiny):
    from training.priors.diffusion import StableDiffusionPrior

    return StableDiffusionPrior(tiny, "orange", device=torch.device("cpu"))


@pytest.fixture(scope="module")
def picture(tmp_path_factory):
    """A disc with a rim on white, like a photograph of a cut orange."""
    image = Image.new("RGB", (96, 80), "white")
    draw = ImageDraw.Draw(image)
    draw.ellipse((18, 10, 78, 70), fill=(240, 130, 20))
    draw.ellipse((24, 16, 72, 64), fill=(250, 190, 60))
    path = tmp_path_factory.mktemp("pictures") / "cut.png"
    image.save(path)
    return path


def blank(condition):
    """A label before anything is drawn: grey on white."""
    return np.where(condition.inside[..., None], condition.render, np.float32(1))


def asked(height=48, width=48, prompt="", depth=2.0):
    flat = np.zeros((height, width), np.float32)
    y, x = np.mgrid[:height, :width]
    inside = (y - height / 2) ** 2 + (x - width / 2) ** 2 < (0.35 * min(height, width)) ** 2
    grey = np.full((height, width, 3), 0.5, np.float32)
    far = np.where(inside, np.float32(depth), np.float32(np.inf))
    return Condition(Family("horizontal", 1), prompt, inside, flat, flat, flat, flat, far, grey)


def noisy_code(prior, sigma, shape=(48, 48)):
    code = prior.encode(np.full((*shape, 3), 0.5, np.float32))
    return code + np.float32(sigma) * np.random.default_rng(5).standard_normal(code.shape, dtype=np.float32)


@pytest.mark.parametrize("shape", [(48, 48), (50, 70), (33, 17), (200, 131)])
def test_codes_are_of_the_size_the_model_knows(prior, shape):
    assert isinstance(prior, LatentDenoiser)
    assert not isinstance(prior, VolumeSolver)
    label = np.random.default_rng(0).random((*shape, 3), dtype=np.float32)
    code = prior.encode(label)
    assert code.dtype == np.float32
    assert max(code.shape[:2]) == NATIVE // 8 and code.shape[2] == 4
    assert abs(code.shape[0] / code.shape[1] - shape[0] / shape[1]) < 0.15
    back = prior.decode(code, shape)
    assert back.shape == label.shape and back.dtype == np.float32
    assert back.min() >= 0 and back.max() <= 1


def test_noise_of_pure_noise_is_finite_and_the_same_bits(prior):
    for sigma in (0.01, 1.0, 14.0, 80.0):
        code = noisy_code(prior, sigma)
        found = prior.denoise(code, sigma, asked(), np.random.default_rng(0))
        assert found.shape == code.shape and found.dtype == np.float32
        assert np.isfinite(found).all()
        assert (found == prior.denoise(code, sigma, asked(), np.random.default_rng(9))).all()


def test_timesteps_and_input_follow_the_models_schedule(prior):
    """Against DDPM's forward process: x_t = sqrt(a) x + sqrt(1 - a) noise, asked at t."""
    betas = np.linspace(0.00085**0.5, 0.012**0.5, 1000) ** 2
    signal = np.cumprod(1 - betas)
    assert np.allclose(prior.model.sigmas, np.sqrt((1 - signal) / signal), rtol=1e-4)
    step = 617
    sigma = float(prior.model.sigmas[step])
    code = noisy_code(prior, sigma)
    condition = asked(prompt="a cut")
    depth = prior._depth_of(condition)
    depth = torch.nn.functional.interpolate(depth, size=code.shape[:2], mode="bilinear", antialias=True)
    scaled = torch.from_numpy(code).permute(2, 0, 1)[None] * float(np.sqrt(signal[step]))
    with torch.no_grad():
        unet = prior.model.unet
        said = unet(torch.cat([scaled, depth], 1), torch.tensor([step]), prior.model.embed(["a cut"])).sample
        empty = unet(torch.cat([scaled, depth], 1), torch.tensor([step]), prior.model.embed([""])).sample
    said, empty = (x[0].permute(1, 2, 0).numpy() for x in (said, empty))
    guidance = prior.guidance
    try:
        prior.guidance = 1
        assert np.allclose(prior.denoise(code, sigma, condition, np.random.default_rng(0)), said, atol=2e-5)
        prior.guidance = 3
        guided = prior.denoise(code, sigma, condition, np.random.default_rng(0))
    finally:
        prior.guidance = guidance
    assert np.abs(said - empty).max() > 1e-4
    assert np.allclose(guided, empty + 3 * (said - empty), atol=1e-4)


def test_v_prediction_is_turned_into_noise(tiny, prior, tmp_path):
    """The same network, declared to predict v: noise = sqrt(a) v + sqrt(1 - a) x_t."""
    from training.priors.diffusion import StableDiffusionPrior

    other = shutil.copytree(tiny, tmp_path / "v")
    path = other / "scheduler" / "scheduler_config.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"prediction_type": "v_prediction"}))
    v = StableDiffusionPrior(other, "orange", guidance=1, device=torch.device("cpu"))
    plain = StableDiffusionPrior(tiny, "orange", guidance=1, device=torch.device("cpu"))
    sigma = 2.0
    code = noisy_code(prior, sigma)
    said = plain.denoise(code, sigma, asked(), np.random.default_rng(0))
    a = 1 / (1 + sigma**2)
    expected = np.sqrt(a) * said + np.sqrt(1 - a) * np.sqrt(a) * code
    assert np.allclose(v.denoise(code, sigma, asked(), np.random.default_rng(0)), expected, atol=1e-5)


def test_depth_and_words_reach_the_model(tiny, prior, tmp_path):
    from training.priors.diffusion import StableDiffusionPrior
    from training.priors.diffusion.depth import exact_depth

    condition = asked()
    depth = exact_depth(condition.inside, condition.depth)[0, 0].numpy()
    assert (depth[condition.inside] == 1).all() and (depth[~condition.inside] == -1).all()
    sloped = np.where(condition.inside, np.linspace(1, 2, 48, dtype=np.float32), np.inf)
    depth = exact_depth(condition.inside, sloped)[0, 0].numpy()
    nearest = sloped[condition.inside].min()
    assert np.allclose(depth[condition.inside], 2 * nearest / sloped[condition.inside] - 1)

    code = noisy_code(prior, 2.0)

    def said(by, condition):
        return by.denoise(code, 2.0, condition, np.random.default_rng(0))

    here = said(prior, condition)
    smaller = asked()
    smaller.inside[:24] = False
    assert np.abs(said(prior, smaller) - here).max() > 1e-4
    assert np.abs(said(prior, asked(prompt="something else")) - here).max() > 1e-4
    assert (said(prior, asked(prompt="the horizontal cross-sectional view of an orange")) == here).all()
    guess = StableDiffusionPrior(tiny, "orange", midas=save_midas(tmp_path / "midas"), device=torch.device("cpu"))
    both = said(guess, condition)
    assert np.isfinite(both).all()
    assert np.abs(both - here).max() > 1e-4


class GaussianNetwork:
    """Stands in for the network: knows that every number of a code is N(mean, 0.2^2), and nothing of depth and text.

    For clean = N(mean, s^2) and given = sqrt(a) clean + sqrt(1 - a) noise, the mean noise is
    sqrt(1 - a) (given - sqrt(a) mean) / (a s^2 + 1 - a).
    """

    dtype = torch.float32
    spread = 0.2

    def __init__(self, mean, sigmas, prediction, config):
        self.mean, self.prediction, self.config = torch.from_numpy(mean).permute(2, 0, 1)[None], prediction, config
        self.signal = torch.from_numpy(1 / (1 + sigmas**2)).float()

    def __call__(self, given, timestep, text):
        a = self.signal[timestep][:, None, None, None]
        codes = given[:, :4]
        noise = (1 - a).sqrt() * (codes - a.sqrt() * self.mean) / (a * self.spread**2 + 1 - a)
        clean = (codes - (1 - a).sqrt() * noise) / a.sqrt()
        said = noise if self.prediction == "epsilon" else a.sqrt() * noise - (1 - a).sqrt() * clean
        return SimpleNamespace(sample=said)


@pytest.mark.parametrize("prediction", ["epsilon", "v_prediction"])
@pytest.mark.parametrize("step", [1.0, 0.5])
def test_distillation_through_the_door_lowers_its_loss(tiny, prediction, step):
    """Schedule, guidance, both kinds of prediction and the loop together: the label's code ends at the mean."""
    from training.priors.diffusion import StableDiffusionPrior

    prior = StableDiffusionPrior(tiny, device=torch.device("cpu"))
    mean = np.random.default_rng(2).standard_normal((6, 6, 4)).astype(np.float32)
    model = prior.model
    mean = np.pad(mean, ((1, 1), (1, 1), (0, 0)))
    model.unet = GaussianNetwork(mean, model.sigmas, prediction, model.unet.config)
    model.prediction = prediction
    ends = []
    prior.decode = lambda latent, shape: ends.append(latent) or np.zeros((*shape, 3), np.float32)
    condition = asked(64, 64)
    distill(blank(condition), prior, condition, np.random.default_rng(0), step=step)
    free = latent_mask(condition.inside, (8, 8))
    start = prior.encode(blank(condition))
    assert (ends[0][~free] == start[~free]).all()
    assert np.sqrt(np.mean((ends[0] - mean)[free] ** 2)) < 0.15 * np.sqrt(np.mean((start - mean)[free] ** 2))

    def loss(code):
        rng = np.random.default_rng(7)
        total = 0.0
        for sigma in np.geomspace(0.16, 10, 12):
            noise = rng.standard_normal(code.shape, dtype=np.float32)
            found = prior.denoise(code + np.float32(sigma) * noise, float(sigma), condition, rng)
            total += np.mean((found - noise)[free] ** 2)
        return total

    assert loss(ends[0]) < 0.5 * loss(start)


@pytest.mark.parametrize("refine", [False, True])
def test_distillation_stays_in_the_silhouette(prior, refine):
    condition = asked(50, 70)
    start = blank(condition)
    label = distill(start, prior, condition, np.random.default_rng(0), refine=refine)
    assert label.shape == start.shape
    assert (label[~condition.inside] == 1).all()
    assert np.abs(label[condition.inside] - 0.5).max() > 0.01
    assert label.min() >= 0 and label.max() <= 1
    again = distill(start, prior, condition, np.random.default_rng(0), refine=refine)
    assert (again == label).all()


def test_finetuning_learns_the_picture_and_keeps_the_rest(tiny, picture, tmp_path, monkeypatch):
    from training.priors.diffusion import StableDiffusionPrior, finetune
    from training.priors.diffusion.loading import load_model

    # Random weights know nothing yet, so these few steps must have an effect.
    monkeypatch.setattr("training.priors.diffusion.dreambooth.FULL_RATE", 4e-3)
    monkeypatch.setattr("training.priors.diffusion.dreambooth.LORA_RATE", 4e-3)
    cpu = torch.device("cpu")
    for full in (False, True):
        out = tmp_path / f"tuned_{full}"
        steps = 16
        seen: list[Any] = []
        losses = finetune(
            tiny,
            {"horizontal": [picture], "radial": [picture]},
            "orange",
            out,
            full=full,
            steps=steps,
            on_class=seen.append,
            device=cpu,
        )
        assert len(losses) == steps and seen[-1] == 1
        assert sorted(seen) == seen
        before, after = load_model(tiny, half=True, device=cpu), StableDiffusionPrior(out, device=cpu)
        assert after.prompts["radial"] == "the vertical cross-sectional view of a sks orange"
        assert fixed_loss(after, picture) < fixed_loss(StableDiffusionPrior(tiny, device=cpu), picture) * 0.97
        changed = {
            name
            for (name, a), b in zip(before.unet.named_parameters(), after.model.unet.state_dict().values(), strict=True)
            if not torch.equal(a, b)
        }
        assert changed
        if not full:
            assert all(".attn" in name and ".to_" in name for name in changed), changed
        for name in ("vae", "text_encoder"):
            a, b = (getattr(m, name).state_dict() for m in (before, after.model))
            assert all(torch.equal(a[key], b[key]) for key in a)
        assert not list(tmp_path.glob(".*")), "something temporary was left"
        with pytest.raises(InputError, match="is there already"):
            finetune(tiny, {"horizontal": [picture]}, "orange", out, steps=1, device=cpu)


def fixed_loss(prior, picture):
    """Loss of the noise prediction on the picture, over fixed noise levels and noises."""
    with Image.open(picture) as image:
        code = prior.encode(np.asarray(image.convert("RGB"), np.float32)[:, 8:-8] / 255)
    rng = np.random.default_rng(3)
    prior.guidance = 1
    errors = []
    for sigma in np.geomspace(0.3, 10, 8):
        noise = rng.standard_normal(code.shape, dtype=np.float32)
        found = prior.denoise(code + np.float32(sigma) * noise, float(sigma), asked(80, 80), rng)
        errors.append(np.mean((found - noise) ** 2))
    return float(np.mean(errors))


def test_finetuning_twice_gives_the_same_bits(tiny, picture, tmp_path):
    from training.priors.diffusion import finetune

    weights = []
    for name in ("a", "b"):
        finetune(tiny, {"parallel": [picture]}, "loaf", tmp_path / name, steps=2, seed=4, device=torch.device("cpu"))
        weights.append((tmp_path / name / "unet" / "diffusion_pytorch_model.safetensors").read_bytes())
    assert weights[0] == weights[1]


def spoil_unet(folder):
    shutil.rmtree(folder / "unet")
    save_plain = save_tiny(folder.parent / "plain", channels=4)
    shutil.copytree(save_plain / "unet", folder / "unet")


def spoil_weights(folder):
    path = folder / "unet" / "diffusion_pytorch_model.safetensors"
    path.write_bytes(path.read_bytes()[:-1000])


def spoil_one_weight(folder):
    from safetensors.torch import load_file, save_file

    path = folder / "vae" / "diffusion_pytorch_model.safetensors"
    weights = load_file(path)
    del weights["decoder.conv_in.weight"]
    save_file(weights, path, metadata={"format": "pt"})


SPOILS: dict[str, Callable[[Path], object]] = {
    "no such folder": shutil.rmtree,
    "not a depth-conditioned model": spoil_unet,
    "cannot be read": spoil_weights,
    "1 weights are missing": spoil_one_weight,
    "pickled weights": lambda f: (f / "unet" / "diffusion_pytorch_model.safetensors").rename(f / "unet" / "x.bin"),
    "model.bin: pickled weights": lambda f: (f / "text_encoder" / "model.safetensors").rename(
        f / "text_encoder" / "model.bin"
    ),
    "no weights": lambda f: (f / "vae" / "diffusion_pytorch_model.safetensors").unlink(),
    "vocab.json: missing": lambda f: (f / "tokenizer" / "vocab.json").unlink(),
    "not a tokenizer": lambda f: (f / "tokenizer" / "vocab.json").write_text("{"),
    "scheduler_config.json: missing": lambda f: shutil.rmtree(f / "scheduler"),
    "config.json: cannot be read": lambda f: (f / "vae" / "config.json").write_text("{'"),
    "predicts 'sample'": lambda f: (f / "scheduler" / "scheduler_config.json").write_text(
        '{"prediction_type": "sample"}'
    ),
    "no 'prompts'": lambda f: (f / "fruitninja.json").write_text("{}"),
}


@pytest.mark.parametrize("complaint", SPOILS)
def test_folders_that_hold_no_such_model_get_one_line(tiny, tmp_path, complaint):
    from training.priors.diffusion import StableDiffusionPrior

    folder = shutil.copytree(tiny, tmp_path / "model")
    SPOILS[complaint](folder)
    with pytest.raises(InputError, match=complaint) as raised:
        StableDiffusionPrior(folder, device=torch.device("cpu"))
    assert "\n" not in str(raised.value)
    assert str(folder) in str(raised.value)


def test_half_precision_copies_are_found(tiny, tmp_path):
    from training.priors.diffusion import StableDiffusionPrior

    folder = shutil.copytree(tiny, tmp_path / "model")
    for path in folder.glob("*/*.safetensors"):
        path.rename(path.with_suffix(".fp16.safetensors"))
    StableDiffusionPrior(folder, device=torch.device("cpu"))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("finetune --model nowhere -o new --exemplar horizontal=PICTURE", "nowhere: no such folder"),
        ("finetune --model nowhere -o TAKEN --exemplar horizontal=PICTURE", "is there already"),
        ("finetune --model nowhere -o new --exemplar sideways=PICTURE", "no family 'sideways'"),
        ("PICTURE -o new --prior stable-diffusion", "no plane to train"),
        ("PICTURE -o new --exemplar horizontal=PICTURE --model TAKEN", "belong to --prior stable-diffusion"),
    ],
)
def test_commands_say_what_is_wrong(tiny, picture, tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("signal.signal", lambda *_: None)
    words = words.replace("PICTURE", str(picture)).replace("TAKEN", str(tiny))
    monkeypatch.setattr("sys.argv", ["fruitninja-train", *words.split()])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_the_command_finetunes(tiny, picture, tmp_path, monkeypatch, capsys):
    out, events = tmp_path / "new", tmp_path / "events"
    monkeypatch.setattr("signal.signal", lambda *_: None)
    words = f"finetune --model {tiny} -o {out} --exemplar radial={picture} --steps 1 --object pear --events {events}"
    monkeypatch.setattr("sys.argv", ["fruitninja-train", *words.split()])
    with pytest.raises(SystemExit) as ended:
        main()
    assert not ended.value.code
    assert capsys.readouterr().out.strip() == str(out)
    lines = [json.loads(line) for line in events.read_text().splitlines()]
    assert [line["event"] for line in lines if line["event"] != "progress"] == ["stage", "done"]
    request = Request(picture, (), prior="stable-diffusion", model=out)
    from training.priors.diffusion import StableDiffusionPrior

    prior = make_prior(request)
    assert isinstance(prior, StableDiffusionPrior)
    assert prior.prompts["radial"].endswith(" a sks pear")
    assert request.fingerprint() != Request(picture, (), prior="stable-diffusion", model=tiny).fingerprint()


def test_a_missing_package_is_said_in_one_line():
    code = (
        "import sys; sys.modules['diffusers'] = None\n"
        "from engine.errors import InputError\n"
        "try:\n    import training.priors.diffusion\n"
        "except InputError as error:\n    print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip().endswith("pip install fruitninja[diffusion]")
