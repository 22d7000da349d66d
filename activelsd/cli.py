"""The command line: the verbs, and what each does with its words.

Nothing heavy is imported at the start; every verb imports what it needs.
"""

from __future__ import annotations

import argparse
import io
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, NoReturn

from activelsd.errors import ActiveLSDError, UserError, did_you_mean

if TYPE_CHECKING:
    from activelsd.evaluate.compare import Comparison

INTERRUPTED, BROKEN_PIPE = 130, 141
"""Exit codes a shell gives to a program that SIGINT or SIGPIPE ended."""

WORDS = "words are group=preset (env=modelnet policy=paper), experiment=NAME or FILE.yaml, and key=value"


SPINS = 1000
"""How often a thread of PyTorch looks for work before it sleeps, if libgomp runs the threads.

By itself it looks 300 times as often, which gains 4 % on idle cores. Where programs share cores, threads then
wait for one that waits for a core: two trainings on two cores were ten times slower. Results are the same.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a verb and return its exit code: 2 for a user's mistake, 1 for a failure, 130 for Ctrl-C."""
    if "OMP_WAIT_POLICY" not in os.environ:
        os.environ.setdefault("GOMP_SPINCOUNT", str(SPINS))  # read when PyTorch is imported
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a console need not know every letter
    try:
        code = _dispatch(list(sys.argv[1:] if argv is None else argv))
        sys.stdout.flush()
    except ActiveLSDError as error:
        print(f"activelsd: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt as stop:
        how = str(stop) or "Stopped; the same command goes on with what is done already."
        print(f"\nactivelsd: {how}", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        # The reader of the output has gone; Python's own flush at exit must not fail once more.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    return code


class _Parser(argparse.ArgumentParser):
    """argparse with this project's errors."""

    def error(self, message: str) -> NoReturn:
        raise UserError(f"{message}; see activelsd --help.")


class Verb(NamedTuple):
    """One command."""

    run: Callable[[argparse.Namespace, list[str]], int]
    usage: str
    help: str


def _parser() -> argparse.ArgumentParser:
    from activelsd import __version__

    parser = _Parser(
        prog="activelsd",
        description="Train an agent that looks around an object and names it, and compare it with others.",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"activelsd {__version__}")
    verbs = parser.add_subparsers(dest="verb", metavar="verb")
    for name, verb in VERBS.items():
        sub = verbs.add_parser(
            name,
            usage=f"activelsd {verb.usage}",
            help=verb.help,
            description=f"{verb.help}; {WORDS}." if "key=value" in verb.usage else f"{verb.help}.",
            allow_abbrev=False,
        )
        if name == "train":
            sub.add_argument(
                "--resume", metavar="RUN", type=Path, help="go on with a run from its last checkpoint"
            )
            sub.add_argument(
                "--sweep",
                metavar="KEY=A,B,C",
                action="append",
                default=[],
                help="a run per value; may be repeated",
            )
        if name in ("train", "prepare", "record"):
            sub.add_argument(
                "--dry-run", action="store_true", help="print every setting, explained, and stop"
            )
        if name == "export":
            sub.add_argument(
                "--layout", choices=("mvcnn", "rotationnet"), default="mvcnn", help="whose naming"
            )
            sub.add_argument(
                "--views", type=int, choices=(12, 20), help="a ring of 12, or a dodecahedron's 20 vertices"
            )
            sub.add_argument("--kind", choices=("shaded", "depth"), default="shaded", help="what they show")
            sub.add_argument("--size", metavar="S", type=int, default=224, help="side in pixels; 224")
        if name in ("evaluate", "compare", "figures"):
            sub.add_argument(
                "--out", metavar="DIR", type=Path, help="folder of the results; the (first) run's by default"
            )
        if name == "compare":
            sub.add_argument(
                "--baselines",
                metavar="A,B",
                type=_names,
                default=[],
                help="players beside the runs, MOVES+STOP among them",
            )
            sub.add_argument(
                "--recognisers",
                metavar="A,B",
                type=_names,
                default=[],
                help="recognisers to train on the same views, unless that is done, and to measure",
            )
            sub.add_argument("--frontier", action="store_true", help="also compare all at equal mean views")
            sub.add_argument(
                "--views", metavar="M", type=_mean, help="choose all stops for a mean of M views"
            )
    return parser


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _mean(text: str) -> float:
    try:
        views = float(text)
    except ValueError:
        views = 0.0
    if not views >= 1:
        raise UserError(f"--views {text}: must be a number of views, 1 or more, as in --views 2.5.")
    return views


def _dispatch(argv: list[str]) -> int:
    parser = _parser()
    if not argv:
        parser.print_help()
        return 0
    if not argv[0].startswith("-") and argv[0] not in VERBS:
        raise UserError(f"There is no verb '{argv[0]}'; {did_you_mean(argv[0], VERBS)}")
    arguments, rest = parser.parse_known_args(argv)
    options = [word for word in rest if word.startswith("-")]
    if options:
        known = ["--help", *(f"--{name.replace('_', '-')}" for name in vars(arguments) if name != "verb")]
        name = options[0].partition("=")[0]
        raise UserError(f"{name} is not an option of activelsd {arguments.verb}; {did_you_mean(name, known)}")
    return VERBS[arguments.verb].run(arguments, rest)


def _train(arguments: argparse.Namespace, words: list[str]) -> int:
    from activelsd.compose import sweep
    from activelsd.sections import dump

    if arguments.resume is not None:
        from activelsd.launch import resume, resumed_config

        if arguments.sweep:
            raise UserError("--resume goes on with one run and --sweep begins several; use one of them.")
        if arguments.dry_run:
            print(dump(resumed_config(arguments.resume, words)), end="")
        else:
            _say(resume(arguments.resume, words))
        return 0

    configs = sweep(words, arguments.sweep)
    if arguments.dry_run:
        print("---\n".join(dump(config) for config in configs), end="")
        return 0
    from activelsd.launch import begin

    for config in configs:
        _say(begin(config))
    return 0


def _say(run: Path) -> None:
    """Print the run's folder; only the first of several processes that train it does so."""
    from activelsd.train.parallel import is_first

    if is_first():
        print(run)


def _prepare(arguments: argparse.Namespace, words: list[str]) -> int:
    from activelsd.compose import resolve
    from activelsd.sections import dump

    config = resolve(words)
    if arguments.dry_run:
        print(dump(config), end="")
        return 0
    from activelsd.envs.viewgraph import SPLITS
    from activelsd.launch import open_worlds

    for name, graph, *_ in open_worlds(config):
        starts = ", ".join(f"{(graph.start_split == i).sum()} {split}" for i, split in enumerate(SPLITS))
        if len(config.worlds) > 1:
            print(f"World {name}")
        print(f"{len(graph.targets)} objects of {len(graph.classes)} classes")
        coloured = " in colour" if graph.channels > 1 else ""
        print(f"{len(graph.frames)} views of {graph.size} pixels{coloured}")
        print(f"Starts of episodes: {starts}")
    return 0


def _record(arguments: argparse.Namespace, words: list[str]) -> int:
    from activelsd.compose import resolve

    for name, world in resolve(words).worlds.items():
        if not world.simulated:
            raise UserError(
                f"env={name} has no simulator to record; its views are made by: activelsd prepare env={name}"
            )
    return _prepare(arguments, words)


def _export(arguments: argparse.Namespace, words: list[str]) -> int:
    from activelsd.compose import resolve

    folders = [word for word in words if "=" not in word]
    if len(folders) != 1:
        raise UserError(
            f"export needs the one folder to write to, and was given {' '.join(folders) or 'none'}; as in:"
            " activelsd export env=modelnet pictures"
        )
    if not 32 <= arguments.size <= 1024:
        raise UserError(f"--size {arguments.size}: must be from 32 to 1024.")
    config = resolve([word for word in words if "=" in word])
    from activelsd.envs.modelnet.settings import ModelNetSettings

    world, *others = config.worlds.values()
    if not isinstance(world, ModelNetSettings) or others:
        raise UserError(f"export draws the objects of env=modelnet, not of env={','.join(config.worlds)}.")
    for key in ("azimuths", "elevations", "cameras"):
        if getattr(world, key) != type(world).model_fields[key].default:
            raise UserError(f"export's cameras are those of --views; leave out env.{key}.")
    from activelsd.console import progress
    from activelsd.envs.modelnet.datasets import open_dataset
    from activelsd.envs.modelnet.export import Form, export

    views = arguments.views or (12 if arguments.layout == "mvcnn" else 20)
    form = Form(layout=arguments.layout, views=views, kind=arguments.kind, size=arguments.size)
    folder = Path(folders[0]).expanduser().absolute()
    with progress("Exporting objects") as report:
        done = export(
            open_dataset(world.dataset),
            folder,
            form,
            skip_broken=world.dataset.skip_broken,
            progress=report,
        )
    print(f"{done.pictures} pictures of {done.objects} objects, {done.written} of them new, in {folder}")
    cameras = " env.cameras=dodecahedron" if views == 20 else ""
    print(f"Read by: env=modelnet env.dataset.path={folder}{cameras}")
    return 0


def _evaluate(arguments: argparse.Namespace, words: list[str]) -> int:
    runs, settings = _runs_and_settings(words)
    if len(runs) > 1:
        raise UserError(
            f"activelsd evaluate measures one run; for several: activelsd compare {' '.join(runs)}"
        )
    from activelsd.contest import evaluate

    return _show(*evaluate(runs, settings, arguments.out))


def _compare(arguments: argparse.Namespace, words: list[str]) -> int:
    from activelsd.registry import moves_and_stop, recognisers

    runs, settings = _runs_and_settings(words)
    for check, names in ((moves_and_stop, arguments.baselines), (recognisers.check, arguments.recognisers)):
        for name in names:  # before PyTorch is imported
            check(name)
    from activelsd.contest import contest

    return _show(
        *contest(
            runs,
            arguments.baselines,
            settings,
            arguments.out,
            arguments.recognisers,
            frontier=arguments.frontier,
            views=arguments.views,
        )
    )


def _figures(arguments: argparse.Namespace, words: list[str]) -> int:
    runs, settings = _runs_and_settings(words)
    from activelsd.evaluate.views_seen import as_text
    from activelsd.figures import draw_figures

    table, files = draw_figures(runs, settings, arguments.out)
    print("\n".join(as_text(table)))
    print(f"Written: {', '.join(file.name for file in files)} in {files[0].parent}")
    return 0


def _runs_and_settings(words: list[str]) -> tuple[list[str], list[str]]:
    """Split words into folders of runs and settings; `split=val` is short for `evaluate.split=val`."""
    from activelsd.config import EvaluateSettings, RunConfig

    settings = [word for word in words if "=" in word]
    known = {**EvaluateSettings.model_fields, **RunConfig.model_fields}
    for key in (word.partition("=")[0] for word in settings):
        if key.partition(".")[0] not in known:
            raise UserError(f"{key} is not a setting; {did_you_mean(key, known)}")
    short = [word.partition("=")[0] in EvaluateSettings.model_fields for word in settings]
    whole = [f"evaluate.{word}" if own else word for word, own in zip(settings, short, strict=True)]
    return [word for word in words if "=" not in word], whole


def _show(comparisons: list[Comparison], files: list[Path]) -> int:
    from rich.console import Console

    from activelsd.evaluate.table import render, text

    console = Console(highlight=False)
    for i, comparison in enumerate(comparisons):
        if i:
            print()
        if console.is_terminal:
            console.print(render(comparison, console.width))
        else:
            print(text(comparison), end="")
    pictures = [file for file in files if file.suffix == ".png"]
    data = ", ".join(file.name for file in files if file not in pictures)
    print(f"Figures and episodes: {data} in {files[0].parent}")
    for picture in pictures:
        print(f"Picture of episodes:  {picture}")
    return 0


def _envs(arguments: argparse.Namespace, words: list[str]) -> int:
    from textwrap import fill

    from activelsd.registry import worlds

    _no_words("envs", words)
    for name in worlds.names():
        package = worlds.package(name)
        print(f"env={name}" + (f"  ({' '.join(package)})" if package else ""))
        try:
            world = worlds.get(name)
            about = {
                "Gymnasium": f'activelsd/World-v0 world="{name}"',
                "moves": ", ".join(world.moves()),
                "shows": world.about,
            }
        except Exception as error:  # noqa: BLE001  a broken package must not hide the other worlds
            why = error if isinstance(error, ActiveLSDError) else f"{type(error).__name__}: {error}"
            about = {"broken": str(why)}
        for what, text in about.items():
            print(fill(text, 80, initial_indent=f"  {what:<11}", subsequent_indent=" " * 13))
    return 0


def _doctor(arguments: argparse.Namespace, words: list[str]) -> int:
    from activelsd.doctor import examine

    _no_words("doctor", words)
    healthy = True
    for finding in examine(Path("runs")):
        healthy &= finding.good
        print(f"{finding.what:<24} {finding.state}{'' if finding.good else '   <- to be mended'}")
    return 0 if healthy else 1


def _no_words(verb: str, words: list[str]) -> None:
    if words:
        raise UserError(f"activelsd {verb} takes no words, and was given '{words[0]}'.")


VERBS = {
    "train": Verb(
        _train,
        "train env=modelnet [group=preset | key=value …] [--resume RUN] [--sweep KEY=A,B] [--dry-run]",
        "Train an agent",
    ),
    "evaluate": Verb(
        _evaluate,
        "evaluate [RUN] [--out DIR] [split=test | evaluate.key=value | env.dataset.path=PATH …]",
        "Measure a trained run",
    ),
    "compare": Verb(
        _compare,
        "compare [RUN …] --baselines A,B [--recognisers A,B] [--frontier] [--views M] [--out DIR]"
        " [evaluate.key=value | env.dataset.path=PATH …]",
        "Play runs and baselines on the same episodes; the newest run where none is named",
    ),
    "figures": Verb(
        _figures,
        "figures [RUN …] [--out DIR] [evaluate.key=value | env.dataset.path=PATH …]",
        "Draw the paper's Table 3 and Figures 3 and 4 for runs; the newest run where none is named",
    ),
    "prepare": Verb(
        _prepare,
        "prepare env=modelnet [env.key=value …] [--dry-run]",
        "Bring a world's views into the cache",
    ),
    "record": Verb(
        _record,
        "record env=thor [env.key=value …] [--dry-run]",
        "Walk a simulator's rooms once and keep all views",
    ),
    "export": Verb(
        _export,
        "export env=modelnet [env.dataset.key=value …] [--layout mvcnn|rotationnet] [--views 12|20]"
        " [--kind shaded|depth] FOLDER",
        "Write views as the picture folders of MVCNN or RotationNet",
    ),
    "envs": Verb(_envs, "envs", "List the worlds"),
    "doctor": Verb(_doctor, "doctor", "Report what this machine offers"),
}
