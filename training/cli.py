"""`fruitninja-train`: gives one capture an inside, or fine-tunes a diffusion model."""

from __future__ import annotations

import math
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated, cast, get_args

import typer

from engine.command import Stop, Stopped, parse_numbers, print_result, run_command
from engine.errors import InputError
from engine.io.fields import LARGEST_INTEGER
from engine.io.files import locked_folder
from engine.io.load import load
from engine.io.picture_file import PICTURE_SUFFIXES
from engine.scene.plane import Plane
from training.events import Reporter
from training.faces.marks import is_mask
from training.families import COUNTS, Family, Kind
from training.isolation_options import parse_body, parse_isolation, select_bodies
from training.request import Interrupted, PriorName, Request, read_request
from training.settings import DetailName

__all__ = ["main", "parse_axis", "parse_families"]

CLASS_PART = 0.5
"""Fraction of a fine-tuning's time that it spends drawing pictures of the class, before its first step."""

BESIDE_REQUEST = ("request", "out", "events", "resume")
"""Options that --request may be combined with: they do not decide the result."""

AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


def train(
    context: typer.Context,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the result.")],
    scene: Annotated[
        Path | None,
        typer.Argument(help="A capture (.ply, .splat, .spz, .sog, .ksplat, .glb) or a textured mesh (.obj, .glb)."),
    ] = None,
    exemplar: Annotated[
        list[str] | None,
        typer.Option(help="A picture of a cut face, or a folder of them: horizontal=A.png, radial=B.jpg, parallel=C/."),
    ] = None,
    same: Annotated[
        bool, typer.Option("--same", help="The pictures are of one and the same thing; believe them where they meet.")
    ] = False,
    family: Annotated[
        list[str] | None,
        typer.Option(
            help="Planes to train: horizontal:40, radial:30, parallel:60[:x], custom:a,b,c,d. "
            "A range at the end, as in horizontal:40:0.2..0.8, keeps to that part of the whole."
        ),
    ] = None,
    prompt: Annotated[
        list[str] | None, typer.Option(help="Words for a family, for priors that read: radial='a halved melon'.")
    ] = None,
    up: Annotated[
        str | None, typer.Option(help="Up axis of the scene: x, y, z, -x, -y, -z. Detected if not given.")
    ] = None,
    keep: Annotated[
        list[str] | None,
        typer.Option(
            help="Only what is in it is the object: box:x0,y0,z0,x1,y1,z1, sphere:x,y,z,radius, or plane:a,b,c,d "
            "for where a x + b y + c z + d is negative. Again for more."
        ),
    ] = None,
    remove: Annotated[list[str] | None, typer.Option(help="What is in it is no part of the object; as --keep.")] = None,
    no_surroundings: Annotated[
        bool,
        typer.Option("--no-surroundings", help="Leave out the room or view around the object, if it shows any."),
    ] = False,
    no_floor: Annotated[
        bool, typer.Option("--no-floor", help="Leave out the table or mat under the object, if there is one.")
    ] = False,
    body: Annotated[
        str | None,
        typer.Option(
            help="Which of several separate bodies is the object: 1, the largest, 2, ... or all, each in a folder of "
            "its own in the result's: 1, 2, ..."
        ),
    ] = None,
    detail: Annotated[str, typer.Option(help="draft, standard or high.")] = "standard",
    prior: Annotated[str, typer.Option(help="What draws the inside: exemplar or stable-diffusion.")] = "exemplar",
    model: Annotated[Path | None, typer.Option(help="Local folder of a Stable Diffusion depth model.")] = None,
    midas: Annotated[
        Path | None, typer.Option(help="Local folder of a depth estimator, used in addition to the exact depth.")
    ] = None,
    thing: Annotated[
        str | None, typer.Option("--object", help="What the object is, for priors that read: watermelon.")
    ] = None,
    iterations: Annotated[
        int | None,
        typer.Option(min=0, help="Most training iterations. Unless given, none where pictures tell all colours."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, max=LARGEST_INTEGER, help="The same seed gives the same result.")] = 0,
    compact: Annotated[
        bool, typer.Option("--compact", help="The result as .spz, a tenth of a .ply's size, in place of the .ply.")
    ] = False,
    request: Annotated[
        Path | None,
        typer.Option(help="A request.json, as the window writes it: the scene and all options above, in their place."),
    ] = None,
    events: Annotated[
        str | None, typer.Option(help="One JSON object a line, to a file or to standard output (-).")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the last checkpoint in the folder.")] = False,
) -> None:
    """Give a hollow capture an inside, from a few pictures of cut faces."""
    stop = Stop()
    if request is not None:
        refuse_options_beside_request(context)
        requested = read_request(request)
        for path in requested.files:
            if not path.is_file():
                raise InputError(f"{path}: no such file (named by {request})")
    else:
        requested = request_from_options(
            scene, exemplar or [], family or [], prompt or [], up, detail, prior, model, midas, thing, iterations, seed
        )
        isolation = parse_isolation(keep or [], remove or [], no_floor, no_surroundings)
        requested = replace(requested, isolation=isolation, same=same, compact=compact)
    runs = {out: requested} if body is None else runs_of_bodies(requested, parse_body(body), out)
    from training.pipeline import run  # imports torch, for which --help and a mistyped option need not wait

    reporter = Reporter.open(events)
    stop.listen()
    with reporter, locked_folder(out):
        try:
            results = []
            for folder, one in runs.items():
                reporter.timings.clear()
                results.append(run(one, folder, reporter, resume, stop.requested))
        except Interrupted as interrupted:
            message = f"stopped; go on with the same command and --resume ({interrupted})"
            raise Stopped(stop.number, message) from interrupted
    if events != "-":
        for result in results:
            print_result(f"{result}\n{result.with_name('cuts.png')}\n{result.with_name('report.json')}")


def runs_of_bodies(request: Request, body: int | None, out: Path) -> dict[Path, Request]:
    """The requests for one body of the scene, or for each if `body` is None, by the folder of the result."""
    gaussians = load(request.scene, request.seed).gaussians
    isolations = select_bodies(gaussians, request.isolation, body, request.scene.name)
    folders = {number: out / str(number) if body is None else out for number in isolations}
    return {folders[number]: replace(request, isolation=isolation) for number, isolation in isolations.items()}


def refuse_options_beside_request(context: typer.Context) -> None:
    """Raises InputError if an option is given that the --request already decides."""
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name or "")
        if source is not None and source.name != "DEFAULT" and parameter.name not in BESIDE_REQUEST:
            name = parameter.opts[0] if parameter.opts[0].startswith("-") else "the scene"
            raise InputError(f"--request holds everything that decides the result; leave out {name}")


def request_from_options(
    scene: Path | None,
    exemplars: list[str],
    families: list[str],
    prompts: list[str],
    up: str | None,
    detail: str,
    prior: str,
    model: Path | None,
    midas: Path | None,
    thing: str | None,
    iterations: int | None,
    seed: int,
) -> Request:
    """The request that the options describe. Raises InputError for invalid or contradictory options."""
    if scene is None:
        raise InputError("no scene; give a capture or a mesh, or a --request")
    if not scene.is_file():
        raise InputError(f"{scene}: no such file")
    if detail not in get_args(DetailName):
        raise InputError(f"--detail {detail}: unknown; choose {', '.join(get_args(DetailName))}")
    if prior not in get_args(PriorName):
        raise InputError(f"--prior {prior}: unknown; choose {', '.join(get_args(PriorName))}")
    reads = prior == "stable-diffusion"
    if not reads and (model or midas):
        raise InputError("--model and --midas belong to --prior stable-diffusion; add it, or leave them out")
    return Request(
        scene=scene,
        families=parse_families(exemplars, families, prompts, pictures_needed=not reads),
        detail=cast(DetailName, detail),
        up=None if up is None else parse_axis(up, "--up"),
        seed=seed,
        iterations=iterations,
        prior=cast(PriorName, prior),
        model=model,
        midas=midas,
        thing=thing,
    )


def finetune(
    model: Annotated[Path, typer.Option(help="Local folder of a Stable Diffusion depth model.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the new model.")],
    exemplar: Annotated[list[str], typer.Option(help="A picture of a cut face: horizontal=A.png, radial=B.jpg.")],
    thing: Annotated[str, typer.Option("--object", help="What the pictures show: watermelon.")] = "object",
    full: Annotated[bool, typer.Option("--full", help="Train every weight of the network, not LoRA's few.")] = False,
    steps: Annotated[int | None, typer.Option(min=1, help="Training steps.")] = None,
    seed: Annotated[int, typer.Option(min=0, max=LARGEST_INTEGER, help="The same seed gives the same result.")] = 0,
    events: Annotated[
        str | None, typer.Option(help="One JSON object a line, to a file or to standard output (-).")
    ] = None,
) -> None:
    """Teach a Stable Diffusion depth model the look of one object; the result is a --model for training."""
    from training.priors import diffusion  # an extra, and slow to import

    steps = diffusion.STEPS if steps is None else steps
    with Reporter.open(events) as reporter:
        with reporter.stage("finetune") as stage:
            diffusion.finetune(
                model,
                parse_pictures(exemplar),
                thing,
                out,
                full,
                steps,
                seed,
                on_class=lambda part: stage.progress(CLASS_PART * part, "drawing the class"),
                on_step=lambda step, loss: stage.progress(
                    CLASS_PART + (1 - CLASS_PART) * step / steps,
                    f"{step}/{steps}  loss {loss:.4f}",
                    iteration=step,
                    iterations=steps,
                    losses={"pictures": loss},
                ),
            )
        reporter.emit("done", model=out)
    if events != "-":
        print_result(str(out))


def parse_axis(text: str, option: str) -> tuple[float, float, float]:
    """Unit vector of an axis given as a letter with an optional sign, or as three numbers with commas."""
    sign = -1.0 if text.startswith("-") else 1.0
    letter = text.lstrip("+-")
    if letter in AXES:
        x, y, z = (sign * value for value in AXES[letter])
        return x, y, z
    numbers = parse_numbers(text, 3, f"{option} {text}: give x, y, z, -x, -y, -z or three numbers a,b,c")
    if not any(numbers):
        raise InputError(f"{option} {text}: an axis needs a direction; give a,b,c that are not all zero")
    size = max(map(abs, numbers))  # divide by it first: the square of 1e200 overflows
    length = math.hypot(*(number / size for number in numbers))
    x, y, z = (number / size / length for number in numbers)
    return x, y, z


def parse_families(
    exemplars: list[str], families: list[str], prompts: list[str], pictures_needed: bool = True
) -> tuple[Family, ...]:
    """Families of planes from command-line options, in the order of `Kind`.

    Families without a --family get the paper's number of planes. Raises InputError for an option that cannot be parsed,
    for pictures of a family without planes, and if there is no family, or no picture although one is needed.
    """
    pictures = parse_pictures(exemplars)
    texts = dict(parse_pair(text, "--prompt") for text in prompts)
    counts: dict[Kind, int] = {}
    spans: dict[Kind, tuple[float, float]] = {}
    axis: tuple[float, float, float] | None = None
    custom: list[Plane] = []
    for text in families:
        name, *parts = text.split(":")
        kind = parse_kind(name, f"--family {text}")
        if kind != "custom" and kind in counts:
            raise InputError(f"--family {text}: {kind} is given twice; give it once")
        if kind == "custom":
            complaint = f"--family {text}: give a plane as custom:a,b,c,d"
            a, b, c, d = parse_numbers(parts[0] if len(parts) == 1 else "", 4, complaint)
            custom.append(Plane.of((a, b, c), d))
            counts[kind] = len(custom)
            continue
        if len(parts) > 1 and ".." in parts[-1]:
            spans[kind] = parse_span(parts.pop(), f"--family {text}")
        if len(parts) > (2 if kind == "parallel" else 1) or not (
            parts and re.fullmatch(r"0*[1-9][0-9]{0,8}", parts[0])
        ):
            raise InputError(f"--family {text}: give a number of planes above zero, as in {kind}:{COUNTS[kind]}")
        counts[kind] = int(parts[0])
        if len(parts) == 2:
            axis = parse_axis(parts[1], "--family parallel")
    if not families:
        counts = {kind: COUNTS[kind] for kind in [*pictures, *texts]}
    for kind in [*pictures, *texts]:
        if not counts.get(kind):
            raise InputError(
                f"{kind}: pictures or words but no planes; add --family {kind}:{COUNTS[kind] or 'a,b,c,d'}"
            )
    if pictures_needed and not pictures:
        raise InputError("no picture of a cut face; give at least one, as in --exemplar horizontal=cut.png")
    if not counts:
        raise InputError(f"no plane to train; give some, as in --family horizontal:{COUNTS['horizontal']}")
    return tuple(
        Family(
            kind,
            counts[kind],
            tuple(pictures.get(kind, ())),
            texts.get(kind, ""),
            axis if kind == "parallel" else None,
            tuple(custom) if kind == "custom" else (),
            spans.get(kind, (0.0, 1.0)),
        )
        for kind in get_args(Kind)
        if kind in counts
    )


def parse_span(text: str, where: str) -> tuple[float, float]:
    """The two ends of a range given as low..high. Range [0, 1]."""
    complaint = f"{where}: give the range as parts of the whole, as in 0.2..0.8"
    low, high = parse_numbers(text.replace("..", ",", 1), 2, complaint)
    if not 0 <= low < high <= 1:
        raise InputError(complaint)
    return low, high


def parse_pictures(exemplars: list[str]) -> dict[Kind, list[Path]]:
    """The pictures of each family from --exemplar options. Raises InputError if one does not exist."""
    pictures: dict[Kind, list[Path]] = {}
    for text in exemplars:
        kind, path = parse_pair(text, "--exemplar")
        found = [Path(path)]
        if found[0].is_dir():
            files = sorted(found[0].iterdir())
            found = [file for file in files if file.suffix.lower() in PICTURE_SUFFIXES and not is_mask(file)]
            if not found:
                raise InputError(f"{path}: no picture in this folder (exemplars of the {kind} family)")
        elif not found[0].is_file():
            raise InputError(f"{path}: no such file (exemplar of the {kind} family)")
        pictures.setdefault(kind, []).extend(found)
    return pictures


def parse_pair(text: str, option: str) -> tuple[Kind, str]:
    """Kind and value of kind=value."""
    name, equals, value = text.partition("=")
    if not equals or not value:
        raise InputError(f"{option} {text}: give it as family=value, as in horizontal=cut.png")
    return parse_kind(name, f"{option} {text}"), value


def parse_kind(name: str, where: str) -> Kind:
    """The kind of family with this name."""
    for kind in get_args(Kind):
        if name == kind:
            return kind
    raise InputError(f"{where}: no family '{name}'; choose {', '.join(get_args(Kind))}")


def main() -> None:
    """Entry point: one clear line and status 2 for bad input, 130 or 143 for a run that was stopped.

    `finetune` as the first argument selects that command; otherwise a scene is trained.
    """
    name, arguments = "fruitninja-train", sys.argv[1:]
    if arguments[:1] == ["finetune"]:
        run_command(f"{name} finetune", finetune, arguments[1:])
    run_command(name, train, epilog="To teach a Stable Diffusion model an object: fruitninja-train finetune --help")


if __name__ == "__main__":
    main()
