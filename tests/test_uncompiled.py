"""The kernels as plain Python give what they give compiled: what a debugger sees is what runs."""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
SCRIPT = """
import numpy as np
import pinocchio as pin
import pincontact as pc

scene = pc.Scene.from_urdf("urdf/disk.urdf", floating_base=True)
rim, floor = scene.add_contour("rim", pc.Circle(0.3), "disk"), scene.add_contour("floor", pc.Plane())
scene.add_contact("c", rim, floor, friction=pc.Coulomb(0.2))
q = [0, 0, 0.2796, 0, 0.564642, 0, 0.825336]
state = scene.initial_state(q, [0.3, 0.2, 0, 0.2, 0.4, -9.0])
for method, options in (("DOP853", {}), ("Moreau", {"step": 0.01})):
    run = pc.simulate(scene, state, 0.03, method=method, t_eval=[0.0, 0.03], **options)
    assert run.status == 0, run.message
    print(*run.q[-1], *run.contacts["c"].force[-1])

# several contacts, of which one is open, and a traced surface of revolution
scene = pc.Scene.from_urdf("urdf/block.urdf", floating_base=True)
scene.add_contours_from_collision(links=["block"], kinds=["corners"])
ring = pc.SurfaceOfRevolution(lambda s: (2.0 + np.cos(s), np.sin(s)), (-3.0, 3.0))
scene.add_contour("ring", ring, placement=pin.SE3(np.eye(3), np.array([2.0, 0.0, -1.0])))
floor = scene.add_contour("floor", pc.Plane(), placement=pin.SE3(np.eye(3), np.array([0.0, 0.0, -1e-9])))
corners = [name for name in scene.contours if name.endswith("-z")]
for corner in corners:
    scene.add_contact(corner, corner, floor, friction=pc.Coulomb(0.2))
scene.add_contact("ring", corners[0], "ring", bilateral=False)
state = scene.initial_state([0, 0, 0.1, 0, 0, 0, 1], [0.4, 0, 0, 0, 0, 0.3], free=["ring"])
for method, options in (("RK23", {"rtol": 1e-4}), ("Moreau", {"step": 0.005})):
    run = pc.simulate(scene, state, 0.01, method=method, t_eval=[0.0, 0.01], **options)
    assert run.status == 0, run.message
    print(*run.q[-1], *run.contacts[corners[0]].force[-1])

# one degree of freedom, whose Jacobian Pinocchio gives as a vector
model = pin.Model()
joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "z")
model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
scene = pc.Scene(model)
scene.add_contact("c", scene.add_contour("ball", pc.Sphere(0.1), "z"), scene.add_contour("floor", pc.Plane()))
state = scene.initial_state([0.101], free=["c"])
for method, options in (("RK23", {"rtol": 1e-4}), ("Moreau", {"step": 0.005})):
    run = pc.simulate(scene, state, 0.02, method=method, t_eval=[0.0, 0.02], **options)
    assert run.status == 0, run.message
    print(*run.q[-1], *run.contacts["c"].force[-1])

# where there are no velocities and no tolerances, and a run of no duration, which quotients are of zeros
for state in (scene.initial_state([0.1001]), scene.initial_state([0.2], [1.0], free=["c"])):
    run = pc.simulate(scene, state, 0.0)
    assert run.status == 0, run.message
    print(*run.q[-1], *run.contacts["c"].force[-1])
"""


def numbers(text: str) -> list[np.ndarray]:
    return [np.array(line.split(), dtype=float) for line in text.splitlines()]


def test_uncompiled_kernels(monkeypatch):
    monkeypatch.chdir(ROOT)
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        exec(SCRIPT, {"__name__": "script"})
    # uncompiled, each view knows how long its array is
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PINCONTACT_CHECKED": "1"}
    command = [sys.executable, "-W", "error::RuntimeWarning", "-c", SCRIPT]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    compiled, plain = numbers(output.getvalue()), numbers(done.stdout)
    # run, but not compiled: that is what a debugger steps through
    assert [row.size for row in compiled] == [row.size for row in plain] == [10, 10, 10, 10, 4, 4, 4, 4]
    # the compiler may order sums otherwise: rounding, which a few dozen steps make a little larger
    np.testing.assert_allclose(np.concatenate(plain), np.concatenate(compiled), rtol=1e-10, atol=1e-11)
