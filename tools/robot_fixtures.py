#!/usr/bin/env python3
"""Makes the robot fixtures: trimmed URDFs for config/robot/ and tables of two other libraries for tests/.

    python3 -m venv venv && venv/bin/pip install pin==4.1.* mujoco==4.0.* example-robot-data==6.0.* numpy
    venv/bin/python tools/robot_fixtures.py trim      # config/robot/{ur5,panda,xarm7}.urdf
    venv/bin/python tools/robot_fixtures.py chains    # tests/fixtures/robot/chain_*.{urdf,toml}
    venv/bin/python tools/robot_fixtures.py tables    # tests/fixtures/robot/*.f64

A table is little-endian f64 without a header, one row per state (tests/cores/robot_fixtures.rs reads it):

    p_BE (3), R_BE (9, row by row), J (6 N, row by row, [v; w] in B), tau of inverse dynamics (N),
    B(q) (lower triangle, row by row), qdd of forward dynamics (N)

The states themselves are not stored: row k holds q in [-3, 3], qd in [-2, 2], qdd in [-5, 5] and tau in [-20, 20],
4 N numbers in that order, from the splitmix64 sequence seeded with 1.

Textbook motors, which neither library knows, are put in as bodies of their own: a rotor hinged to the link before
its joint, at the joint's origin and about its axis. The arm's motion is then the linear image `G q` of its joints,
with G holding ones and gear ratios, and the projections `G^T tau`, `G^T B G` and `J G` are exact.
"""

import math
import pathlib
import re
import sys
import tomllib
import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import pinocchio as pin

ROOT = pathlib.Path(__file__).resolve().parent.parent
CONFIG = ROOT / "config" / "robot"
FIXTURES = ROOT / "tests" / "fixtures" / "robot"
STATES = {"pin": 1000, "mujoco": 100}
CHAIN_STATES = 100
G0 = 9.81


# ---------------------------------------------------------------- trimmed URDFs

SOURCES = {
    "ur5": "ur_description/urdf/ur5_robot.urdf",
    "panda": "panda_description/urdf/panda.urdf",
    "xarm7": "xarm_description/urdf/xarm7.urdf",
}


def trim():
    share = next(pathlib.Path(sys.prefix).glob("lib/python*/site-packages/cmeel.prefix/share"))
    for name, source in SOURCES.items():
        root = ET.parse(share / "example-robot-data" / "robots" / source).getroot()
        out = ET.Element("robot", name=name)
        for link in root.findall("link"):
            kept = ET.SubElement(out, "link", name=link.get("name"))
            inertial = link.find("inertial")
            if inertial is not None and float(inertial.find("mass").get("value")) > 0:
                kept.append(inertial)
        for joint in root.findall("joint"):
            kept = ET.SubElement(out, "joint", name=joint.get("name"), type=joint.get("type"))
            for tag in ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic"):
                element = joint.find(tag)
                if element is None:
                    continue
                if tag == "dynamics":  # keys beyond the format's own
                    element.attrib = {k: v for k, v in element.attrib.items() if k in ("damping", "friction")}
                kept.append(element)
        for element in out.iter():
            element.text = element.tail = None
        ET.indent(out)
        note = f"Trimmed from {source} of example-robot-data 6.0: no visuals, collisions, transmissions. See LICENCES.md."
        (CONFIG / f"{name}.urdf").write_text(f"<!-- {note} -->\n{ET.tostring(out, encoding='unicode')}\n")


# ---------------------------------------------------------------- random chains

def chains():
    for n in range(2, 8):
        rng = np.random.default_rng(100 + n)
        write_chain(rng, n, FIXTURES / f"chain_{n}.urdf")
    rng = np.random.default_rng(99)
    motors = "".join(
        f"\n[[urdf.joint]]\nname = \"joint_{i}\"\n"
        f"motor = {{ mass_kg = {rng.uniform(0.1, 2):.3f}, inertia_kg_m2 = {rng.uniform(1e-4, 1e-3):.6f}, "
        f"gear_ratio = {rng.uniform(-120, 120):.2f} }}\n"
        for i in (0, 1, 3, 4)
    ) + "armature_kg_m2 = 0.37\n"
    (FIXTURES / "chain_5_motors.toml").write_text(
        "# Textbook motors and an armature on chain_5.urdf, on a base that leans.\n"
        "name = \"chain_5_motors\"\ngravity_m_s2 = [3.0, -2.0, -9.0]\n\n"
        "[urdf]\nfile = \"chain_5.urdf\"\ntip = \"tip\"\n" + motors
    )


def vec(v):
    return " ".join(repr(float(x)) for x in v)


def random_inertial(rng, link):
    a = rng.normal(size=(3, 3))
    d = a @ a.T * 0.02 + np.eye(3) * 0.002  # second moments of a body that can exist
    inertia = np.eye(3) * np.trace(d) - d
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=vec(rng.uniform(-0.2, 0.2, 3)), rpy=vec(rng.uniform(-3, 3, 3)))
    ET.SubElement(inertial, "mass", value=repr(float(rng.uniform(0.2, 6))))
    names = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    ET.SubElement(inertial, "inertia", {k: repr(float(inertia[ij])) for k, ij in names.items()})


def write_chain(rng, n, path):
    robot = ET.Element("robot", name=path.stem)
    ET.SubElement(robot, "link", name="base")

    def add(parent, child, name, kind, inertial=True):
        link = ET.SubElement(robot, "link", name=child)
        if inertial:
            random_inertial(rng, link)
        joint = ET.SubElement(robot, "joint", name=name, type=kind)
        ET.SubElement(joint, "origin", xyz=vec(rng.uniform(-0.5, 0.5, 3)), rpy=vec(rng.uniform(-3, 3, 3)))
        ET.SubElement(joint, "parent", link=parent)
        ET.SubElement(joint, "child", link=child)
        if kind != "fixed":
            ET.SubElement(joint, "axis", xyz=vec(rng.normal(size=3)) if rng.random() < 0.7 else "0 -1 0")
            limit = {"effort": "50", "velocity": "3"}
            if kind != "continuous":
                limit |= {"lower": "-3", "upper": "3"}
            ET.SubElement(joint, "limit", limit)

    at = "base"
    for i in range(n):
        if rng.random() < 0.3:  # a fixed piece in between
            add(at, f"piece_{i}", f"weld_{i}", "fixed")
            at = f"piece_{i}"
        kind = ["revolute", "prismatic", "continuous"][int(rng.choice(3, p=[0.6, 0.25, 0.15]))]
        if i == n - 1 and n == 2:
            kind = "revolute"
        add(at, f"link_{i}", f"joint_{i}", kind)
        at = f"link_{i}"
        if rng.random() < 0.4:  # a fixed branch beside the chain
            add(at, f"branch_{i}", f"branch_weld_{i}", "fixed")
    add(at, "tip", "tip_weld", "fixed", inertial=False)
    ET.indent(robot)
    path.write_text(ET.tostring(robot, encoding="unicode") + "\n")


# ---------------------------------------------------------------- the arms as the libraries see them

class Arm:
    """A URDF text with rotors in it, the tip's link, gravity, and the map G from joints to all coordinates."""

    def __init__(self, urdf, tip, gravity, joints, motors, armature):
        self.gravity, self.tip = np.array(gravity, float), tip
        self.joints, self.armature = joints, np.array([armature.get(j, 0.0) for j in joints])
        root = ET.fromstring(urdf)
        for joint in joints:
            motor = motors.get(joint)
            if motor:
                add_rotor(root, joint, motor)
        self.gear = {f"{j}_rotor": (j, m["gear_ratio"]) for j, m in motors.items()}
        self.urdf = ET.tostring(root, encoding="unicode")

    def projection(self, names):
        G = np.zeros((len(names), len(self.joints)))
        for row, name in enumerate(names):
            joint, factor = self.gear.get(name, (name, 1.0))
            G[row, self.joints.index(joint)] = factor
        return G


def add_rotor(root, joint, motor):
    of = root.find(f"joint[@name='{joint}']")
    link = ET.SubElement(root, "link", name=f"{joint}_rotor_link")
    axis = np.array([float(x) for x in of.find("axis").get("xyz").split()])
    axis /= np.linalg.norm(axis)
    # Only the axial moment belongs to the textbook's motor. MuJoCo wants a body that can exist, so the transverse
    # moments are there too, and the link before is relieved of them: see `relieve`.
    I = motor["inertia_kg_m2"]
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz="0 0 0", rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=repr(motor["mass_kg"]))
    iso = {"ixx": repr(I), "iyy": repr(I), "izz": repr(I), "ixy": "0", "ixz": "0", "iyz": "0"}
    ET.SubElement(inertial, "inertia", iso)
    new = ET.SubElement(root, "joint", name=f"{joint}_rotor", type="continuous")
    for tag in ("origin", "parent", "axis"):
        new.append(ET.fromstring(ET.tostring(of.find(tag))))
    ET.SubElement(new, "child", link=f"{joint}_rotor_link")
    ET.SubElement(new, "limit", effort="1", velocity="1")
    relieve(root, of, axis, I)


def rpy_matrix(rpy):
    return pin.rpy.rpyToMatrix(*[float(x) for x in rpy.split()])


def relieve(root, joint, axis, I):
    """Takes `I (1 - a a^T)`, a the axis in the parent link's frame, from the parent link's inertia."""
    inertial = root.find(f"link[@name='{joint.find('parent').get('link')}']/inertial")
    if inertial is None:  # the base: it does not move
        return
    a = rpy_matrix(joint.find("origin").get("rpy")) @ axis
    R = rpy_matrix(inertial.find("origin").get("rpy"))
    a = R.T @ a
    element = inertial.find("inertia")
    d = I * (np.eye(3) - np.outer(a, a))
    for key, (i, j) in {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}.items():
        element.set(key, repr(float(element.get(key)) - float(d[i, j])))


def hold_fingers(urdf):
    root = ET.fromstring(urdf)
    for joint in root.findall("joint"):
        if "finger" in joint.get("name"):
            joint.set("type", "fixed")
            for tag in ("mimic", "limit", "axis", "dynamics"):
                for element in joint.findall(tag):
                    joint.remove(element)
    return ET.tostring(root, encoding="unicode")


def from_toml(path):
    record = tomllib.loads(path.read_text())
    urdf = hold_fingers((path.parent / record["urdf"]["file"]).read_text())
    motors = {j["name"]: j["motor"] for j in record["urdf"].get("joint", []) if "motor" in j}
    armature = {j["name"]: j.get("armature_kg_m2", 0.0) for j in record["urdf"].get("joint", [])}
    gravity = record.get("gravity_m_s2", [0, 0, -G0])
    return Arm(urdf, record["urdf"]["tip"], gravity, moving(urdf), motors, armature)


def moving(urdf):
    return [j.get("name") for j in ET.fromstring(urdf).findall("joint") if j.get("type") != "fixed"]


def from_table(path):
    """A standard Denavit-Hartenberg file as a URDF, written out anew from the textbook's definition of the table."""
    record = tomllib.loads(path.read_text())
    assert record["dh"]["convention"] == "standard"
    robot = ET.Element("robot", name=record["name"])
    ET.SubElement(robot, "link", name="base")
    before, motors, armature = "base", {}, {}
    for row in record["dh"]["joint"]:
        name = row["name"]
        joint = ET.SubElement(robot, "joint", name=name, type=row["type"])
        ET.SubElement(joint, "parent", link=before)
        ET.SubElement(joint, "child", link=f"{name}_axis")
        ET.SubElement(joint, "origin", xyz=f"0 0 {row.get('d_m', 0.0)!r}", rpy=f"0 0 {row.get('theta_rad', 0.0)!r}")
        ET.SubElement(joint, "axis", xyz="0 0 1")
        ET.SubElement(joint, "limit", lower="-9", upper="9", velocity="9", effort="9")
        ET.SubElement(robot, "link", name=f"{name}_axis")
        link = ET.SubElement(robot, "link", name=name)
        weld = ET.SubElement(robot, "joint", name=f"{name}_weld", type="fixed")
        ET.SubElement(weld, "parent", link=f"{name}_axis")
        ET.SubElement(weld, "child", link=name)
        ET.SubElement(weld, "origin", xyz=f"{row.get('a_m', 0.0)!r} 0 0", rpy=f"{row.get('alpha_rad', 0.0)!r} 0 0")
        body, moments = row["link"], row["link"]["inertia_kg_m2"]
        inertial = ET.SubElement(link, "inertial")
        ET.SubElement(inertial, "origin", xyz=vec(body.get("com_m", [0, 0, 0])), rpy="0 0 0")
        mass, moments = body["mass_kg"], {k: moments.get(k, 0.0) for k in ("xx", "yy", "zz", "xy", "xz", "yz")}
        if body.get("idealised"):
            # MuJoCo refuses bodies that cannot exist. What is put in here does not show at 1e-10: traces of mass
            # and moment, and moments about axes about which this arm never turns.
            mass = max(mass, 1e-13)
            for k in ("xx", "yy", "zz"):
                moments[k] = max(moments["zz"], 1e-13)
        ET.SubElement(inertial, "mass", value=repr(mass))
        ET.SubElement(inertial, "inertia", {f"i{k}": repr(v) for k, v in moments.items()})
        if "motor" in row:
            motors[name] = row["motor"]
        armature[name] = row.get("armature_kg_m2", 0.0)
        before = name
    tool = record.get("tool", {})
    ET.SubElement(robot, "link", name="flange")
    weld = ET.SubElement(robot, "joint", name="flange_weld", type="fixed")
    ET.SubElement(weld, "parent", link=before)
    ET.SubElement(weld, "child", link="flange")
    ET.SubElement(weld, "origin", xyz=vec(tool.get("position_m", [0, 0, 0])), rpy=vec(tool.get("rpy_rad", [0, 0, 0])))
    urdf = ET.tostring(robot, encoding="unicode")
    gravity = record.get("gravity_m_s2", [0, 0, -G0])
    return Arm(urdf, "flange", gravity, moving(urdf), motors, armature)


# ---------------------------------------------------------------- the two libraries

class Pinocchio:
    def __init__(self, arm):
        self.arm = arm
        self.model = pin.buildModelFromXML(arm.urdf)
        self.model.gravity.linear = arm.gravity
        # A continuous joint is (cos, sin) in q; velocities are plain.
        self.names = [self.model.names[i] for i in range(1, self.model.njoints)]
        self.G = arm.projection(self.names)
        self.data = self.model.createData()
        self.frame = self.model.getFrameId(arm.tip)

    def row(self, q, qd, qdd, tau):
        m, d, G = self.model, self.data, self.G
        full = np.zeros(m.nq)
        for i, value in enumerate(G @ q):
            joint = m.joints[i + 1]
            full[joint.idx_q:joint.idx_q + joint.nq] = [value] if joint.nq == 1 else [math.cos(value), math.sin(value)]
        pin.framesForwardKinematics(m, d, full)
        X = d.oMf[self.frame]
        J = pin.computeFrameJacobian(m, d, full, self.frame, pin.LOCAL_WORLD_ALIGNED) @ G
        B = pin.crba(m, d, full)
        B = G.T @ (np.triu(B) + np.triu(B, 1).T) @ G + np.diag(self.arm.armature)
        rnea = G.T @ pin.rnea(m, d, full, G @ qd, G @ qdd) + self.arm.armature * qdd
        if len(self.names) == len(q) and not self.arm.armature.any():
            fd = pin.aba(m, d, full, qd, tau)
        else:
            fd = np.linalg.solve(B, tau - G.T @ pin.rnea(m, d, full, G @ qd, np.zeros(m.nv)))
        return pack(X.translation.copy(), X.rotation.copy(), J, rnea, B, fd)


class Mujoco:
    def __init__(self, arm):
        self.arm = arm
        settings = '<mujoco><compiler fusestatic="false" discardvisual="false" strippath="false"/></mujoco>'
        text = re.sub(r"(<robot[^>]*>)", r"\1" + settings, arm.urdf, count=1)
        self.model = m = mujoco.MjModel.from_xml_string(text)
        m.opt.gravity[:] = arm.gravity
        m.dof_damping[:] = 0
        m.dof_frictionloss[:] = 0
        m.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        self.names = [m.joint(i).name for i in range(m.njnt)]
        self.G = arm.projection(self.names)
        self.data = mujoco.MjData(m)
        self.body = m.body(arm.tip).id

    def row(self, q, qd, qdd, tau):
        m, d, G = self.model, self.data, self.G
        d.qpos[:], d.qvel[:], d.qacc[:] = G @ q, G @ qd, G @ qdd
        mujoco.mj_inverse(m, d)
        rnea = G.T @ d.qfrc_inverse + self.arm.armature * qdd
        jacp, jacr = np.zeros((3, m.nv)), np.zeros((3, m.nv))
        mujoco.mj_jacBody(m, d, jacp, jacr, self.body)
        J = np.vstack([jacp, jacr]) @ G
        B = np.zeros((m.nv, m.nv))
        mujoco.mj_fullM(m, d, B)
        B = G.T @ B @ G + np.diag(self.arm.armature)
        p, R = d.xpos[self.body].copy(), d.xmat[self.body].reshape(3, 3).copy()
        if len(self.names) == len(q) and not self.arm.armature.any():
            d.qfrc_applied[:] = tau
            mujoco.mj_forward(m, d)
            fd = d.qacc.copy()
            d.qfrc_applied[:] = 0
        else:
            d.qacc[:] = 0
            mujoco.mj_inverse(m, d)
            fd = np.linalg.solve(B, tau - G.T @ d.qfrc_inverse)
        return pack(p, R, J, rnea, B, fd)


def pack(p, R, J, tau, B, qdd):
    lower = np.concatenate([B[i, : i + 1] for i in range(len(B))])
    return [np.ravel(x) for x in (p, R, J, tau, lower, qdd)]


# ---------------------------------------------------------------- tables

def uniforms():
    state, mask = 1, (1 << 64) - 1
    while True:
        state = (state + 0x9E3779B97F4A7C15) & mask
        z = state
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
        yield ((z ^ (z >> 31)) >> 11) * 2.0**-53


def states(n, count):
    source = uniforms()
    for _ in range(count):
        yield [np.array([(2 * next(source) - 1) * bound for _ in range(n)]) for bound in (3, 2, 5, 20)]


def tables():
    arms = {path.stem: from_toml(path) for path in (CONFIG / f"{n}.toml" for n in ("ur5", "panda", "xarm7"))}
    arms |= {name: from_table(CONFIG / f"{name}.toml") for name in ("scara", "pan_tilt")}
    arms["chain_5_motors"] = from_toml(FIXTURES / "chain_5_motors.toml")
    for n in range(2, 8):
        urdf = (FIXTURES / f"chain_{n}.urdf").read_text()
        arms[f"chain_{n}"] = Arm(urdf, "tip", [0, 0, -G0], moving(urdf), {}, {})
    for name, arm in arms.items():
        n = len(arm.joints)
        oracles = {"pin": Pinocchio(arm), "mujoco": Mujoco(arm)}
        count = CHAIN_STATES if name.startswith("chain") else STATES["pin"]
        rows = {key: [oracle.row(*state) for state in states(n, count)] for key, oracle in oracles.items()}
        apart = [
            max(np.abs(a[k] - b[k]).max() / np.abs(a[k]).max() for a, b in zip(rows["pin"], rows["mujoco"]))
            for k in range(6)
        ]
        print(f"{name:15} n={n} Pinocchio against MuJoCo, p R J tau B qdd:", *(f"{x:.1e}" for x in apart))
        for key, table in rows.items():
            stored = table if key == "pin" else table[: STATES["mujoco"] if count > CHAIN_STATES else 20]
            data = np.array([np.concatenate(row) for row in stored], dtype="<f8")
            (FIXTURES / f"{name}.{key}.f64").write_bytes(data.tobytes())


if __name__ == "__main__":
    FIXTURES.mkdir(parents=True, exist_ok=True)
    commands = {"trim": trim, "chains": chains, "tables": tables}
    if len(sys.argv) != 2 or sys.argv[1] not in commands:
        sys.exit(__doc__)
    commands[sys.argv[1]]()
