"""What sweeps in tests call: functions that worker processes can import, and runs of a few milliseconds."""

import os
import time

import numpy as np
import pinocchio as pin

import pincontact as pc

G = 9.81


def bead_on_ramp(mu, angle, duration=0.2):
    """A point mass thrown down a ramp: it slides with a constant deceleration."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "bead")
    model.appendBodyToJoint(joint, pin.Inertia(0.5, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    model.addBodyFrame("bead", joint, pin.SE3.Identity(), 0)
    scene = pc.Scene(model)
    ramp = pin.SE3(pin.utils.rotate("y", angle), np.zeros(3))
    bead, floor = scene.add_contour("bead", pc.Point(), "bead"), scene.add_contour("ramp", pc.Plane(), placement=ramp)
    scene.add_contact("c", bead, floor, friction=pc.Coulomb(mu))
    state = scene.initial_state(np.zeros(3), 2.0 * ramp.rotation[:, 0])
    return scene, state, {"duration": duration}


def path(mu, angle, duration=0.2):
    """How far it comes, m."""
    return 2.0 * duration + 0.5 * G * (np.sin(angle) - mu * np.cos(angle)) * duration**2


def distance(run):
    return {"distance": float(np.linalg.norm(run.q[-1])), "force": run.contacts["c"].force[-1]}


def figures_or_trouble(x):
    """Plain figures; a run that raises at 2, one that cannot be stored at 3, one that leaves at 4."""
    if x == 2:
        raise ValueError("two is too much")
    if x == 3:
        return {"y": object()}
    if x == 4:
        raise SystemExit(7)
    return {"y": x * x, "word": f"n{x}"}


def crashes_at_two(x):
    if x == 2:
        os._exit(3)
    return {"y": x}


def counted(x, folder):
    """Leaves a mark for every time it is called."""
    with open(os.path.join(folder, "calls"), "a") as file:
        file.write(f"{x}\n")
    return {"y": 2 * x}


def slow(x):
    time.sleep(0.05)
    return {"y": x, "process": os.getpid()}
