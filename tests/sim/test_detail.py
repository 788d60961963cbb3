"""Detailed visuals change what cameras see, and nothing else."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import types
import warnings
from pathlib import Path

import mujoco
import numpy as np
import pytest
from rcs_data import Dataset

import rcs
from rcs.devices import lookup
from rcs.errors import InvalidSetup
from rcs.kinematics import load
from rcs.robots.description import ArmDescription, GripperDescription, MenagerieBody, MenagerieVisuals, Mount
from rcs.robots.fr3 import FR3
from rcs.robots.franka_hand import FRANKA_HAND
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress
from rcs.rollout.replay import replay
from rcs.sim import RobotPlacement, Scene
from rcs.sim.detail import exchange_visuals

Robot = ArmDescription | GripperDescription

MAPPED: list[Robot] = [
    part
    for kind in ("arm", "gripper")
    for name in lookup.names(kind)
    if isinstance(part := lookup.find(kind, name), Robot) and part.menagerie is not None
]
"""All arms and grippers that are installed and have meshes in the collection."""

TETRAHEDRON = "v 0 0 0\nv .05 0 0\nv 0 .05 0\nv 0 0 .05\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


class DownloadError(Exception):
    """The error that the package raises without a network."""


def stand_in(root: Path) -> types.ModuleType:
    """Return a module that finds models under `root` as the package does with MENAGERIE_ROOT."""
    module = types.ModuleType("mujoco_menagerie")

    def get(name: str) -> types.SimpleNamespace:
        def xml(entry: str) -> Path:
            if not (root / name).is_dir():
                raise DownloadError(f"no network to fetch {name}")
            return root / name / f"{entry}.xml"

        return types.SimpleNamespace(xml=xml)

    module.__dict__.update(get=get, MenagerieError=DownloadError)
    return module


def write_collection(root: Path, mapped: list[MenagerieVisuals]) -> None:
    """Write models with the bodies that are mapped: a mesh to look at, a box to collide with, a joint each."""
    sources: dict[Path, dict[str, None]] = {}
    for visuals in mapped:
        names = sources.setdefault(root / visuals.model / f"{visuals.entry}.xml", {})
        names.update(dict.fromkeys(body.source for body in visuals.bodies))
    for file, names in sources.items():
        (file.parent / "assets").mkdir(parents=True, exist_ok=True)
        (file.parent / "assets" / "shape.obj").write_text(TETRAHEDRON)
        bodies = "".join(
            f"""
            <body name="{name}">
              <joint name="{name}"/>
              <geom group="2" type="mesh" mesh="shape" material="red" euler="90 0 0"/>
              <geom group="3" type="box" size="0.1 0.1 0.1"/>
            </body>"""
            for name in names
        )
        file.write_text(
            f"""
            <mujoco>
              <compiler meshdir="assets"/>
              <asset><material name="red" rgba="1 0 0 1"/><mesh file="shape.obj" scale="2 2 2"/></asset>
              <worldbody>{bodies}</worldbody>
            </mujoco>"""
        )


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A small collection in the place of the large one."""
    root = tmp_path / "collection"
    write_collection(root, [part.menagerie for part in MAPPED if part.menagerie is not None])
    return root


@pytest.fixture(params=MAPPED, ids=lambda part: part.name)
def robot(request: pytest.FixtureRequest) -> Robot:
    """An arm or a gripper with meshes in the collection."""
    return request.param


@pytest.fixture(params=["small", pytest.param("real", marks=pytest.mark.extras)])
def meshes(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """A collection that can be used: a small one in a temporary folder, and the real one where it is."""
    if request.param == "small":
        monkeypatch.setitem(sys.modules, "mujoco_menagerie", stand_in(request.getfixturevalue("root")))
    else:
        need_real_meshes()
    return request.param


def need_real_meshes() -> None:
    """Skip where the package or its models are not there; tests download nothing."""
    pytest.importorskip("mujoco_menagerie", reason="mujoco-menagerie is not installed")
    if "MENAGERIE_ROOT" not in os.environ:
        pytest.skip("MENAGERIE_ROOT is not set to a folder with models of mujoco_menagerie")


def compiled(robot: Robot, *, is_detailed: bool) -> mujoco.MjModel:
    spec = load(robot)
    if is_detailed:
        assert exchange_visuals(spec, [("", robot.menagerie)])
    return spec.compile()


def names(model: mujoco.MjModel) -> dict[str, list[str]]:
    kinds = ("body", "joint", "site", "actuator", "sensor", "camera", "tendon", "equality", "light")
    found = {kind: [getattr(model, kind)(i).name for i in range(getattr(model, COUNTS[kind]))] for kind in kinds}
    found["geom"] = [name for i in range(model.ngeom) if (name := model.geom(i).name)]
    return found


COUNTS = {
    "body": "nbody",
    "joint": "njnt",
    "site": "nsite",
    "actuator": "nu",
    "sensor": "nsensor",
    "camera": "ncam",
    "tendon": "ntendon",
    "equality": "neq",
    "light": "nlight",
}

# Which geoms belong to a body, compared by themselves below; and the scale of a joint for falling asleep, which depends
# on the extent of all geoms and is in use only where sleeping is enabled.
OF_GEOMS = {"body_geomnum", "body_geomadr", "body_bvhadr", "body_bvhnum", "dof_length"}


def collisions(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    fields = ("bodyid", "type", "contype", "conaffinity", "condim", "group", "priority", "size", "pos", "quat")
    fields += ("friction", "solref", "solimp", "margin", "gap", "rbound", "aabb")
    return {field: getattr(model, f"geom_{field}")[solid] for field in fields}


def test_bodies_joints_masses_limits_actuators_and_names_are_the_built_in_ones(robot: Robot, meshes: str) -> None:
    plain, detailed = compiled(robot, is_detailed=False), compiled(robot, is_detailed=True)
    assert detailed.nmesh > plain.nmesh == 0
    assert names(detailed) == names(plain)
    prefixes = ("body_", "jnt_", "dof_", "site_", "actuator_", "tendon_", "eq_", "exclude_", "sensor_", "wrap_", "cam_")
    compared = [field for field in dir(plain) if field.startswith(prefixes) and field not in OF_GEOMS]
    assert {"body_mass", "body_inertia", "jnt_range", "actuator_gainprm", "site_pos"} <= set(compared)
    for field in [*compared, "qpos0", "key_qpos"]:
        np.testing.assert_array_equal(getattr(detailed, field), getattr(plain, field), err_msg=field)
    for (field, one), two in zip(collisions(detailed).items(), collisions(plain).values(), strict=True):
        np.testing.assert_array_equal(one, two, err_msg=field)
    assert detailed.stat.meaninertia == plain.stat.meaninertia
    assert not detailed.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP


def test_bodies_and_sites_are_where_they_were_bit_for_bit(robot: Robot, meshes: str) -> None:
    plain, detailed = (mujoco.MjData(compiled(robot, is_detailed=is_detailed)) for is_detailed in (False, True))
    rng = np.random.default_rng(4)
    for _ in range(20):
        q = rng.uniform(*plain.model.jnt_range.T)
        for data in (plain, detailed):
            data.qpos[:] = q
            mujoco.mj_forward(data.model, data)
        for field in ("xpos", "xquat", "site_xpos", "site_xmat", "M", "qfrc_bias", "qacc"):
            np.testing.assert_array_equal(getattr(detailed, field), getattr(plain, field), err_msg=field)
        assert detailed.ncon == plain.ncon


def test_only_meshes_are_seen_and_they_neither_touch_nor_weigh(robot: Robot, meshes: str) -> None:
    spec = load(robot)
    assert exchange_visuals(spec, [("", robot.menagerie)])
    assert robot.menagerie is not None
    for body in robot.menagerie.bodies:
        geoms = spec.body(body.body).geoms
        seen = [geom for geom in geoms if geom.group <= 2]
        assert {geom.type for geom in seen} == {mujoco.mjtGeom.mjGEOM_MESH}
        assert {(geom.contype, geom.conaffinity, geom.mass) for geom in seen} == {(0, 0, 0.0)}


def test_a_robot_in_a_scene_has_the_same_names_with_either(placement: RobotPlacement, meshes: str) -> None:
    models: list[mujoco.MjModel] = []
    for assets in ("builtin", "menagerie"):
        scene = Scene.empty()
        scene.add_robot(placement, assets=assets)
        models.append(scene.compile())
    assert names(models[0]) == names(models[1])
    assert models[0].nmesh == 0
    # Arm and gripper: each has a model of its own in the collection.
    assert {models[1].mesh(i).name.rpartition("/")[0] for i in range(models[1].nmesh)} == {
        "fr3/franka_fr3",
        "fr3/gripper/franka_emika_panda",
    }


def test_an_episode_has_the_same_content_with_either_and_replays_with_either(
    meshes: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for assets in ("builtin", "menagerie"):
        setup = rcs.Setup(assets=assets)
        for _ in collect(Collection(setup=setup, out=tmp_path / assets, episodes=1, seed=3), Progress()):
            pass
    plain, detailed = (Dataset.open(tmp_path / assets) for assets in ("builtin", "menagerie"))
    assert detailed.info.setup["assets"] == "menagerie"
    assert detailed.episodes[0].length > 50
    np.testing.assert_array_equal(detailed.episodes[0].sim_state(), plain.episodes[0].sim_state())
    assert detailed.episodes[0].content_hash == plain.episodes[0].content_hash
    # The states are enough for a replay: it needs no meshes, and does not ask for them.
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert all(result.is_equal for result in replay(tmp_path / "menagerie"))


def small_arm() -> mujoco.MjSpec:
    return mujoco.MjSpec.from_string(
        """
        <mujoco>
          <worldbody>
            <body name="link">
              <inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>
              <geom group="2" type="sphere" size="0.1" contype="0" conaffinity="0" mass="0"/>
              <geom name="gel" group="2" type="sphere" size="0.1" contype="0" conaffinity="0" mass="0"/>
              <body name="tip">
                <inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>
                <geom group="2" type="sphere" size="0.1" contype="0" conaffinity="0" mass="0"/>
              </body>
            </body>
          </worldbody>
        </mujoco>"""
    )


def test_a_mesh_lies_where_the_mapping_says_and_looks_like_its_source(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    at = Mount(translation=(0.1, 0.2, 0.3), quaternion=(0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)))
    visuals = MenagerieVisuals(
        model="some_arm",
        entry="arm",
        bodies=(
            MenagerieBody(body="link", source="part_a"),
            MenagerieBody(body="link", source="part_b", source_in_body=at),
        ),
    )
    write_collection(tmp_path, [visuals])
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", stand_in(tmp_path))
    spec = small_arm()
    assert exchange_visuals(spec, [("", visuals)])
    model = spec.compile()
    # The sphere gave way to two meshes. A named geom stays, and so does a body that is not mapped.
    assert list(model.geom_type[model.geom_bodyid == model.body("link").id]) == [
        mujoco.mjtGeom.mjGEOM_SPHERE,
        mujoco.mjtGeom.mjGEOM_MESH,
        mujoco.mjtGeom.mjGEOM_MESH,
    ]
    assert model.body("tip").geomnum[0] == 1
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    source = mujoco.MjModel.from_xml_path(str(tmp_path / "some_arm" / "arm.xml"))
    reference = mujoco.MjData(source)
    mujoco.mj_kinematics(source, reference)
    first, second = (np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH))[:2]
    np.testing.assert_allclose(data.geom_xpos[first], reference.geom_xpos[0], atol=1e-12)
    np.testing.assert_allclose(data.geom_xmat[first], reference.geom_xmat[0], atol=1e-12)
    turned = np.asarray(rcs.Pose(at.translation, at.quaternion).matrix)
    np.testing.assert_allclose(data.geom_xpos[second], turned[:3, :3] @ reference.geom_xpos[0] + turned[:3, 3])
    material = model.mat(model.geom_matid[first])
    assert list(material.rgba) == [1.0, 0.0, 0.0, 1.0]
    assert model.nmesh == 1
    np.testing.assert_array_equal(model.mesh_vert, source.mesh_vert)


def warned(robots: list[RobotPlacement]) -> tuple[mujoco.MjModel, str]:
    """Return the scene with detailed visuals, and the one warning on the way."""
    scene = Scene.empty()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for robot in robots:
            scene.add_robot(robot, assets="menagerie")
    (only,) = caught
    return scene.compile(), str(only.message)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("not installed", r"not installed; pip install 'robot-control-stack\[menagerie\]'"),
        ("no network", r"no network to fetch franka_fr3.*prefetch franka_fr3 franka_emika_panda` once.*MENAGERIE_ROOT"),
        ("half a collection", "franka_emika_panda is neither on disk"),
        ("no body", "franka_fr3 of mujoco-menagerie lacks body fr3_link3"),
        ("no file", "franka_fr3 of mujoco-menagerie lacks file .*shape.obj"),
        ("not XML", "franka_fr3 is neither on disk"),
    ],
)
def test_without_meshes_one_warning_says_what_to_do_and_the_built_in_visuals_stay(
    change: str, told: str, placement: RobotPlacement, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm = root / "franka_fr3"
    if change == "no network":
        shutil.rmtree(root)
    elif change == "half a collection":
        shutil.rmtree(root / "franka_emika_panda")
    elif change == "no body":
        (arm / "fr3.xml").write_text((arm / "fr3.xml").read_text().replace("fr3_link3", "other"))
    elif change == "no file":
        (arm / "assets" / "shape.obj").unlink()
    elif change == "not XML":
        (arm / "fr3.xml").write_text("version https://git-lfs")
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", None if change == "not installed" else stand_in(root))  # pyright: ignore[reportArgumentType]
    second = RobotPlacement(name="second", arm=FR3, gripper=FRANKA_HAND)
    model, message = warned([placement, second])
    assert re.search(told, message)
    plain = Scene.empty()
    plain.add_robot(placement)
    plain.add_robot(second)
    assert model.nmesh == 0
    np.testing.assert_array_equal(model.geom_size, plain.compile().geom_size)


def test_the_package_is_not_imported_unless_it_is_asked_for() -> None:
    program = "import rcs, sys; rcs.make('Free').close(); sys.exit('mujoco_menagerie' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False, timeout=60).returncode == 0


def test_a_setup_names_the_valid_assets() -> None:
    with pytest.raises(InvalidSetup, match="assets is 'photo'; valid: 'builtin', 'menagerie'"):
        rcs.Setup(assets="photo")  # pyright: ignore[reportArgumentType]
