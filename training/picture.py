"""How a training went: loss and free-run error of every test over the iterations (thesis Fig. 5.11 to 5.13)."""

import io

import numpy as np
from matplotlib.figure import Figure

from faultline.training.loop import Training

BAR = 1e5


def picture(training: Training) -> bytes:
    """A PNG; errors are medians over members, dashed where they were trained, solid where they were not."""
    history, layout = training.history, training.layout
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    loss, error = figure.subplots(1, 2, width_ratios=(1.0, 1.4))
    loss.plot(history.iteration, history.loss, ".-", color="#444444")
    loss.set_title("loss of the phase's windows")
    units = [layout.model.known[test.predicts].unit for test in layout.tests]
    size = training.scaling.z_size[layout.predicts] / [BAR if unit == "Pa" else 1.0 for unit in units]
    told = ", ".join("bar" if unit == "Pa" else unit for unit in dict.fromkeys(units))
    folds = training.recipe.folds > 0
    for t, test in enumerate(layout.tests):
        seen, held = (np.array(part)[:, t] * size[t] for part in (history.seen, history.held))
        [line] = error.plot(history.iteration, held if folds else seen, label=test.name, linewidth=1.3)
        if folds:
            error.plot(history.iteration, seen, "--", color=line.get_color(), linewidth=0.8)
    error.set_title(f"free run, RMS error [{told}]" + (": held out (solid), trained on (dashed)" if folds else ""))
    error.legend(ncols=2, fontsize=8, frameon=False)
    for axes in (loss, error):
        axes.set_yscale("log")
        axes.set_xlabel("iteration")
        axes.grid(visible=True, which="both", alpha=0.2)
        axes.spines[["top", "right"]].set_visible(False)
    names = ", ".join(dict.fromkeys(stretch for stretch in training.recordings))
    figure.suptitle(f"Training of {layout.model.name} on {names} (recipe {training.recipe.name})", fontweight="bold")
    raw = io.BytesIO()
    figure.savefig(raw, format="png", dpi=110, metadata={"Software": None})
    return raw.getvalue()
