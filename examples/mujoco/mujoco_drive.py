#!/usr/bin/env python3
"""An arm in MuJoCo behind vservo's external drive, in lockstep or in real time. See README.md beside this file.

    mujoco_drive.py ROBOT.urdf [--tip LINK] [--lock JOINT]... [--payload-kg M] [--instance NAME]
"""
import argparse
import mmap
import os
import re
import sys
import time

import iceoryx2 as iox2
import mujoco
import numpy as np

from vservo_layouts import DriveCommand, DriveFlag, DriveState, DriveText, RobotState, TextKind

TICK_NS = 1_000_000
BRAKE_NS = 100_000_000  # real time: without a command for so long the brakes close
TORQUE = 0


def lines_of(kind, lines):
    s = DriveText(stamp=time.monotonic_ns(), kind=kind)
    text = "\n".join(lines).encode()[:511]  # a zero byte stays at the end
    s.text[: len(text)] = text
    return s


def joint_names(names):
    """What control compares with the joints of its robot file."""
    s = lines_of(TextKind.JOINTS, names)
    s.joints = len(names)
    s.signs[: len(names)] = [1.0] * len(names)
    return s


def properties(by_the_clock):
    """How often states come, after how long without a command the arm is stopped, and that it obeys at once; in lockstep it waits for each. Motors that take torques at limited rates
    would add `effort_rate` and N m/s for each joint."""
    watchdog = [f"watchdog_ms {BRAKE_NS / 1e6:g}"] if by_the_clock else []
    return lines_of(TextKind.PROPERTIES, [f"period_ms {TICK_NS / 1e6:g}", "lag_ms 0", *watchdog])


class Arm:
    """The robot of a URDF file, stepped by 1 ms under joint torques."""

    def __init__(self, urdf, lock, payload_kg, payload_com, tip):
        # Links that no joint moves stay bodies of their own, so that the payload finds the flange.
        settings = '<mujoco><compiler fusestatic="false" discardvisual="true"/></mujoco>'
        text = re.sub(r"(<robot[^>]*>)", r"\1" + settings, open(urdf, encoding="utf-8").read(), count=1)
        spec = mujoco.MjSpec.from_string(text)
        for mimic in spec.equalities:
            spec.delete(mimic)
        for name in lock:
            spec.delete(spec.joint(name))
        spec.option.timestep = 1e-3
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
        if payload_kg > 0:
            load = spec.body(tip).add_body(name="payload", pos=payload_com)
            load.mass, load.inertia, load.explicitinertial = payload_kg, [1e-6] * 3, True
        self.model = spec.compile()
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        self.data, self.at_rest = mujoco.MjData(self.model), mujoco.MjData(self.model)
        self.names = [self.model.joint(i).name for i in range(self.model.njnt)]
        self.effort = efforts(text, self.names)
        self.held = True  # by its brakes, until the first command

    def start(self, q):
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = q[: self.model.nq]
        self.held = True

    def step(self):
        if not self.held:
            mujoco.mj_step(self.model, self.data)

    def brake(self):
        self.data.qvel[:] = 0
        self.held = True

    def own_torques(self, flags):
        """What this robot adds by itself to torques that do not contain it."""
        n, m, d, own = self.model.nv, self.model, self.data, np.zeros(self.model.nv)
        if not flags & DriveFlag.GRAVITY:
            self.at_rest.qpos[:] = d.qpos
            mujoco.mj_forward(m, self.at_rest)
            own += self.at_rest.qfrc_bias[:n]
        if not flags & DriveFlag.FRICTION:  # Coulomb friction changes its sign within some mrad/s, so that an arm at rest is not shaken
            own += m.dof_damping * d.qvel + m.dof_frictionloss * np.tanh(d.qvel / 2e-3)
        return own

    def obey(self, tau, flags):
        tau = np.array(tau[: self.model.nv]) + self.own_torques(flags)
        self.data.qfrc_applied[:] = np.clip(tau, -self.effort, self.effort)
        self.held = False

    def state(self, tick, stamp, flags):
        n, d = self.model.nv, self.data
        s = DriveState(tick=tick, stamp=stamp, joints=n, modes=1 << TORQUE, flags=flags | DriveFlag.TRUTH, robot_state=RobotState.READY)
        s.q[:n] = s.q_true[:n] = d.qpos.tolist()
        s.qd[:n] = s.qd_true[:n] = d.qvel.tolist()
        s.tau[:n] = d.qfrc_applied.tolist()
        return s


def efforts(text, names):
    found = {}
    for name, body in re.findall(r'<joint[^>]*name="([^"]+)"[^>]*>(.*?)</joint>', text, re.S):
        limit = re.search(r'<limit[^>]*effort="([^"]+)"', body)
        found[name] = float(limit.group(1)) if limit else np.inf
    return np.array([found[name] for name in names])


class GuardianStop:
    """The stop of vservo's guardian: two numbers in the page that control makes before START. While they differ the drive brakes by itself and holds."""

    ASKED = 88  # the number beside it says up to which stops were reset

    def __init__(self, instance):
        self.path = os.environ.get("VSERVO_ROOT", f"/dev/shm/vservo-{instance}") + "/stop"
        self.page = None

    def open(self):
        try:
            with open(self.path, "rb") as file:
                self.page = mmap.mmap(file.fileno(), 4096, prot=mmap.PROT_READ)
        except (OSError, ValueError):
            self.page = None  # a control without one

    def stands(self):
        return self.page is not None and self.page[self.ASKED : self.ASKED + 8] != self.page[self.ASKED + 8 : self.ASKED + 16]


class Ports:
    """drive/command in, drive/state out. vservo makes the services; this end waits for them."""

    def __init__(self, instance):
        root, prefix = f"/dev/shm/vservo-{instance}", f"vservo.{instance}."
        config = iox2.config.default()
        config.global_cfg.prefix = iox2.FileName.new(os.environ.get("VSERVO_PREFIX", prefix))
        config.global_cfg.root_path = iox2.Path.new(os.environ.get("VSERVO_ROOT", root))
        iox2.set_log_level(iox2.LogLevel.Fatal)
        builder = iox2.NodeBuilder.new().config(config)
        self.node = builder.signal_handling_mode(iox2.SignalHandlingMode.Disabled).create(iox2.ServiceType.Ipc)
        commands = self.patiently("drive/command", lambda s: s.publish_subscribe(DriveCommand).open())
        bell = self.patiently("drive/command", lambda s: s.event().open())
        states = self.patiently("drive/state", lambda s: s.publish_subscribe(DriveState).open())
        texts = self.patiently("drive/text", lambda s: s.publish_subscribe(DriveText).open())
        state_bell = self.patiently("drive/state", lambda s: s.event().open())
        self.listener = bell.listener_builder().create()
        self.notifier = state_bell.notifier_builder().create()
        self.commands = commands.subscriber_builder().create()
        self.texts = texts.publisher_builder().create()
        self.sent = self.told = 0
        self.states = states.publisher_builder().create()  # last: with both, the drive counts as present

    def patiently(self, name, open_):
        """Opens a service as soon as it is there: control makes it when it starts. Says why it cannot, now and then."""
        said = time.monotonic()
        while True:
            try:
                return open_(self.node.service_builder(iox2.ServiceName.new(name)))
            except Exception as e:
                if time.monotonic() - said > 4.0:
                    said = time.monotonic()
                    print(f"mujoco drive: cannot open {name} yet: {e}", file=sys.stderr)
                time.sleep(0.01)

    def receive(self, longest_ms):
        """The waiting commands, oldest first; none when nothing came for so long."""
        if longest_ms:
            self.listener.timed_wait(iox2.Duration.from_millis(longest_ms))
        while (sample := self.commands.receive()) is not None:
            command = DriveCommand.from_buffer_copy(sample.payload().contents)
            sample.delete()  # one sample may be borrowed at a time
            yield command

    def send(self, state):
        state.sequence, self.sent = self.sent, self.sent + 1
        self.states.send_copy(state)
        self.notifier.notify()

    def tell(self, text):
        text.sequence, self.told = self.told, self.told + 1
        self.texts.send_copy(text)


def run(arm, ports, guardian):
    by_the_clock, next_ns, count, obeyed_ns = False, 0, 0, 0
    while True:
        for c in ports.receive(0 if by_the_clock else 50):
            if c.flags & DriveFlag.LAST:
                return
            if c.flags & DriveFlag.START:
                guardian.open()
                arm.start(c.q_r)
                by_the_clock = not c.flags & DriveFlag.LOCKSTEP
                next_ns = time.monotonic_ns()
                ports.tell(joint_names(arm.names))  # before the answer
                ports.tell(properties(by_the_clock))
                ports.send(arm.state(0, next_ns if by_the_clock else c.stamp, DriveFlag.INITIAL))
                continue
            if c.joints != arm.model.nv or not np.isfinite(c.tau).all():
                sys.exit(f"mujoco drive: a command of {c.joints} joints, or with numbers that are none: not obeyed")
            if guardian.stands():
                continue  # below the brakes are closed, and stay so
            arm.obey(c.tau, c.flags)
            obeyed_ns = time.monotonic_ns()
            if not by_the_clock:
                arm.step()
                ports.send(arm.state(c.tick + 1, c.stamp + TICK_NS, 0))
        if by_the_clock:
            next_ns += TICK_NS
            time.sleep(max(0, next_ns - time.monotonic_ns()) * 1e-9)
            if not arm.held and (guardian.stands() or time.monotonic_ns() - obeyed_ns > BRAKE_NS):
                arm.brake()
            # An arm moves on while this program is held up: all that it missed is in the next state, not in a burst of states that no arm shows.
            missed = max(0, (time.monotonic_ns() - next_ns) // TICK_NS)
            for _ in range(1 + missed):
                arm.step()
            next_ns += missed * TICK_NS
            count += 1
            ports.send(arm.state(count, time.monotonic_ns(), 0))


def main():
    p = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    p.add_argument("urdf")
    p.add_argument("--tip", default="tool0", help="link that carries the payload")
    p.add_argument("--lock", action="append", default=[], metavar="JOINT", help="joint that does not move")
    p.add_argument("--payload-kg", type=float, default=0.0, help="a load that the controller does not know")
    p.add_argument("--payload-com-m", type=float, nargs=3, default=[0.0, 0.0, 0.05])
    p.add_argument("--instance", default=os.environ.get("VSERVO_INSTANCE", "default"))
    a = p.parse_args()
    arm = Arm(a.urdf, a.lock, a.payload_kg, a.payload_com_m, a.tip)
    print(f"mujoco drive: {arm.model.nv} joints, instance {a.instance}", file=sys.stderr)
    run(arm, Ports(a.instance), GuardianStop(a.instance))


if __name__ == "__main__":
    main()
