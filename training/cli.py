"""`fruitninja-train`: the main job without a window."""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from typing import Annotated, Any, cast, get_args

import numpy as np
import typer

from engine.errors import InputError
from engine.plane import Plane
from training.events import Reporter
from training.families import COUNTS, Family, Kind
from training.run import Interrupted, PriorName, Request, run
from training.settings import DetailName

__all__ = ["main", "parse_families"]

AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


def train(
    scene: Annotated[Path, typer.Argument(help="A 3DGS .ply, or a textured mesh (.obj, .glb, .ply).")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the result.")],
    exemplar: Annotated[
        list[str] | None, typer.Option(help="A picture of a cut face: horizontal=A.png, radial=B.jpg, parallel=C.png.")
    ] = None,
    family: Annotated[
        list[str] | None,
        typer.Option(help="Planes to train: horizontal:40, radial:30, parallel:60[:x], custom:a,b,c,d."),
    ] = None,
    prompt: Annotated[
        list[str] | None, typer.Option(help="Words for a family, for priors that read: radial='a halved melon'.")
    ] = None,
    up: Annotated[
        str | None, typer.Option(help="Up axis of the scene: x, y, z, -x, -y, -z. Detected if not given.")
    ] = None,
    detail: Annotated[str, typer.Option(help="draft, standard or high.")] = "standard",
    prior: Annotated[str, typer.Option(help="What draws the inside: exemplar.")] = "exemplar",
    iterations: Annotated[int | None, typer.Option(min=0, help="Most training iterations.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same result.")] = 0,
    events: Annotated[
        str | None, typer.Option(help="One JSON object a line, to a file or to standard output (-).")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the last checkpoint in the folder.")] = False,
) -> None:
    """Give a hollow capture an inside, from a few pictures of cut faces."""
    stop = Stop()
    if not scene.is_file():
        raise InputError(f"{scene}: no such file")
    if detail not in get_args(DetailName):
        raise InputError(f"--detail {detail}: unknown; choose {', '.join(get_args(DetailName))}")
    if prior not in get_args(PriorName):
        raise InputError(f"--prior {prior}: unknown; choose {', '.join(get_args(PriorName))}")
    request = Request(
        scene=scene,
        families=parse_families(exemplar or [], family or [], prompt or []),
        detail=cast(DetailName, detail),
        up=None if up is None else parse_axis(up, "--up"),
        seed=seed,
        iterations=iterations,
        prior=cast(PriorName, prior),
    )
    reporter = Reporter.open(events)
    stop.listen()
    with reporter:
        result = run(request, out, reporter, resume, stop.asked)
    if events != "-":
        print(f"{result}\n{out / 'cuts.png'}\n{out / 'report.json'}")


class Stop:
    """Remembers that the user asked to stop, by Ctrl-C or SIGTERM; a second Ctrl-C stops at once."""

    def __init__(self) -> None:
        self.signal = 0

    def asked(self) -> bool:
        """Whether to stop."""
        return self.signal != 0

    def listen(self) -> None:
        """From now on signals are remembered instead of ending the process between two lines."""
        signal.signal(signal.SIGINT, self._notice)
        signal.signal(signal.SIGTERM, self._notice)

    def _notice(self, number: int, _: Any) -> None:
        if self.signal == signal.SIGINT == number:
            raise KeyboardInterrupt
        self.signal = number


def parse_axis(text: str, option: str) -> tuple[float, float, float]:
    """(x, y, z) of an axis given as a letter with an optional sign, or as three numbers with commas."""
    sign = -1.0 if text.startswith("-") else 1.0
    letter = text.lstrip("+-")
    if letter in AXES:
        x, y, z = (sign * value for value in AXES[letter])
        return x, y, z
    numbers = parse_numbers(text, 3, f"{option} {text}: give x, y, z, -x, -y, -z or three numbers a,b,c")
    if not any(numbers):
        raise InputError(f"{option} {text}: an axis needs a direction; give a,b,c that are not all zero")
    return numbers[0], numbers[1], numbers[2]


def parse_numbers(text: str, count: int, complaint: str) -> list[float]:
    """That many finite numbers with commas between, or InputError with the complaint."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError as error:
        raise InputError(complaint) from error
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise InputError(complaint)
    return numbers


def parse_families(exemplars: list[str], families: list[str], prompts: list[str]) -> tuple[Family, ...]:
    """Families of planes from the command line, in the order of `Kind`.

    Families given only by their pictures get the paper's number of planes. Raises InputError for anything that does
    not read, for pictures of a family without planes, and where no family is left.
    """
    pictures: dict[Kind, list[Path]] = {}
    for text in exemplars:
        kind, path = parse_pair(text, "--exemplar")
        if not Path(path).is_file():
            raise InputError(f"{path}: no such file (exemplar of the {kind} family)")
        pictures.setdefault(kind, []).append(Path(path))
    words = dict(parse_pair(text, "--prompt") for text in prompts)
    counts: dict[Kind, int] = {}
    axis: tuple[float, float, float] | None = None
    custom: list[Plane] = []
    for text in families:
        name, *parts = text.split(":")
        kind = parse_kind(name, f"--family {text}")
        if kind == "custom":
            complaint = f"--family {text}: give a plane as custom:a,b,c,d"
            a, b, c, d = parse_numbers(parts[0] if len(parts) == 1 else "", 4, complaint)
            custom.append(Plane.of((a, b, c), d))
            counts[kind] = len(custom)
            continue
        if len(parts) > (2 if kind == "parallel" else 1) or not (parts and parts[0].isdigit() and int(parts[0]) > 0):
            raise InputError(f"--family {text}: give a number of planes above zero, as in {kind}:{COUNTS[kind]}")
        counts[kind] = int(parts[0])
        if len(parts) == 2:
            axis = parse_axis(parts[1], "--family parallel")
    if not families:
        counts = {kind: COUNTS[kind] for kind in pictures}
    for kind in [*pictures, *words]:
        if not counts.get(kind):
            raise InputError(
                f"{kind}: pictures or words but no planes; add --family {kind}:{COUNTS[kind] or 'a,b,c,d'}"
            )
    if not any(pictures.values()):
        raise InputError("no picture of a cut face; give at least one, as in --exemplar horizontal=cut.png")
    return tuple(
        Family(
            kind,
            counts[kind],
            tuple(pictures.get(kind, ())),
            words.get(kind, ""),
            axis if kind == "parallel" else None,
            tuple(custom) if kind == "custom" else (),
        )
        for kind in get_args(Kind)
        if kind in counts
    )


def parse_pair(text: str, option: str) -> tuple[Kind, str]:
    """Kind and value of kind=value."""
    name, equals, value = text.partition("=")
    if not equals or not value:
        raise InputError(f"{option} {text}: give it as family=value, as in horizontal=cut.png")
    return parse_kind(name, f"{option} {text}"), value


def parse_kind(name: str, where: str) -> Kind:
    """The family of this name."""
    for kind in get_args(Kind):
        if name == kind:
            return kind
    raise InputError(f"{where}: no family '{name}'; choose {', '.join(get_args(Kind))}")


def main() -> None:
    """Entry point: one clear line and status 2 for bad input, 130 or 143 for a run that was stopped."""
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command()(train)
    try:
        app()
    except InputError as error:
        print(f"fruitninja-train: {error}", file=sys.stderr)
        sys.exit(2)
    except Interrupted as interrupted:
        print(f"fruitninja-train: stopped; go on with the same command and --resume ({interrupted})", file=sys.stderr)
        sys.exit(130)
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
