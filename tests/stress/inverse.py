"""Inverse dynamics within limits on random states of the quadruped and the arm, the long form of
tests/test_inverse_limits.py: equations of motion, cones, limits, certificates; and with the `bench` extra, optimality
against clarabel's cone programs.

    python tests/stress/inverse.py [--count 1000] [--seed 0]
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import scipy.sparse

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from inverse_cases import Case, by_pinocchio, check_case, kept, random_case, solve, tasks

import pincontact as pc

try:
    import clarabel
except ImportError:
    clarabel = None


def by_clarabel(case: Case, same: np.ndarray | None) -> float | None:
    """The least weighted distance from the wanted accelerations; or with those of `same` (nv,) the least norm of
    efforts. Over (a, efforts, forces on the robot), all in parts of the loads; None where clarabel has no answer."""
    equations, model = by_pinocchio(case), case.scene.model
    names, nv = list(case.scene.contacts), model.nv
    start = 6 if model.njoints > 7 else 0
    na, load = nv - start, float(np.abs(equations.nle).max())
    size = nv + na + 3 * len(names)
    dynamics = np.zeros((nv, size))
    dynamics[:, :nv] = equations.mass / load
    dynamics[start:, nv : nv + na] = -np.eye(na)
    for k, name in enumerate(names):
        at = slice(nv + na + 3 * k, nv + na + 3 * k + 3)
        dynamics[:, at] = -(equations.axes[name] @ equations.jacobians[name]).T
    constraints, values = kept(case, equations)
    # redundant rows would leave no interior of the dual
    left, sizes, right = np.linalg.svd(constraints, full_matrices=False)
    rank = int((sizes > 1e-9 * sizes[0]).sum())
    zero = [(dynamics, -equations.nle / load)]
    zero.append((np.hstack([right[:rank], np.zeros((rank, size - nv))]), (left.T @ values)[:rank] / sizes[:rank]))
    limits, cones = [], []
    bound = model.effortLimit[start:] / load
    box = np.zeros((na, size))
    box[:, nv : nv + na] = np.eye(na)
    limits += [(box, bound), (-box, bound)]
    for k, name in enumerate(names):
        at = nv + na + 3 * k
        along, across = case.mu[name]
        if equations.sticks[name]:
            cone = np.zeros((3, size))
            cone[0, at + 2], cone[1, at], cone[2, at + 1] = 1.0, 1.0 / along, 1.0 / across
            cones.append(-cone)
            continue
        squares = np.array([along, across]) ** 2 * equations.slip[name]
        slide, push = np.zeros((2, size)), np.zeros((1, size))
        slide[:, at : at + 2] = np.eye(2)
        slide[:, at + 2] = squares / np.sqrt(squares @ equations.slip[name])
        push[0, at + 2] = -1.0
        zero.append((slide, np.zeros(2)))
        limits.append((push, np.zeros(1)))
    rows, goal = tasks(case)
    wide = np.hstack([rows, np.zeros((len(rows), size - nv))])
    if same is None:
        quadratic, linear, constant = wide.T @ wide, -wide.T @ goal, 0.5 * float(goal @ goal)
    else:
        _, sizes, right = np.linalg.svd(wide, full_matrices=False)
        rank = int((sizes > 1e-9 * sizes[0]).sum())
        zero.append((right[:rank], right[:rank, :nv] @ same))
        quadratic, linear, constant = box.T @ box, np.zeros(size), 0.0
    matrix = np.vstack([*(a for a, _ in zero), *(a for a, _ in limits), *cones])
    offset = np.concatenate([*(b for _, b in zero), *(b for _, b in limits), np.zeros(3 * len(cones))])
    kinds = [
        clarabel.ZeroConeT(sum(len(b) for _, b in zero)),
        clarabel.NonnegativeConeT(sum(len(b) for _, b in limits)),
        *(clarabel.SecondOrderConeT(3) for _ in cones),
    ]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    csc = scipy.sparse.csc_matrix
    found = clarabel.DefaultSolver(csc(np.triu(quadratic)), linear, csc(matrix), offset, kinds, settings).solve()
    if str(found.status) != "Solved":
        return None
    return float(np.sqrt(max(2.0 * (found.obj_val + constant), 0.0))) * (1.0 if same is None else load)


def main(count: int, seed: int) -> int:
    failures, outcomes, compared, worst = 0, Counter(), Counter(), Counter()
    begin = time.perf_counter()
    for kind in ("quadruped", "arm"):
        for k in range(seed, seed + count):
            try:
                case = random_case(kind, k)
            except pc.NoContactError:
                # the random posture does not reach the floor
                outcomes[kind, "no state"] += 1
                continue
            try:
                outcome = check_case(case)
                outcomes[kind, outcome] += 1
                if clarabel is None or outcome == "nothing":
                    continue
                found = solve(case, unreachable="nearest")
                rows, goal = tasks(case)
                ours = float(np.linalg.norm(rows @ found.acceleration - goal))
                theirs = by_clarabel(case, None)
                if theirs is not None:
                    compared["distance"] += 1
                    worst["distance"] = max(worst["distance"], (ours - theirs) / (1.0 + np.linalg.norm(goal)))
                if outcome == "reached":
                    theirs = by_clarabel(case, found.acceleration)
                    ours = float(np.linalg.norm(found.efforts))
                    if theirs is not None:
                        compared["efforts"] += 1
                        worst["efforts"] = max(worst["efforts"], (ours - theirs) / (1.0 + theirs))
            except (AssertionError, pc.ContactError) as error:
                failures += 1
                print(f"{kind}, seed {k}: {type(error).__name__}: {' '.join(str(error).split())[:200]}")
    for (kind, outcome), number in sorted(outcomes.items()):
        print(f"{kind}: {number} {outcome}")
    for what, number in compared.items():
        print(f"{what}: {number} compared with clarabel, greater by {worst[what]:.1e} at most, relatively")
        failures += int(worst[what] > 1e-5)
    if clarabel is None:
        print("clarabel is not installed (pip install pincontact[bench]): optimality was not compared")
    print(f"{failures} failures, {time.perf_counter() - begin:.0f} s")
    return failures


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    sys.exit(main(given.count, given.seed) != 0)
