"""What sparse regression names (SINDy, as pysindy has it): run in the peers' environment, without any of ours.

    .venv-peer/bin/python tests/campaigns/sindy_peer.py features.npz

The file has for each of two recordings, `training` and `held`, what `discrepancy_ablations.sindy_features` makes of it.
Every threshold of a grid gives a model of the training recording; that with the smallest error of the derivative on the
held-out one is taken, or the sparsest that is no worse than by one standard error, as is customary. It prints the terms
that the model has besides the nominal ones, as JSON.
"""

import json
import sys

import numpy as np

THRESHOLDS = np.geomspace(1e-4, 0.3, 30)
BLOCKS = 40


def main() -> None:
    """Prints the candidate terms that were chosen."""
    import pysindy  # not where the tests are collected

    data = np.load(sys.argv[1])
    names, nominal = data["names"].tolist(), set(data["nominal"].tolist())
    training, held = data["training"], data["held"]
    size, scale = training.std(axis=0), data["training_rate"].std()
    size[size == 0.0] = 1.0
    middle = training.mean(axis=0)
    A, B = (training - middle) / size, (held - middle) / size
    found = []
    for threshold in THRESHOLDS:
        optimizer = pysindy.STLSQ(threshold=threshold, alpha=1e-3)
        model = pysindy.SINDy(optimizer=optimizer, feature_library=pysindy.PolynomialLibrary(degree=1))
        model.fit(A, t=float(data["step_s"]), x_dot=data["training_rate"][:, None] / scale, feature_names=names)
        left = (model.predict(B)[:, 0] - data["held_rate"] / scale) ** 2
        blocks = np.array([part.mean() for part in np.array_split(left, BLOCKS)])
        chosen = [name for name, c in zip(names, model.coefficients()[0, 1:], strict=True) if c != 0.0]
        found.append((blocks.mean(), blocks.std() / BLOCKS**0.5, chosen))
    best = min(found, key=lambda one: one[0])
    within = [one for one in found if one[0] <= best[0] + best[1]]
    sparsest = min(within, key=lambda one: len(one[2]))
    print(json.dumps([name for name in sparsest[2] if name not in nominal]))


if __name__ == "__main__":
    main()
