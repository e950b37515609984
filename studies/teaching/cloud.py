"""Draw how the cloud of estimates of two parameters shrinks as placements are added."""

from __future__ import annotations

from pathlib import Path

from studies.improve.output import BLACK, BLUE, RED, SKY
from studies.teaching.ensemble import Ensemble, ellipse, share_inside
from studies.teaching.style import GREY, WIDTH, card, save_png

PAIR = (17, 1)  # torso, z and x
SHOWN = {5: SKY, 10: BLUE, 30: RED}  # placements and colours
POSTURES = 5  # of a placement


def cloud(found: dict[int, Ensemble], path: Path) -> Path:
    """Draw the estimates of many experiments after some placements, with ellipses by the stated covariance.

    Args:
        found: by the number of placements.
    """
    with card(1, 1, WIDTH, 6.7) as (figure, axes):
        ax = axes[0, 0]
        for count, colour in SHOWN.items():
            pair = found[count].of(PAIR)
            around = ellipse(pair.truth, pair.covariance)
            inside = share_inside(pair.values, pair.truth, pair.covariance)
            label = (
                f"{count} placements, {POSTURES * count} postures: {100 * inside:.0f} % of the dots inside"
            )
            ax.plot(*pair.values.T, "o", color=colour, markersize=4, markeredgewidth=0, alpha=0.65)
            ax.plot(*around.T, color=colour, linewidth=2.2, label=label)
        ax.plot(*pair.truth, "+", color=BLACK, markersize=16, markeredgewidth=2.5, label="truth")
        ax.set_aspect("equal", adjustable="datalim")
        ax.set_xlabel("torso, upward (torso.z), mm")
        ax.set_ylabel("torso, forward (torso.x), mm")
        ax.set_title(
            f"Each dot is the estimate of one of {len(pair.values)} simulated experiments;\n"
            "the ellipses hold 95 % by the stated standard errors and correlations",
            loc="left",
        )
        handles, labels = ax.get_legend_handles_labels()
        handles.append(ax.plot([], [], " ")[0])
        labels.append("2 placements: no estimate, 20 readings for 25 parameters")
        legend = figure.legend(handles, labels, loc="outside lower center", ncols=1)
        legend.get_texts()[-1].set_color(GREY)
        return save_png(figure, path)
