"""The benchmark's scenes of many events: contacts that stick and slip, lift off, land and rattle."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from .problem import CENTRE, FLOOR, Body, Drive, G, Problem, Shape, Touch, balanced

URDF = Path(__file__).resolve().parents[3] / "urdf" / "quadruped.urdf"


def _root(function: Callable[[float], float], start: float, end: float) -> float:
    """The first zero after the start, math.inf if there is none: steps of 1e-4 s, then Brent's method."""
    from scipy.optimize import brentq

    step = 1e-4
    # what begins at zero leaves it first
    before = start + 1e-9
    while before < end:
        after = before + step
        if function(before) * function(after) <= 0.0:
            return float(brentq(function, before, after, xtol=1e-15, rtol=1e-15))
        before = after
    return math.inf


# a piece of a motion: when it begins, and positions (n,) or (n, k) at times (n,)
Piece = tuple[float, Callable[[np.ndarray], np.ndarray]]


def _joined(stretches: list[Piece], times: np.ndarray) -> np.ndarray:
    """Positions at times that are in several stretches."""
    starts = [start for start, _ in stretches]
    which = np.maximum(np.searchsorted(starts, times, side="right") - 1, 0)
    return np.array([stretches[k][1](np.array([t]))[0] for k, t in zip(which, times)])


def forced_block() -> Problem:
    """A block on four feet, pushed to and fro by a force that friction holds for a part of each half period.

    Its feet slip alike, so it moves as one particle does: a polynomial and a sine while it slips, nothing between.
    """
    mass, mu, push, rate, duration = 2.0, 0.4, 14.0, 9.0, 10.0
    feet = [Shape("point", (), "block", (x, y, -0.05)) for x in (-0.2, 0.2) for y in (-0.1, 0.1)]
    a, b = push / (mass * rate), mu * G

    def stretches() -> list[Piece]:
        found: list[Piece] = []
        t0 = x0 = 0.0
        while t0 < duration:
            # at rest until the push exceeds what friction holds, which is in the first or the third quarter of a period
            if abs(push * math.sin(rate * t0)) <= mu * mass * G:
                found.append((t0, lambda t, x0=x0: np.full(t.shape, x0)))  # type: ignore[misc]
                half = math.ceil(rate * t0 / math.pi - math.asin(mu * mass * G / push) / math.pi)
                t0 = (half * math.pi + math.asin(mu * mass * G / push)) / rate
            sign, begins, at = math.copysign(1.0, math.sin(rate * t0)), t0, x0

            def speed(t: float, begins: float = begins, sign: float = sign) -> float:
                return a * (math.cos(rate * begins) - math.cos(rate * t)) - sign * b * (t - begins)

            def place(t: np.ndarray, begins: float = begins, sign: float = sign, at: float = at) -> np.ndarray:
                after, phase = t - begins, rate * begins
                swing = a * math.cos(phase) * after - a / rate * (np.sin(rate * t) - math.sin(phase))
                return at + swing - 0.5 * sign * b * after**2

            found.append((t0, place))
            t0 = _root(speed, t0, duration)
            x0 = float(place(np.array([t0]))[0]) if math.isfinite(t0) else 0.0
        return found

    def closed_form(times: np.ndarray) -> np.ndarray:
        x = _joined(stretches(), times)
        return np.column_stack([0.2 + x, np.full_like(x, 0.1), np.zeros_like(x)])[:, None, :]

    drive = Drive(push * np.eye(6)[0], rate, np.zeros(6))
    return Problem("forced_block", "block on four feet, pushed to and fro",
                   (Body("block", "free", mass, np.diag([0.02, 0.03, 0.04])),),
                   tuple(Touch(foot, FLOOR, mu) for foot in feet), np.array([0, 0, 0.05, 0, 0, 0, 1.0]), np.zeros(6),
                   duration, (("block", (0.2, 0.1, -0.05)),), "a foot", closed_form, drive=drive,
                   events=True)  # fmt: skip


def belt() -> Problem:
    """A mass on a spring sticks and slips on a heavy moving belt while a force shakes it.

    Linear in each mode, so both motions are sines and polynomials piece by piece. The belt is a body of its own, of a
    thousand times the mass, so that no engine has to prescribe a motion.
    """
    carriage, shoe, heavy, stiffness, mu, push, rate = 0.5, 0.5, 1000.0, 100.0, 0.4, 2.0, 6.0
    mass, grip, speed, duration = carriage + shoe, mu * shoe * G, 0.15, 10.0

    def closed_form(times: np.ndarray) -> np.ndarray:
        return _joined(_on_belt(mass, heavy, stiffness, grip, push, rate, speed, duration), times)[:, None, :]

    bodies = (
        Body("belt", "prismatic", heavy, np.eye(3), axis=(1.0, 0.0, 0.0)),
        Body("carriage", "prismatic", carriage, 1e-3 * np.eye(3), axis=(1.0, 0.0, 0.0), stiffness=stiffness),
        Body("shoe", "prismatic", shoe, 1e-3 * np.eye(3), "carriage"),
    )
    touch = Touch(Shape("point", (), "shoe"), Shape("plane", (), "belt"), mu)
    return Problem("belt", "stick-slip oscillator on a belt", bodies, (touch,), np.zeros(3),
                   np.array([speed, speed, 0.0]), duration, (("shoe", CENTRE),), "mass", closed_form,
                   drive=Drive(push * np.eye(3)[1], rate, np.zeros(3)), events=True)  # fmt: skip


def _on_belt(
    mass: float, heavy: float, stiffness: float, grip: float, push: float, rate: float, speed: float, duration: float
) -> list[Piece]:
    """Stretches of the mass (x, 0, 0), which starts at x = 0 with the speed of the belt."""
    t0, x0, v0, belt = 0.0, 0.0, speed, speed
    sign, found = 0.0, []
    while t0 < duration:
        # m x'' = -k x + friction + push sin(rate t); friction is sign * grip, or that of masses which move as one
        inertia, steady = (mass, sign * grip / stiffness) if sign else (mass + heavy, 0.0)
        omega = math.sqrt(stiffness / inertia)
        shake = push / (stiffness - inertia * rate**2)
        c = x0 - steady - shake * math.sin(rate * t0)
        d = (v0 - shake * rate * math.cos(rate * t0)) / omega
        given = t0, omega, shake, steady, c, d

        def place(t, given=given):
            begins, omega, shake, steady, c, d = given
            phase = omega * (t - begins)
            return steady + shake * np.sin(rate * t) + c * np.cos(phase) + d * np.sin(phase)

        def velocity(t, given=given):
            begins, omega, shake, _, c, d = given
            phase = omega * (t - begins)
            return shake * rate * np.cos(rate * t) + omega * (d * np.cos(phase) - c * np.sin(phase))

        def held(t, place=place):
            """The friction that keeps the mass on the belt."""
            pulled = push * np.sin(rate * t) - stiffness * place(t)
            return pulled * (mass / (mass + heavy) - 1.0)

        def belt_speed(t, sign=sign, begins=t0, belt=belt):
            return belt - sign * grip / heavy * (t - begins)

        found.append((t0, lambda t, place=place: np.column_stack([place(t), np.zeros_like(t), np.zeros_like(t)])))
        if sign:
            t0 = _root(lambda t: float(belt_speed(t) - velocity(t)), t0, duration)
        else:
            t0 = _root(lambda t: float(grip - abs(held(t))), t0, duration)
        if math.isfinite(t0):
            x0, v0 = float(place(t0)), float(velocity(t0))
            belt, force = v0, float(held(t0))
            # from stick it slips; where slip ends it sticks if friction can hold it
            sign = math.copysign(1.0, force) if not sign or abs(force) > grip else 0.0
    return found


def rattle() -> Problem:
    """A capsule without friction falls on one end and then the other, ever faster, until it lies.

    Most of its mass is beyond its ends, so an end that lands lifts the other, with (1 - k) / (1 + k) of the speed where
    k = m l^2 / I. Between impacts it turns about one end, of which one quadrature is the time.
    """
    mass, half, radius, moment, raised = 1.0, 0.2, 0.05, 0.16, 0.3
    k = mass * half**2 / moment
    nodes, weights = np.polynomial.legendre.leggauss(40)

    def fall_time(top: float, s: np.ndarray) -> np.ndarray:
        """Time from the sine `top` of the inclination at rest to the sine top (1 - s^2): smooth in s."""
        x = 0.5 * np.multiply.outer(s, nodes + 1.0)
        sine = top * (1.0 - x * x)
        slowness = np.sqrt((moment + mass * half**2 * (1.0 - sine**2)) / (1.0 - sine**2))
        return math.sqrt(2.0 * top / (mass * G * half)) * 0.5 * s * (slowness @ weights)

    def closed_form(times: np.ndarray) -> np.ndarray:
        one = np.ones(1)
        # when the capsule is at the top of each hop, and how high
        tops, sines = [0.0], [math.sin(raised)]
        while sines[-1] > 1e-17:
            sine = sines[-1] * ((1.0 - k) / (1.0 + k)) ** 2
            tops.append(tops[-1] + float(fall_time(sines[-1], one)[0] + fall_time(sine, one)[0]))
            sines.append(sine)
        out = np.zeros((len(times), 2, 3))
        for i, t in enumerate(times):
            lands = [top + float(fall_time(sine, one)[0]) for top, sine in zip(tops, sines)]
            hop = int(np.searchsorted(lands, t))
            sine = 0.0
            if hop < len(tops):
                wanted = abs(t - tops[hop])
                s = wanted / float(fall_time(sines[hop], one)[0])
                for _ in range(50):
                    at = sines[hop] * (1.0 - s * s)
                    rate = math.sqrt((moment + mass * half**2 * (1.0 - at**2)) / (1.0 - at**2))
                    rate *= math.sqrt(2.0 * sines[hop] / (mass * G * half))
                    s -= (float(fall_time(sines[hop], np.array([s]))[0]) - wanted) / rate
                sine = sines[hop] * (1.0 - s * s)
            reach = half * math.sqrt(1.0 - sine**2)
            out[i, :, 0] = reach, -reach
            # the end that is up: the first one first
            out[i, :, 2] = radius
            out[i, hop % 2, 2] += 2.0 * half * sine
        return out

    ends = [(half, 0.0, 0.0), (-half, 0.0, 0.0)]
    q = np.r_[0.0, 0.0, radius + half * math.sin(raised), 0.0, -math.sin(0.5 * raised), 0.0, math.cos(0.5 * raised)]
    touches = tuple(
        Touch(Shape("sphere", (radius,), "capsule", end), FLOOR, 0.0, apart=apart)
        for end, apart in zip(ends, (True, False))
    )
    body = Body("capsule", "free", mass, np.diag([0.02, moment, moment]))
    return Problem("rattle", "capsule rattling to rest", (body,), touches, q, np.zeros(6), 1.0,
                   tuple(("capsule", end) for end in ends), "its ends", closed_form, events=True)  # fmt: skip


def trot() -> Problem:
    """The quadruped of urdf/quadruped.urdf trots, on joint springs, dampers and torques that are sines of time.

    Diagonal legs bend and stretch together and swing forward while they are up. It starts where they begin to bend.
    """
    shank, bend, stiffness, damping, mu = 0.16, 0.6, 150.0, 1.5, 1.0
    rate, lift, swing = 4.0 * math.pi, 0.05, 0.08
    height = 2.0 * shank * math.cos(bend)
    q, standing, amplitude, phase = np.zeros(19), np.zeros(19), np.zeros(18), np.zeros(18)
    q[2], standing[2], q[6], standing[6] = height * math.cos(swing), height, 1.0, 1.0
    touches = []
    for leg, name in enumerate(("fl", "fr", "hl", "hr")):
        first = 1.0 if name in ("fl", "hr") else -1.0
        hip, knee = 3 * leg + 1, 3 * leg + 2
        standing[7 + hip], standing[7 + knee] = bend, -2.0 * bend
        q[7 + hip], q[7 + knee] = bend + first * swing, -2.0 * bend
        # the knee bends with a sine, the hip with half of it; and it swings with a cosine
        amplitude[6 + hip], phase[6 + hip] = first * stiffness * math.hypot(lift, swing), math.atan2(swing, lift)
        amplitude[6 + knee] = -2.0 * first * stiffness * lift
        touches.append(Touch(Shape("point", (), f"{name}_shank", (0.0, 0.0, -shank)), FLOOR, mu))
    base, *legs = _from_urdf()
    sprung = (base, *(replace(link, stiffness=stiffness, damping=damping) for link in legs))
    return Problem("trot", "trotting quadruped", balanced(sprung, standing, tuple(touches)), tuple(touches), q,
                   np.zeros(18), 2.0, (("base", CENTRE),), "origin of the base", drive=Drive(amplitude, rate, phase),
                   events=True)  # fmt: skip


def _from_urdf() -> tuple[Body, ...]:
    """The links of the URDF, whose frames and inertias are not turned."""
    robot = ElementTree.parse(URDF).getroot()
    joints = {joint.find("child").get("link"): joint for joint in robot.iter("joint")}  # type: ignore[union-attr]

    def numbers(element: Any, path: str, key: str) -> tuple[float, float, float]:
        x, y, z = (float(number) for number in element.find(path).get(key).split())
        return x, y, z

    found = []
    for link in robot.iter("link"):
        name, inertia = str(link.get("name")), link.find("inertial/inertia")
        xx, yy, zz = (float(inertia.get(key)) for key in ("ixx", "iyy", "izz"))  # type: ignore[union-attr, arg-type]
        mass = float(link.find("inertial/mass").get("value"))  # type: ignore[union-attr, arg-type]
        body = Body(name, "free", mass, np.diag([xx, yy, zz]), com=numbers(link, "inertial/origin", "xyz"))
        if joint := joints.get(name):
            parent = str(joint.find("parent").get("link"))  # type: ignore[union-attr]
            place, axis = numbers(joint, "origin", "xyz"), numbers(joint, "axis", "xyz")
            body = replace(body, joint="revolute", parent=parent, place=place, axis=axis)
        found.append(body)
    return tuple(found)


EVENT_SCENES: dict[str, Callable[[], Problem]] = {make.__name__: make for make in (forced_block, belt, rattle, trot)}
