"""A billiard ball that is struck low and to one side: it slides, comes back rolling, lies still, and still spins.

Friction with the cloth turns the backspin round while it slows the ball down; what is left after slip has ended is
taken by rolling resistance, and the side spin, all the while, by the resistance to spinning. All three phases are of
constant acceleration, and end at events: their times and places are printed beside the closed forms.

    python examples/billiards.py [--html FILE]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import pincontact as pc

URDF = Path(__file__).resolve().parent.parent / "urdf" / "ball.urdf"
MU, ROLLING, SPINNING, G = 0.2, 4e-3, 1e-3, 9.81


def closed_form(radius: float, speed: float, backspin: float, sidespin: float) -> dict[str, float]:
    """Times in s of the ends of slip, of rolling and of spin, and the place in m where the ball lies still.

    For backspin that outlasts slip: the ball comes back.
    """
    friction, brake = MU * G / (0.4 * radius), ROLLING * G / (0.4 * radius**2)
    slides = (speed + backspin * radius) / (MU * G + (friction + brake) * radius)
    left = speed - MU * G * slides
    slowing = ROLLING * G / (1.4 * radius)
    place = (speed - 0.5 * MU * G * slides) * slides + left * abs(left) / (2.0 * slowing)
    return {
        "slides": slides,
        "rolls": slides + abs(left) / slowing,
        "spins": sidespin * 0.4 * radius**2 / (SPINNING * G),
        "place": place,
    }


def main(html: Path | None = None, speed: float = 1.5, backspin: float = 60.0, sidespin: float = 40.0) -> dict:
    scene = pc.Scene.from_urdf(URDF, floating_base=True)
    radius = float(scene.collision_model.geometryObjects[0].geometry.radius)
    ball = scene.add_contour("ball", pc.Sphere(radius), "ball")
    cloth = scene.add_contour("cloth", pc.Plane())
    scene.add_contact("ball/cloth", ball, cloth, friction=pc.Coulomb(MU, spinning=SPINNING, rolling=ROLLING))
    expected = closed_form(radius, speed, backspin, sidespin)
    duration = 1.05 * max(expected["rolls"], expected["spins"])
    state = scene.initial_state([0, 0, radius, 0, 0, 0, 1], [speed, 0, 0, 0, -backspin, sidespin])
    run = pc.simulate(scene, state, duration, rtol=1e-10, atol=1e-12, t_eval=np.linspace(0.0, duration, 401))
    ends = {event.kind: event.time for event in run.events if event.kind == "stick"}
    holds = [event.time for event in run.events if event.kind == "hold"]
    found = {
        "slides": ends["stick"],
        "rolls": min(holds, key=lambda t: abs(t - expected["rolls"])),
        "spins": min(holds, key=lambda t: abs(t - expected["spins"])),
        "place": float(run.q[-1, 0]),
    }
    for name, unit in (("slides", "s"), ("rolls", "s"), ("spins", "s"), ("place", "m")):
        print(f"{name:7s} {found[name]:.12f} {unit}, closed form {expected[name]:.12f}")
    print(f"{run.message} At rest to {np.abs(run.v[-1]).max():.1e}")
    if html is not None:
        print(f"wrote {pc.export_html(run, html)}")
    return found | {f"expected_{name}": value for name, value in expected.items()} | {"events": len(run.events)}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a replay as an HTML file")
    main(parser.parse_args().html)
