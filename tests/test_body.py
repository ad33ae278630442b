"""The MJCF body: masses, scaling, limits, contacts."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from questsim.body import build_body
from questsim.errors import InputError
from questsim.skeleton import DOFS, LINKS


def standing(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data


def test_default_body_has_published_mass_links_and_hinges() -> None:
    model = build_body().model
    assert model.body_mass.sum() == pytest.approx(70.0, rel=1e-6)
    assert (model.nbody - 1, model.nv - 6, model.nu) == (16, 33, 33)
    assert [model.body(i).name for i in range(1, 17)] == list(LINKS)
    assert [model.actuator(i).name for i in range(33)] == list(DOFS)


def test_default_body_is_as_tall_as_it_says() -> None:
    model = build_body().model
    data = standing(model)
    head = model.geom("head")
    top = data.geom("head").xpos[2] + head.size[2]
    assert top == pytest.approx(1.75, abs=0.002)
    soles = [model.geom(i).id for i in range(model.ngeom) if "heel_ball" in model.geom(i).name]
    assert len(soles) == 4
    assert min(data.geom_xpos[i, 2] - model.geom_size[i, 0] for i in soles) == pytest.approx(0.0)


@pytest.mark.parametrize("height", [1.2, 1.45, 2.2])
def test_default_scaling_follows_geometric_similarity(height: float) -> None:
    s = height / 1.75
    body, reference = build_body(height), build_body()
    for link in LINKS[1:]:
        np.testing.assert_allclose(
            body.model.body(link).pos, reference.model.body(link).pos * s, atol=1e-12
        )
    np.testing.assert_allclose(body.model.body_mass, reference.model.body_mass * s**3)
    np.testing.assert_allclose(body.model.body_inertia, reference.model.body_inertia * s**5)
    np.testing.assert_allclose(body.torque_limits, reference.torque_limits * s**3)
    np.testing.assert_allclose(body.damping, reference.damping * s**3)
    links = reference.model.geom_bodyid > 0
    np.testing.assert_allclose(body.model.geom_size[links], reference.model.geom_size[links] * s)
    np.testing.assert_allclose(body.model.geom_pos[links], reference.model.geom_pos[links] * s)
    np.testing.assert_allclose(body.model.site_pos, reference.model.site_pos * s)


def test_paper_preset_scales_linearly_with_200_newton_metres_and_two_substeps() -> None:
    body, default = build_body(2.1, "paper"), build_body()
    s = 2.1 / 1.75
    np.testing.assert_allclose(body.torque_limits, 200.0 * s)
    np.testing.assert_allclose(body.model.body_mass, default.model.body_mass * s)
    np.testing.assert_allclose(body.model.body_inertia, default.model.body_inertia * s)
    np.testing.assert_allclose(np.ravel(body.model.dof_frictionloss)[6:], 0.1 * s)
    assert body.substeps == 2
    assert body.model.opt.timestep == pytest.approx(1 / 72)


@pytest.mark.parametrize("height", [1.19, 2.21, 175.0])
def test_heights_outside_the_range_are_refused(height: float) -> None:
    with pytest.raises(InputError, match=r"outside 1\.2-2\.2 m"):
        build_body(height)


def test_foot_sensors_carry_the_weight_of_the_standing_body() -> None:
    model = build_body().model
    data = standing(model)
    springs = 4.0 * np.ravel(model.dof_damping)[6:] / 0.04
    for _ in range(60):
        data.ctrl[:] = -springs * data.qpos[7:]
        mujoco.mj_step(model, data)
    force = data.sensordata.reshape(2, 3)
    assert -force[:, 2].sum() == pytest.approx(70.0 * 9.81, rel=0.1)


def test_foot_sensors_feel_the_floor_and_not_the_other_foot() -> None:
    model = build_body(1.75, self_collision=True).model
    data = mujoco.MjData(model)
    data.qpos[2] = 3.0
    data.joint("left_hip_x").qpos, data.joint("right_hip_x").qpos = -0.1, 0.1
    mujoco.mj_forward(model, data)
    touching = {model.body(model.geom_bodyid[geom]).name for geom in data.contact.geom.ravel()}
    assert {"left_foot", "right_foot"} <= touching
    np.testing.assert_array_equal(data.sensordata, 0.0)


def test_links_collide_with_each_other_only_on_request() -> None:
    def contacts(self_collision: bool) -> int:
        model = build_body(1.75, self_collision=self_collision).model
        data = mujoco.MjData(model)
        data.qpos[2] = 3.0
        data.joint("left_shoulder_x").qpos = np.radians(-40)
        data.joint("left_shoulder_y").qpos = np.radians(-40)
        data.joint("left_elbow_y").qpos = np.radians(-40)
        mujoco.mj_forward(model, data)
        return int(data.ncon)

    assert contacts(self_collision=False) == 0
    assert contacts(self_collision=True) > 0


def test_upright_body_does_not_touch_itself() -> None:
    model = build_body(1.75, self_collision=True).model
    data = mujoco.MjData(model)
    data.qpos[2] = 3.0
    mujoco.mj_forward(model, data)
    assert data.ncon == 0
