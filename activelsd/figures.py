"""Draws the paper's Table 3 and its Figures 3 and 4 for runs, given by their folders."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

from activelsd.contest import ELSEWHERE, Played, named_runs, play_runs, writing
from activelsd.evaluate.certainty import CertaintyStrip, certainty_strips
from activelsd.evaluate.learning import Curve, lacking, learning_curve
from activelsd.evaluate.metrics import EpisodeGroup
from activelsd.evaluate.protocol import episodes_of
from activelsd.evaluate.result_files import write_files
from activelsd.evaluate.views_seen import Table, as_csv, with_published
from activelsd.train.logging import METRICS, read_metrics
from activelsd.train.run import Run, check_writable

_LOG = logging.getLogger("activelsd")


def draw_figures(
    folders: Sequence[str], words: Sequence[str], out: Path | None = None
) -> tuple[Table, list[Path]]:
    """Plays runs, and writes `table3.png`, `table3.csv`, `figure3.png` and `figure4.png`.

    A figure that a run has nothing for is left out, with a warning that says why. If the first run has
    several worlds, there are a table and a Figure 4 for each.

    Args:
        folders: of runs; Figure 4 shows episodes of the first. None: the newest in `./runs`.
        words: settings as `key=value`, as for a contest.
        out: folder of the files; None: `figures` in the first run's.

    Returns:
        Table 3 of the runs and of the paper, and the files.

    Raises:
        UserError: a run or setting is not one there is, or the runs' episodes are not the same.
    """
    from activelsd.evaluate.paper_pictures import draw_certainty, draw_learning, draw_views_seen

    runs = named_runs(folders)
    folder = runs[0].folder / "figures" if out is None else out.expanduser()
    check_writable(folder, ELSEWHERE)  # before anything is played
    contents: dict[str, bytes] = {}
    whole: dict[str, Sequence[EpisodeGroup]] = {}
    for played in play_runs(runs, (), words):
        comparison, suffix = played.comparison, played.suffix
        own = {one.name + suffix.replace("_", ", ", 1): one.seen for one in comparison.players}
        table = with_published(own)
        whole |= table
        contents[f"table3{suffix}.png"] = draw_views_seen(table)
        contents[f"table3{suffix}.csv"] = as_csv(table).encode()
        strips = _strips(played)
        if strips:
            contents[f"figure4{suffix}.png"] = draw_certainty(strips, comparison.graph.classes)
        else:
            _LOG.warning("No episode of %s took four views; Figure 4 is left out.", runs[0].folder)
    curves = _curves(runs)
    if curves:
        contents["figure3.png"] = draw_learning(curves)
    with writing(folder):
        return whole, write_files(contents, folder)


def _strips(played: Played) -> list[CertaintyStrip]:
    """Episodes of the first run with its class distributions."""
    comparison, entrant = played.comparison, played.entrants[0]
    listed = episodes_of(
        comparison.graph, comparison.split, per_object=comparison.per_object, seed=comparison.seed
    )
    rows = comparison.rows[entrant.name]
    device = str(entrant.network.device)
    return certainty_strips(entrant.network, comparison.graph, entrant.rules, rows, listed, device=device)


def _curves(runs: Sequence[Run]) -> dict[str, Curve]:
    """The runs' curves by the names of their folders; a run whose metrics lack something is warned of."""
    curves = {}
    for run in runs:
        metrics = read_metrics(run.folder / METRICS)
        lack = lacking(metrics)
        if lack is None:
            curves[run.folder.name] = learning_curve(metrics)
        else:
            _LOG.warning(
                "%s has no %s, which Figure 3 needs, and is left out there; train it anew with this version.",
                run.folder / METRICS,
                lack,
            )
    return curves
