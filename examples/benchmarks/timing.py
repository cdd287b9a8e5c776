"""Timing of short calls on a machine that has something else to do, and the body that most of them are about."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np
import pinocchio as pin

# Batches of so many seconds: most fall between the interruptions.
BATCHES, LENGTH = 301, 5e-4


def free_body(moments: tuple[float, float, float] = (0.02, 0.03, 0.04)) -> pin.Model:
    """One free body of 1 kg with principal moments of inertia in kg m^2 and a frame "body" at its centre."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "free")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.diag(moments)), pin.SE3.Identity())
    model.addBodyFrame("body", joint, pin.SE3.Identity(), 0)
    return model


def batch(call: Callable[[], object], calls: int) -> float:
    """Seconds per call of one batch."""
    began = time.perf_counter()
    for _ in range(calls):
        call()
    return (time.perf_counter() - began) / calls


def by_turns(*calls: Callable[[], object]) -> list[float]:
    """Lower quartiles in microseconds of the calls' batches, which take turns."""
    sized = [(timed, max(1, round(LENGTH / min(batch(timed, 10) for _ in range(5))))) for timed in calls]
    times = [[batch(timed, number) for timed, number in sized] for _ in range(BATCHES)]
    return [statistics.quantiles(column, n=4)[0] * 1e6 for column in zip(*times)]
