"""Every kind of joint that Pinocchio has, on its way through a user's calls: simulate, save, plot, replay, tables."""

from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

import pincontact as pc
from pincontact.analysis.linearize import velocity_names
from pincontact.dynamics.manifold import _find_blocks


def continuous():
    """An unbounded rotation about an axis of no name, as URDF files bring it."""
    body = (
        '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="j" type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 0.6 0.8"/></joint>'
    )
    return pin.buildModelFromXML(f'<robot name="r"><link name="a"/><link name="b">{body}</robot>').joints[1]


def composite():
    joint = pin.JointModelComposite()
    joint.addJoint(pin.JointModelPX())
    joint.addJoint(pin.JointModelSpherical())
    return joint


KINDS = {
    "planar": pin.JointModelPlanar,
    "spherical": pin.JointModelSpherical,
    "free flyer": pin.JointModelFreeFlyer,
    "unbounded": pin.JointModelRUBX,
    "unbounded, unaligned": continuous,
    "z y x": pin.JointModelSphericalZYX,
    "translation": pin.JointModelTranslation,
    "helical": lambda: pin.JointModelHX(0.1),
    "universal": lambda: pin.JointModelUniversal(np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])),
    "composite": composite,
}


def two_bodies(joint):
    """A body on the joint, and a pendulum on it."""
    model = pin.Model()
    base = model.addJoint(0, joint, pin.SE3.Identity(), "base")
    inertia = pin.Inertia(1.0, np.array([0.02, 0.01, -0.1]), np.diag([0.01, 0.012, 0.014]))
    model.appendBodyToJoint(base, inertia, pin.SE3.Identity())
    model.addFrame(pin.Frame("body", base, pin.SE3.Identity(), pin.FrameType.BODY))
    hinge = model.addJoint(base, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.2])), "hinge")
    model.appendBodyToJoint(
        hinge, pin.Inertia(0.5, np.array([0.0, 0.0, -0.1]), np.diag([0.003] * 3)), pin.SE3.Identity()
    )
    return model


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_goes_all_the_way(kind, tmp_path):
    model = two_bodies(KINDS[kind]())
    scene = pc.Scene(model)
    floor = scene.add_contour("floor", pc.Plane(), placement=pin.SE3(np.eye(3), np.array([0.0, 0.0, -2.0])))
    foot = scene.add_contour("foot", pc.Sphere(0.05), "body")
    scene.add_contact("foot", foot, floor, friction=pc.Coulomb(0.3))
    state = scene.initial_state(pin.neutral(model), np.linspace(0.5, 1.0, model.nv), free=["foot"])
    run = pc.simulate(scene, state, 0.3, rtol=1e-9, atol=1e-11, energies=True)
    assert run.status == 0
    energies = run.energies()
    total = energies.kinetic + energies.potential
    # as tight as the run's tolerance, of some J
    assert np.ptp(total) < 1e-7 and np.ptp(energies.kinetic) > 1e-3
    # time stepping of first order in its step
    stepped = pc.simulate(scene, state, 0.3, method="Moreau", dt=1e-3)
    apart = pin.difference(model, stepped.q[-1], run.q[-1])
    assert np.abs(apart).max() < 0.02
    run.save(tmp_path / "run")
    again = pc.Trajectory.load(tmp_path / "run.npz")
    assert np.array_equal(again.q, run.q) and np.array_equal(again.v, run.v)
    page = pc.export_html(run, tmp_path / "run.html")
    assert page.stat().st_size > 100_000


@pytest.mark.parametrize("kind", KINDS)
def test_coordinates_of_every_kind_have_names(kind):
    pytest.importorskip("pandas", reason="pandas is in the extra `data`")
    model = two_bodies(KINDS[kind]())
    scene = pc.Scene(model)
    run = pc.simulate(scene, scene.initial_state(pin.neutral(model)), 0.01)
    table = run.to_pandas()
    assert table.columns.is_unique
    for letter, rows in (("q", run.q), ("v", run.v)):
        columns = [name for name in table.columns if name.startswith(f"{letter}.")]
        assert len(columns) == rows.shape[1] and columns[-1] == f"{letter}.hinge"
        assert all(name.startswith(f"{letter}.base") for name in columns[:-1])
        assert np.array_equal(table[columns].to_numpy(), rows)
    names = velocity_names(model)
    assert len(set(names)) == model.nv and names[-1] == "hinge" and all(n.startswith("base") for n in names[:-1])


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_drawn_in_plots(kind):
    matplotlib = pytest.importorskip("matplotlib", reason="Matplotlib is in the extra `plot`")
    matplotlib.use("Agg")
    model = two_bodies(KINDS[kind]())
    scene = pc.Scene(model)
    run = pc.simulate(scene, scene.initial_state(pin.neutral(model)), 0.01, energies=True)
    from matplotlib import pyplot

    figure, axes = pyplot.subplots()
    run.plot(kinds=["energy"], axes=[axes])
    assert all(np.isfinite(line.get_ydata()).all() for line in axes.get_lines()) and axes.get_lines()
    pyplot.close(figure)


def test_a_kind_that_is_not_known_is_refused_by_the_joints_name():
    odd = SimpleNamespace(shortname=lambda: "JointModelOdd", nq=5, nv=3, idx_q=0, idx_v=0)
    model = SimpleNamespace(njoints=2, joints=[None, odd], names=["universe", "shoulder"])
    with pytest.raises(pc.ModelError, match=r"joint 'shoulder': type JointModelOdd .* know\."):
        _find_blocks(model)
