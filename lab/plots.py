"""Draws the tables that `lodestone report` writes: a heat map by blueprint, and curves by group and by run.

    pip install matplotlib
    python lab/plots.py runs/<run>/report
    python lab/plots.py sweeps/<sweep>/report

Every picture is beside its table: success.png, curves.png, and, if it was asked for, comparison.png. That of a
sweep, curves.png, has a part for each group.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot


def read(path: Path) -> list[list[str]]:
    with path.open(newline="") as file:
        return list(csv.reader(file))


def heat_map(path: Path) -> None:
    header, *rows = read(path)
    steps = [int(step) for step in header[3:]]
    values = [[float(value) if value else float("nan") for value in row[3:]] for row in rows]
    figure, axes = pyplot.subplots(figsize=(9, 2 + 0.13 * len(rows)))
    # Each column reaches from the evaluation before to its own steps, so that the last one ends with the training.
    edges = [0 if steps[0] > 0 else -1, *steps]
    image = axes.pcolormesh(edges, range(len(rows) + 1), values, vmin=0.0, vmax=1.0)
    axes.invert_yaxis()
    axes.set_yticks([row + 0.5 for row in range(len(rows))], [row[2] for row in rows], fontsize=6)
    axes.set_xlabel("environment steps")
    axes.set_title("Success by blueprint")
    figure.colorbar(image, ax=axes)
    save(figure, path)


def lines(path: Path, title: str) -> None:
    _, *rows = read(path)
    figure, axes = pyplot.subplots(figsize=(9, 5))
    for name in dict.fromkeys(row[0] for row in rows):
        of_name = [[float(value) for value in row[1:]] for row in rows if row[0] == name]
        steps, _, _, rates, low, high = zip(*of_name)
        axes.plot(steps, rates, marker="o", markersize=3, label=name)
        axes.fill_between(steps, low, high, alpha=0.15)
    axes.set_xlim(0, max(int(row[1]) for row in rows))
    axes.set_ylim(0.0, 1.02)
    axes.set_xlabel("environment steps")
    axes.set_ylabel("success, 95 % intervals")
    axes.set_title(title)
    axes.legend()
    save(figure, path)


def points(path: Path) -> None:
    """Draws the points of a sweep, a part for each group that was evaluated more than once."""
    header, *rows = read(path)
    table = [dict(zip(header, row)) for row in rows]
    by_group = {group: [row for row in table if row["group"] == group] for group in {row["group"]: None for row in table}}
    by_group = {group: of for group, of in by_group.items() if len({row["n_env_steps"] for row in of}) > 1}
    if not by_group:
        sys.exit(f"{path} has no group that was evaluated more than once")
    figure, all_axes = pyplot.subplots(1, len(by_group), figsize=(5.5 * len(by_group), 4), sharey=True, squeeze=False)
    for axes, (group, of_group) in zip(all_axes[0], by_group.items()):
        for i, name in enumerate({row["point"]: None for row in table}):
            of_point = [row for row in of_group if row["point"] == name]
            x = [int(row["n_env_steps"]) for row in of_point]
            axes.plot(x, [float(row["mean"]) for row in of_point], f"C{i}o-", markersize=3, label=name)
            ends = [[float(row[end] or row["mean"]) for row in of_point] for end in ("mean_low", "mean_high")]
            axes.fill_between(x, *ends, color=f"C{i}", alpha=0.15)
        axes.set_ylim(0.0, 1.02)
        axes.set_xlabel("environment steps")
        axes.set_title(group)
    all_axes[0][0].set_ylabel("mean success over seeds, 95 % intervals")
    all_axes[0][-1].legend()
    save(figure, path)


def save(figure: pyplot.Figure, path: Path) -> None:
    picture = path.with_suffix(".png")
    figure.savefig(picture, dpi=150, bbox_inches="tight")
    print(picture)


def main() -> None:
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    report = Path(sys.argv[1])
    if not (report / "success.csv").is_file():
        points(report / "curves.csv")
        return
    heat_map(report / "success.csv")
    lines(report / "curves.csv", "Success by group")
    if (report / "comparison.csv").is_file():
        lines(report / "comparison.csv", "Success of several runs")


if __name__ == "__main__":
    main()
